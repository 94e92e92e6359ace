//! Preview pictures of published light maps: what a request asks for, and the file it gets.

use std::collections::{HashMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rebake_core::export::ExportError;
use rebake_core::render::{
    self, Palette, RenderOptions, View, Viewpoint, auto_exposure, change_since, render_values, stated_errors,
};
use serde::{Deserialize, Serialize};
use tokio::sync::Semaphore;
use utoipa::ToSchema;

use crate::engine::{Canceled, LightMap, Observer, World};
use crate::jobs::queue::SceneNumber;
use crate::store::versions::Published;

/// Longest side of a picture, pixels.
pub const MAX_SIDE: u32 = 4096;
/// Most samples per pixel.
pub const MAX_SAMPLES: u32 = 4096;
/// Most samples of a whole picture: about a minute on two cores.
pub const MAX_TOTAL_SAMPLES: u64 = 256 << 20;
/// Samples per pixel of a picture that asks for none.
pub const DEFAULT_SAMPLES: u32 = 4;
/// Pictures that are drawn at the same time; more wait.
const CONCURRENT: usize = 2;
/// Versions before an edit that are kept per scene, to show changes against.
const BASELINES: usize = 4;

/// What a picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PictureView {
    /// Emission, direct and indirect light.
    #[default]
    Full,
    /// Emission and direct light.
    Direct,
    /// Reflected indirect light.
    Indirect,
    /// The light map: irradiance / π, without albedo.
    Lightmap,
    /// The light map with lines between its elements.
    Elements,
    /// How the light map changed since a version: blue is less, red more.
    Change,
    /// The stated error of every element.
    Error,
}

/// File formats of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PictureFormat {
    /// 8-bit sRGB, tone-mapped.
    #[default]
    Png,
    /// 32-bit float, linear, as computed.
    Exr,
}

/// How radiance becomes the values of a PNG.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ToneMap {
    /// AgX, the base look.
    #[default]
    Agx,
    /// Khronos PBR Neutral.
    Neutral,
    /// None: values are cut at 1.
    Linear,
}

impl From<ToneMap> for render::ToneMap {
    fn from(tone: ToneMap) -> render::ToneMap {
        match tone {
            ToneMap::Agx => render::ToneMap::AgX,
            ToneMap::Neutral => render::ToneMap::Neutral,
            ToneMap::Linear => render::ToneMap::Linear,
        }
    }
}

/// A picture to be drawn.
#[derive(Clone, Copy, Debug)]
pub struct PictureSpec {
    /// What it shows.
    pub view: PictureView,
    /// From where.
    pub viewpoint: Viewpoint,
    /// Size, samples, seed.
    pub options: RenderOptions,
    /// As which file.
    pub format: PictureFormat,
    /// Stops; automatic where absent.
    pub exposure: Option<f32>,
    /// Tone map of a PNG.
    pub tone: ToneMap,
    /// What the ends of the colour scale stand for (change, error); automatic where absent.
    pub scale: Option<f32>,
}

impl PictureSpec {
    /// A picture as it gets better, for a client that shows each: with 1, 4, 16 samples per pixel and so on, the last
    /// one with as many as asked for. All but the last cost a third of that together.
    pub fn passes(&self) -> Vec<PictureSpec> {
        let all = self.options.samples;
        let before = std::iter::successors(Some(1u32), |samples| samples.checked_mul(4)).take_while(|n| *n < all);
        let pass = |samples| PictureSpec { options: RenderOptions { samples, ..self.options }, ..*self };
        before.chain([all]).map(pass).collect()
    }
}

/// A drawn picture.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// The file.
    pub bytes: Vec<u8>,
    /// Stops in force, for a PNG of light.
    pub exposure: Option<f32>,
    /// What the ends of the colour scale stand for, for a PNG of change or error.
    pub scale: Option<f32>,
}

