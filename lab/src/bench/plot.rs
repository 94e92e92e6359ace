//! RMSE against time as an SVG picture: one panel per case, one curve per method. Errors are logarithmic; time is, too,
//! but for drags.

use std::fmt::Write;

use rebake_core::Stated;

use super::study::Curve;
use super::{CaseReport, Report, RunReport, Setup, Study, StudyCase, StudyReport};

/// Size of a panel's frame and the room around it, pixels.
const WIDTH: f64 = 400.0;
const HEIGHT: f64 = 280.0;
const LEFT: f64 = 72.0;
const RIGHT: f64 = 24.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 52.0;
const HEAD: f64 = 64.0;

/// Colours that stay apart for colour-blind readers (Okabe and Ito), and marks that stay apart without colour.
const COLORS: [&str; 7] = ["#0072b2", "#e69f00", "#cc79a7", "#d55e00", "#009e73", "#56b4e9", "#000000"];

/// What is drawn.
struct Sheet<'a> {
    title: &'a str,
    /// Of the curves.
    labels: Vec<String>,
    note: String,
    mode: Stated,
    /// Time is a logarithmic axis as the error always is; else it begins at 0.
    log_time: bool,
    panels: Vec<Panel<'a>>,
}

/// One diagram.
struct Panel<'a> {
    title: &'a str,
    note: String,
    /// Horizontal lines: error, text, dashes.
    lines: Vec<(f64, &'static str, &'static str)>,
    /// Seconds and error; in the order of the labels.
    curves: Vec<Vec<(f64, f64)>>,
}

/// Draws a report.
pub fn svg(report: &Report) -> String {
    let labels = labels(report);
    let panel = |case| case_panel(case, &labels);
    let panels = report.cases.iter().map(panel).collect();
    let note = note(&report.setup, "medians of ");
    let setup = &report.setup;
    draw(&Sheet { title: &setup.scene, labels: labels.clone(), note, mode: setup.mode, log_time: true, panels })
}

/// Draws the report of a study.
pub fn study_svg(report: &StudyReport) -> String {
    let labels = report.cases.first().map(|case| case.curves.iter().map(|curve| curve.label.clone()).collect());
    draw(&Sheet {
        title: &report.setup.scene,
        labels: labels.unwrap_or_default(),
        note: note(&report.setup, ""),
        mode: report.setup.mode,
        log_time: matches!(report.study, Study::Focus { .. }),
        panels: report.cases.iter().map(study_panel).collect(),
    })
}

fn note(setup: &Setup, of_runs: &str) -> String {
    format!("{} elements, {} threads, {of_runs}{} runs", setup.elements, setup.threads, setup.seeds)
}

fn study_panel(case: &StudyCase) -> Panel<'_> {
    let points = |curve: &Curve| curve.points.iter().map(|point| (point.seconds, point.rmse)).collect();
    Panel {
        title: &case.name,
        note: case.about.clone(),
        lines: vec![(case.reference.rmse_noise, NOISE, "2 4")],
        curves: case.curves.iter().map(points).collect(),
    }
}

/// Text of the line at the reference's own error.
const NOISE: &str = "noise of the reference";

fn case_panel<'a>(case: &'a CaseReport, labels: &[String]) -> Panel<'a> {
    let curve = |label: &String| {
        let runs = case.runs.iter().filter(|r| r.label() == *label);
        let mut points: Vec<(f64, f64)> = runs.map(|r| (r.seconds, r.rmse)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    };
    let noise = case.reference.rmse_noise;
    let untouched = case.no_update_rmse.unwrap_or(0.0);
    Panel {
        title: &case.name,
        note: format!("{:.1} % of the area", 100.0 * case.edited_share),
        lines: vec![(untouched, "no update", "7 4"), (noise, NOISE, "2 4")],
        curves: labels.iter().map(curve).collect(),
    }
}

fn draw(sheet: &Sheet) -> String {
    let columns = sheet.panels.len().clamp(1, 3);
    let rows = sheet.panels.len().div_ceil(columns).max(1);
    let (cell_width, cell_height) = (LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM);
    let (width, height) = ((cell_width * columns as f64).max(760.0), HEAD + cell_height * rows as f64);
    let mut out = String::new();
    let _ = write!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    head(&mut out, sheet, width);
    for (k, panel) in sheet.panels.iter().enumerate() {
        let x = (k % columns) as f64 * cell_width + LEFT;
        let y = HEAD + (k / columns) as f64 * cell_height + TOP;
        let _ = writeln!(out, "<g transform=\"translate({x:.0} {y:.0})\">");
        diagram(&mut out, panel, sheet);
        out.push_str("</g>\n");
    }
    out.push_str("</svg>\n");
    out
}

