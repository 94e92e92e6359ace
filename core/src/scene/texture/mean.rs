//! The mean of a picture over a triangle: texels times the exact area of their overlap with it.

use glam::{DVec2, DVec4, Vec2};

use super::reduce::Level;
use super::{Texture, TextureMean, Wrap};

/// Texels under a triangle, and rows and columns that it spans, before a coarser level is read: the most that one mean
/// costs. The coarser texels at its rim then average a little of what lies beside it.
const MAX_AREA: f64 = 2048.0;
const MAX_SPAN: f64 = 256.0;
/// Texels² below which a triangle counts as a line.
const LEAST_AREA: f64 = 1e-9;

impl Texture {
    /// Mean over a triangle of the picture, given by texture coordinates (u to the right, v down, the picture is
    /// 0..1 × 0..1): each texel counts by the area of its overlap with the triangle times its weight. Exact up to
    /// some 2,000 texels; of larger triangles to about a 30th of their width at the rim. A triangle without an area
    /// is a line or a point.
    pub fn mean_over(&self, uv: [Vec2; 3], wrap: [Wrap; 2]) -> TextureMean {
        let uv = uv.map(|corner| corner.as_dvec2());
        if !uv.iter().all(|corner| corner.is_finite()) {
            return self.mean();
        }
        let last = self.levels.len() - 1;
        let fits = |level: &&Level| {
            let corners = in_texels(level, uv);
            let span = corners[0].max(corners[1]).max(corners[2]) - corners[0].min(corners[1]).min(corners[2]);
            double_area(corners).abs() <= 2.0 * MAX_AREA && span.max_element() <= MAX_SPAN
        };
        match self.levels[..last].iter().find(fits) {
            // One texel: the whole.
            None => self.mean(),
            Some(level) => over(level, in_texels(level, uv), wrap),
        }
    }
}

fn in_texels(level: &Level, uv: [DVec2; 3]) -> [DVec2; 3] {
    uv.map(|corner| corner * DVec2::new(f64::from(level.width), f64::from(level.height)))
}

fn double_area([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).perp_dot(c - a)
}

fn over(level: &Level, mut corners: [DVec2; 3], wrap: [Wrap; 2]) -> TextureMean {
    if double_area(corners).abs() < LEAST_AREA {
        return along(level, corners, wrap);
    }
    corners.sort_by(|a, b| a.y.total_cmp(&b.y));
    let [top, middle, bottom] = corners;
    let (mut sum, mut area) = (DVec4::ZERO, 0.0);
    // Above and below the middle corner both sides are straight.
    for (from, to) in [(top.y, middle.y), (middle.y, bottom.y)] {
        let mut y0 = from;
        while y0 < to {
            let row = y0.floor();
            let y1 = to.min(row + 1.0);
            let side = |y: f64| {
                let short = if from == top.y && to == middle.y {
                    crossing(top, middle, y)
                } else {
                    crossing(middle, bottom, y)
                };
                let long = crossing(top, bottom, y);
                [short.min(long), short.max(long)]
            };
            let y = wrap[1].apply(row as i64, level.height);
            add_row(level, y, [side(y0), side(y1)], y1 - y0, wrap[0], &mut sum, &mut area);
            y0 = y1;
        }
    }
    if area > 0.0 { TextureMean::of(sum / area) } else { along(level, corners, wrap) }
}

/// Where the line from `a` to `b` crosses height `y`.
fn crossing(a: DVec2, b: DVec2, y: f64) -> f64 {
    let height = b.y - a.y;
    if height <= 0.0 { a.x } else { a.x + (b.x - a.x) * ((y - a.y) / height).clamp(0.0, 1.0) }
}

/// Adds a slice of a row of texels, `height` high, between two straight sides given as `[[left, right]; 2]` at its top
/// and its bottom.
fn add_row(level: &Level, y: u32, sides: [[f64; 2]; 2], height: f64, wrap: Wrap, sum: &mut DVec4, area: &mut f64) {
    let [left, right] = [0, 1].map(|side| [sides[0][side], sides[1][side]]);
    let (start, end) = (left[0].min(left[1]).floor(), right[0].max(right[1]));
    let (inner_start, inner_end) = (left[0].max(left[1]), right[0].min(right[1]));
    let mut x = start;
    while x < end {
        let share = if x >= inner_start && x + 1.0 <= inner_end {
            height
        } else {
            let left_of = |x: f64| height * (mean_below(x, right) - mean_below(x, left));
            (left_of(x + 1.0) - left_of(x)).max(0.0)
        };
        if share > 0.0 {
            *sum += level.texel(wrap.apply(x as i64, level.width), y).as_dvec4() * share;
            *area += share;
        }
        x += 1.0;
    }
}

/// Mean of min(x, e) for e evenly between two values.
fn mean_below(x: f64, [a, b]: [f64; 2]) -> f64 {
    let (low, high) = (a.min(b), a.max(b));
    if x >= high {
        0.5 * (low + high)
    } else if x <= low {
        x
    } else {
        let below = (x - low) / (high - low);
        below * 0.5 * (low + x) + (1.0 - below) * x
    }
}

/// Mean along the longest side of a triangle without an area.
fn along(level: &Level, [a, b, c]: [DVec2; 3], wrap: [Wrap; 2]) -> TextureMean {
    let sides = [(a, b), (b, c), (c, a)];
    let longest = sides.into_iter().max_by(|s, t| s.0.distance(s.1).total_cmp(&t.0.distance(t.1)));
    let (from, to) = longest.unwrap_or((a, b));
    let steps = from.distance(to).ceil().clamp(1.0, 4.0 * MAX_SPAN);
    let size = DVec2::new(f64::from(level.width), f64::from(level.height));
    let at = |step: u32| level.at(from.lerp(to, (f64::from(step) + 0.5) / steps) / size, wrap).as_dvec4();
    TextureMean::of((0..steps as u32).map(at).sum::<DVec4>() / steps)
}
