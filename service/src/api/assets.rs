//! Assets: what is uploaded to be inserted later, and pictures of the sky.

use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use bytes::Bytes;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::extract::{ApiPath, ApiQuery, read_upload, require_content_type};
use super::keys::{Keyed, Turn};
use super::paging::Page;
use super::problem::{ApiResult, Kind, Problem};
use super::scenes::ListQuery;
use super::types::{Asset, Bounds};
use super::{Shared, require_serving, uploads};
use crate::engine;
use crate::state::App;
use crate::store::assets::{Assets, Content, Listed, NoRoom, Stays};

/// Media types of pictures of the sky.
const PICTURE_TYPES: &[&str] = &["image/x-exr", "image/vnd.radiance"];

/// An asset in a list.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct AssetSummary {
    /// Content hash: what `insert` and `sky` name.
    #[schema(example = "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24")]
    asset: String,
    /// Name of its first object; absent of a picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "chair")]
    name: Option<String>,
    /// Triangles in the file; 0 of a picture.
    triangles: u64,
    /// What it fills in its own space, metres; absent where it has no triangles.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    bounds: Option<Bounds>,
    /// Texels across and down of a picture of the sky, as it is kept; absent of what can be inserted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    picture: Option<[u32; 2]>,
    /// Bytes of the file.
    bytes: u64,
    /// Bytes that it takes of the service's memory.
    memory_bytes: u64,
    /// Scenes that use it: while there is one, it cannot be deleted.
    scenes: Vec<String>,
}

/// One page of assets.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct AssetPage {
    /// Newest first; those from before a restart come behind those after it.
    items: Vec<AssetSummary>,
    /// Asks for the next page; absent on the last.
    next_cursor: Option<String>,
}

/// Uploads an asset to insert later, or a picture of the sky. The same bytes give the same id: 201 the first time, 200
/// afterwards.
///
/// Pictures are equirectangular: linear RGB radiance as OpenEXR (channels R, G and B) or Radiance, at most 8192 × 4096
/// pixels; kept are at most 2048 × 1024, their means. The top is +y, the middle lies towards +x, the right half towards +z.
#[utoipa::path(
    post, path = "/v1/assets", tag = "assets", operation_id = "create_asset",
    params(
        ("Idempotency-Key" = Option<String>, Header, description = "Refuses another file with the same key: repeating an upload is safe without one, too"),
    ),
    request_body(content(
        (Vec<u8> = "model/gltf-binary"), (Vec<u8> = "model/gltf+json"), (Vec<u8> = "application/zip"),
        (Vec<u8> = "image/x-exr"), (Vec<u8> = "image/vnd.radiance"), (Vec<u8> = "application/octet-stream")
    ), description = "A `.glb`, a `.gltf` that holds its files, or one with them as a zip archive; or a picture of the sky; of the last type any of these"),
    responses((status = 201, body = Asset, description = "Uploaded"), (status = 200, body = Asset, description = "Known already"))
)]
pub(super) async fn create(State(app): Shared, headers: HeaderMap, body: Body) -> ApiResult<(StatusCode, Json<Asset>)> {
    require_serving(&app)?;
    require_content_type(&headers, &[uploads::GLB_TYPES, PICTURE_TYPES].concat())?;
    let is_picture = require_content_type(&headers, PICTURE_TYPES).is_ok();
    let turn = Turn::of(&app, &headers).await?;
    let (file, _room) = read_upload(&app, &headers, body).await?;
    let key = Keyed::new(&app, turn, "asset".to_owned(), &file).await?;
    let is_known = key.as_ref().map(Keyed::known).transpose()?.flatten().is_some();
    let permit = uploads::upload_permit(&app).await?;
    let its_app = app.clone();
    let add = move || {
        let _permit = permit;
        let added = add(&its_app, &file, is_picture || engine::is_sky(&file))?;
        if let Some(record) = key.filter(|_| !is_known).map(|key| key.record(None, None)) {
            its_app.store.upload_keyed(&record)?;
            its_app.upload_keys.insert(record);
        }
        Ok(added)
    };
    app.compute.build(add).await?
}

