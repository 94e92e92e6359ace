//! Edit requests as JSON.

use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

pub use super::edit_light_types::{
    DirectionalLight, EnvironmentLight, GroupLights, InsertLight, MoveLight, NewLight, PointLight, Relight, RelightOne,
    RemoveLight, Sky, SpotLight,
};
use super::edit_nodes::Reference;
use super::job_types::JobPriority;
use super::misread::{FromFields, Misread, from_value, tagged, take};

/// One edit with its budget and focus, or several as one job.
#[derive(Clone, Debug, Serialize, ToSchema)]
#[serde(untagged)]
pub enum EditRequest {
    /// Several, applied as a unit or not at all.
    Many(EditList),
    /// One.
    One(SingleEdit),
}

/// Several edits, applied in order, as a unit or not at all. An empty list lights what canceled jobs left undone.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EditList {
    /// The edits. Where one carries a `budget`, `focus`, `tiles` or `priority` of its own, the list's counts first, then
    /// the first edit's.
    pub edits: Vec<SingleEdit>,
    /// When to stop. Without a bound: as soon as the edit's own noise adds at most 5 % to the error that the whole light map
    /// had, at most doubles it where the change is seen, and what is new is as good as what is around it; after 48 samples
    /// per element at the latest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// What to light first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus: Option<Focus>,
    /// In which steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tiles: Option<Tiles>,
    /// Whose turn comes sooner; `normal` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<JobPriority>,
}

/// One edit.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct SingleEdit {
    /// What to change.
    #[serde(flatten)]
    pub op: EditOp,
    /// When to stop. Without a bound: as soon as the edit's own noise adds at most 5 % to the error that the whole light map
    /// had, at most doubles it where the change is seen, and what is new is as good as what is around it; after 48 samples
    /// per element at the latest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub budget: Option<Budget>,
    /// What to light first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus: Option<Focus>,
    /// In which steps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tiles: Option<Tiles>,
    /// Whose turn comes sooner; `normal` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub priority: Option<JobPriority>,
}

impl FromFields for EditRequest {
    /// A list where there is one, else an edit.
    fn from_fields(fields: Map<String, Value>) -> Result<EditRequest, Misread> {
        match fields.contains_key("edits") {
            true => from_value(fields.into()).map(EditRequest::Many),
            false => SingleEdit::from_fields(fields).map(EditRequest::One),
        }
    }
}

impl FromFields for SingleEdit {
    fn from_fields(mut fields: Map<String, Value>) -> Result<SingleEdit, Misread> {
        Ok(SingleEdit {
            budget: take(&mut fields, "budget")?.flatten(),
            focus: take(&mut fields, "focus")?.flatten(),
            tiles: take(&mut fields, "tiles")?.flatten(),
            priority: take(&mut fields, "priority")?.flatten(),
            op: EditOp::from_fields(fields)?,
        })
    }
}

impl<'de> Deserialize<'de> for EditRequest {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<EditRequest, D::Error> {
        FromFields::from_object(deserializer)
    }
}

impl<'de> Deserialize<'de> for SingleEdit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<SingleEdit, D::Error> {
        FromFields::from_object(deserializer)
    }
}

tagged! {
    /// What to change.
    pub enum EditOp by "op" {
        /// Puts an asset into the scene.
        Insert(Insert) = "insert",
        /// Takes objects out.
        Remove(Remove) = "remove",
        /// Gives an object a new place.
        Move(Move) = "move",
        /// Repaints an object, or a material.
        Material(Repaint) = "material",
        /// Takes objects out of the light, to come back later.
        Hide(Hide) = "hide",
        /// Brings hidden objects back.
        Show(Show) = "show",
        /// Takes the last edit request back that was not taken back yet; stands alone in its request.
        Undo(Undo) = "undo",
        /// Makes the last edit request that was taken back again; stands alone in its request.
        Redo(Redo) = "redo",
        /// Changes colour or intensity of lights.
        Relight(Relight) = "relight",
        /// Adds a light.
        InsertLight(InsertLight) = "insert_light",
        /// Gives the scene its light from outside.
        Sky(Sky) = "sky",
        /// Takes a light away.
        RemoveLight(RemoveLight) = "remove_light",
        /// Moves or turns a light.
        MoveLight(MoveLight) = "move_light",
        /// Lets lights share a layer of the light map.
        GroupLights(GroupLights) = "group_lights",
    }
}

/// Puts an asset into the scene as one object.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Insert {
    /// What `POST /v1/assets` answered.
    pub asset: String,
    /// Name of the new object; must be free.
    #[schema(example = "chair-2")]
    pub name: String,
    /// Asset space to world space, column-major, metres.
    #[schema(example = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 2, 1]))]
    pub transform: [f64; 16],
}

/// Takes objects out, with the lights on them.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Remove {
    /// Names, in which `*` matches any part of a name, or nodes. A request may hold 4096 of them, 64 with a `*`.
    #[schema(example = json!(["sofa"]), value_type = Vec<Reference>)]
    pub objects: Vec<String>,
}

