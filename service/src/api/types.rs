//! What travels as JSON. Inputs refuse fields they do not know; outputs may gain fields.

use glam::{DMat4, DVec3, Vec3};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::edit_types::Budget;
pub(crate) use super::event_types::to_event_data;
pub use super::event_types::{SceneChange, SceneEvent, SnapshotEvent};
pub use super::job_types::{Job, JobKind, JobPriority, JobProgress, JobState};
pub use super::light_types::{Light, PartName, SceneLayer, SceneLayerLight};
use crate::engine;
use crate::mode::Mode;
use crate::sizing::Sizing;
use crate::store::versions::Stated;

/// Whether a scene can be worked with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SceneState {
    /// It was uploaded just now: its elements are being laid out. Until then it has none, and no objects; requests that
    /// need them wait.
    Preparing,
    /// It takes edits.
    Ready,
    /// It cannot be built; `error` says why. It can be looked at and deleted.
    Damaged,
}

impl From<crate::store::scene::SceneState> for SceneState {
    fn from(state: crate::store::scene::SceneState) -> SceneState {
        use crate::store::scene::SceneState as Kept;
        match state {
            Kept::Preparing => SceneState::Preparing,
            Kept::Ready => SceneState::Ready,
            Kept::Damaged => SceneState::Damaged,
        }
    }
}

/// Errors of light as it is kept, before its noise is averaged away: irradiance / π, mean over RGB, of the light that the
/// map holds. The error of a value that is read between elements is about the root of the sum of both squares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LightError {
    /// Of chance: it falls with samples. Null where nothing is known, as of an estimate or of light that is not up to date.
    #[schema(example = 0.004)]
    pub noise: Option<f32>,
    /// Of the distance between elements: it falls with their spacing, and no number of samples makes it smaller. Null
    /// where the noise is not known, where too few points were measured, or where it is too small to be told from noise.
    #[schema(example = 0.02)]
    pub resolution: Option<f32>,
}

impl LightError {
    /// JSON has no infinity.
    pub(crate) fn finite(self) -> LightError {
        LightError { noise: self.noise.and_then(finite), resolution: self.resolution.and_then(finite) }
    }
}

impl From<Stated> for LightError {
    fn from(Stated { noise, resolution }: Stated) -> LightError {
        LightError { noise, resolution }.finite()
    }
}

