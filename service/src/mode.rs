//! Which light a light map holds for its clients.

use std::borrow::Cow;

use clap::ValueEnum;
use glam::Vec3;
use rebake_core::{LightMap, LightPart, Stated};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a light map holds, and what its error is stated of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
#[schema(as = SceneMode)]
pub enum Mode {
    /// Direct + indirect light.
    #[default]
    #[serde(alias = "Full")]
    Full,
    /// Indirect light only; the direct part is the client's.
    #[serde(alias = "Indirect")]
    Indirect,
}

impl Mode {
    /// What light maps state the error of.
    pub fn stated(self) -> Stated {
        match self {
            Mode::Full => Stated::Full,
            Mode::Indirect => Stated::Indirect,
        }
    }

    /// The part of all light that it is.
    pub fn part(self) -> LightPart {
        match self {
            Mode::Full => LightPart::Full,
            Mode::Indirect => LightPart::Indirect,
        }
    }

    /// Radiance / albedo per slot, as computed: noise has both signs.
    pub fn values(self, map: &LightMap) -> Cow<'_, [Vec3]> {
        map.light.part(self.part())
    }
}

#[cfg(test)]
mod tests {
    use super::Mode;

    #[test]
    fn what_earlier_versions_stored_is_read() {
        for (text, mode) in [("Full", Mode::Full), ("indirect", Mode::Indirect), ("Indirect", Mode::Indirect)] {
            assert_eq!(serde_json::from_value::<Mode>(text.into()).unwrap(), mode);
        }
    }
}
