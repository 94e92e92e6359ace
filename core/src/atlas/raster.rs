//! Which texels a triangle covers. Texel (x, y) has its centre at (x + ½, y + ½).

use glam::{DVec2, Vec2};

/// Calls `visit` for the texels, within `size`, whose centres lie in a triangle or at most `reach` texels from its box in
/// either direction, row by row; those near its slopes may be a little farther away. Slivers cost their length, not
/// their box.
pub(crate) fn for_rows(corners: [Vec2; 3], reach: f64, size: [u32; 2], mut visit: impl FnMut(u32, u32)) {
    let corners = corners.map(Vec2::as_dvec2);
    let (low, high) = corners.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(l, h), c| (l.min(*c), h.max(*c)));
    if !(low.is_finite() && high.is_finite()) {
        return;
    }
    // Casts saturate: what is left of the first texel begins there.
    let first = |from: f64| (from - reach - 0.5).ceil() as u32;
    let end = |to: f64, most: u32| ((to + reach - 0.5).floor() + 1.0).min(f64::from(most)) as u32;
    for y in first(low.y)..end(high.y, size[1]) {
        let middle = f64::from(y) + 0.5;
        let Some((from, to)) = across(corners, middle - reach, middle + reach) else { continue };
        for x in first(from)..end(to, size[0]) {
            visit(x, y);
        }
    }
}

/// From where to where a triangle goes between two heights; none where it does not.
fn across(corners: [DVec2; 3], low: f64, high: f64) -> Option<(f64, f64)> {
    let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
    for k in 0..3 {
        let (a, b) = (corners[k], corners[(k + 1) % 3]);
        let (a, b) = if a.y <= b.y { (a, b) } else { (b, a) };
        if a.y > high || b.y < low {
            continue;
        }
        let at = |height: f64| a.x + (b.x - a.x) * ((height - a.y) / (b.y - a.y)).clamp(0.0, 1.0);
        let ends = if b.y > a.y { [at(low), at(high)] } else { [a.x, b.x] };
        from = ends.into_iter().fold(from, f64::min);
        to = ends.into_iter().fold(to, f64::max);
    }
    (from <= to).then_some((from, to))
}

/// Barycentric weights of a point, which may be negative; none where the triangle has no area.
pub(crate) fn weights(corners: [Vec2; 3], point: DVec2) -> Option<[f64; 3]> {
    let [a, b, c] = corners.map(|corner| corner.as_dvec2() - point);
    let parts = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
    let sum: f64 = parts.iter().sum();
    (sum != 0.0).then(|| parts.map(|part| part / sum)).filter(|weights| weights.iter().all(|w| w.is_finite()))
}

/// The point of a triangle that is nearest to a point, by its barycentric weights, and how far away that is, squared.
pub(crate) fn nearest(corners: [Vec2; 3], point: DVec2) -> ([f64; 3], f64) {
    if let Some(weights) = weights(corners, point).filter(|weights| weights.iter().all(|w| *w >= 0.0)) {
        return (weights, 0.0);
    }
    let mut best = ([1.0, 0.0, 0.0], f64::INFINITY);
    for k in 0..3 {
        let next = (k + 1) % 3;
        let (a, b) = (corners[k].as_dvec2(), corners[next].as_dvec2());
        let length2 = (b - a).length_squared();
        let t = if length2 > 0.0 { ((point - a).dot(b - a) / length2).clamp(0.0, 1.0) } else { 0.0 };
        let distance2 = (a + (b - a) * t - point).length_squared();
        if distance2 < best.1 {
            let mut weights = [0.0; 3];
            (weights[k], weights[next]) = (1.0 - t, t);
            best = (weights, distance2);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    fn visited(corners: [Vec2; 3], reach: f64) -> Vec<(u32, u32)> {
        let mut list = Vec::new();
        for_rows(corners, reach, [24, 24], |x, y| list.push((x, y)));
        list
    }

    /// By brute force over all texels: none whose centre is within reach is missing, each comes once.
    #[test]
    fn no_texel_is_missing_or_comes_twice() {
        let mut rng = Pcg32::new(7, 1);
        for round in 0..300 {
            let mut corner = || Vec2::from(rng.next_2d()) * 30.0 - 3.0;
            let corners = if round % 3 == 0 {
                let a = corner();
                [a, a + (corner() - a) * 0.01, corner()]
            } else {
                [corner(), corner(), corner()]
            };
            let reach = [0.0, 1.0, 1.5][round % 3];
            let list = visited(corners, reach);
            let mut unique = list.clone();
            unique.sort_unstable();
            unique.dedup();
            assert_eq!(unique.len(), list.len());
            for (x, y) in (0..24 * 24).map(|k| (k % 24, k / 24)) {
                let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let (near, distance2) = nearest(corners, centre);
                assert!((near.iter().sum::<f64>() - 1.0).abs() < 1e-9);
                let there = unique.binary_search(&(x, y)).is_ok();
                assert!(there || distance2.sqrt() > reach, "{corners:?} {x} {y}");
                assert!(!there || distance2.sqrt() < 2.0 * reach + 1e-6, "{corners:?} {x} {y} {distance2}");
            }
        }
    }

    #[test]
    fn what_is_not_finite_covers_nothing() {
        for bad in [f32::NAN, f32::INFINITY] {
            assert!(visited([Vec2::ZERO, Vec2::X * 9.0, Vec2::splat(bad)], 1.0).is_empty());
        }
        assert!(!visited([Vec2::splat(-1e30), Vec2::new(1e30, -1e30), Vec2::splat(1e30)], 0.0).is_empty());
    }
}
