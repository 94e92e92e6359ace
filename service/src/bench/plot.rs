//! RMSE against time as an SVG picture: one panel per case, log-log, one curve per method.

use std::fmt::Write;

use super::{CaseReport, Mode, Report, RunReport};

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

/// Draws a report.
pub fn svg(report: &Report) -> String {
    let labels = labels(report);
    let columns = report.cases.len().clamp(1, 3);
    let rows = report.cases.len().div_ceil(columns).max(1);
    let (cell_width, cell_height) = (LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM);
    let (width, height) = ((cell_width * columns as f64).max(760.0), HEAD + cell_height * rows as f64);
    let mut out = String::new();
    let _ = write!(
        out,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    head(&mut out, report, &labels, width);
    for (k, case) in report.cases.iter().enumerate() {
        let x = (k % columns) as f64 * cell_width + LEFT;
        let y = HEAD + (k / columns) as f64 * cell_height + TOP;
        let _ = writeln!(out, "<g transform=\"translate({x:.0} {y:.0})\">");
        panel(&mut out, case, &labels, report.mode);
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

fn head(out: &mut String, report: &Report, labels: &[String], width: f64) {
    let _ = writeln!(
        out,
        "<text x=\"16\" y=\"24\" font-size=\"15\" font-weight=\"bold\">{}</text>\
         <text x=\"{:.0}\" y=\"24\" text-anchor=\"end\" fill=\"#666\">{} elements, {} threads, medians of {} runs</text>",
        escape(&report.scene),
        width - 16.0,
        report.elements,
        report.threads,
        report.seeds
    );
    let mut x = 16.0;
    for (k, label) in labels.iter().enumerate() {
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

/// A logarithmic axis over whole steps of 1, 2, 5.
struct Axis {
    low: f64,
    high: f64,
    length: f64,
}

impl Axis {
    fn over(values: impl Iterator<Item = f64>, length: f64) -> Axis {
        let (low, high) = values
            .filter(|v| v.is_finite() && *v > 0.0)
            .fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.1, 10.0) };
        Axis { low: low / 1.3, high: high * 1.3, length }
    }

    /// Distance from the low end.
    fn at(&self, value: f64) -> f64 {
        (value / self.low).ln() / (self.high / self.low).ln() * self.length
    }

    /// Values to label: 1, 2, 5 per decade, or decades alone where there are many.
    fn ticks(&self) -> Vec<f64> {
        let decades = (self.high / self.low).log10();
        let steps: &[f64] = if decades > 3.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let exponents = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let all = exponents.flat_map(|e| steps.iter().map(move |s| s * 10f64.powi(e)));
        all.filter(|v| *v >= self.low && *v <= self.high).collect()
    }
}

fn panel(out: &mut String, case: &CaseReport, labels: &[String], mode: Mode) {
    let xs = Axis::over(case.runs.iter().map(|r| r.seconds), WIDTH);
    let noise = case.reference.rmse_noise;
    let errors = case.runs.iter().map(|r| r.rmse).chain(case.no_update_rmse).chain([noise]);
    let ys = Axis::over(errors, HEIGHT);
    let y_of = |v: f64| HEIGHT - ys.at(v);
    let _ = writeln!(
        out,
        "<text x=\"0\" y=\"-14\" font-size=\"14\" font-weight=\"bold\">{}</text>\
         <text x=\"{WIDTH}\" y=\"-14\" text-anchor=\"end\" fill=\"#666\">{:.1} % of the area</text>",
        escape(&case.name),
        100.0 * case.edited_share
    );
    grid(out, &xs, &ys, mode);
    let untouched = case.no_update_rmse.unwrap_or(0.0);
    for (value, text, dash) in [(untouched, "no update", "7 4"), (noise, "noise of the reference", "2 4")] {
        if value > 0.0 {
            let y = y_of(value);
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
    for (k, label) in labels.iter().enumerate() {
        let runs = case.runs.iter().filter(|r| r.label() == *label && r.rmse > 0.0);
        let mut points: Vec<(f64, f64)> = runs.map(|r| (r.seconds, r.rmse)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        curve(out, k, points.into_iter().map(|(s, e)| (xs.at(s), y_of(e))).collect());
    }
}

fn grid(out: &mut String, xs: &Axis, ys: &Axis, mode: Mode) {
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
    let part = if mode == Mode::Indirect { "indirect light" } else { "all light" };
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
    points.into_iter().for_each(|(x, y)| mark(out, k, x, y));
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
    }

    #[test]
    fn names_cannot_break_the_picture() {
        assert_eq!(escape("a<b>&c"), "a&lt;b&gt;&amp;c");
    }
}