/// A scene with all that is in it.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Scene {
    /// Stable id.
    #[schema(example = "s1-k3f9qz")]
    pub id: String,
    /// Name for people.
    #[schema(example = "living room")]
    pub name: String,
    /// Whether it can be worked with.
    pub state: SceneState,
    /// What the light map holds.
    pub mode: Mode,
    /// Largest distance between neighbouring elements, metres.
    #[schema(example = 0.1)]
    pub spacing: f32,
    /// How elements are spread over what the file holds; absent while the scene is prepared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizing: Option<Sizing>,
    /// Texels per metre of its atlas; absent where it was uploaded without one.
    #[schema(example = 20.0)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texels_per_metre: Option<f32>,
    /// Version of the light map; 0 before anything was published.
    #[schema(example = 7)]
    pub version: u64,
    /// Version at which elements, objects or lights last changed: fetch `/elements` again where it did.
    #[schema(example = 3)]
    pub elements_version: u64,
    /// Length of the light map. Elements of removed objects leave holes of zeros; the length never falls.
    #[schema(example = 21_034)]
    pub elements: u64,
    /// Elements in use.
    #[schema(example = 20_500)]
    pub live_elements: u64,
    /// Triangles after subdivision.
    #[schema(example = 40_112)]
    pub triangles: u64,
    /// Memory that the scene holds.
    #[schema(example = 9_211_340)]
    pub memory_bytes: u64,
    /// Stated error of the light that the map holds (`mode`): area-weighted RMSE (irradiance / π). Null where nothing is
    /// known of it, as of an estimate, or of light from before an edit.
    #[schema(example = 0.012)]
    pub estimated_rmse: Option<f32>,
    /// Its errors: of chance, and of the distance between elements, which is measured while light is computed. Null after an
    /// edit until there is light for it.
    pub light_error: LightError,
    /// What the scene works towards whenever no edit waits, until the first bound is reached; absent where it was uploaded
    /// without a bake.
    pub target: Option<Budget>,
    /// Edit requests that were accepted so far and changed something. The scene's `ETag`, which `If-Match` compares with.
    #[schema(example = 3)]
    pub accepted_edits: u64,
    /// How many of those `version` shows with their geometry. While it is below `accepted_edits`, objects and lights are
    /// told as all accepted edits leave them, and objects have the elements that they have in `version`.
    #[schema(example = 3, required = true)]
    #[serde(default)]
    pub published_edits: u64,
    /// Accepted edits whose light is not in the map yet: those of jobs that wait, run or were canceled.
    pub unlit_edits: u64,
    /// The objects, in order, after all accepted edits. Their `albedo` is the mean of the file or of the last repaint; light meets at most
    /// `max_albedo`.
    pub objects: Vec<SceneObject>,
    /// The lights, in order, after all accepted edits.
    pub lights: Vec<Light>,
    /// The layers of the light map: it is the sum of weight × layer. None before a light is relit or lights are
    /// grouped.
    pub layers: Vec<SceneLayer>,
    /// The file's cameras, in order.
    pub cameras: Vec<Camera>,
    /// What the file asked for and did not get.
    pub warnings: Vec<String>,
    /// Triangles without an area, dropped at upload.
    pub degenerate_triangles: u64,
    /// The job that runs on the scene, else the next one.
    #[schema(example = "j4-k3f9qz")]
    pub current_job: Option<String>,
    /// What is wrong with it: it is damaged, or its light could not be saved.
    pub error: Option<String>,
    /// When it was uploaded.
    #[schema(value_type = String, format = DateTime, example = "2026-11-23T09:00:00Z")]
    pub created_at: Timestamp,
}

/// What a scene would take: the answer to an upload with `dry_run=true`.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct ScenePlan {
    /// Largest distance between neighbouring elements, metres: as asked for, else as it would be chosen.
    #[schema(example = 0.1)]
    pub spacing: f32,
    /// Elements of the light map.
    #[schema(example = 20_500)]
    pub elements: u64,
    /// Triangles after subdivision.
    #[schema(example = 40_112)]
    pub triangles: u64,
    /// Number of objects.
    pub objects: u64,
    /// Number of lights.
    pub lights: u64,
    /// Memory that the scene would hold before its first edit, with its layers.
    #[schema(example = 9_211_340)]
    pub memory_bytes: u64,
    /// What the file asks for and would not get.
    pub warnings: Vec<String>,
    /// Triangles without an area, which would be dropped.
    pub degenerate_triangles: u64,
}

/// A scene in a list.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneSummary {
    /// Stable id.
    #[schema(example = "s1-k3f9qz")]
    pub id: String,
    /// Name for people.
    #[schema(example = "living room")]
    pub name: String,
    /// Whether it can be worked with.
    pub state: SceneState,
    /// What the light map holds.
    pub mode: Mode,
    /// Largest distance between neighbouring elements, metres.
    pub spacing: f32,
    /// Version of the light map.
    pub version: u64,
    /// Length of the light map.
    pub elements: u64,
    /// Number of objects.
    pub object_count: u64,
    /// The job that runs on the scene, else the next one.
    pub current_job: Option<String>,
    /// What is wrong with it: it is damaged, or its light could not be saved.
    pub error: Option<String>,
    /// When it was uploaded.
    #[schema(value_type = String, format = DateTime, example = "2026-11-23T09:00:00Z")]
    pub created_at: Timestamp,
}

/// Neighbouring elements.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub struct ElementRange {
    /// The first.
    pub first: u32,
    /// How many.
    pub count: u32,
}

/// An axis-aligned box in world space, metres.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, ToSchema)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: [f64; 3],
    /// Largest coordinates.
    pub max: [f64; 3],
}

