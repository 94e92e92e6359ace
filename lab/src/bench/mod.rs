//! Speed against error, all methods in one process on the same tree, samplers and threads; and what clients of a service
//! have over time.

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
mod study;
mod subject;

pub use crate::paper::Equation;
pub use cases::{Case, CaseKind, EditFile, PreparedCase};
pub use gallery::PictureOptions;
pub use methods::{Goal, Method, Timed, process_cpu_seconds, run_method};
pub use plot::{study_svg, svg};
pub use reference::{Measured, Reference};
pub use report::{BaseReport, CaseReport, PictureReport, ReferenceReport, Report, RunReport, Setup};
pub use run::{Options, Watcher, run};
pub use service::{Base, Drag, Seen, Service};
pub use study::{Curve, Point, Study, StudyCase, StudyReport, TimeToError, as_map, run_study};
pub use subject::Subject;
