//! A scene as another machine can have it: the files that it was made of, and how it came to be. The same world comes
//! of it wherever it is made, bit for bit.

use std::collections::BTreeSet;
use std::sync::Arc;

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::objects::Objects;
use super::{ClusterError, FORMAT};
use crate::api::edit_parse;
use crate::engine::{World, layout_hash};
use crate::jobs::queue::SceneNumber;
use crate::restore;
use crate::store::lighting::Sequence;
use crate::store::records::{Origin, SceneRecord};
use crate::store::{Store, StoreError};

/// How a scene came to be, by hashes of files.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Manifest {
    format: u32,
    /// Version of who wrote it: others might make another world of the same files.
    version: String,
    /// Hash of the world's elements.
    layout: String,
    record: SceneRecord,
    upload: String,
    assets: BTreeSet<String>,
    /// Bodies of edits.
    edits: Vec<Box<RawValue>>,
}

/// A scene that others are told of.
pub(crate) struct Told<'a> {
    pub(crate) scene: SceneNumber,
    /// Up to which of its edits.
    pub(crate) sequence: Sequence,
    /// As it is then.
    pub(crate) world: &'a World,
}

/// What a manifest is made of: read from the store, with its files.
pub(super) struct Gathered {
    manifest: Manifest,
    files: Vec<Bytes>,
}

/// Reads what others need. May take its time.
pub(super) fn gather(store: &dyn Store, told: &Told<'_>) -> Result<Gathered, StoreError> {
    let Origin { record, edits } = store.origin(told.scene, told.sequence)?;
    let odd = |error: &dyn std::fmt::Display| StoreError::damaged("an edit cannot be read again", error);
    let mut assets: BTreeSet<String> = record.outside.sky.iter().map(|sky| sky.asset.clone()).collect();
    for body in &edits {
        let parsed = edit_parse::parse(body, usize::MAX).map_err(|problem| odd(&problem))?;
        assets.extend(edit_parse::used_assets(&parsed).into_iter().map(str::to_owned));
    }
    let raw = |body: Vec<u8>| {
        let text = String::from_utf8(body).map_err(|error| odd(&error))?;
        RawValue::from_string(text).map_err(|error| odd(&error))
    };
    let edits = edits.into_iter().map(raw).collect::<Result<_, _>>()?;
    let upload = store.upload(told.scene)?;
    let mut files = assets.iter().map(|id| store.asset(id)).collect::<Result<Vec<Bytes>, _>>()?;
    let hash = blake3::hash(&upload).to_hex().to_string();
    files.push(upload);
    let (layout, version) = (layout_hash(told.world), env!("CARGO_PKG_VERSION").to_owned());
    let manifest = Manifest { format: FORMAT, version, layout, record, upload: hash, assets, edits };
    Ok(Gathered { manifest, files })
}

impl Gathered {
    /// Puts all of it where others find it, and answers the manifest's hash.
    pub(super) async fn put(self, objects: &Objects) -> Result<String, ClusterError> {
        for file in self.files {
            objects.put_file(file).await?;
        }
        let bytes = serde_json::to_vec(&self.manifest).map_err(|error| ClusterError::odd("a snapshot", error))?;
        objects.put_file(bytes.into()).await
    }
}

/// A scene's files.
pub(super) struct Fetched {
    manifest: Manifest,
    upload: Bytes,
    assets: Vec<(String, Bytes)>,
}

/// Fetches all of a snapshot.
pub(super) async fn fetch(objects: &Objects, hash: &str) -> Result<Fetched, ClusterError> {
    let manifest = objects.file(hash).await?;
    let manifest: Manifest =
        serde_json::from_slice(&manifest).map_err(|error| ClusterError::odd("a snapshot", error))?;
    if manifest.format != FORMAT || manifest.version != env!("CARGO_PKG_VERSION") {
        return Err(ClusterError::OtherVersion(manifest.version));
    }
    let upload = objects.file(&manifest.upload).await?;
    let mut assets = Vec::new();
    for id in &manifest.assets {
        assets.push((id.clone(), objects.file(id).await?));
    }
    Ok(Fetched { manifest, upload, assets })
}

impl Fetched {
    /// Keeps the files as those of a scene.
    pub(super) fn keep(&self, store: &dyn Store, scene: SceneNumber) -> Result<(), StoreError> {
        self.assets.iter().try_for_each(|(id, file)| store.asset_added(id, file))?;
        store.scene_created(scene, &self.manifest.record, &self.upload, None, None)
    }

    /// The world as it came to be: seconds for large scenes.
    pub(super) fn build(self) -> Result<Arc<World>, ClusterError> {
        let Manifest { record, edits, layout, .. } = self.manifest;
        let edits = edits.iter().map(|body| body.get().as_bytes().to_vec()).collect();
        let assets = self.assets.iter().map(|(id, file)| (id.as_str(), &**file));
        let world = restore::world_of(&self.upload, assets, &Origin { record, edits });
        let world = world.map_err(|error| ClusterError::odd("a snapshot", error))?;
        match layout_hash(&world) == layout {
            true => Ok(Arc::new(world)),
            false => Err(ClusterError::OtherLayout),
        }
    }
}
