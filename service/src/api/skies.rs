//! Light from outside: what uploads and edits say of it, checked, and its pictures found.

use std::sync::Arc;

use glam::Vec3;
use rebake_core::allowed::Allowed;
use rebake_core::scene::LightKind;

use super::edit_types;
use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};
use super::upload_query::CreateQuery;
use crate::engine::{Edit, Outside, Scene, SkyPicture};
use crate::store::assets::{Assets, Content};
use crate::store::records::{StoredOutside, StoredSky};

/// What an upload asks for beside `environment`.
pub(super) fn asked_for(query: &CreateQuery) -> ApiResult<StoredOutside> {
    let invalid = |field: &str, reason: &str| Err(Problem::field(Kind::InvalidQuery, field, reason));
    let sun_angle = query.sun_angle.unwrap_or(0.0);
    if !(0.0..180.0).contains(&sun_angle) {
        return invalid("sun_angle", "has to be at least 0 and below 180");
    }
    let outside = StoredOutside { sky: None, default_sky: query.default_sky.unwrap_or(false), sun_angle };
    let Some(asset) = &query.sky else {
        return match (query.sky_rotation, query.sky_strength) {
            (None, None) => Ok(outside),
            (Some(_), _) => invalid("sky_rotation", "comes without `sky`"),
            (None, Some(_)) => invalid("sky_strength", "comes without `sky`"),
        };
    };
    if query.environment.is_some() {
        return invalid("sky", "may not come with `environment`: a scene has one or the other");
    }
    check_turn(Allowed::ASKED, query.sky_rotation, query.sky_strength, "sky_", Kind::InvalidQuery)?;
    let (rotation, strength) = (query.sky_rotation.unwrap_or(0.0), query.sky_strength.unwrap_or(1.0));
    Ok(StoredOutside { sky: Some(StoredSky { asset: asset.clone(), rotation, strength }), ..outside })
}

/// Light from outside as an upload asked for it, with its picture.
pub(crate) fn outside(environment: Option<[f32; 3]>, asked_for: &StoredOutside, assets: &Assets) -> ApiResult<Outside> {
    let sky = match (&asked_for.sky, environment) {
        (Some(sky), _) => Some((turned(picture(&sky.asset, "sky", assets)?, sky.rotation), Vec3::ONE, sky.strength)),
        (None, Some(radiance)) => Some((LightKind::Environment, Vec3::from_array(radiance), 1.0)),
        (None, None) => None,
    };
    Ok(Outside { sky, default_sky: asked_for.default_sky, sun_angle: asked_for.sun_angle.to_radians() })
}

/// The engine's edit of the sky.
pub(super) fn edit(sky: &edit_types::Sky, path: &str, assets: &Assets, allowed: Allowed) -> ApiResult<Edit> {
    let intensity = sky.strength.unwrap_or(1.0);
    let prefix = if path.is_empty() { String::new() } else { format!("{path}.") };
    check_turn(allowed, sky.rotation, sky.strength, &prefix, Kind::InvalidValue)?;
    let (kind, color) = match (&sky.asset, &sky.radiance) {
        (Some(asset), None) => {
            let picture = picture(asset, &join(path, "asset"), assets)?;
            (turned(picture, sky.rotation.unwrap_or(0.0)), Vec3::ONE)
        }
        (None, Some(radiance)) => {
            let radiance = Vec3::from_array(*radiance);
            allowed.check_strength(Some(radiance), Some(intensity)).map_err(|_| {
                let reason = format!("each has to be 0 to {:e}, times `strength` as well", allowed.brightest);
                Problem::field(Kind::InvalidValue, join(path, "radiance"), reason)
            })?;
            (LightKind::Environment, radiance)
        }
        (Some(_), Some(_)) => {
            let reason = "may not come with `asset`: the sky is one or the other";
            return Err(Problem::field(Kind::InvalidValue, join(path, "radiance"), reason));
        }
        (None, None) => {
            let reason = "neither it nor `radiance` is given";
            return Err(Problem::field(Kind::InvalidValue, join(path, "asset"), reason));
        }
    };
    Ok(Edit::Sky { kind, color, intensity })
}

/// Checks rotation and strength, whose names begin with `prefix`.
fn check_turn(
    allowed: Allowed,
    rotation: Option<f32>,
    strength: Option<f32>,
    prefix: &str,
    kind: Kind,
) -> ApiResult<()> {
    if rotation.is_some_and(|rotation| !rotation.is_finite()) {
        return Err(Problem::field(kind, format!("{prefix}rotation"), "has to be finite"));
    }
    let told = allowed.check_strength(None, strength);
    told.map_err(|error| Problem::field(kind, format!("{prefix}strength"), error.reason))
}

/// `rotation`: degrees.
fn turned(picture: Arc<SkyPicture>, rotation: f32) -> LightKind {
    LightKind::Sky { picture, rotation: rotation.rem_euclid(360.0).to_radians() }
}

/// The model that an asset is.
pub(super) fn model(id: &str, field: &str, assets: &Assets) -> ApiResult<Arc<Scene>> {
    match find(id, field, assets)? {
        Content::Model(scene) => Ok(scene),
        Content::Picture(_) => {
            Err(Problem::field(Kind::InvalidValue, field, "is a picture of the sky, which cannot be inserted"))
        }
    }
}

fn picture(id: &str, field: &str, assets: &Assets) -> ApiResult<Arc<SkyPicture>> {
    match find(id, field, assets)? {
        Content::Picture(picture) => Ok(picture),
        Content::Model(_) => Err(Problem::field(Kind::InvalidValue, field, "is a model, and no picture of a sky")),
    }
}

fn find(id: &str, field: &str, assets: &Assets) -> ApiResult<Content> {
    let unknown = || Problem::field(Kind::UnknownAsset, field, format!("no asset {id:?} was uploaded"));
    assets.get(id).ok_or_else(unknown)
}
