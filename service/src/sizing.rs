//! How the elements of a scene are spread.

use clap::ValueEnum;
use rebake_core::Spread;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How the elements of a scene are spread over what they lie on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Sizing {
    /// Equally far apart.
    #[default]
    Uniform,
    /// Closer together where light needs it, farther apart elsewhere.
    Light,
}

impl From<Spread> for Sizing {
    fn from(spread: Spread) -> Sizing {
        match spread {
            Spread::Uniform => Sizing::Uniform,
            Spread::ByLight | Spread::ByLightWithin => Sizing::Light,
        }
    }
}

impl Sizing {
    /// As queries and the command line have it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Sizing::Uniform => "uniform",
            Sizing::Light => "light",
        }
    }

    /// What it is where a largest spacing is asked for, or is not.
    pub fn spread(self, has_spacing: bool) -> Spread {
        match (self, has_spacing) {
            (Sizing::Uniform, _) => Spread::Uniform,
            (Sizing::Light, false) => Spread::ByLight,
            (Sizing::Light, true) => Spread::ByLightWithin,
        }
    }
}

/// What is kept of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum StoredSpread {
    #[default]
    Uniform,
    ByLight,
    ByLightWithin,
}

impl From<Spread> for StoredSpread {
    fn from(spread: Spread) -> StoredSpread {
        match spread {
            Spread::Uniform => StoredSpread::Uniform,
            Spread::ByLight => StoredSpread::ByLight,
            Spread::ByLightWithin => StoredSpread::ByLightWithin,
        }
    }
}

impl From<StoredSpread> for Spread {
    fn from(stored: StoredSpread) -> Spread {
        match stored {
            StoredSpread::Uniform => Spread::Uniform,
            StoredSpread::ByLight => Spread::ByLight,
            StoredSpread::ByLightWithin => Spread::ByLightWithin,
        }
    }
}
