//! `rebake bench --measure focus` and `--measure drag`: what a client of the service has, and when.

use rebake_lab::bench::{Study, StudyCase, StudyReport};
use serde_json::json;

use super::super::ui;
use super::table::print_head;
use super::{BenchArgs, What};

/// A way for the demo's chair: away from the table, towards the corner under the wall lamp.
pub(super) const DEMO_DRAG: &str = r#"{"scene": "", "cases": [
    {"name": "chair", "edit": "move", "objects": ["chair"],
     "transform": [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  4.3, 0, 3.2, 1]}
]}"#;

/// Samples per element where none are asked for: the service's own default.
const SAMPLES: u32 = 64;

/// What to measure over time; none where it is edits, method by method.
pub(super) fn study(args: &BenchArgs) -> Option<Study> {
    match args.measure {
        What::Edits => None,
        What::Focus => Some(Study::Focus {
            focus: args.focus.clone().unwrap_or_else(|| json!({ "camera": 0 })),
            tiles: args.tiles.clone(),
            samples: args.samples.first().copied().unwrap_or(SAMPLES),
        }),
        What::Drag => Some(Study::Drag { moves: args.moves }),
    }
}

/// Prints the newest case, below a line about the scene where it is the first.
pub(super) fn print_last(report: &StudyReport) -> anyhow::Result<()> {
    let Some(case) = report.cases.last() else { return Ok(()) };
    if report.cases.len() == 1 {
        print_head(&report.setup, "")?;
    }
    ui::out("")?;
    let noise = ui::rmse(case.reference.rmse_noise);
    ui::out(&format!("{}, {}, reference's noise {noise}", ui::bold(&case.name), case.about))?;
    match report.study {
        Study::Focus { .. } => print_times(case),
        Study::Drag { .. } => print_curves(case),
    }
}

fn print_times(case: &StudyCase) -> anyhow::Result<()> {
    const HEADINGS: [&str; 4] = ["RMSE in view", "without focus", "with focus", "sooner"];
    let table = ui::Table::new(&HEADINGS, &[12, 13, 10, 7]);
    ui::out(&ui::faint(&table.row(&HEADINGS)))?;
    let or_never = |x: Option<f64>, text: fn(f64) -> String| x.map_or_else(|| "–".to_owned(), text);
    for time in &case.times {
        ui::out(&table.row(&[
            ui::rmse(time.rmse),
            or_never(time.without_focus, milliseconds),
            or_never(time.with_focus, milliseconds),
            or_never(time.ratio, |ratio| format!("{ratio:.2}×")),
        ]))?;
    }
    Ok(())
}

/// A line per quarter of a second, and the means over the drag.
fn print_curves(case: &StudyCase) -> anyhow::Result<()> {
    const EVERY: usize = 5;
    let labels = case.curves.iter().map(|curve| curve.label.as_str());
    let headings: Vec<&str> = ["time"].into_iter().chain(labels).collect();
    let table = ui::Table::new(&headings, &[12, 10, 10]);
    ui::out(&ui::faint(&table.row(&headings)))?;
    let times = case.curves.first().map(|curve| curve.points.as_slice()).unwrap_or_default();
    for (k, point) in times.iter().enumerate().step_by(EVERY) {
        let errors = case.curves.iter().map(|curve| ui::rmse(curve.points[k].rmse));
        ui::out(&table.row(&[ui::seconds(point.seconds)].into_iter().chain(errors).collect::<Vec<_>>()))?;
    }
    let means = case.curves.iter().map(|curve| curve.mean_rmse.map_or_else(|| "–".to_owned(), ui::rmse));
    ui::out(&ui::bold(&table.row(&["while dragged".to_owned()].into_iter().chain(means).collect::<Vec<_>>())))
}

fn milliseconds(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.0} ms", 1e3 * seconds) } else { ui::seconds(seconds) }
}
