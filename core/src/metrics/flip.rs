//! ꟻLIP for low dynamic range: P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild,
//! *FLIP: A Difference Evaluator for Alternating Images*, 2020.
//!
//! Per pixel 0 (no difference) to 1: how strongly an observer sees a difference when two pictures alternate, from
//! colours filtered by the eye's contrast sensitivity and from edges and points. All filters of the paper are sums of
//! products of a row and a column, so they are applied that way.

use glam::{Mat3, Vec3};
use rayon::prelude::*;

/// The paper's viewing conditions: 0.7 m from a screen 0.7 m wide with 3840 pixels across.
pub const PIXELS_PER_DEGREE: f32 = 67.020_64;

/// Exponents of colour and feature differences (section 4.1.3 and 4.2.3).
const Q_C: f32 = 0.7;
const Q_F: f32 = 0.5;
/// Part of the largest colour difference that is mapped to `P_T`.
const P_C: f32 = 0.4;
const P_T: f32 = 0.95;
/// Width of the feature detectors, degrees.
const FEATURE_WIDTH: f32 = 0.082;
/// Largest scale parameter of the contrast sensitivity functions: sets the radius of all of them.
const MAX_SCALE: f32 = 0.04;

/// One row of pixels after the other.
struct Plane {
    width: usize,
    values: Vec<f32>,
}

/// ꟻLIP per pixel of two pictures in sRGB (each channel in 0..=1), row by row.
///
/// # Panics
/// Where the pictures differ in size or rows are not complete.
pub fn flip(reference: &[Vec3], test: &[Vec3], width: usize, pixels_per_degree: f32) -> Vec<f32> {
    assert!(reference.len() == test.len() && width > 0 && test.len().is_multiple_of(width), "sizes have to agree");
    let prepared = [reference, test].map(|picture| Prepared::new(picture, width, pixels_per_degree));
    let largest = hyab(hunt_lab(Vec3::Y), hunt_lab(Vec3::Z)).powf(Q_C);
    let one = |i: usize| {
        let [a, b] = [&prepared[0], &prepared[1]];
        let color = redistribute(hyab(a.lab[i], b.lab[i]).powf(Q_C), largest);
        let feature = (a.edges[i] - b.edges[i]).abs().max((a.points[i] - b.points[i]).abs());
        color.powf(1.0 - (feature * std::f32::consts::FRAC_1_SQRT_2).powf(Q_F))
    };
    (0..reference.len()).into_par_iter().map(one).collect()
}

/// Maps 0..=largest to 0..=1 such that most of the range is for the differences that matter.
fn redistribute(difference: f32, largest: f32) -> f32 {
    let knee = P_C * largest;
    if difference < knee { P_T / knee * difference } else { P_T + (difference - knee) / (largest - knee) * (1.0 - P_T) }
}

/// What both pipelines need of one picture.
struct Prepared {
    /// Filtered colour, L*a*b* with the Hunt adjustment.
    lab: Vec<Vec3>,
    /// Lengths of the detectors' answers.
    edges: Vec<f32>,
    points: Vec<f32>,
}

impl Prepared {
    fn new(srgb: &[Vec3], width: usize, ppd: f32) -> Prepared {
        let opponent: Vec<Vec3> = srgb.par_iter().map(|c| ycxcz_from_linear(c.map(linear_from_srgb))).collect();
        let plane = |part: usize| Plane { width, values: opponent.iter().map(|c| c[part]).collect() };
        // Amplitude and scale of each Gaussian (table 1 of the paper).
        let y = sensitivity(&plane(0), &[(1.0, 0.0047)], ppd);
        let cx = sensitivity(&plane(1), &[(1.0, 0.0053)], ppd);
        let cz = sensitivity(&plane(2), &[(34.1, 0.04), (13.5, 0.025)], ppd);
        let lab = |i: usize| {
            let filtered = linear_from_ycxcz(Vec3::new(y[i], cx[i], cz[i]));
            hunt_lab(filtered.clamp(Vec3::ZERO, Vec3::ONE))
        };
        let achromatic = Plane { width, values: opponent.iter().map(|c| (c.x + 16.0) / 116.0).collect() };
        Prepared {
            lab: (0..srgb.len()).into_par_iter().map(lab).collect(),
            edges: features(&achromatic, ppd, |x, _| -x),
            points: features(&achromatic, ppd, |x, sd| x * x / (sd * sd) - 1.0),
        }
    }
}

