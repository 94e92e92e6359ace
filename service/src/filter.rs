//! Whether light is delivered as it is stored.

use std::sync::Arc;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::engine::{self, Canceled, LightMap, Observer, World};

/// What is done to light on its way to a client; what is stored stays as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema, ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum Filter {
    /// Nothing.
    #[default]
    None,
    /// Noise is averaged away: elements take in those near them on the surface whose light, as far as the stated errors of
    /// both tell, may be the same. The mean by area stays; errors are stated of what is delivered.
    Statistical,
}

impl Filter {
    /// The light map of a world as it is delivered.
    ///
    /// # Errors
    /// [`Canceled`] where the observer says so.
    pub fn apply(self, world: &World, map: Arc<LightMap>, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        match self {
            Filter::None => Ok(map),
            Filter::Statistical => engine::filter(world, &map, |_| true, observer).map(Arc::new),
        }
    }
}
