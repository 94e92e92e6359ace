//! Reports of error against time as a client sees it: what a focus brings, and what is shown during a drag.

use anyhow::{Result, ensure};
use glam::Vec3;
use rebake_core::{LightMap, Stated};
use serde::Serialize;
use serde_json::Value;

use super::report::{ReferenceReport, Setup};
use super::{Case, CaseKind, Options, Service, Subject, Watcher, drag, focus};

/// What is measured over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Study {
    /// Time to an error in what a focus looks at, with it and without.
    Focus {
        /// The focus of all edits, as the API takes it.
        focus: Value,
        /// In which steps, as the API takes it.
        #[serde(skip_serializing_if = "Option::is_none")]
        tiles: Option<Value>,
        /// Samples per element of an edit.
        samples: u32,
    },
    /// Error while objects are moved ten times per second and afterwards, beside re-baking.
    Drag {
        /// How many moves.
        moves: u32,
    },
}

/// All cases of a study.
#[derive(Clone, Debug, Serialize)]
pub struct StudyReport {
    /// What was measured.
    pub study: Study,
    /// The scene, threads and so on.
    #[serde(flatten)]
    pub setup: Setup,
    /// In the order of the edit file.
    pub cases: Vec<StudyCase>,
}

/// One case of a study.
#[derive(Clone, Debug, Serialize)]
pub struct StudyCase {
    /// From the edit file.
    pub name: String,
    /// For people: what is measured where.
    pub about: String,
    /// What errors are measured against; for a drag at its first place.
    pub reference: ReferenceReport,
    /// Error against time.
    pub curves: Vec<Curve>,
    /// When errors are reached; for a focus.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub times: Vec<TimeToError>,
}

/// Error against time.
#[derive(Clone, Debug, Serialize)]
pub struct Curve {
    /// What it is of.
    pub label: String,
    /// In the order of time.
    pub points: Vec<Point>,
    /// Mean RMSE over the time of the drag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mean_rmse: Option<f64>,
}

/// A point of a curve.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// Since the edit, or since the first move.
    pub seconds: f64,
    /// Area-weighted RMSE of what the client has then, the reference's own noise taken out.
    pub rmse: f64,
}

/// When an error is reached.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TimeToError {
    /// The error.
    pub rmse: f64,
    /// Seconds without focus; none where it is not reached.
    pub without_focus: Option<f64>,
    /// Seconds with focus.
    pub with_focus: Option<f64>,
    /// So many times sooner with focus.
    pub ratio: Option<f64>,
}

/// Runs a study on the current rayon pool, with services that `service` lends.
pub fn run_study(
    study: &Study,
    subject: &Subject,
    options: &Options,
    service: &dyn Service,
    watcher: &mut dyn Watcher,
) -> Result<StudyReport> {
    let is_wanted = |case: &Case| matches!(study, Study::Focus { .. }) || case.edit == CaseKind::Move;
    ensure!(
        subject.file.cases.iter().any(is_wanted),
        "cases: a drag takes those whose edit is \"move\", there is none"
    );
    let setup = subject.setup(options, watcher)?;
    let spacing = setup.spacing;
    let mut report = StudyReport { study: study.clone(), setup, cases: Vec::new() };
    subject.each_case((options, spacing), is_wanted, watcher, |case, watcher| {
        report.cases.push(match study {
            Study::Focus { focus, tiles, samples } => {
                let view = focus::View { focus, tiles: tiles.as_ref(), samples: *samples };
                focus::measure(case, &view, options, service, watcher)?
            }
            Study::Drag { moves } => drag::measure(case, *moves, options, service, watcher)?,
        });
        watcher.study_case_done(&report)
    })?;
    Ok(report)
}

/// Published values as a light map, all of it in the part that `mode` measures.
pub fn as_map(values: Vec<Vec3>, mode: Stated) -> LightMap {
    let mut map = LightMap::black(values.len());
    match mode {
        Stated::Full => map.light.direct = values,
        Stated::Indirect => map.light.indirect = values,
    }
    map
}
