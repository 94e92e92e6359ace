//! What a world is made by, and why it cannot be made.

use crate::atlas::{AtlasError, AtlasOptions};
use crate::scene::DEFAULT_MAX_ALBEDO;
use crate::surface::SurfaceError;

/// Limits and resolution of a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorldOptions {
    /// Largest distance between neighbouring elements, metres; chosen from the scene's size where absent.
    pub spacing: Option<f32>,
    /// How many elements there are to be, where there is no `spacing`: nearly so many, and no more unless it has more
    /// pieces of surface ([`Density::of_elements`](crate::Density::of_elements)). The scene then has a warning.
    pub elements: Option<usize>,
    /// Most squares of its spacing that one object has ([`Density`](crate::Density)). Where absent it is chosen with
    /// the spacing, and there is no such bound on one that is given.
    pub object_squares: Option<f64>,
    /// More element slots than this are refused.
    pub max_elements: usize,
    /// More triangles between elements than this are refused.
    pub max_triangles: usize,
    /// What light maps state the error of.
    pub stated: Stated,
    /// Largest albedo that light meets, from 0 to 1: where a surface has more, of the file, an inserted asset or a
    /// repaint, this counts. In a closed room of albedo 1 light has no end.
    pub max_albedo: f32,
    /// Its objects have places in an atlas, which edits keep ([`World::atlas`](super::World::atlas)).
    pub atlas: Option<AtlasOptions>,
    /// Whether elements lie equally far apart.
    pub spread: Spread,
}

/// How elements are spread over what they lie on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Spread {
    /// One spacing for all.
    #[default]
    Uniform,
    /// Closer where light needs them, farther apart elsewhere: about as many as at one spacing (within a tenth).
    ByLight,
    /// Closer where light needs them, and nowhere farther apart than the spacing: up to half as many more than at one
    /// spacing.
    ByLightWithin,
}

/// Light whose error is stated, and by which samples are spent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Stated {
    /// Direct and indirect light.
    #[default]
    Full,
    /// Indirect light alone: whoever uses such a map computes direct light otherwise.
    Indirect,
}

impl Stated {
    /// The part of some light that counts.
    #[inline]
    pub(crate) fn of<V: std::ops::Add<Output = V>>(self, direct: V, indirect: V) -> V {
        match self {
            Stated::Full => direct + indirect,
            Stated::Indirect => indirect,
        }
    }
}

impl Default for WorldOptions {
    fn default() -> Self {
        WorldOptions {
            spacing: None,
            elements: None,
            object_squares: None,
            max_elements: 20_000_000,
            max_triangles: 40_000_000,
            stated: Stated::Full,
            max_albedo: DEFAULT_MAX_ALBEDO,
            atlas: None,
            spread: Spread::Uniform,
        }
    }
}

/// Why a scene cannot be made ready.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WorldError {
    /// `spacing` is none that elements may have.
    #[error("spacing: {0}")]
    Spacing(String),
    /// The squares that an object may have are none.
    #[error("object_squares: must be a number above 0, not {0}")]
    ObjectSquares(f64),
    /// `max_albedo` is no number from 0 to 1.
    #[error("max_albedo: must be a number from 0 to 1, not {0}")]
    MaxAlbedo(f32),
    /// There is no atlas for it.
    #[error(transparent)]
    Atlas(#[from] AtlasError),
    /// An object cannot be subdivided.
    #[error("object {object:?}: {source}")]
    Surface {
        /// Name of the object.
        object: String,
        /// What stands in the way.
        source: SurfaceError,
    },
    /// Too many elements or triangles at this spacing.
    #[error("the scene has more than {limit} {what} at a spacing of {spacing} m")]
    TooLarge {
        /// `elements` or `triangles`.
        what: &'static str,
        /// The limit that was passed.
        limit: usize,
        /// Spacing in force.
        spacing: f32,
    },
}
