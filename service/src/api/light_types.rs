//! Lights, the layers of a light map, and what there is of it to fetch, as JSON.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::store::versions::{LightPart, Wanted};

/// What to fetch of a light map or a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum PartName {
    /// Direct + indirect light.
    Full,
    /// Light straight from lights.
    Direct,
    /// Light after at least one bounce.
    Indirect,
    /// The standard error of each element (irradiance / π), of the light that is the scene's mode: three equal numbers,
    /// infinite where nothing is known of it (in glTF the largest finite number).
    Error,
    /// Ambient occlusion: the share of the hemisphere above each element, weighted by the cosine, in which nothing lies
    /// within `ao_distance`; three equal numbers. Computed when it is asked for. In files, not in deltas.
    Ao,
    /// From where the light of each element comes (the scene's mode): the first band of spherical harmonics of the
    /// radiance that comes to its hemisphere, three RGB coefficients, of y, z and x. Gathered from the light map when
    /// it is asked for. In `raw` the values of all elements for y, then z, then x; in pictures channels `y.R` and so
    /// on. In files, not in deltas.
    Directional,
}

impl PartName {
    /// What of a light map or a layer it names; none of what is no light.
    pub(super) fn of_light(self) -> Option<Wanted> {
        match self {
            PartName::Full => Some(Wanted::Light(LightPart::Full)),
            PartName::Direct => Some(Wanted::Light(LightPart::Direct)),
            PartName::Indirect => Some(Wanted::Light(LightPart::Indirect)),
            PartName::Error => Some(Wanted::Error),
            PartName::Ao | PartName::Directional => None,
        }
    }
}

/// A light. Its strength is `color` × `intensity`, in the unit of its kind.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct Light {
    /// Its name.
    #[schema(example = "lamp")]
    pub name: String,
    /// Index of its node in the uploaded file, of an emissive surface that of its object; absent for what was inserted.
    #[schema(example = 5)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<u32>,
    /// `extras.id` of the node, where the file has one.
    #[schema(example = "c04e")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// `emissive`, `point`, `spot`, `directional` or `environment`.
    #[schema(example = "point")]
    pub kind: String,
    /// Linear RGB factor.
    pub color: [f32; 3],
    /// Radiance (emissive, environment), candela (point, spot), lux (directional), or a factor on a picture of the sky.
    #[schema(example = 40.0)]
    pub intensity: f32,
    /// The layer of the light map that holds its light; null while the map has no layers, or none of this light yet.
    #[schema(example = "lamp")]
    pub layer: Option<String>,
    /// The object that emits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub object: Option<String>,
    /// Where it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<[f64; 3]>,
    /// Where it shines.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f32; 3]>,
    /// Where the light of a point or spot light ends, metres; absent where it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<f32>,
    /// Full intensity of a spot light up to this angle from `direction`, radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inner_cone_angle: Option<f32>,
    /// No light of a spot light beyond this angle from `direction`, radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outer_cone_angle: Option<f32>,
    /// Angle that the disc of a directional light takes up, radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle: Option<f32>,
    /// By how much a picture of the sky is turned about +y, degrees; absent without a picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<f32>,
}

/// A layer: the light of some lights at reference strengths.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneLayer {
    /// Its name: that of its group or its light, or `shared`.
    #[schema(example = "ceiling")]
    pub name: String,
    /// What it counts in the light map at this version, per channel. A client that relights by itself takes the new
    /// strength over the reference instead.
    #[schema(example = json!([2.5, 2.25, 2]))]
    pub weight: [f32; 3],
    /// Its lights.
    pub lights: Vec<SceneLayerLight>,
    /// Memory that it takes: 36 bytes per element.
    #[schema(example = 757_224)]
    pub memory_bytes: u64,
}

/// A light of a layer.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub struct SceneLayerLight {
    /// Name of the light.
    #[schema(example = "lamp")]
    pub name: String,
    /// Strength (`color` × `intensity`) at which the layer holds its light.
    pub reference: [f32; 3],
}
