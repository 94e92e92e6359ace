//! `rebake bench`: speed against error, all methods in one process on the same tree, samplers and threads.

mod cases;
mod methods;
mod reference;

pub use cases::{Case, EditFile, PreparedCase};
pub use methods::{Method, Timed, run_method};
pub use reference::{Measured, Reference};
