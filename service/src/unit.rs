//! What the intensities of a file's lights are numbers of.

use clap::ValueEnum;
use rebake_core::scene::Scene;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What the intensities of a file's point and spot lights are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum LightUnit {
    /// Candela, as glTF has it; also W/sr, as Blender writes in its lighting mode "Unitless".
    #[default]
    Candela,
    /// Watts into all directions together, as Blender writes in its lighting mode "Raw": divided by 4π.
    Watt,
}

impl LightUnit {
    /// As queries and the command line have it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            LightUnit::Candela => "candela",
            LightUnit::Watt => "watt",
        }
    }

    /// Brings the lights of a file that was just read to intensity per steradian.
    pub fn convert(self, scene: &mut Scene) {
        match self {
            LightUnit::Candela => {}
            LightUnit::Watt => scene.lamps_in_watts(),
        }
    }
}