/// Keeps an asset. One that is refused leaves nothing behind.
fn add(app: &App, file: &Bytes, is_picture: bool) -> ApiResult<(StatusCode, Json<Asset>)> {
    let (content, warnings) = if is_picture {
        let (picture, warnings) =
            engine::load_sky(file, app.config.limits.upload_bytes).map_err(uploads::load_problem)?;
        (Content::from(picture), warnings)
    } else {
        let scene = engine::load(file, &app.config.limits, None).map_err(uploads::load_problem)?;
        uploads::check_strengths(&scene)?;
        let warnings = scene.warnings.clone();
        (Content::from(scene), warnings)
    };
    let id = Assets::id_of(file);
    let (triangles, picture) = (triangles(&content), size(&content));
    let asset = Asset { asset: id.clone(), triangles, picture, warnings };
    let _change = app.assets.change();
    if app.assets.get(&id).is_some() {
        return Ok((StatusCode::OK, Json(asset)));
    }
    let full = |NoRoom| Problem::new(Kind::TooManyAssets, "there is no room for another asset");
    app.assets.check_room(file.len()).map_err(full)?;
    let promise = app.memory.promise(content.memory_bytes(), 0);
    let _promise = promise.map_err(|full| uploads::memory_problem("asset", full))?;
    app.store.asset_added(&id, file)?;
    app.assets.insert(id, content, file.len());
    Ok((StatusCode::CREATED, Json(asset)))
}

/// All assets, newest first.
#[utoipa::path(
    get, path = "/v1/assets", tag = "assets", operation_id = "list_assets", params(ListQuery),
    responses((status = 200, body = AssetPage, description = "A page of assets"))
)]
pub(super) async fn list(State(app): Shared, ApiQuery(query): ApiQuery<ListQuery>) -> ApiResult<Json<AssetPage>> {
    let page = Page::new(&app.config, query.limit, query.cursor.as_deref())?;
    let assets = app.assets.older_than(page.before, page.limit + 1);
    let (assets, next_cursor) = page.cut(assets, |asset| asset.number);
    let items = assets.into_iter().map(|asset| summary(&app, asset)).collect();
    Ok(Json(AssetPage { items, next_cursor }))
}

/// Deletes an asset that no scene needs.
#[utoipa::path(
    delete, path = "/v1/assets/{asset}", tag = "assets", operation_id = "delete_asset",
    params(("asset" = String, Path, description = "The asset's content hash")),
    responses((status = 204, description = "Deleted"))
)]
pub(super) async fn delete(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<StatusCode> {
    require_serving(&app)?;
    let its_app: Arc<App> = app.clone();
    let delete = move || {
        let deleted = its_app.assets.delete(&id, || its_app.store.asset_deleted(&id))?;
        deleted.map_err(|stays| match stays {
            Stays::Unknown => Problem::new(Kind::AssetNotFound, format!("there is no asset {id:?}")),
            Stays::Needed(scenes) => {
                let scenes: Vec<String> = scenes.iter().take(5).map(|number| its_app.ids.scene(*number)).collect();
                Problem::new(Kind::AssetNeeded, format!("the asset is used by {}", scenes.join(", ")))
            }
        })
    };
    app.compute.run(delete).await??;
    Ok(StatusCode::NO_CONTENT)
}

fn summary(app: &App, asset: Listed) -> AssetSummary {
    AssetSummary {
        name: name(&asset.content),
        bounds: asset.bounds.map(|(min, max)| Bounds { min: min.to_array(), max: max.to_array() }),
        triangles: triangles(&asset.content),
        picture: size(&asset.content),
        bytes: asset.bytes as u64,
        memory_bytes: asset.memory_bytes,
        scenes: asset.needed_by.iter().map(|number| app.ids.scene(*number)).collect(),
        asset: asset.id,
    }
}

fn name(content: &Content) -> Option<String> {
    let Content::Model(scene) = content else { return None };
    scene.objects.first().map(|object| object.name.clone())
}

fn triangles(content: &Content) -> u64 {
    let Content::Model(scene) = content else { return 0 };
    scene.objects.iter().map(|object| object.mesh.triangles.len() as u64).sum()
}

fn size(content: &Content) -> Option<[u32; 2]> {
    let Content::Picture(picture) = content else { return None };
    let (width, height) = picture.size();
    Some([width as u32, height as u32])
}
