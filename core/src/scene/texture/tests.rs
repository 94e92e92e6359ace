//! Means against the clipping of every texel by itself, and pictures whose means are known.

use glam::{DVec2, DVec4, Vec2, Vec3};

use super::reduce::linear_from_srgb;
use super::*;

/// SplitMix64, as numbers within 0..1.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn noise(width: u32, height: u32, random: &mut Random) -> Vec<u8> {
    (0..width * height * 4).map(|_| (random.next() * 256.0) as u8).collect()
}

/// The polygon within x ≥ 0 after turning it so that the edge of a texel is there.
fn cut(polygon: &[DVec2], inside: impl Fn(DVec2) -> f64) -> Vec<DVec2> {
    let mut out = Vec::new();
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (da, db) = (inside(a), inside(b));
        if da >= 0.0 {
            out.push(a);
        }
        if (da > 0.0 && db < 0.0) || (da < 0.0 && db > 0.0) {
            out.push(a.lerp(b, da / (da - db)));
        }
    }
    out
}

/// Clips the triangle to every texel in its bounds (Sutherland and Hodgman).
fn clipped(width: u32, height: u32, rgba: &[u8], alpha: AlphaUse, uv: [Vec2; 3], wrap: [Wrap; 2]) -> TextureMean {
    let size = DVec2::new(f64::from(width), f64::from(height));
    let corners = uv.map(|corner| corner.as_dvec2() * size);
    let low = corners[0].min(corners[1]).min(corners[2]).floor();
    let high = corners[0].max(corners[1]).max(corners[2]).ceil();
    let (mut sum, mut total) = (DVec4::ZERO, 0.0);
    for y in low.y as i64..high.y as i64 {
        for x in low.x as i64..high.x as i64 {
            let (left, top) = (x as f64, y as f64);
            let polygon = cut(&corners, |p| p.x - left);
            let polygon = cut(&polygon, |p| left + 1.0 - p.x);
            let polygon = cut(&polygon, |p| p.y - top);
            let polygon = cut(&polygon, |p| top + 1.0 - p.y);
            let side = |i: usize| polygon[i].perp_dot(polygon[(i + 1) % polygon.len()]);
            let area = 0.5 * (0..polygon.len()).map(side).sum::<f64>().abs();
            let (column, row) = (wrap[0].apply(x, width), wrap[1].apply(y, height));
            let texel = &rgba[4 * (row * width + column) as usize..][..4];
            let weight = match alpha {
                AlphaUse::Ignored => 1.0,
                AlphaUse::Cutoff(cutoff) => f64::from(u8::from(f32::from(texel[3]) / 255.0 >= cutoff)),
                AlphaUse::Blend => f64::from(texel[3]) / 255.0,
            };
            let [r, g, b] = [0, 1, 2].map(|c| linear_from_srgb(f64::from(texel[c]) / 255.0));
            sum += DVec4::new(r, g, b, 1.0) * weight * area;
            total += area;
        }
    }
    TextureMean::of(sum / total)
}

#[test]
fn means_are_those_of_clipped_texels() {
    let mut random = Random(7);
    let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    let alphas = [AlphaUse::Ignored, AlphaUse::Cutoff(0.5), AlphaUse::Blend];
    for case in 0..400 {
        let (width, height) = (1 + (random.next() * 40.0) as u32, 1 + (random.next() * 40.0) as u32);
        let rgba = noise(width, height, &mut random);
        let alpha = alphas[case % 3];
        let wrap = [wraps[case / 3 % 3], wraps[case / 9 % 3]];
        let texture = Texture::new(width, height, &rgba, alpha, usize::MAX);
        // From a tenth of the picture to all of it, and beyond its sides.
        let scale = 0.1 + 0.9 * random.next();
        let start = Vec2::new(random.next() as f32, random.next() as f32) * 4.0 - 2.0;
        let uv = [0; 3].map(|_| start + Vec2::new(random.next() as f32, random.next() as f32) * scale as f32);
        let (found, right) = (texture.mean_over(uv, wrap), clipped(width, height, &rgba, alpha, uv, wrap));
        // Texels are kept in 65,535ths.
        assert!((found.weight - right.weight).abs() < 1e-4, "{case}: {found:?} {right:?}");
        let weighed = (found.color * found.weight - right.color * right.weight).abs().max_element();
        assert!(weighed < 1e-4, "{case}: {found:?} {right:?}");
    }
}