/// An object: a glTF node with a mesh, the unit of an edit.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneObject {
    /// Its index in `/elements`; beyond those where it is not published yet.
    pub index: u32,
    /// Its name.
    #[schema(example = "sofa")]
    pub name: String,
    /// Its elements; none before it is published.
    pub elements: ElementRange,
    /// Errors of its light.
    pub light_error: LightError,
    /// The second half of its elements belongs to the back of its surface.
    pub with_back: bool,
    /// Triangles after subdivision.
    pub triangles: u32,
    /// Where it is.
    pub bounds: Bounds,
    /// Mean diffuse albedo, linear RGB, as the file or the last repaint has it. Light meets at most the scene's
    /// `max_albedo`.
    #[schema(example = json!([0.6, 0.1, 0.1]))]
    pub albedo: [f32; 3],
    /// Object space to world space, column-major, metres: what `move` replaces.
    #[schema(example = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 2, 1]))]
    pub transform: [f64; 16],
    /// Hidden by an edit: it takes no part in light and has no elements until it is shown.
    pub hidden: bool,
    /// Index of its node in the uploaded file; none for what was inserted.
    #[schema(example = 4)]
    pub node: Option<u32>,
    /// `extras.id` of the node, where the file has one.
    #[schema(example = "a81f")]
    pub id: Option<String>,
}

impl SceneObject {
    pub(crate) fn new(object: &engine::ObjectSummary, stated: Stated) -> SceneObject {
        SceneObject {
            index: object.index,
            name: object.name.clone(),
            elements: ElementRange { first: object.first_element, count: object.elements },
            light_error: stated.into(),
            with_back: object.with_back,
            triangles: object.triangles,
            bounds: Bounds { min: object.bounds.0.to_array(), max: object.bounds.1.to_array() },
            albedo: object.albedo.to_array(),
            transform: object.world_from_object.to_cols_array(),
            hidden: object.is_hidden,
            node: object.node.as_ref().map(|node| node.index),
            id: object.node.as_ref().and_then(|node| node.id.as_deref()).map(str::to_owned),
        }
    }
}

/// A camera of the file, as `eye`, `target`, `up` and `fov_y` of a focus or a picture.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Camera {
    /// Its index.
    pub index: u32,
    /// Its name.
    #[schema(example = "Camera")]
    pub name: String,
    /// Where it stands.
    pub eye: [f64; 3],
    /// A point it looks at, one metre ahead.
    pub target: [f64; 3],
    /// Upward.
    pub up: [f64; 3],
    /// Vertical field of view, radians.
    #[schema(example = 0.9)]
    pub fov_y: f32,
}

/// An uploaded asset.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Asset {
    /// Content hash: what `insert` and `sky` name.
    #[schema(example = "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24")]
    pub asset: String,
    /// Triangles in the file; 0 of a picture.
    pub triangles: u64,
    /// Texels across and down of a picture of the sky, as it is kept; absent of what can be inserted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<[u32; 2]>,
    /// What the file asked for and did not get.
    pub warnings: Vec<String>,
}

/// One page of scenes.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct ScenePage {
    /// Newest first.
    pub items: Vec<SceneSummary>,
    /// Asks for the next page; absent on the last.
    pub next_cursor: Option<String>,
}

/// One page of jobs.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct JobPage {
    /// Newest first.
    pub items: Vec<Job>,
    /// Asks for the next page; absent on the last.
    pub next_cursor: Option<String>,
}

/// `/healthz` and `/readyz`.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// `ok`.
    #[schema(example = "ok")]
    pub status: String,
}

/// JSON has no NaN and no infinity.
pub(crate) fn finite(x: f32) -> Option<f32> {
    x.is_finite().then_some(x)
}

pub(crate) fn vec3(values: [f32; 3]) -> Vec3 {
    Vec3::from_array(values)
}

pub(crate) fn dvec3(values: [f64; 3]) -> DVec3 {
    DVec3::from_array(values)
}

pub(crate) fn dmat4(values: &[f64; 16]) -> DMat4 {
    DMat4::from_cols_array(values)
}