/// Gives an object a new place.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Move {
    /// Its name or node.
    #[schema(example = "sofa", value_type = Reference)]
    pub object: String,
    /// Object space to world space, column-major, metres; replaces the present one.
    #[schema(example = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0, 2, 1]))]
    pub transform: [f64; 16],
    /// It is being dragged: its light ends with its first round where the next step of the same drag waits by then. Later
    /// steps start from the light before the drag.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drag: bool,
}

/// Repaints an object, a material wherever it is, or the parts of one object that have it.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Repaint {
    /// Name or node of the object; without it the edit names a material.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "sofa", value_type = Option<Reference>)]
    pub object: Option<String>,
    /// Name of the material in the file; without it all materials of the object.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "wood")]
    pub material: Option<String>,
    /// Diffuse albedo, linear RGB, each 0 to 1.
    #[schema(example = json!([0.6, 0.1, 0.1]))]
    pub albedo: [f32; 3],
    /// What becomes of the file's textures and vertex colours; `replace` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<PaintedTexture>,
}

/// What becomes of textures and vertex colours where a material is painted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum PaintedTexture {
    /// They are painted over: the albedo is the same all over.
    Replace,
    /// They stay, and the albedo multiplies them instead of the file's base colour factor. Where an earlier edit has
    /// painted over them, the albedo is the same all over.
    Multiply,
}

/// Takes objects out of the light, with the lights on them. They stay in the list and keep their names, places and
/// materials, but have no elements.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Hide {
    /// Names, in which `*` matches any part of a name, or nodes. Those that are hidden stay so.
    #[schema(example = json!(["sofa"]), value_type = Vec<Reference>)]
    pub objects: Vec<String>,
}

/// Brings hidden objects back, with the lights on them.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Show {
    /// Names, in which `*` matches any part of a name, or nodes. Those that are not hidden stay so.
    #[schema(example = json!(["sofa"]), value_type = Vec<Reference>)]
    pub objects: Vec<String>,
}

/// Takes the last edit request back that counts. What it changed is as before it; the light too, bit for bit where it is
/// still kept.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Undo {
    /// Of a drag all steps at once.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drag: bool,
}

/// Makes the last request again that was taken back. Any other edit ends what can be made again.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Redo {
    /// Of a drag all steps at once.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drag: bool,
}

/// When a job stops: the first bound that is reached ends it. With a bound on time or error alone, samples go on
/// until that is reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// Samples per element.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 64, minimum = 1)]
    pub samples_per_element: Option<u32>,
    /// Seconds from when the request was accepted. A job does at least one round, however long that takes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 2.5)]
    pub max_seconds: Option<f64>,
    /// Stated area-weighted RMSE (irradiance / π).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.01)]
    pub target_rmse: Option<f32>,
}

/// What the client looks at: a camera of the file (`camera`), a camera of one's own (`eye`, `target`), or a sphere
/// (`point`, `radius`).
#[derive(Clone, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Focus {
    /// Index or name of a camera of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<CameraRef>,
    /// Where the camera stands.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye: Option<[f64; 3]>,
    /// What it looks at.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target: Option<[f64; 3]>,
    /// Upward; +y where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Vertical field of view, radians; π/3 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fov_y: Option<f32>,
    /// Pixels across; with `height` the shape of the picture, 16:9 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    /// Pixels down.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    /// Middle of a sphere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point: Option<[f64; 3]>,
    /// Radius of the sphere, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f32>,
}

/// How what is lit first is cut up: tile after tile, each published as soon as it has its samples, in the order of
/// importance. With a `focus` that gives a camera the order is by Chebyshev distance on screen from what is edited, of
/// what the camera sees; in a sphere by distance from its middle. Without `focus` it is by a bound on the change, and
/// elements whose bound is below a hundredth of the largest come with the rest. The rest of the map follows.
/// Lights that move are baked anew: their light is shown everywhere at once, roughly, and what is in focus gets its
/// samples together.
///
/// A newer edit of the scene ends the order: tiles that are not done are left, the map is completed, the job has
/// succeeded, and the newer edit begins at its own place.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Tiles {
    /// Elements per tile, about; 256 where absent. Tiles are larger where there would be more than 256 of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 256, minimum = 16, maximum = 1048576)]
    pub size: Option<u32>,
    /// Samples per element of each tile; 64 where absent. Never more than the budget has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 64, minimum = 1)]
    pub samples: Option<u32>,
    /// `continuous` where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<TileMode>,
}

/// How tiles are gone through.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TileMode {
    /// Not at all: everything in focus together, published after every round, as without `tiles`; then the rest, until
    /// the budget ends.
    Global,
    /// Tile after tile, then the rest to the same samples, and no further.
    Incremental,
    /// Tile after tile, then the rest to the same samples, and then refinement until the budget ends.
    Continuous,
}

/// A camera of the file.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum CameraRef {
    /// By its place in the list.
    Index(u32),
    /// By its name.
    Name(String),
}