/// Why there is no picture.
#[derive(Clone, Debug, thiserror::Error)]
pub enum DrawError {
    /// Nobody waits for it any more.
    #[error("canceled")]
    Canceled,
    /// The file could not be made.
    #[error(transparent)]
    Export(#[from] ExportError),
}

impl From<Canceled> for DrawError {
    fn from(_: Canceled) -> DrawError {
        DrawError::Canceled
    }
}

/// Draws a picture on the current rayon pool. `before` is what a change is shown against; without it the whole light
/// counts as change.
///
/// # Errors
/// [`DrawError`]
pub fn draw(
    now: (&World, &LightMap),
    before: Option<(&World, &LightMap)>,
    spec: &PictureSpec,
    observer: &dyn Observer,
) -> Result<Drawn, DrawError> {
    let (world, map) = now;
    let view = match spec.view {
        PictureView::Full => View::Full,
        PictureView::Direct => View::Direct,
        PictureView::Indirect => View::Indirect,
        PictureView::Lightmap => View::LightMap,
        PictureView::Elements => View::Elements,
        PictureView::Change => {
            let change = match before {
                Some(before) => change_since(before, now),
                None => (0..map.len()).map(|slot| map.total(slot).element_sum() / 3.0).collect(),
            };
            return draw_values(world, &change, Palette::Signed, spec, observer);
        }
        PictureView::Error => return draw_values(world, &stated_errors(map), Palette::Heat, spec, observer),
    };
    let picture = render::render(world, map, &spec.viewpoint, view, &spec.options, observer)?;
    match spec.format {
        PictureFormat::Png => {
            let exposure = spec.exposure.unwrap_or_else(|| auto_exposure(&picture.pixels));
            let bytes = picture.png(exposure, spec.tone.into())?;
            Ok(Drawn { bytes, exposure: Some(exposure), scale: None })
        }
        PictureFormat::Exr => Ok(Drawn { bytes: picture.exr(&[])?, exposure: None, scale: None }),
    }
}

fn draw_values(
    world: &World,
    values: &[f32],
    palette: Palette,
    spec: &PictureSpec,
    observer: &dyn Observer,
) -> Result<Drawn, DrawError> {
    let picture = render_values(world, values, &spec.viewpoint, &spec.options, observer)?;
    match spec.format {
        PictureFormat::Png => {
            let scale = spec.scale.unwrap_or_else(|| picture.auto_scale());
            Ok(Drawn { bytes: picture.png(scale, palette)?, exposure: None, scale: Some(scale) })
        }
        PictureFormat::Exr => Ok(Drawn { bytes: picture.exr(&[])?, exposure: None, scale: None }),
    }
}

/// Ends the work of a request that was dropped.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watch(Arc<AtomicBool>);

impl Observer for Watch {
    fn canceled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Held by the request that waits: a client that leaves takes its picture with it.
pub(crate) struct CancelOnDrop(Watch);

impl Watch {
    pub(crate) fn guard(&self) -> CancelOnDrop {
        CancelOnDrop(self.clone())
    }
}

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.0.store(true, Ordering::Relaxed);
    }
}

/// What pictures need beside the scenes: their turn, and the versions before the last edits.
pub(crate) struct Pictures {
    pub(crate) turns: Arc<Semaphore>,
    baselines: Mutex<HashMap<SceneNumber, VecDeque<Arc<Published>>>>,
}

impl Pictures {
    pub(crate) fn new() -> Pictures {
        Pictures { turns: Arc::new(Semaphore::new(CONCURRENT)), baselines: Mutex::default() }
    }

    /// Keeps a version for a while: an edit is about to change it.
    pub(crate) fn remember(&self, scene: SceneNumber, published: Arc<Published>) {
        let mut held = self.held();
        let kept = held.entry(scene).or_default();
        if kept.back().is_some_and(|last| last.version == published.version) {
            return;
        }
        if kept.len() == BASELINES {
            kept.pop_front();
        }
        kept.push_back(published);
    }

    /// Forgets a scene that was deleted.
    pub(crate) fn forget(&self, scene: SceneNumber) {
        self.held().remove(&scene);
    }

    /// The kept version `since`; the newest one where that is absent.
    pub(crate) fn baseline(&self, scene: SceneNumber, since: Option<u64>) -> Option<Arc<Published>> {
        let held = self.held();
        let kept = held.get(&scene)?;
        match since {
            Some(version) => kept.iter().find(|published| published.version == version).cloned(),
            None => kept.back().cloned(),
        }
    }

    /// Versions that a change can be shown against, oldest first.
    pub(crate) fn versions(&self, scene: SceneNumber) -> Vec<u64> {
        self.held().get(&scene).map_or_else(Vec::new, |kept| kept.iter().map(|p| p.version).collect())
    }

    fn held(&self) -> MutexGuard<'_, HashMap<SceneNumber, VecDeque<Arc<Published>>>> {
        self.baselines.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
