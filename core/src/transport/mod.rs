//! One application of the transport operator T: what arrives at an element, estimated with rays.
//!
//! Light maps hold `M = irradiance / π`; a surface with albedo ρ sends out ρ M. With `L = E + ρ M`, one bounce is
//! `M' = G[L]`, where G gathers L over the hemisphere by the cosine.

pub(crate) mod direct;
mod effort;
mod gather;
mod hint;
mod incoming;
mod plain;
mod seen;
mod spots;
mod surfel;
mod walk;
mod work;

pub use direct::DirectLight;
pub(crate) use effort::Effort;
pub(crate) use gather::{gather, gather_paths, gathered};
pub(crate) use hint::Hint;
pub(crate) use incoming::{Radiance, Source};
pub use plain::{direct_light, light_of_one};
pub(crate) use spots::{Spots, Target};
pub use surfel::Surfel;
pub(crate) use walk::{End, Field, Rough, walk};
pub use work::Work;
pub(crate) use work::{black, blacken, for_slots, sums};
