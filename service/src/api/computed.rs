//! Parts of light maps and atlases that are computed when a client asks: ambient occlusion, and from where light comes.

use std::sync::Arc;

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use rebake_core::directional::{DirectionalOptions, directional};
use rebake_core::occlusion::{OcclusionOptions, ambient_occlusion};

use super::lightmap::Chosen;
use super::problem::{ApiResult, Kind, Problem};
use super::uploads::memory_problem;
use crate::engine::Canceled;
use crate::pictures::Watch;
use crate::state::App;
use crate::store::computed::ComputedPart;
use crate::store::scene::SceneEntry;
use crate::store::versions::Published;

/// Rays per element: a stated error of ambient occlusion of about 0.05 where half is open.
const SAMPLES: u32 = 64;

/// Bytes per slot while a part is computed.
const BYTES_PER_SLOT: u64 = 192;

/// Header with the stated error.
static ERROR: HeaderName = HeaderName::from_static("x-rebake-estimated-rmse");

/// Header with the distance in force, metres.
static DISTANCE: HeaderName = HeaderName::from_static("x-rebake-ao-distance");

/// What is to be computed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wanted {
    /// Ambient occlusion, within a distance.
    Occlusion(Option<f32>),
    /// The first band of spherical harmonics of incoming light.
    Directional,
}

/// Checks a distance that a query asks for.
pub(super) fn check_distance(distance: Option<f32>, is_asked_for: bool) -> ApiResult<()> {
    let invalid = |reason: &str| Err(Problem::field(Kind::InvalidQuery, "ao_distance", reason));
    match distance {
        Some(_) if !is_asked_for => invalid("goes with part=ao"),
        Some(distance) if !(distance.is_finite() && distance > 0.0) => {
            invalid("has to be a finite number of metres above 0")
        }
        _ => Ok(()),
    }
}

/// What was chosen, computed where it is not there. Off the async threads; given up when the client goes away.
pub(super) async fn computed(
    app: &Arc<App>,
    scene: &Arc<SceneEntry>,
    published: &Arc<Published>,
    chosen: Chosen,
) -> ApiResult<Chosen> {
    let Chosen::Wanted(wanted) = chosen else { return Ok(chosen) };
    let (kept, version, distance) = match wanted {
        Wanted::Occlusion(distance) => (&scene.occlusion, published.elements_version, distance),
        Wanted::Directional => (&scene.directional, published.version, None),
    };
    let _asked = kept.turn.lock().await;
    if let Some(found) = kept.get(version, distance) {
        return Ok(Chosen::Computed(found));
    }
    let found = Arc::new(compute(app, published, wanted).await?);
    kept.keep(version, distance, &found);
    Ok(Chosen::Computed(found))
}

/// What headers tell of a part.
pub(super) fn headers(part: &ComputedPart) -> ApiResult<HeaderMap> {
    let told = [(&ERROR, Some(part.stated)), (&DISTANCE, part.distance)];
    let told = told.into_iter().filter_map(|(name, value)| Some((name.clone(), value?)));
    let header = |(name, value): (HeaderName, f32)| {
        Ok((name, HeaderValue::from_str(&value.to_string()).map_err(Problem::internal)?))
    };
    told.map(header).collect()
}

async fn compute(app: &Arc<App>, published: &Arc<Published>, wanted: Wanted) -> ApiResult<ComputedPart> {
    let (watch, its_app, published) = (Watch::default(), Arc::clone(app), Arc::clone(published));
    let _guard = watch.guard();
    let turn = app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
    let seed = app.config.seed;
    let work = move || {
        let _turn = turn;
        let bytes = published.world.slots() as u64 * BYTES_PER_SLOT;
        let _promise = its_app.memory.promise(bytes, 0).map_err(|full| memory_problem("part", full))?;
        let found = match wanted {
            Wanted::Occlusion(distance) => occlusion_of(&published, distance, seed, &watch),
            Wanted::Directional => directional_of(&published, seed, &watch),
        };
        found.map_err(|Canceled| Problem::new(Kind::ShuttingDown, "the part was given up"))
    };
    app.compute.draw(work).await?
}

fn occlusion_of(
    published: &Published,
    distance: Option<f32>,
    seed: u64,
    watch: &Watch,
) -> Result<ComputedPart, Canceled> {
    let options = OcclusionOptions { distance, samples: SAMPLES, seed };
    let found = ambient_occlusion(&published.world, &options, watch)?;
    let about = vec![
        ("lightMapLayer", "ao".to_owned()),
        ("lightMapError", found.stated.to_string()),
        ("ambientOcclusionDistance", found.distance.to_string()),
    ];
    let (stated, distance) = (found.stated, Some(found.distance));
    Ok(ComputedPart { bands: vec![("", found.open)], about, stated, distance })
}

fn directional_of(published: &Published, seed: u64, watch: &Watch) -> Result<ComputedPart, Canceled> {
    let options = DirectionalOptions { part: published.mode(), samples: SAMPLES, seed };
    let found = directional(&published.world, &published.map, &options, watch)?;
    let [y, z, x] = found.band;
    let about = vec![("lightMapLayer", "directional".to_owned()), ("lightMapError", found.stated.to_string())];
    Ok(ComputedPart { bands: vec![("y", y), ("z", z), ("x", x)], about, stated: found.stated, distance: None })
}
