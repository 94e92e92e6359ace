//! The engine of rebake: scenes, trees, light transport, bakes and updates of light maps.
//!
//! A plain synchronous library: it knows no HTTP, no async, no clock and no global state. The same inputs
//! and seed give the same bits on any number of threads.

mod accumulate;
pub mod allowed;
mod ambient;
pub mod atlas;
mod bake;
mod batches;
mod bits;
pub mod bvh;
mod by_parts;
mod chunks;
pub mod delta;
pub mod directional;
mod drag;
pub mod edit;
mod estimate;
pub mod export;
pub mod filter;
mod focus;
pub mod harmonics;
mod hash;
mod importance;
mod indices;
pub mod job;
pub mod layers;
pub mod lightmap;
pub mod metrics;
#[cfg(test)]
mod module_graph;
pub mod occlusion;
mod order;
pub mod points;
pub mod probes;
pub mod random;
mod ranges;
mod refine;
pub mod render;
pub mod resolution;
mod rounds;
pub mod sampling;
mod scatter;
pub mod scene;
mod solve;
mod space;
pub mod surface;
pub mod texels;
mod tiles;
pub mod transport;
mod update;
mod value;
mod world;

pub use bake::bake;
pub use by_parts::{PartBaker, PartError, PartSpec};
pub use chunks::Chunks;
pub use drag::DragBasis;
pub use edit::{Edit, EditError, EditErrorKind, Relight, Restore};
pub use estimate::{Estimate, EstimateError};
pub use focus::Focus;
pub use importance::{Importance, TileMode, Tiles};
pub use job::{Budget, Canceled, NextPart, Observer, Offer, Pass, Progress, Snapshot, Unobserved};
pub use lightmap::{LayerHeader, LightMap, LightPart, LightValues};
pub use refine::refine;
pub use space::{Density, Footprint, LAYOUT_VERSION, NO_OBJECT, Placement, object_areas};
pub use update::update;
pub use world::{
    Emitter, LightInfo, LightSample, ObjectInfo, Placed, Spread, Stated, Transition, Trees, Validity, World,
    WorldError, WorldOptions, arriving, visible_light,
};