/// Filters by a sum of Gaussians, normalised.
fn sensitivity(plane: &Plane, gaussians: &[(f32, f32)], ppd: f32) -> Vec<f32> {
    use std::f32::consts::PI;
    let radius = (3.0 * (MAX_SCALE / (2.0 * PI * PI)).sqrt() * ppd).ceil() as i32;
    let mut sum = vec![0.0; plane.values.len()];
    let mut total = 0.0;
    for &(amplitude, scale) in gaussians {
        let at = |x: i32| (-PI * PI * (x as f32 / ppd).powi(2) / scale).exp();
        let kernel: Vec<f32> = (-radius..=radius).map(at).collect();
        let weight = amplitude * (PI / scale).sqrt();
        total += weight * kernel.iter().sum::<f32>().powi(2);
        let filtered = separable(plane, &kernel, &kernel);
        sum.iter_mut().zip(filtered).for_each(|(sum, value)| *sum += weight * value);
    }
    sum.iter().map(|value| value / total).collect()
}

/// Length of a detector's answer along x and y: `shape(x, sd)` times a Gaussian, its positive and its negative
/// weights each of sum 1.
fn features(plane: &Plane, ppd: f32, shape: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    let sd = 0.5 * FEATURE_WIDTH * ppd;
    let radius = (3.0 * sd).ceil() as i32;
    let gaussian: Vec<f32> = (-radius..=radius).map(|x| (-((x * x) as f32) / (2.0 * sd * sd)).exp()).collect();
    let mut along: Vec<f32> = (-radius..=radius).zip(&gaussian).map(|(x, g)| shape(x as f32, sd) * g).collect();
    let positive: f32 = along.iter().filter(|w| **w > 0.0).sum();
    let negative: f32 = -along.iter().filter(|w| **w < 0.0).sum::<f32>();
    along.iter_mut().for_each(|w| *w /= if *w > 0.0 { positive } else { negative });
    let total: f32 = gaussian.iter().sum();
    let across: Vec<f32> = gaussian.iter().map(|g| g / total).collect();
    let (x, y) = (separable(plane, &along, &across), separable(plane, &across, &along));
    x.iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
}

/// Convolves rows, then columns; beyond the border the border goes on.
fn separable(plane: &Plane, along_x: &[f32], along_y: &[f32]) -> Vec<f32> {
    let Plane { width, values } = plane;
    let (width, height) = (*width, values.len() / width);
    let at = |i: usize, k: usize, taps: usize, len: usize| {
        // A convolution, not a correlation: tap k stands for the offset radius − k.
        (i + taps / 2).saturating_sub(k).min(len - 1)
    };
    let mut rows = vec![0.0f32; values.len()];
    rows.par_chunks_mut(width).zip(values.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = along_x.iter().enumerate().map(|(k, w)| w * row[at(x, k, along_x.len(), width)]).sum();
        }
    });
    let mut columns = vec![0.0f32; values.len()];
    columns.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (k, w) in along_y.iter().enumerate() {
            let row = at(y, k, along_y.len(), height) * width;
            out.iter_mut().zip(&rows[row..row + width]).for_each(|(out, value)| *out += w * value);
        }
    });
    columns
}

fn linear_from_srgb(c: f32) -> f32 {
    if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
}

/// Linear sRGB to CIE XYZ (D65), divided by the white point: white is (1, 1, 1).
fn relative_xyz() -> Mat3 {
    let xyz = Mat3::from_cols(
        Vec3::new(10_135_552.0 / 24_577_794.0, 2_613_072.0 / 12_288_897.0, 1_425_312.0 / 73_733_382.0),
        Vec3::new(8_788_810.0 / 24_577_794.0, 8_788_810.0 / 12_288_897.0, 8_788_810.0 / 73_733_382.0),
        Vec3::new(4_435_075.0 / 24_577_794.0, 887_015.0 / 12_288_897.0, 70_074_185.0 / 73_733_382.0),
    );
    Mat3::from_diagonal((xyz * Vec3::ONE).recip()) * xyz
}

