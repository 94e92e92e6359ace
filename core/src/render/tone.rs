//! From radiance to what a screen shows.

use glam::{Mat3, Vec3};

use crate::export::srgb_from_linear;

/// How radiance becomes display values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ToneMap {
    /// AgX, the default look: T. Sobotka's display transform, in the polynomial fit of B. Wrensch (2023) with the
    /// Rec. 2020 working space of Blender and Filament. It is what three.js calls `AgXToneMapping`.
    #[default]
    AgX,
    /// Khronos PBR Neutral (2024): keeps base colours as they are below 0.8 and compresses only what is brighter.
    Neutral,
    /// No tone map: values are cut at 1. For measuring.
    Linear,
}

impl ToneMap {
    /// Linear display values in 0..=1.
    pub fn map(self, color: Vec3) -> Vec3 {
        // NaN becomes 0: `max` returns the other operand.
        let color = color.max(Vec3::ZERO).min(Vec3::splat(f32::MAX));
        match self {
            ToneMap::AgX => agx(color),
            ToneMap::Neutral => neutral(color),
            ToneMap::Linear => color,
        }
        .clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// 8-bit sRGB.
    pub(super) fn encode(self, color: Vec3) -> [u8; 3] {
        self.map(color).to_array().map(|c| (srgb_from_linear(c) * 255.0 + 0.5) as u8)
    }
}

fn agx(color: Vec3) -> Vec3 {
    /// Linear Rec. 709 to Rec. 2020 primaries, by columns.
    const REC2020_FROM_REC709: Mat3 = Mat3::from_cols(
        Vec3::new(0.6274, 0.0691, 0.0164),
        Vec3::new(0.3293, 0.9195, 0.0880),
        Vec3::new(0.0433, 0.0113, 0.8956),
    );
    const REC709_FROM_REC2020: Mat3 = Mat3::from_cols(
        Vec3::new(1.6605, -0.1246, -0.0182),
        Vec3::new(-0.5876, 1.1329, -0.1006),
        Vec3::new(-0.0728, -0.0083, 1.1187),
    );
    const INSET: Mat3 = Mat3::from_cols(
        Vec3::new(0.856_627_15, 0.137_318_97, 0.111_898_21),
        Vec3::new(0.095_121_24, 0.761_242, 0.076_799_42),
        Vec3::new(0.048_251_607, 0.101_439_04, 0.811_302_4),
    );
    const OUTSET: Mat3 = Mat3::from_cols(
        Vec3::new(1.127_100_6, -0.141_329_76, -0.141_329_76),
        Vec3::new(-0.110_606_64, 1.157_823_7, -0.110_606_64),
        Vec3::new(-0.016_493_939, -0.016_493_939, 1.251_936_4),
    );
    /// log2 of the darkest and the brightest value that differ from black and white.
    const EV: (f32, f32) = (-12.473_93, 4.026_069);
    let log = (INSET * (REC2020_FROM_REC709 * color)).max(Vec3::splat(1e-10)).map(f32::log2);
    let x = ((log - Vec3::splat(EV.0)) / (EV.1 - EV.0)).clamp(Vec3::ZERO, Vec3::ONE);
    let (x2, x4) = (x * x, x * x * x * x);
    let curve = 15.5 * x4 * x2 - 40.14 * x4 * x + 31.96 * x4 - 6.868 * x2 * x + 0.4298 * x2 + 0.1191 * x
        - Vec3::splat(0.002_32);
    REC709_FROM_REC2020 * (OUTSET * curve).max(Vec3::ZERO).map(|c| c.powf(2.2))
}

fn neutral(color: Vec3) -> Vec3 {
    const START: f32 = 0.8 - 0.04;
    const DESATURATION: f32 = 0.15;
    let x = color.min_element();
    let color = color - Vec3::splat(if x < 0.08 { x - 6.25 * x * x } else { 0.04 });
    let peak = color.max_element();
    if peak < START {
        return color;
    }
    let d = 1.0 - START;
    let new_peak = 1.0 - d * d / (peak + d - START);
    let g = 1.0 - 1.0 / (DESATURATION * (peak - new_peak) + 1.0);
    (color * (new_peak / peak)).lerp(Vec3::splat(new_peak), g)
}

/// Stops that bring the geometric mean luminance of what is not black to middle grey (0.18), in thirds of a stop: what
/// small changes do not move. 0 for a black picture.
pub fn auto_exposure(pixels: &[Vec3]) -> f32 {
    const MIDDLE_GREY: f64 = 0.18;
    let (mut sum, mut count) = (0.0f64, 0u64);
    for pixel in pixels {
        let luminance = f64::from(pixel.dot(Vec3::new(0.2126, 0.7152, 0.0722)));
        if luminance > 1e-9 && luminance.is_finite() {
            sum += luminance.log2();
            count += 1;
        }
    }
    if count == 0 {
        return 0.0;
    }
    let stops = MIDDLE_GREY.log2() - sum / count as f64;
    ((stops * 3.0).round() / 3.0) as f32
}
