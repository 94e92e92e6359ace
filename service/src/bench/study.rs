//! Reports of error against time as a client sees it: what a focus brings, and what is shown during a drag.

use std::path::Path;

use anyhow::{Context, Result, bail};
use glam::Vec3;
use rebake_core::scene::Scene;
use rebake_core::{LightMap, World, WorldOptions};
use serde::Serialize;
use serde_json::Value;

use super::report::ReferenceReport;
use super::{Case, CaseKind, EditFile, Mode, Options, Watcher, drag, focus};

/// What is measured over time.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Study {
    /// Time to an error in what a focus looks at, with it and without.
    Focus {
        /// The focus of all edits, as the API takes it.
        focus: Value,
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
    /// File of the scene.
    pub scene: String,
    /// Elements of the scene as it is in the file.
    pub elements: usize,
    /// Threads of the service, and of re-baking.
    pub threads: usize,
    /// Largest distance between neighbouring elements, metres.
    pub spacing: f32,
    /// What errors are measured on.
    pub mode: Mode,
    /// Runs. Times to an error are medians of them, errors during a drag are means.
    pub seeds: u32,
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

/// Runs a study on the current rayon pool. `folder` is where paths in the edit file begin.
pub fn run_study(
    study: &Study,
    name: &str,
    scene: &Scene,
    file: &EditFile,
    folder: &Path,
    options: &Options,
    watcher: &mut dyn Watcher,
) -> Result<StudyReport> {
    watcher.step("", "elements of the scene");
    let mut world_options = WorldOptions { spacing: options.spacing, ..WorldOptions::default() };
    let world = World::new(scene.clone(), &world_options)?;
    world_options.spacing = Some(world.spacing());
    let mut report = StudyReport {
        study: study.clone(),
        scene: name.to_owned(),
        elements: world.element_count(),
        threads: rayon::current_num_threads(),
        spacing: world.spacing(),
        mode: options.mode,
        seeds: options.seeds,
        cases: Vec::new(),
    };
    let wanted = |case: &Case| {
        let is_named = options.filter.as_ref().is_none_or(|part| case.name.contains(part));
        is_named && (matches!(study, Study::Focus { .. }) || case.edit == CaseKind::Move)
    };
    for (k, case) in file.cases.iter().enumerate().filter(|(_, case)| wanted(case)) {
        watcher.step(&case.name, "edit");
        let prepared =
            case.prepare(scene, folder, &world_options).with_context(|| format!("cases[{k}] ({:?})", case.name))?;
        report.cases.push(match study {
            Study::Focus { focus, samples } => focus::measure(&prepared, focus, *samples, options, watcher)?,
            Study::Drag { moves } => drag::measure(&prepared, *moves, options, watcher)?,
        });
        watcher.study_case_done(&report)?;
    }
    if report.cases.is_empty() {
        bail!("cases: none to run; a drag takes those whose edit is \"move\"");
    }
    Ok(report)
}

/// Published values as a light map, all of it in the part that `mode` measures.
pub(super) fn as_map(values: Vec<Vec3>, mode: Mode) -> LightMap {
    let black = LightMap::black(values.len());
    match mode {
        Mode::Full => LightMap { direct: values, ..black },
        Mode::Indirect => LightMap { indirect: values, ..black },
    }
}
