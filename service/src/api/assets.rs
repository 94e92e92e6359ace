//! Assets: what is uploaded to be inserted later.

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};

use super::extract::{read_body, require_content_type};
use super::problem::{ApiResult, Kind, Problem};
use super::types::Asset;
use super::{Shared, require_serving, uploads};
use crate::engine;
use crate::store::assets::{Assets, NoRoom};

/// Uploads an asset to insert later. The same bytes give the same id: 201 the first time, 200 afterwards.
#[utoipa::path(
    post, path = "/v1/assets", tag = "assets", operation_id = "create_asset",
    request_body(content = Vec<u8>, content_type = "model/gltf-binary", description = "A `.glb`, or a `.gltf` with its files as a zip archive"),
    responses((status = 201, body = Asset, description = "Uploaded"), (status = 200, body = Asset, description = "Known already"))
)]
pub(super) async fn create(State(app): Shared, headers: HeaderMap, body: Body) -> ApiResult<(StatusCode, Json<Asset>)> {
    require_serving(&app)?;
    require_content_type(&headers, uploads::GLB_TYPES)?;
    let permit = uploads::upload_permit(&app).await?;
    let glb = read_body(&app, &headers, body, app.config.limits.upload_bytes).await?;
    let its_app = app.clone();
    let add = move || {
        let _permit = permit;
        let scene = engine::load(&glb, &its_app.config.limits, None).map_err(uploads::load_problem)?;
        let id = Assets::id_of(&glb);
        let triangles = scene.objects.iter().map(|object| object.mesh.triangles.len() as u64).sum();
        let asset = Asset { asset: id.clone(), triangles, warnings: scene.warnings.clone() };
        its_app.store.asset_added(&id, &glb)?;
        let full = |NoRoom| Problem::new(Kind::TooManyAssets, "there is no room for another asset");
        let is_new = its_app.assets.insert(id, scene, glb.len()).map_err(full)?;
        Ok((if is_new { StatusCode::CREATED } else { StatusCode::OK }, Json(asset)))
    };
    app.compute.build(add).await?
}
