//! One application of the transport operator T: what arrives at an element, estimated with rays.
//!
//! Light maps hold `M = irradiance / π`; a surface with albedo ρ sends out ρ M. With `L = E + ρ M`, one bounce is
//! `M' = G[L]`, where G gathers L over the hemisphere by the cosine.

pub(crate) mod direct;
mod effort;
mod gather;
mod hint;
mod incoming;
mod seen;
mod spots;
mod surfel;
mod walk;
mod work;

pub(crate) use direct::DirectLight;
pub(crate) use effort::Effort;
pub(crate) use gather::{gather, gather_paths, gathered};
pub(crate) use hint::Hint;
pub(crate) use incoming::{Radiance, Source};
pub(crate) use spots::{Spots, Target};
pub(crate) use surfel::Surfel;
pub(crate) use walk::{End, Field, Rough, walk};
pub(crate) use work::{Work, black, blacken, for_slots};
