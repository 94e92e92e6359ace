//! What has to survive a restart, as plain data.

use std::collections::BTreeMap;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::lighting::{Effort, Sequence};
use super::versions::Lineage;
use crate::engine::{Density, Focus, Importance, LightMap, MeanSquare, ResolutionError, TileMode, Tiles};
use crate::jobs::JobSpec;
use crate::jobs::budget::JobBudget;
use crate::jobs::queue::{Job, JobNumber, SceneNumber};
use crate::mode::Mode;
use crate::sizing::StoredSpread;
use crate::unit::LightUnit;

/// How a scene was uploaded.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct SceneRecord {
    pub(crate) name: String,
    pub(crate) mode: Mode,
    /// The spacing in force, also where the client left it open.
    pub(crate) spacing: f32,
    /// Most squares of its spacing that one object has; none: as many as it takes.
    #[serde(default)]
    pub(crate) object_squares: Option<f64>,
    /// How many elements the client asked for, where that is how the spacing was chosen.
    #[serde(default)]
    pub(crate) elements: Option<usize>,
    /// How elements are spread.
    #[serde(default)]
    pub(crate) spread: StoredSpread,
    pub(crate) environment: Option<[f32; 3]>,
    #[serde(default)]
    pub(crate) outside: StoredOutside,
    /// What the intensities of the file's lights are.
    #[serde(default)]
    pub(crate) unit: LightUnit,
    /// Bound on albedos, where the client stated one.
    #[serde(default)]
    pub(crate) max_albedo: Option<f32>,
    /// Its atlas, where it was uploaded with one.
    #[serde(default)]
    pub(crate) atlas: Option<StoredAtlas>,
    /// Names of lights with those of their layers.
    #[serde(default)]
    pub(crate) groups: BTreeMap<String, String>,
    /// What it works towards; none: nothing but its edits.
    #[serde(default)]
    pub(crate) target: Option<JobBudget>,
    pub(crate) created_at: Timestamp,
}

impl SceneRecord {
    /// How far its elements lie apart.
    pub(crate) fn density(&self) -> Density {
        Density { spacing: self.spacing, object_squares: self.object_squares.unwrap_or(f64::INFINITY) }
    }
}

/// How a scene came to be.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    pub(crate) record: SceneRecord,
    /// Bodies of its accepted edits, in their order.
    pub(crate) edits: Vec<Vec<u8>>,
}

/// What an atlas is made by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredAtlas {
    /// In force, also where the client left it open.
    pub(crate) texels_per_metre: f32,
    /// The limit that it was made under, which its edits keep.
    pub(crate) max_texels: u64,
}

/// What an upload asks for beside `environment` that shines from outside.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredOutside {
    pub(crate) sky: Option<StoredSky>,
    pub(crate) default_sky: bool,
    /// Degrees.
    pub(crate) sun_angle: f32,
}

/// A picture of the sky, as it is used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredSky {
    pub(crate) asset: String,
    /// Degrees.
    pub(crate) rotation: f32,
    pub(crate) strength: f32,
}

/// A job with all that is needed to run it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct JobRecord {
    #[serde(with = "super::stored_job")]
    pub(crate) job: Job,
    #[serde(flatten)]
    pub(crate) spec: JobSpec,
}

/// What comes first, as it is kept.
pub(crate) mod stored_importance {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::{Importance, StoredFocus, StoredTiles};

    #[derive(Serialize, Deserialize)]
    struct Stored {
        focus: Option<StoredFocus>,
        #[serde(default)]
        tiles: Option<StoredTiles>,
    }

    pub(crate) fn serialize<S: Serializer>(importance: &Importance, serializer: S) -> Result<S::Ok, S::Error> {
        let Importance { focus, tiles } = *importance;
        Stored { focus: focus.map(Into::into), tiles: tiles.map(Into::into) }.serialize(serializer)
    }

    pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Importance, D::Error> {
        let Stored { focus, tiles } = Stored::deserialize(deserializer)?;
        Ok(Importance { focus: focus.map(Into::into), tiles: tiles.map(Into::into) })
    }
}

/// What a client looks at.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum StoredFocus {
    Camera { eye: [f64; 3], target: [f64; 3], up: [f64; 3], fov_y: f32, aspect: f32 },
    Sphere { point: [f64; 3], radius: f32 },
}

impl From<Focus> for StoredFocus {
    fn from(focus: Focus) -> StoredFocus {
        match focus {
            Focus::Camera { eye, target, up, fov_y, aspect } => {
                let (eye, target, up) = (eye.to_array(), target.to_array(), up.to_array());
                StoredFocus::Camera { eye, target, up, fov_y, aspect }
            }
            Focus::Sphere { point, radius } => StoredFocus::Sphere { point: point.to_array(), radius },
        }
    }
}

impl From<StoredFocus> for Focus {
    fn from(focus: StoredFocus) -> Focus {
        match focus {
            StoredFocus::Camera { eye, target, up, fov_y, aspect } => {
                Focus::Camera { eye: eye.into(), target: target.into(), up: up.into(), fov_y, aspect }
            }
            StoredFocus::Sphere { point, radius } => Focus::Sphere { point: point.into(), radius },
        }
    }
}

/// How what comes first is cut up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct StoredTiles {
    size: u32,
    samples: u32,
    mode: StoredMode,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum StoredMode {
    Global,
    Incremental,
    Continuous,
}