/// All methods of a report, in order of appearance.
fn labels(report: &Report) -> Vec<String> {
    let mut labels: Vec<String> = Vec::new();
    for label in report.cases.iter().flat_map(|c| &c.runs).map(RunReport::label) {
        if !labels.contains(&label) {
            labels.push(label);
        }
    }
    labels
}

fn head(out: &mut String, sheet: &Sheet, width: f64) {
    let _ = writeln!(
        out,
        "<text x=\"16\" y=\"24\" font-size=\"15\" font-weight=\"bold\">{}</text>\
         <text x=\"{:.0}\" y=\"24\" text-anchor=\"end\" fill=\"#666\">{}</text>",
        escape(sheet.title),
        width - 16.0,
        escape(&sheet.note)
    );
    let mut x = 16.0;
    for (k, label) in sheet.labels.iter().enumerate() {
        let color = COLORS[k % COLORS.len()];
        let _ = write!(
            out,
            "<line x1=\"{x:.0}\" y1=\"46\" x2=\"{:.0}\" y2=\"46\" stroke=\"{color}\" stroke-width=\"2\"/>",
            x + 26.0
        );
        mark(out, k, x + 13.0, 46.0);
        let _ = writeln!(out, "<text x=\"{:.0}\" y=\"50\">{}</text>", x + 32.0, escape(label));
        x += 52.0 + 7.0 * label.chars().count() as f64;
    }
}

/// An axis, logarithmic or from 0.
struct Axis {
    low: f64,
    high: f64,
    length: f64,
    is_log: bool,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, length: f64) -> Axis {
        let (low, high) = values
            .filter(|v| v.is_finite() && *v > 0.0)
            .fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.1, 10.0) };
        Axis { low: low / 1.3, high: high * 1.3, length, is_log: true }
    }

    /// From 0, with values in even steps.
    fn begun_at_zero(self) -> Axis {
        Axis { low: 0.0, high: self.high / 1.3, is_log: false, ..self }
    }

    /// Distance from the low end.
    fn at(&self, value: f64) -> f64 {
        match self.is_log {
            true => (value / self.low).ln() / (self.high / self.low).ln() * self.length,
            false => value / self.high * self.length,
        }
    }

    /// Values to label: 1, 2, 5 per decade, or decades alone where there are many; about five even steps from 0.
    fn ticks(&self) -> Vec<f64> {
        if !self.is_log {
            let decade = 10f64.powf((self.high / 5.0).log10().floor());
            let step = [1.0, 2.0, 5.0, 10.0].map(|s| s * decade).into_iter().rfind(|s| *s <= self.high / 4.0);
            let step = step.unwrap_or(decade);
            return (0..=(self.high / step + 1e-9) as u32).map(|k| f64::from(k) * step).collect();
        }
        let decades = (self.high / self.low).log10();
        let steps: &[f64] = if decades > 3.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let exponents = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let all = exponents.flat_map(|e| steps.iter().map(move |s| s * 10f64.powi(e)));
        all.filter(|v| *v >= self.low && *v <= self.high).collect()
    }
}

fn diagram(out: &mut String, panel: &Panel, sheet: &Sheet) {
    let points = || panel.curves.iter().flatten();
    let xs = Axis::over(points().map(|p| p.0), WIDTH);
    let xs = if sheet.log_time { xs } else { xs.begun_at_zero() };
    let errors = points().map(|p| p.1).chain(panel.lines.iter().map(|line| line.0));
    let ys = Axis::over(errors, HEIGHT);
    let y_of = |v: f64| HEIGHT - ys.at(v);
    let _ = writeln!(
        out,
        "<text x=\"0\" y=\"-14\" font-size=\"14\" font-weight=\"bold\">{}</text>\
         <text x=\"{WIDTH}\" y=\"-14\" text-anchor=\"end\" fill=\"#666\">{}</text>",
        escape(panel.title),
        escape(&panel.note)
    );
    grid(out, &xs, &ys, sheet.mode);
    for (value, text, dash) in &panel.lines {
        if *value > 0.0 {
            let y = y_of(*value);
            let _ = writeln!(
                out,
                "<line x1=\"0\" y1=\"{y:.1}\" x2=\"{WIDTH}\" y2=\"{y:.1}\" stroke=\"#777\" stroke-dasharray=\"{dash}\"/>\
                 <text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\" font-size=\"11\" fill=\"#555\" stroke=\"white\" \
                 stroke-width=\"3\" paint-order=\"stroke\">{text}</text>",
                WIDTH - 4.0,
                y - 4.0
            );
        }
    }
    for (k, points) in panel.curves.iter().enumerate() {
        let shown = points.iter().filter(|(s, e)| *e > 0.0 && (*s > 0.0 || !sheet.log_time));
        curve(out, k, shown.map(|(s, e)| (xs.at(*s), y_of(*e))).collect());
    }
}

