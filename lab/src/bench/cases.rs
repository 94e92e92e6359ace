//! `EDITS.json`: edit cases of a scene, and the worlds before and after.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use glam::{DMat4, Vec3};
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{LightKind, LoadLimits, Scene, load, load_path};
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
    /// The world after the edit with one tree over everything: what a bake from scratch would have built.
    pub after: World,
}

impl EditFile {
    /// Reads a file of cases.
    pub fn read(path: &Path) -> Result<EditFile> {
        let cannot = || format!("cannot read {}", path.display());
        let text = std::fs::read_to_string(path).with_context(cannot)?;
        EditFile::from_json(&text).with_context(cannot)
    }

    /// Cases from the text of a file. Errors name the field at fault.
    pub fn from_json(text: &str) -> Result<EditFile> {
        let mut json = serde_json::Deserializer::from_str(text);
        let file: EditFile = serde_path_to_error::deserialize(&mut json)?;
        json.end()?;
        ensure!(!file.cases.is_empty(), "cases: is empty");
        Ok(file)
    }
}

impl Case {
    /// Loads what the case needs from `folder` and applies it. Errors name the field at fault.
    pub fn prepare(&self, scene: &Scene, folder: &Path, options: &WorldOptions) -> Result<PreparedCase> {
        let (before, edits) = self.edits(scene, folder)?;
        let before = World::new(as_uploaded(&before)?, options)?;
        let transition = before.apply(&edits)?;
        let trees = transition.after.rebuilt_trees();
        let after = transition.after.with_trees(trees).context("the trees do not fit the scene")?;
        Ok(PreparedCase { name: self.name.clone(), before, edits, transition, after })
    }

    /// The scene before the edit, and the edit as a client would send it.
    fn edits(&self, scene: &Scene, folder: &Path) -> Result<(Scene, Vec<Edit>)> {
        let names = self.named_objects(scene)?;
        if names.is_empty() && !(self.edit == CaseKind::Insert && self.asset.is_some()) {
            bail!(
                "objects: name at least one{}",
                if self.edit == CaseKind::Insert { ", or give an asset" } else { "" }
            );
        }
        let mut before = scene.clone();
        let edits = match self.edit {
            CaseKind::Insert => {
                let asset = match &self.asset {
                    Some(_) if !names.is_empty() => bail!("asset: give either objects or an asset, not both"),
                    Some(path) => load_asset(&folder.join(path)).context("asset")?,
                    None => take_out(&mut before, &names),
                };
                let name = format!("inserted: {}", self.name);
                vec![Edit::Insert {
                    asset: Arc::new(as_uploaded(&asset).context("asset")?),
                    name,
                    transform: self.transform.map_or(DMat4::IDENTITY, |t| matrix(&t)),
                }]
            }
            CaseKind::Remove => vec![Edit::Remove { objects: names }],
            CaseKind::Move => {
                let transform = matrix(&self.transform.context("transform: is missing")?);
                names.into_iter().map(|object| Edit::Move { object, transform }).collect()
            }
            CaseKind::Material => {
                let albedo = Vec3::from(self.albedo.context("albedo: is missing")?);
                names.into_iter().map(|object| Edit::Material { object, albedo }).collect()
            }
        };
        Ok((before, edits))
    }

    fn named_objects(&self, scene: &Scene) -> Result<Vec<String>> {
        let mut names: Vec<String> = Vec::new();
        for (k, pattern) in self.objects.iter().enumerate() {
            let matches = |name: &str| rebake_core::edit::name_matches(pattern, name);
            let found = names.len();
            let new = scene.objects.iter().filter(|o| matches(&o.name) && !names.contains(&o.name));
            let new: Vec<String> = new.map(|o| o.name.clone()).collect();
            names.extend(new);
            if names.len() == found && !names.iter().any(|name| matches(name)) {
                bail!("objects[{k}]: the scene has no object {pattern:?}");
            }
        }
        Ok(names)
    }
}

impl PreparedCase {
    /// Area of the edited objects over that of the scene that holds them.
    pub fn edited_share(&self) -> f64 {
        let edited = |name: &str| {
            self.edits.iter().any(|edit| match edit {
                Edit::Insert { name: inserted, .. } => inserted == name,
                Edit::Remove { objects } => objects.iter().any(|o| o == name),
                Edit::Move { object, .. } | Edit::Material { object, .. } => object == name,
                _ => false,
            })
        };
        let inserts = self.edits.iter().any(|edit| matches!(edit, Edit::Insert { .. }));
        let world = if inserts { &self.transition.after } else { &self.before };
        let (mut part, mut all) = (0.0, 0.0);
        for object in world.objects() {
            let first = object.first_element as usize;
            let area: f64 =
                world.areas().range(first..first + object.element_count as usize).copied().map(f64::from).sum();
            all += area;
            part += if edited(object.name) { area } else { 0.0 };
        }
        part / all
    }
}

fn matrix(columns: &[f64; 16]) -> DMat4 {
    DMat4::from_cols_array(columns)
}

fn load_asset(path: &Path) -> Result<Scene> {
    let cannot = || format!("cannot load {}", path.display());
    load_path(path, &LoadLimits::default()).with_context(cannot)
}

/// A scene as a service reads it that it is sent to. Transforms are rounded on the way, and where an edge is as long as
/// the spacing allows the last bit decides how it is cut.
fn as_uploaded(scene: &Scene) -> Result<Scene> {
    Ok(load(&write_scene_glb(scene)?, &LoadLimits::default())?)
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
