//! `rebake bench`: speed against error, all methods in one process on the same tree, samplers and threads; and what
//! clients of a service have over time.

mod cases;
mod drag;
mod focus;
mod gallery;
mod methods;
mod plot;
mod reference;
mod report;
mod run;
mod service;
mod session;
mod study;
mod subject;

pub use cases::{Case, CaseKind, EditFile, PreparedCase};
pub use gallery::PictureOptions;
pub use methods::{Goal, Method, Timed, run_method};
pub use plot::{study_svg, svg};
pub use rebake_core::paper::Equation;
pub use reference::{Measured, Reference};
pub use report::{BaseReport, CaseReport, PictureReport, ReferenceReport, Report, RunReport, Setup};
pub use run::{Options, Watcher, run};
pub use service::run_service;
pub use study::{Curve, Point, Study, StudyCase, StudyReport, TimeToError, run_study};
pub use subject::Subject;

/// Which part of the light map errors are measured on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Direct + indirect.
    Full,
    /// Indirect only, as the published method is measured.
    Indirect,
}

impl Mode {
    /// What light maps state the error of.
    pub fn stated(self) -> rebake_core::Stated {
        match self {
            Mode::Full => rebake_core::Stated::Full,
            Mode::Indirect => rebake_core::Stated::Indirect,
        }
    }
}
