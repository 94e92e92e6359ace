//! Reports on the terminal.

use rebake_lab::bench::{CaseReport, Setup};

use super::super::ui;

/// A line about the scene; `of_runs` says what figures are of the runs, as in "medians of ".
pub(super) fn print_head(setup: &Setup, of_runs: &str) -> anyhow::Result<()> {
    ui::out(&format!(
        "{}: {} elements, spacing {:.3} m, {} threads, {of_runs}{} runs",
        ui::bold(&setup.scene),
        ui::count(setup.elements as u64),
        setup.spacing,
        setup.threads,
        setup.seeds
    ))
}

const HEADINGS: [&str; 12] =
    ["method", "time", "CPU", "samples", "rays", "mean", "RMSE", "±", "bias", "stated", "gain", "by CPU"];

pub(super) fn print_case(case: &CaseReport) -> anyhow::Result<()> {
    let widths: Vec<usize> = [18, 7, 7, 7, 7, 7, 7, 7, 7, 7, 6, 6].to_vec();
    let table = ui::Table::new(&HEADINGS, &widths);
    ui::out("")?;
    let edited = format!("{:.1} % of the area", 100.0 * case.edited_share);
    ui::out(&format!("{}, {edited}, {} elements", ui::bold(&case.name), ui::count(case.elements as u64)))?;
    ui::out(&ui::faint(&table.row(&HEADINGS)))?;
    let value = |x: Option<f64>| x.map_or_else(|| "–".to_owned(), ui::rmse);
    let line = |name: &str, rmse: f64| table.row(&[name, "", "", "", "", "", &ui::rmse(rmse)]);
    if let Some(rmse) = case.no_update_rmse {
        ui::out(&line("no update", rmse))?;
    }
    if let Some(rmse) = case.base.rmse {
        ui::out(&line("before the edit", rmse))?;
    }
    ui::out(&line("reference's noise", case.reference.rmse_noise))?;
    for run in &case.runs {
        ui::out(&table.row(&[
            run.label(),
            ui::seconds(run.seconds),
            run.cpu_seconds.map_or_else(|| "–".to_owned(), ui::seconds),
            run.samples_per_element.to_string(),
            ui::short(run.rays as f64),
            format!("{:.4}", run.mean_ratio),
            ui::rmse(run.rmse),
            ui::rmse(run.rmse_error),
            bias(run.bias_floor, run.bias_error),
            value(run.estimated_rmse),
            gain(run.gain),
            gain(run.gain_cpu),
        ]))?;
        if let Some(rmse) = run.change_rmse {
            let (rmse, gain) = (ui::rmse(rmse), gain(run.change_gain));
            let (error, bias) = (value(run.change_rmse_error), bias(run.change_bias, run.change_bias_error));
            let row = ["  its change alone", "", "", "", "", "", &rmse, &error, &bias, "", &gain];
            ui::out(&ui::faint(&table.row(&row)))?;
        }
    }
    Ok(())
}

/// Bias, or what it is below where noise hides it.
fn bias(floor: Option<f64>, error: Option<f64>) -> String {
    match (floor, error) {
        (Some(floor), Some(error)) if floor > 2.0 * error => ui::rmse(floor),
        (Some(floor), Some(error)) => format!("<{}", ui::rmse(floor + 2.0 * error)),
        _ => "–".to_owned(),
    }
}

/// RMSE of path tracing in the same time over this one.
fn gain(gain: Option<f64>) -> String {
    gain.map_or_else(|| "–".to_owned(), |g| if g < 9.95 { format!("{g:.1}×") } else { format!("{g:.0}×") })
}