/// The linear opponent space of the contrast sensitivity functions.
fn ycxcz_from_linear(rgb: Vec3) -> Vec3 {
    let Vec3 { x, y, z } = relative_xyz() * rgb;
    Vec3::new(116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z))
}

fn linear_from_ycxcz(c: Vec3) -> Vec3 {
    let y = (c.x + 16.0) / 116.0;
    relative_xyz().inverse() * Vec3::new(y + c.y / 500.0, y, y - c.z / 200.0)
}

/// L*a*b* whose chroma falls with lightness (Hunt effect).
fn hunt_lab(rgb: Vec3) -> Vec3 {
    const DELTA: f32 = 6.0 / 29.0;
    let curve = |t: f32| if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let Vec3 { x, y, z } = (relative_xyz() * rgb).map(curve);
    let lightness = 116.0 * y - 16.0;
    Vec3::new(lightness, 500.0 * (x - y) * 0.01 * lightness, 200.0 * (y - z) * 0.01 * lightness)
}

/// City-block in lightness, Euclidean in chroma.
fn hyab(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    d.x.abs() + d.y.hypot(d.z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Pcg32;

    fn noise(count: usize, seed: u64) -> Vec<Vec3> {
        let mut rng = Pcg32::new(seed, 0);
        (0..count).map(|_| Vec3::new(rng.next_f32(), rng.next_f32(), rng.next_f32())).collect()
    }

    #[test]
    fn equal_pictures_do_not_differ() {
        let picture = noise(40 * 30, 1);
        assert!(flip(&picture, &picture, 40, PIXELS_PER_DEGREE).iter().all(|e| *e == 0.0));
    }

    #[test]
    fn it_is_symmetric_and_between_0_and_1() {
        let (a, b) = (noise(40 * 30, 1), noise(40 * 30, 2));
        let (ab, ba) = (flip(&a, &b, 40, PIXELS_PER_DEGREE), flip(&b, &a, 40, PIXELS_PER_DEGREE));
        assert_eq!(ab, ba);
        assert!(ab.iter().all(|e| (0.0..=1.0).contains(e)) && ab.iter().any(|e| *e > 0.05));
    }

    #[test]
    fn green_and_blue_are_as_far_apart_as_can_be() {
        // The paper's normalisation: no pair of colours is further apart; there are no features in flat pictures.
        let (green, blue) = (vec![Vec3::Y; 32 * 32], vec![Vec3::Z; 32 * 32]);
        let error = flip(&green, &blue, 32, PIXELS_PER_DEGREE);
        assert!(error.iter().all(|e| (e - 1.0).abs() < 1e-3), "{}", error[0]);
        let white = flip(&vec![Vec3::ONE; 32 * 32], &vec![Vec3::ZERO; 32 * 32], 32, PIXELS_PER_DEGREE);
        assert!(white.iter().all(|e| (0.9..1.0).contains(e)), "{}", white[0]);
    }

    /// Means that NVIDIA's flip-evaluator 1.7 gives for the same pictures: `tests/peers/flip.py` computes them anew.
    #[test]
    fn means_are_those_of_the_reference_implementation() {
        let width = 64;
        let at = |i: usize| ((i % width) as f32 / 63.0, (i / width) as f32 / 47.0);
        let reference: Vec<Vec3> = (0..64 * 48).map(at).map(|(x, y)| Vec3::new(x, y, 0.5)).collect();
        let shifted: Vec<Vec3> = (0..64 * 48).map(at).map(|(x, y)| Vec3::new(x, 1.0 - y, 0.5)).collect();
        let square = |i: usize| (i % width / 8 + i / width / 8).is_multiple_of(2);
        let checkered: Vec<Vec3> = (0..64 * 48).map(|i| reference[i] * if square(i) { 1.0 } else { 0.8 }).collect();
        for (test, expected) in [(shifted, SHIFTED), (checkered, CHECKERED)] {
            let error = flip(&reference, &test, width, PIXELS_PER_DEGREE);
            let mean = error.iter().map(|e| f64::from(*e)).sum::<f64>() / error.len() as f64;
            assert!((mean - expected).abs() < 1e-4, "{mean} {expected}");
        }
    }

    const SHIFTED: f64 = 0.852_228;
    const CHECKERED: f64 = 0.325_902;
}
