//! `EDITS.json`: edit cases of a scene, and the worlds before and after.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use glam::{DMat4, Vec3};
use rebake_core::scene::{LightKind, LoadLimits, Scene, load_glb};
use rebake_core::{Edit, Transition, World, WorldOptions};
use serde::Deserialize;

/// A file of edit cases; paths in it are relative to the file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EditFile {
    /// The scene's `.glb`.
    pub scene: PathBuf,
    /// Cases in order.
    pub cases: Vec<Case>,
}

/// One edit of a scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// For people.
    pub name: String,
    /// What is done.
    pub edit: CaseKind,
    /// Objects it is done to; `*` matches any part of a name. For `insert` they are taken out first.
    #[serde(default)]
    pub objects: Vec<String>,
    /// For `insert`: a `.glb` to put in.
    pub asset: Option<PathBuf>,
    /// Column-major; identity where absent.
    pub transform: Option<[f64; 16]>,
    /// For `material`.
    pub albedo: Option<[f32; 3]>,
}

/// Kinds of edit that a case can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CaseKind {
    /// Puts objects or an asset in.
    Insert,
    /// Takes objects out.
    Remove,
    /// Gives objects another transform.
    Move,
    /// Gives objects another albedo.
    Material,
}

/// A case made ready: the scene before it and the edits that lead to the scene after it.
pub struct PreparedCase {
    /// From the case.
    pub name: String,
    /// World before the edit.
    pub before: World,
    /// As a client would send them.
    pub edits: Vec<Edit>,
    /// To the world after the edit.
    pub transition: Transition,
}

impl EditFile {
    /// Reads a file of cases.
    pub fn read(path: &Path) -> Result<EditFile> {
        let text = std::fs::read_to_string(path).with_context(|| format!("{}", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is not a file of edit cases", path.display()))
    }
}

impl Case {
    /// Loads what the case needs from `folder` and applies it.
    pub fn prepare(&self, scene: &Scene, folder: &Path, options: &WorldOptions) -> Result<PreparedCase> {
        let transform = self.transform.map_or(DMat4::IDENTITY, |t| DMat4::from_cols_array(&t));
        let names = self.named_objects(scene)?;
        let mut before = scene.clone();
        let edits = match self.edit {
            CaseKind::Insert => {
                let asset = match &self.asset {
                    Some(path) => {
                        let path = folder.join(path);
                        let bytes = std::fs::read(&path).with_context(|| format!("{}", path.display()))?;
                        load_glb(&bytes, &LoadLimits::default())?
                    }
                    None if names.is_empty() => bail!("case {:?}: objects or an asset are needed", self.name),
                    None => take_out(&mut before, &names),
                };
                vec![Edit::Insert { asset: Arc::new(asset), name: format!("inserted: {}", self.name), transform }]
            }
            CaseKind::Remove => vec![Edit::Remove { objects: names }],
            CaseKind::Move => names.into_iter().map(|object| Edit::Move { object, transform }).collect(),
            CaseKind::Material => {
                let albedo = Vec3::from(self.albedo.with_context(|| format!("case {:?}: albedo is missing", self.name))?);
                names.into_iter().map(|object| Edit::Material { object, albedo }).collect()
            }
        };
        let before = World::new(before, options)?;
        let transition = before.apply(&edits)?;
        Ok(PreparedCase { name: self.name.clone(), before, edits, transition })
    }

    fn named_objects(&self, scene: &Scene) -> Result<Vec<String>> {
        let mut names = Vec::new();
        for pattern in &self.objects {
            let regular = |name: &str| rebake_core::edit::name_matches(pattern, name);
            let found: Vec<String> =
                scene.objects.iter().filter(|o| regular(&o.name)).map(|o| o.name.clone()).collect();
            if found.is_empty() {
                bail!("case {:?}: the scene has no object {pattern:?}", self.name);
            }
            names.extend(found);
        }
        Ok(names)
    }
}

/// Moves objects, with the lights on them, into a scene of their own.
fn take_out(scene: &mut Scene, names: &[String]) -> Scene {
    let mut asset = Scene { cameras: Vec::new(), warnings: Vec::new(), ..scene.clone() };
    let named = |name: &String| names.contains(name);
    asset.objects.retain(|o| named(&o.name));
    scene.objects.retain(|o| !named(&o.name));
    let on_named = |kind: &LightKind| matches!(kind, LightKind::Emissive { object, .. } if named(object));
    asset.lights.retain(|l| on_named(&l.kind));
    scene.lights.retain(|l| !on_named(&l.kind));
    asset
}
