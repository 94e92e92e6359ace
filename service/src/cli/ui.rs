//! What a person sees: numbers, tables, progress bars, colours only on a terminal.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

/// A line of results on standard output.
pub(super) fn out(line: &str) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(stdout, "{line}")?;
    stdout.flush()?;
    Ok(())
}

/// A line for the person who watches, on standard error.
pub(super) fn note(line: &str) {
    // Nobody to tell if standard error is gone.
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Asks the person who sits there; anything but yes is no.
pub(super) fn confirm(question: &str) -> anyhow::Result<bool> {
    let mut stderr = std::io::stderr().lock();
    write!(stderr, "{question} [y/N] ")?;
    stderr.flush()?;
    let mut answer = String::new();
    std::io::stdin().read_line(&mut answer)?;
    Ok(["y", "yes"].contains(&answer.trim().to_lowercase().as_str()))
}

/// Whether a person sits in front of both input and output.
pub(super) fn is_interactive() -> bool {
    std::io::stdin().is_terminal() && std::io::stdout().is_terminal()
}

fn colors(on: bool) -> bool {
    on && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty())
}

/// Red on a terminal, for standard error.
pub(super) fn red(text: &str) -> String {
    paint(text, "31;1", colors(std::io::stderr().is_terminal()))
}

/// Bold on a terminal, for standard output.
pub(super) fn bold(text: &str) -> String {
    paint(text, "1", colors(std::io::stdout().is_terminal()))
}

/// Faint on a terminal, for standard output.
pub(super) fn faint(text: &str) -> String {
    paint(text, "2", colors(std::io::stdout().is_terminal()))
}

fn paint(text: &str, code: &str, on: bool) -> String {
    if on { format!("\x1b[{code}m{text}\x1b[0m") } else { text.to_owned() }
}

/// A bar of thousandths on standard error, where that is a terminal.
pub(super) fn bar(what: &str) -> ProgressBar {
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("{prefix:>12} {bar:32} {percent:>3} %  {elapsed}  {msg}") {
        bar.set_style(style.progress_chars("━╸ "));
    }
    bar.set_prefix(what.to_owned());
    bar.enable_steady_tick(Duration::from_millis(100));
    bar
}

/// A running clock on standard error, where that is a terminal, for work of unknown length.
pub(super) fn spinner(what: &str) -> ProgressBar {
    let spinner = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{prefix:>12} {spinner}  {elapsed}  {msg}") {
        spinner.set_style(style);
    }
    spinner.set_prefix(what.to_owned());
    spinner.enable_steady_tick(Duration::from_millis(100));
    spinner
}

/// `1 light`, `2 lights`.
pub(super) fn counted(n: u64, thing: &str) -> String {
    format!("{} {thing}{}", count(n), if n == 1 { "" } else { "s" })
}

/// `1234567` as `1,234,567`.
pub(super) fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// Three significant digits with a prefix: `12.3 M`.
pub(super) fn short(n: f64) -> String {
    let (scale, prefix) = match n.abs() {
        x if x >= 1e9 => (1e9, " G"),
        x if x >= 1e6 => (1e6, " M"),
        x if x >= 1e4 => (1e3, " k"),
        _ => return format!("{n:.0}"),
    };
    format!("{}{prefix}", digits(n / scale))
}

/// Three significant digits, without zeros at the end: `0.05`, `2.5`, `1230`.
pub(super) fn number(x: f64) -> String {
    if x == 0.0 || !x.is_finite() {
        return x.to_string();
    }
    let decimals = (2 - x.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{x:.decimals$}");
    if decimals == 0 { text } else { text.trim_end_matches('0').trim_end_matches('.').to_owned() }
}

/// A size in bytes.
pub(super) fn bytes(n: u64) -> String {
    match n as f64 {
        x if x >= 1024.0 * 1024.0 * 1024.0 => format!("{} GiB", digits(x / (1024.0 * 1024.0 * 1024.0))),
        x if x >= 1024.0 * 1024.0 => format!("{} MiB", digits(x / (1024.0 * 1024.0))),
        x if x >= 1024.0 => format!("{} KiB", digits(x / 1024.0)),
        _ => format!("{n} B"),
    }
}

/// A time span: seconds, from two minutes on minutes, from two hours on hours.
pub(super) fn seconds(s: f64) -> String {
    match s {
        s if s >= 7200.0 => format!("{} h", digits(s / 3600.0)),
        s if s >= 120.0 => format!("{} min", digits(s / 60.0)),
        s if s >= 1.0 => format!("{} s", digits(s)),
        s => format!("{s:.2} s"),
    }
}

/// An error of the light map: radiance / albedo, so of the order of the scene's brightness.
pub(super) fn rmse(x: f64) -> String {
    match x {
        x if !x.is_finite() => "–".to_owned(),
        x if x == 0.0 || x >= 0.001 => format!("{x:.4}"),
        x => format!("{x:.1e}"),
    }
}

/// Three significant digits of a number from 1 to 9,999.
fn digits(x: f64) -> String {
    let decimals = if x.abs() >= 99.95 {
        0
    } else if x.abs() >= 9.995 {
        1
    } else {
        2
    };
    format!("{x:.decimals$}")
}

/// Columns side by side: the first aligned left, all others right.
#[derive(Debug)]
pub(super) struct Table {
    widths: Vec<usize>,
}

impl Table {
    /// Columns at least as wide as their headings, and as these widths.
    pub(super) fn new(headings: &[&str], widths: &[usize]) -> Table {
        let widths = headings.iter().zip(widths).map(|(heading, width)| heading.chars().count().max(*width));
        Table { widths: widths.collect() }
    }

    /// One line of the table.
    pub(super) fn row<S: AsRef<str>>(&self, cells: &[S]) -> String {
        let mut line = String::new();
        for (i, (cell, width)) in cells.iter().zip(&self.widths).enumerate() {
            let (cell, width) = (cell.as_ref(), *width);
            if i == 0 {
                line.push_str(&format!("{cell:<width$}"));
            } else {
                line.push_str(&format!("  {cell:>width$}"));
            }
        }
        line.trim_end().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_for_people() {
        assert_eq!([0, 999, 1000, 61_234, 1_234_567].map(count), ["0", "999", "1,000", "61,234", "1,234,567"]);
        assert_eq!([5.0, 9999.0, 12_345.0, 6.1e6, 2.5e9].map(short), ["5", "9999", "12.3 k", "6.10 M", "2.50 G"]);
        assert_eq!([12, 2048, 5 << 20, 3 << 30].map(bytes), ["12 B", "2.00 KiB", "5.00 MiB", "3.00 GiB"]);
        assert_eq!(
            [0.123, 1.0, 99.0, 150.0, 7200.0].map(seconds),
            ["0.12 s", "1.00 s", "99.0 s", "2.50 min", "2.00 h"]
        );
        assert_eq!(
            [0.0, 0.05, 2.5, 1.0, 1234.5, -0.33333, 1e-5, f64::INFINITY].map(number),
            ["0", "0.05", "2.5", "1", "1234", "-0.333", "0.00001", "inf"]
        );
        assert_eq!([0.0, 0.01234, 0.00012, f64::NAN].map(rmse), ["0.0000", "0.0123", "1.2e-4", "–"]);
    }

    #[test]
    fn tables_line_up() {
        let table = Table::new(&["step", "n"], &[6, 5]);
        assert_eq!(table.row(&["step", "n"]), "step        n");
        assert_eq!(table.row(&["− sofa", "1,234"]), "− sofa  1,234");
    }
}
