//! The light map as glTF: the files that the scene was made of as edits have left them.

use std::collections::BTreeSet;
use std::sync::Arc;

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::atlas::{BYTES_PER_TEXEL, atlas_of};
use super::coding::encode_body;
use super::extract::Coding;
use super::lightmap::{self, Chosen};
use super::problem::{ApiResult, Problem};
use super::uploads::{load_problem, memory_problem};
use crate::engine::{self, Atlas, LightAbout, LitScene, Originals};
use crate::pictures::Watch;
use crate::state::App;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

/// Bytes per element while its vertices are made and written.
const BYTES_PER_ELEMENT: u64 = 400;
/// Bytes per byte of a file that is copied: the file, what it is opened to, what is written of it.
const COPIES: u64 = 4;

/// How a light map is laid out in glTF.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum GlbLayout {
    /// By element: the subdivided meshes.
    Vertices,
    /// By texel: the meshes as they are, with `TEXCOORD_1` on pages of the atlas.
    Atlas,
}

/// What is asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wish {
    pub(super) layout: Option<GlbLayout>,
    pub(super) unlit: Option<bool>,
}

/// Files of a scene, as they were uploaded.
struct Files {
    upload: Bytes,
    assets: Vec<(String, Bytes)>,
}

/// The scene with its light map.
pub(super) async fn glb(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    published: Arc<Published>,
    (chosen, wish): (Chosen, Wish),
    coding: Coding,
) -> ApiResult<Bytes> {
    let default = if published.world.atlas().is_some() { GlbLayout::Atlas } else { GlbLayout::Vertices };
    let atlas = match wish.layout.unwrap_or(default) {
        GlbLayout::Atlas => Some(atlas_of(app, scene, &published).await?),
        GlbLayout::Vertices => None,
    };
    // Materials that shine by their light map are what viewers without lights can show of it.
    let unlit = wish.unlit.unwrap_or(atlas.is_some());
    // Who does not say how it is to be laid out maps elements to vertices: surfaces alone, in the order of slots.
    let by_slot = wish.layout.is_none() && wish.unlit.is_none() && atlas.is_none();
    let (watch, its_app, its_scene) = (Watch::default(), Arc::clone(app), Arc::clone(scene));
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let work = move || {
        let _turn = turn;
        if by_slot {
            let bytes = published.world.element_count() as u64 * BYTES_PER_ELEMENT;
            let _promise = its_app.memory.promise(bytes, 0).map_err(|full| memory_problem("file", full))?;
            let (values, _) = lightmap::values(&published, &chosen).map_err(Problem::internal)?;
            let file = engine::lightmap_glb(&published.world, &lightmap::finite(&values));
            return encode_body(coding, file.map_err(Problem::internal)?).map_err(Problem::internal);
        }
        let files = files_of(&its_app, &its_scene, &published)?;
        let bytes = files.bytes() * COPIES + light_bytes(&published, atlas.as_deref());
        let promise = its_app.memory.promise(bytes, 0);
        let _promise = promise.map_err(|full| memory_problem("file", full))?;
        let originals = files.open()?;
        let (values, _) = lightmap::values(&published, &chosen).map_err(Problem::internal)?;
        let values = lightmap::finite(&values);
        let about = LightAbout { version: Some(published.version), estimated_rmse: published.stated_rmse() };
        let atlas = atlas.as_deref();
        let world = &published.world;
        let lit = LitScene { world, atlas, values: &values, originals: &originals, unlit, about };
        let file = engine::lit_glb(&lit, &watch).map_err(Problem::internal)?;
        encode_body(coding, file).map_err(Problem::internal)
    };
    app.compute.draw(work).await?
}

/// What writing the light takes.
fn light_bytes(published: &Published, atlas: Option<&Atlas>) -> u64 {
    match atlas {
        Some(atlas) => {
            atlas.pages().iter().map(|page| u64::from(page.width) * u64::from(page.height)).sum::<u64>()
                * BYTES_PER_TEXEL
        }
        None => published.world.element_count() as u64 * BYTES_PER_ELEMENT,
    }
}

/// The upload, and the assets that objects were inserted from.
fn files_of(app: &App, scene: &SceneEntry, published: &Published) -> ApiResult<Files> {
    let objects = published.world.scene.objects.iter();
    let ids: BTreeSet<&str> = objects.filter_map(|object| object.asset.as_deref()).collect();
    let asset = |id: &str| Ok::<_, Problem>((id.to_owned(), app.store.asset(id)?));
    Ok(Files { upload: app.store.upload(scene.number)?, assets: ids.into_iter().map(asset).collect::<ApiResult<_>>()? })
}

impl Files {
    fn bytes(&self) -> u64 {
        (self.upload.len() + self.assets.iter().map(|(_, file)| file.len()).sum::<usize>()) as u64
    }

    /// One after the other: each is let go once it is open.
    fn open(self) -> ApiResult<Originals> {
        let open = |file: &Bytes| engine::open_original(file).map_err(load_problem);
        let scene = Some(open(&self.upload)?);
        let assets = self.assets.into_iter().map(|(id, file)| Ok((id, open(&file)?)));
        Ok(Originals { scene, assets: assets.collect::<ApiResult<_>>()? })
    }
}
