//! All further bounces of a source, on a subset of the elements: rays are traced once and kept as a sparse matrix, and
//! the system is solved on it.

mod bounces;
mod exchange;
mod gmres;
mod rows;
mod subset;

pub(crate) use bounces::Solvable;
pub(crate) use exchange::{Exchange, Paths};
pub(crate) use rows::Rows;
pub(crate) use subset::Subset;
