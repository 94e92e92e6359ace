//! What travels as JSON of edits of lights.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::edit_nodes::Reference;
use super::misread::tagged;

/// Changes colour or intensity of lights.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Relight {
    /// Light by light.
    pub lights: Vec<RelightOne>,
}

/// New colour or intensity of one light; what is absent stays.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RelightOne {
    /// Its name or node.
    #[schema(example = "lamp", value_type = Reference)]
    pub light: String,
    /// Linear RGB factor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub color: Option<[f32; 3]>,
    /// Scalar factor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 2.5)]
    pub intensity: Option<f32>,
}

/// Adds a light.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InsertLight {
    /// Its name; must be free.
    #[schema(example = "lamp-2")]
    pub name: String,
    /// What it is.
    pub light: NewLight,
}

tagged! {
    /// A light to add.
    pub enum NewLight by "kind" {
        /// Shines in all directions.
        Point(PointLight) = "point",
        /// Shines in a cone.
        Spot(SpotLight) = "spot",
        /// Shines from afar.
        Directional(DirectionalLight) = "directional",
        /// Constant radiance from outside.
        Environment(EnvironmentLight) = "environment",
    }
}

/// Shines in all directions.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PointLight {
    /// Where it is.
    #[schema(example = json!([0, 2, 0]))]
    pub position: [f64; 3],
    /// Linear RGB factor.
    #[schema(example = json!([1, 1, 1]))]
    pub color: [f32; 3],
    /// Candela.
    #[schema(example = 40.0)]
    pub intensity: f32,
    /// Its light ends here, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<f32>,
}

/// Shines in a cone.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SpotLight {
    /// Where it is.
    pub position: [f64; 3],
    /// Where it shines.
    pub direction: [f32; 3],
    /// Linear RGB factor.
    pub color: [f32; 3],
    /// Candela.
    pub intensity: f32,
    /// Full intensity up to this angle from `direction`, radians; 0 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inner_cone_angle: Option<f32>,
    /// No light beyond this angle, radians; π/4 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outer_cone_angle: Option<f32>,
    /// Its light ends here, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<f32>,
}

/// Shines from afar.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DirectionalLight {
    /// Where it shines.
    pub direction: [f32; 3],
    /// Linear RGB factor.
    pub color: [f32; 3],
    /// Lux on a surface that faces it.
    pub intensity: f32,
    /// Angle that its disc takes up, radians, at least 0 and below π: the sun's is 0.0093. 0 where absent: hard shadows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.0093)]
    pub angle: Option<f32>,
}

/// Constant radiance from outside.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EnvironmentLight {
    /// Linear RGB factor.
    pub color: [f32; 3],
    /// Radiance.
    pub intensity: f32,
}

/// Gives the scene its light from outside, instead of what it has of it: a picture or the same from everywhere. The light
/// is named `environment`, and is relit, grouped and removed as others are.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Sky {
    /// An equirectangular picture: what `POST /v1/assets` answered. Either it or `radiance`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24")]
    pub asset: Option<String>,
    /// Linear RGB radiance from everywhere. Either it or `asset`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radiance: Option<[f32; 3]>,
    /// By how much the picture is turned about +y, counter-clockwise seen from above, degrees; 0 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 90.0)]
    pub rotation: Option<f32>,
    /// Factor on the radiance; 1 where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = 1.0)]
    pub strength: Option<f32>,
}

/// Takes a light away. An emissive surface stays as an object that emits nothing.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RemoveLight {
    /// Its name or node.
    #[schema(example = "lamp", value_type = Reference)]
    pub light: String,
}

/// Moves a point or spot light, turns a spot or directional light.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MoveLight {
    /// Its name or node.
    #[schema(example = "lamp", value_type = Reference)]
    pub light: String,
    /// New place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = json!([1, 2, 0]))]
    pub position: Option<[f64; 3]>,
    /// New direction in which it shines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f32; 3]>,
    /// It is being dragged: a quick estimate is published at once, and the exact update follows unless the next step of
    /// the same drag waits by then. No later light starts from an estimate. The light gets a layer of its own.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub drag: bool,
}

/// Lets lights share a layer of the light map: relighting all of them alike needs no rays, and costs the memory of one
/// layer. A scene has at most 1022 such groups.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct GroupLights {
    /// Name of the layer, and of the group. Absent: the lights belong to no group any more, and stay in the layer that
    /// they are in.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(example = "ceiling")]
    pub name: Option<String>,
    /// Names or nodes of lights.
    #[schema(example = json!(["lamp-1", "lamp-2"]), value_type = Vec<Reference>)]
    pub lights: Vec<String>,
}