/// Triangles that coarser levels answer: two halves of a picture of half black and half white are grey, a triangle well
/// within one half is of its colour.
#[test]
fn large_triangles_cost_little_and_stay_right() {
    let (width, height) = (1000, 600);
    let rgba: Vec<u8> =
        (0..width * height).flat_map(|i| if i % width < width / 2 { [0, 0, 0, 255] } else { [255; 4] }).collect();
    for max_texels in [usize::MAX, 1 << 16] {
        let texture = Texture::new(width, height, &rgba, AlphaUse::Ignored, max_texels);
        assert!((texture.mean().color - 0.5).abs().max_element() < 1e-4, "{:?}", texture.mean());
        let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let halves = [[0, 1, 2], [0, 2, 3]].map(|t| texture.mean_over(t.map(|i| corners[i]), [Wrap::Repeat; 2]));
        let both = (halves[0].color + halves[1].color) * 0.5;
        assert!((both - 0.5).abs().max_element() < 1e-4, "{halves:?}");
        // The triangle above the diagonal is white over 3/4 of its area.
        assert!((halves[0].color.x - 0.75).abs() < 0.02, "{halves:?}");
        let inside = [Vec2::new(0.6, 0.1), Vec2::new(0.95, 0.1), Vec2::new(0.6, 0.9)];
        assert!((texture.mean_over(inside, [Wrap::Repeat; 2]).color - 1.0).abs().max_element() < 1e-4);
        // A floor of a thousand tiles.
        let tiled = corners.map(|corner| corner * 1000.0);
        let mean = texture.mean_over([tiled[0], tiled[1], tiled[2]], [Wrap::Repeat; 2]);
        assert!((mean.color - 0.5).abs().max_element() < 1e-3, "{mean:?}");
    }
}

/// A palette: all corners at one place. A gradient: all on one line.
#[test]
fn points_and_lines_read_the_texels_under_them() {
    let rgba = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 255, 255]].concat();
    let texture = Texture::new(4, 1, &rgba, AlphaUse::Ignored, usize::MAX);
    for (u, color) in [(0.1, Vec3::X), (0.3, Vec3::Y), (0.6, Vec3::Z), (0.9, Vec3::ONE), (1.1, Vec3::X)] {
        let place = Vec2::new(u, 0.5);
        assert_eq!(texture.mean_over([place; 3], [Wrap::Repeat; 2]).color, color);
        assert_eq!(texture.texel(place, [Wrap::Repeat; 2]).color, color);
    }
    let line = [Vec2::new(0.0, 0.5), Vec2::new(0.25, 0.5), Vec2::new(0.5, 0.5)];
    assert_eq!(texture.mean_over(line, [Wrap::Repeat; 2]).color, Vec3::new(0.5, 0.5, 0.0));
    let nowhere = [Vec2::NAN, Vec2::ZERO, Vec2::ONE];
    assert_eq!(texture.mean_over(nowhere, [Wrap::Repeat; 2]), texture.mean());
}

/// Holes are told to the texel, also where the colours are kept smaller, and the colour behind them does not count.
#[test]
fn holes_are_exact_and_colourless() {
    let mut random = Random(3);
    let (width, height) = (33, 17);
    let mut rgba = noise(width, height, &mut random);
    for texel in rgba.as_chunks_mut::<4>().0 {
        let color = if texel[3] < 128 { [255, 0, 255] } else { [0, 255, 0] };
        texel[..3].copy_from_slice(&color);
    }
    let texture = Texture::new(width, height, &rgba, AlphaUse::Cutoff(0.5), 64);
    assert!(texture.is_transparent() && texture.size().0 * texture.size().1 <= 64);
    let mut solid = 0;
    for y in 0..height {
        for x in 0..width {
            let uv = Vec2::new((x as f32 + 0.5) / width as f32, (y as f32 + 0.5) / height as f32);
            let is_solid = rgba[4 * (y * width + x) as usize + 3] >= 128;
            assert_eq!(texture.is_solid_at(uv, [Wrap::Clamp; 2]), is_solid);
            assert_eq!(texture.is_solid_at(uv + 3.0, [Wrap::Repeat; 2]), is_solid);
            solid += u32::from(is_solid);
        }
    }
    let mean = texture.mean();
    assert!((mean.color - Vec3::Y).abs().max_element() < 1e-3, "{mean:?}");
    // Rounded to 65,535ths at every level.
    assert!((mean.weight - solid as f32 / (width * height) as f32).abs() < 2e-4, "{mean:?} {solid}");
    let plain = Texture::new(width, height, &rgba, AlphaUse::Ignored, 64);
    assert!(!plain.is_transparent() && plain.is_solid_at(Vec2::ZERO, [Wrap::Clamp; 2]));
}
