//! What the service answers, as far as this client reads it. Fields it does not know are passed over.

use std::path::Path;

use serde::Deserialize;

use crate::{LightUnit, Sizing};

/// How to upload a scene. What is absent is the service's to choose.
#[derive(Clone, Debug, Default)]
pub struct NewScene {
    /// A name for people.
    pub name: Option<String>,
    /// Largest distance between neighbouring elements, metres.
    pub spacing: Option<f32>,
    /// How many elements there are to be, in place of a spacing.
    pub elements: Option<usize>,
    /// How they are spread.
    pub sizing: Option<Sizing>,
    /// `full` or `indirect`.
    pub mode: Option<String>,
    /// Constant radiance from outside.
    pub environment: Option<[f32; 3]>,
    /// A picture of the sky: what [`crate::client::Client::create_asset`] answered.
    pub sky: Option<String>,
    /// By how much it is turned about +y, degrees.
    pub sky_rotation: Option<f32>,
    /// Factor on its radiance.
    pub sky_strength: Option<f32>,
    /// `true`: a plain sky where there is no light.
    pub default_sky: Option<bool>,
    /// Angle of the discs of directional lights, degrees.
    pub sun_angle: Option<f32>,
    /// What the intensities of the file's point and spot lights are.
    pub unit: Option<LightUnit>,
    /// Largest albedo that light meets.
    pub max_albedo: Option<f32>,
    /// `vertices` or `atlas`.
    pub layout: Option<String>,
    /// Texels per metre of the atlas.
    pub texels_per_metre: Option<f32>,
    /// `shared`, `each` or a JSON object of layers with their lights.
    pub layers: Option<String>,
    /// What the scene works towards: samples per element …
    pub samples_per_element: Option<u32>,
    /// … seconds from the upload …
    pub max_seconds: Option<f64>,
    /// … stated error.
    pub target_rmse: Option<f32>,
    /// `false`: upload only.
    pub bake: Option<bool>,
}

impl NewScene {
    pub(super) fn query(&self) -> Vec<(&'static str, String)> {
        let environment = self.environment.map(|[r, g, b]| format!("{r},{g},{b}"));
        [
            ("name", self.name.clone()),
            ("spacing", self.spacing.map(|spacing| spacing.to_string())),
            ("elements", self.elements.map(|elements| elements.to_string())),
            ("sizing", self.sizing.map(|sizing| sizing.name().to_owned())),
            ("mode", self.mode.clone()),
            ("environment", environment),
            ("sky", self.sky.clone()),
            ("sky_rotation", self.sky_rotation.map(|degrees| degrees.to_string())),
            ("sky_strength", self.sky_strength.map(|factor| factor.to_string())),
            ("default_sky", self.default_sky.map(|is_wanted| is_wanted.to_string())),
            ("sun_angle", self.sun_angle.map(|degrees| degrees.to_string())),
            ("unit", self.unit.map(|unit| unit.name().to_owned())),
            ("max_albedo", self.max_albedo.map(|albedo| albedo.to_string())),
            ("layout", self.layout.clone()),
            ("texels_per_metre", self.texels_per_metre.map(|density| density.to_string())),
            ("layers", self.layers.clone()),
            ("samples_per_element", self.samples_per_element.map(|samples| samples.to_string())),
            ("max_seconds", self.max_seconds.map(|seconds| seconds.to_string())),
            ("target_rmse", self.target_rmse.map(|rmse| rmse.to_string())),
            ("bake", self.bake.map(|bake| bake.to_string())),
        ]
        .into_iter()
        .filter_map(|(key, value)| value.map(|value| (key, value)))
        .collect()
    }

    /// The file's name without its ending, as a scene's name.
    pub fn name_of(path: &Path) -> Option<String> {
        path.file_stem().map(|stem| stem.to_string_lossy().into_owned())
    }
}

/// A scene.
#[derive(Clone, Debug, Deserialize)]
pub struct Scene {
    /// Its id.
    pub id: String,
    /// Its name.
    #[serde(default)]
    pub name: Option<String>,
    /// `preparing`, `ready` or `damaged`.
    #[serde(default)]
    pub state: Option<String>,
    /// What is wrong with it.
    #[serde(default)]
    pub error: Option<String>,
    /// Version of its light map.
    #[serde(default)]
    pub version: u64,
    /// Elements of its light map.
    #[serde(default, alias = "element_count")]
    pub elements: u64,
    /// Memory in bytes.
    #[serde(default)]
    pub memory_bytes: u64,
    /// Its objects.
    #[serde(default)]
    pub objects: Vec<Object>,
    /// Its lights.
    #[serde(default)]
    pub lights: Vec<Light>,
    /// What the file asked for and did not get.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// The current job, or its id.
    #[serde(default, alias = "current_job")]
    job: Option<serde_json::Value>,
}

impl Scene {
    /// Whether its elements are still being laid out: it has none, and no objects, until then.
    pub fn is_preparing(&self) -> bool {
        self.state.as_deref() == Some("preparing")
    }

    /// Id of the job that is queued or runs.
    pub fn job_id(&self) -> Option<&str> {
        let job = self.job.as_ref()?;
        job.as_str().or_else(|| job["id"].as_str())
    }
}

/// An object of a scene.
#[derive(Clone, Debug, Deserialize)]
pub struct Object {
    /// Its name.
    pub name: String,
}

/// A light of a scene.
#[derive(Clone, Debug, Deserialize)]
pub struct Light {
    /// Its name.
    pub name: String,
}

/// An uploaded asset.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Asset {
    pub(super) asset: String,
}

/// One page of a list.
#[derive(Debug, Deserialize)]
pub(super) struct Page {
    pub(super) items: Vec<serde_json::Value>,
    pub(super) next_cursor: Option<String>,
}

pub use crate::jobs::queue::JobState;

/// A job.
#[derive(Clone, Debug, Deserialize)]
pub struct Job {
    /// Its id.
    pub id: String,
    /// Its scene.
    #[serde(default)]
    pub scene: String,
    /// What it does, e.g. `bake`.
    #[serde(default)]
    pub kind: String,
    /// Where it stands.
    pub state: JobState,
    /// How far it is.
    #[serde(default)]
    pub progress: JobProgress,
    /// What went wrong.
    #[serde(default)]
    pub error: Option<serde_json::Value>,
    /// What to know of how it ended.
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl Job {
    /// What went wrong, in words.
    pub fn error_text(&self) -> Option<String> {
        let error = self.error.as_ref()?;
        let text = error.as_str().or_else(|| error["detail"].as_str()).or_else(|| error["title"].as_str());
        Some(text.map_or_else(|| error.to_string(), str::to_owned))
    }
}

/// Errors of light, as far as they are known.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(default)]
pub struct LightError {
    /// Of chance.
    pub noise: Option<f64>,
    /// Of the distance between elements.
    pub resolution: Option<f64>,
}

/// How far a job is.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct JobProgress {
    /// Part that is done, 0..=1, as far as can be told.
    pub fraction: Option<f64>,
    /// What is being done.
    pub pass: Option<String>,
    /// Samples per element so far.
    pub samples_per_element: Option<u64>,
    /// Time since the job started.
    pub elapsed_ms: Option<u64>,
    /// The stated error of the newest version.
    pub estimated_rmse: Option<f64>,
    /// Its errors, each.
    pub light_error: LightError,
    /// Rays traced so far.
    pub rays: Option<u64>,
    /// The newest version of the job.
    pub version: Option<u64>,
}
