//! Colours that stand for numbers, and the bar that says which.

use glam::Vec3;

/// A scale of colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Palette {
    /// −1 to 1: blue is less, grey nothing, red more (K. Moreland's diverging map, 2009).
    Signed,
    /// 0 to 1: black, purple, orange, yellow (*inferno*, S. van der Walt and N. Smith).
    Heat,
}

const SIGNED: [[u8; 3]; 5] = [[59, 76, 192], [141, 176, 254], [221, 221, 221], [244, 154, 123], [180, 4, 38]];
const HEAT: [[u8; 3]; 9] = [
    [0, 0, 4],
    [33, 12, 74],
    [86, 16, 110],
    [137, 34, 106],
    [188, 55, 84],
    [227, 89, 51],
    [249, 140, 10],
    [249, 201, 50],
    [252, 255, 164],
];

impl Palette {
    /// The smallest value with a colour of its own; the largest is 1.
    fn low(self) -> f32 {
        match self {
            Palette::Signed => -1.0,
            Palette::Heat => 0.0,
        }
    }

    /// sRGB in 0..=1; values beyond the ends take the ends' colours, what is not a number magenta.
    pub fn color(self, value: f32) -> Vec3 {
        if value.is_nan() {
            return Vec3::new(1.0, 0.0, 1.0);
        }
        let table: &[[u8; 3]] = match self {
            Palette::Signed => &SIGNED,
            Palette::Heat => &HEAT,
        };
        let t = ((value - self.low()) / (1.0 - self.low())).clamp(0.0, 1.0) * (table.len() - 1) as f32;
        let i = (t as usize).min(table.len() - 2);
        let at = |i: usize| Vec3::from(table[i].map(f32::from)) / 255.0;
        at(i).lerp(at(i + 1), t - i as f32)
    }

    /// What the lower end, the middle and the upper end of the scale stand for, where that is `scale`.
    pub fn ticks(self, scale: f32) -> [String; 3] {
        [self.low(), 0.5 * (self.low() + 1.0), 1.0].map(|end| number(end * scale))
    }

    /// The colour at a part of the way from the lower end of the scale to the upper one.
    pub fn color_along(self, share: f32) -> Vec3 {
        self.color(self.low() + (1.0 - self.low()) * share)
    }

    /// Draws the scale with the numbers of its ends into the lower edge of 8-bit RGB; pictures that are too small for
    /// it stay as they are.
    pub(super) fn draw_bar(self, rgb: &mut [u8], width: usize, height: usize, scale: f32) {
        let zoom = (height / 180).max(1);
        let bar = 8 * zoom;
        let [low, _, high] = self.ticks(scale);
        let texts = [low, high];
        let text_width = texts.iter().map(|t| t.len() * 4 * zoom).max().unwrap_or(0) + 4 * zoom;
        if height < 8 * bar || width < 2 * text_width + 16 * zoom {
            return;
        }
        let mut set = |x: usize, y: usize, color: [u8; 3]| rgb[3 * (y * width + x)..][..3].copy_from_slice(&color);
        for y in height - bar..height {
            for x in 0..width {
                let inside = x.saturating_sub(text_width) as f32 / (width - 2 * text_width) as f32;
                let is_bar = x >= text_width && x < width - text_width && y >= height - bar + zoom;
                let color = if is_bar { self.color_along(inside.min(1.0)) } else { Vec3::splat(0.08) };
                set(x, y, color.to_array().map(|c| (c * 255.0 + 0.5) as u8));
            }
        }
        for (text, left) in texts.iter().zip([2 * zoom, width - text_width + 2 * zoom]) {
            for (i, character) in text.chars().enumerate() {
                for (row, bits) in glyph(character).into_iter().enumerate() {
                    for column in (0..3).filter(|c| bits >> (2 - c) & 1 == 1) {
                        for dot in 0..zoom * zoom {
                            let x = left + (4 * i + column) * zoom + dot % zoom;
                            set(x, height - bar + (1 + row) * zoom + zoom / 2 + dot / zoom, [235; 3]);
                        }
                    }
                }
            }
        }
    }
}

fn number(value: f32) -> String {
    match value.abs() {
        v if v == 0.0 || (0.001..10_000.0).contains(&v) => format!("{value}"),
        _ => format!("{value:e}"),
    }
}

/// Three by five dots: rows from the top, the highest of three bits on the left.
fn glyph(character: char) -> [u8; 5] {
    match character {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 1, 1],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        '-' => [0, 0, 7, 0, 0],
        'e' => [0, 7, 7, 4, 7],
        _ => [0; 5],
    }
}

/// The smallest of 1, 2, 5 × 10ⁿ that at most 1 % of the values pass in size; 1 where nothing differs from 0.
pub fn nice_scale(values: &[f32]) -> f32 {
    let mut sizes: Vec<f32> = values.iter().map(|v| v.abs()).filter(|v| *v > 0.0 && v.is_finite()).collect();
    if sizes.is_empty() {
        return 1.0;
    }
    let at = (sizes.len() * 99 / 100).min(sizes.len() - 1);
    let (_, wanted, _) = sizes.select_nth_unstable_by(at, f32::total_cmp);
    // In f64, so that what comes out is the f32 that is written the shortest way.
    let decade = 10f64.powi(wanted.log10().floor() as i32);
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step: f64| (step * decade) as f32);
    steps.into_iter().find(|scale| *scale >= *wanted * 0.999_999).unwrap_or(*wanted)
}
