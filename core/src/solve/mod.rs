//! All further bounces of a source: on a subset of the elements, with the tail closed by a solve over clusters.

mod clusters;
mod propagate;
mod subset;

pub(crate) use propagate::{Bounces, propagate};
pub(crate) use subset::Subset;