impl From<Tiles> for StoredTiles {
    fn from(Tiles { size, samples, mode }: Tiles) -> StoredTiles {
        let mode = match mode {
            TileMode::Global => StoredMode::Global,
            TileMode::Incremental => StoredMode::Incremental,
            TileMode::Continuous => StoredMode::Continuous,
        };
        StoredTiles { size, samples, mode }
    }
}

impl From<StoredTiles> for Tiles {
    fn from(StoredTiles { size, samples, mode }: StoredTiles) -> Tiles {
        let mode = match mode {
            StoredMode::Global => TileMode::Global,
            StoredMode::Incremental => TileMode::Incremental,
            StoredMode::Continuous => TileMode::Continuous,
        };
        Tiles { size, samples, mode }
    }
}

/// An accepted edit request.
#[derive(Clone, Debug)]
pub(crate) struct EditRecord<'a> {
    /// Place among the scene's accepted requests, from 1.
    pub(crate) sequence: Sequence,
    pub(crate) body: &'a [u8],
    pub(crate) accepted_at: Timestamp,
}

/// What a client changes of a scene beside its contents; none: it stays.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SceneChange<'a> {
    pub(crate) name: Option<&'a str>,
    pub(crate) target: Option<&'a JobBudget>,
}

/// An idempotency key with what was answered.
#[derive(Clone, Debug)]
pub(crate) struct KeyRecord {
    pub(crate) key: String,
    pub(crate) body_hash: blake3::Hash,
    pub(crate) job: JobNumber,
    pub(crate) answer: Arc<str>,
}

/// An idempotency key of an upload, with what that made.
#[derive(Clone, Debug)]
pub(crate) struct UploadRecord {
    pub(crate) key: String,
    /// Of the file and how it was to be taken.
    pub(crate) hash: blake3::Hash,
    /// None of an asset, which goes by what is in it.
    pub(crate) scene: Option<SceneNumber>,
    /// What bakes the scene.
    pub(crate) job: Option<JobNumber>,
}

/// All that one accepted request changes, kept as a unit.
#[derive(Clone, Debug)]
pub(crate) struct Accepted<'a> {
    pub(crate) scene: SceneNumber,
    /// None where the request holds no edit.
    pub(crate) edit: Option<EditRecord<'a>>,
    pub(crate) job: &'a JobRecord,
    pub(crate) key: Option<&'a KeyRecord>,
    /// Jobs of the scene so far: seeds derive from it.
    pub(crate) jobs: u64,
}

/// The light of a scene, of one moment.
#[derive(Clone)]
pub(crate) struct LightRecord {
    pub(crate) about: LightState,
    /// As published.
    pub(crate) map: Arc<LightMap>,
    /// Per slot: the version that last changed it.
    pub(crate) changed: Arc<[u64]>,
    /// What the next job starts from, and what it is right for.
    pub(crate) lit: Option<(Sequence, Arc<LightMap>)>,
    /// Light of states before.
    pub(crate) earlier: EarlierLight,
}

/// Light maps of a scene's earlier states, each with the sequence number that it is right for.
#[derive(Clone, Default)]
pub(crate) struct EarlierLight {
    /// What undo goes back to, the oldest first.
    pub(crate) kept: Vec<(Sequence, Arc<LightMap>)>,
    /// What the light to start from was computed from.
    pub(crate) base: Option<(Sequence, Arc<LightMap>)>,
}

/// Of light that was kept before layouts had versions.
fn first_layout_version() -> u32 {
    1
}

/// What is kept beside the maps.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct LightState {
    pub(crate) version: u64,
    pub(crate) elements_version: u64,
    /// The sequence number of the published world.
    pub(crate) shown: Sequence,
    /// What the published light is right for, where it is more than carried over.
    pub(crate) right_for: Option<Sequence>,
    pub(crate) estimated_rmse: Option<f32>,
    /// Not kept by earlier builds.
    #[serde(default)]
    pub(crate) resolution: Option<StoredResolution>,
    pub(crate) lineage: Lineage,
    /// Hash of the published world's elements.
    pub(crate) layout: String,
    /// By which version of the layout they are laid out.
    #[serde(default = "first_layout_version")]
    pub(crate) layout_version: u32,
    /// What the layers of the published map count in it: bits of RGB, since JSON knows neither infinity nor NaN.
    #[serde(default)]
    pub(crate) weights: Vec<[u32; 3]>,
    /// What was done towards the scene's target.
    #[serde(default)]
    pub(crate) effort: Effort,
    /// Time ended the light to start from before it was as accurate as was asked for.
    #[serde(default)]
    pub(crate) is_coarse: bool,
}

/// What was measured of a map's error of resolution: sums of squares, as the engine has them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredResolution {
    all: (u32, [f64; 5]),
    objects: Vec<(u32, [f64; 5])>,
}

impl StoredResolution {
    pub(crate) fn new(error: &ResolutionError) -> StoredResolution {
        let objects = error.objects.iter().map(MeanSquare::sums).collect();
        StoredResolution { all: error.all.sums(), objects }
    }

    /// As it was measured; none where it is of so many objects no more.
    pub(crate) fn of_objects(self, objects: usize) -> Option<ResolutionError> {
        let sums = Some(self.objects).filter(|sums| sums.len() == objects)?;
        let objects = sums.into_iter().map(MeanSquare::of_sums).collect();
        let mut error = ResolutionError::default();
        (error.all, error.objects) = (MeanSquare::of_sums(self.all), objects);
        Some(error)
    }
}
