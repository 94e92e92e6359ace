//! Pictures at half the size, by exact box means in linear light.

use glam::Vec4;

/// A picture of one size. A texel is linear RGB times weight, and weight, in 65,535ths.
#[derive(Clone, PartialEq)]
pub(super) struct Level {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Row by row from the top.
    pub(super) texels: Vec<[u16; 4]>,
}

impl Level {
    /// Linear RGB times weight, and weight.
    pub(super) fn texel(&self, x: u32, y: u32) -> Vec4 {
        let texel = self.texels[y as usize * self.width as usize + x as usize];
        Vec4::from_array(texel.map(f32::from)) / f32::from(u16::MAX)
    }
}

/// All levels, the first of at most `max_texels`. `linear` and `weights` tell what each code of a colour and of alpha
/// stands for.
pub(super) fn pyramid(
    width: u32,
    height: u32,
    texels: &[[u8; 4]],
    [linear, weights]: [&[f32; 256]; 2],
    max_texels: usize,
) -> Vec<Level> {
    let fetch = |x: u32, y: u32| {
        let [r, g, b, a] = texels[y as usize * width as usize + x as usize].map(usize::from);
        Vec4::new(linear[r], linear[g], linear[b], 1.0) * weights[a]
    };
    let mut level = if texels.len() <= max_texels {
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        Level { width, height, texels: rows.map(|(x, y)| stored(fetch(x, y))).collect() }
    } else {
        halved(width, height, fetch)
    };
    while level.texels.len() > max_texels {
        level = halved(level.width, level.height, |x, y| level.texel(x, y));
    }
    let mut levels = vec![level];
    while let Some(level) = levels.last().filter(|level| level.texels.len() > 1) {
        let half = halved(level.width, level.height, |x, y| level.texel(x, y));
        levels.push(half);
    }
    levels
}

fn stored(texel: Vec4) -> [u16; 4] {
    (texel * f32::from(u16::MAX)).to_array().map(|part| part.round() as u16)
}

/// Half the size, rounded up: every texel is the mean over its share of the picture, also of odd sizes.
fn halved(width: u32, height: u32, fetch: impl Fn(u32, u32) -> Vec4) -> Level {
    let (columns, rows) = (boxes(width), boxes(height));
    let mut texels = Vec::with_capacity(columns.len() * rows.len());
    for (top, row_shares) in &rows {
        for (left, column_shares) in &columns {
            let mut mean = Vec4::ZERO;
            for (y, row_share) in (*top..height).zip(row_shares).filter(|(_, share)| **share > 0.0) {
                for (x, column_share) in (*left..width).zip(column_shares).filter(|(_, share)| **share > 0.0) {
                    mean += fetch(x, y) * (row_share * column_share);
                }
            }
            texels.push(stored(mean));
        }
    }
    Level { width: columns.len() as u32, height: rows.len() as u32, texels }
}

/// For each texel of a row of half the length: the first of those under it, and the shares of up to three.
fn boxes(length: u32) -> Vec<(u32, [f32; 3])> {
    let half = length.div_ceil(2);
    let step = f64::from(length) / f64::from(half);
    let share = |at: u32| {
        let (start, end) = (f64::from(at) * step, f64::from(at + 1) * step);
        let first = (start.floor() as u32).min(length - 1);
        let part = |k: u32| {
            let texel = f64::from(first + k);
            ((end.min(texel + 1.0) - start.max(texel)).max(0.0) / step) as f32
        };
        (first, [part(0), part(1), part(2)])
    };
    (0..half).map(share).collect()
}

/// What the codes of sRGB stand for.
pub(super) fn srgb_codes() -> [f32; 256] {
    std::array::from_fn(|code| linear_from_srgb(code as f64 / 255.0) as f32)
}

/// IEC 61966-2-1.
pub(super) fn linear_from_srgb(value: f64) -> f64 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}
