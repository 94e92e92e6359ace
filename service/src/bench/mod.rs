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

pub use crate::Mode;