fn grid(out: &mut String, xs: &Axis, ys: &Axis, mode: Stated) {
    for v in xs.ticks() {
        let x = xs.at(v);
        let _ = writeln!(
            out,
            "<line x1=\"{x:.1}\" y1=\"0\" x2=\"{x:.1}\" y2=\"{HEIGHT}\" stroke=\"#e4e4e4\"/>\
             <text x=\"{x:.1}\" y=\"{:.0}\" text-anchor=\"middle\">{}</text>",
            HEIGHT + 16.0,
            number(v)
        );
    }
    for v in ys.ticks() {
        let y = HEIGHT - ys.at(v);
        let _ = writeln!(
            out,
            "<line x1=\"0\" y1=\"{y:.1}\" x2=\"{WIDTH}\" y2=\"{y:.1}\" stroke=\"#e4e4e4\"/>\
             <text x=\"-6\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            y + 4.0,
            number(v)
        );
    }
    let part = if mode == Stated::Indirect { "indirect light" } else { "all light" };
    let _ = writeln!(
        out,
        "<rect width=\"{WIDTH}\" height=\"{HEIGHT}\" fill=\"none\" stroke=\"#888\"/>\
         <text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\">time, seconds</text>\
         <text transform=\"translate(-54 {:.0}) rotate(-90)\" text-anchor=\"middle\">RMSE of radiance / albedo, {part}</text>",
        WIDTH / 2.0,
        HEIGHT + 36.0,
        HEIGHT / 2.0
    );
}

fn curve(out: &mut String, k: usize, points: Vec<(f64, f64)>) {
    let path: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let color = COLORS[k % COLORS.len()];
    let _ =
        writeln!(out, "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>", path.join(" "));
    // Marks of a dense curve would hide it: some of them tell it apart.
    let every = points.len().div_ceil(24).max(1);
    points.into_iter().step_by(every).for_each(|(x, y)| mark(out, k, x, y));
}

fn mark(out: &mut String, k: usize, x: f64, y: f64) {
    let color = COLORS[k % COLORS.len()];
    let (l, r, t, b) = (x - 4.0, x + 4.0, y - 4.0, y + 4.0);
    let _ = match k % 4 {
        0 => writeln!(out, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{color}\"/>"),
        1 => writeln!(out, "<rect x=\"{l:.1}\" y=\"{t:.1}\" width=\"8\" height=\"8\" fill=\"{color}\"/>"),
        2 => writeln!(out, "<path d=\"M{l:.1} {b:.1}H{r:.1}L{x:.1} {t:.1}Z\" fill=\"{color}\"/>"),
        _ => writeln!(out, "<path d=\"M{x:.1} {t:.1}L{r:.1} {y:.1}L{x:.1} {b:.1}L{l:.1} {y:.1}Z\" fill=\"{color}\"/>"),
    };
}

/// As short as it is exact: 0.002, 0.5, 20.
fn number(v: f64) -> String {
    if !(1e-4..1e4).contains(&v) { format!("{v:.0e}") } else { format!("{}", (v * 1e6).round() / 1e6) }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_are_logarithmic_and_labelled_at_round_numbers() {
        let axis = Axis::over([0.01, 1.0, f64::NAN, 0.0].into_iter(), 100.0);
        let quarter = (axis.at(0.1) - axis.at(0.01)) - (axis.at(1.0) - axis.at(0.1));
        assert!(quarter.abs() < 1e-9 && axis.at(0.01) > 0.0 && axis.at(1.0) < 100.0);
        assert_eq!(
            axis.ticks().into_iter().map(number).collect::<Vec<_>>(),
            ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]
        );
        assert!(!Axis::over(std::iter::empty(), 100.0).ticks().is_empty());
        let even = Axis::over([4.5].into_iter(), 90.0).begun_at_zero();
        assert_eq!(even.ticks(), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert!((even.at(1.0) - 20.0).abs() < 1e-9);
    }

    #[test]
    fn names_cannot_break_the_picture() {
        assert_eq!(escape("a<b>&c"), "a&lt;b&gt;&amp;c");
    }
}
