//! The chi² test of every sampler against its density (after Mitsuba's `chi2.py`).

use std::f32::consts::{PI, TAU};

use glam::Vec3;

use super::{
    Cone, Discrete, Equirect, Mixture, Spheres, SphericalTriangle, TexelChoice, cosine_hemisphere,
    cosine_hemisphere_pdf, uniform_barycentrics, uniform_sphere, uniform_sphere_pdf,
};
use crate::metrics::Family;
use crate::random::Pcg32;

/// Upper tail of the chi² distribution by the Wilson–Hilferty normal approximation: z-score.
fn chi2_z(statistic: f64, dof: f64) -> f64 {
    let k = 2.0 / (9.0 * dof);
    ((statistic / dof).cbrt() - (1.0 - k)) / k.sqrt()
}

/// Compares counts with expectations; cells of fewer than 5 expected are pooled.
fn compare_counts(family: &mut Family, name: &str, counts: &[f64], expected: &[f64]) {
    let (mut statistic, mut dof, mut pool_c, mut pool_e) = (0.0, -1.0, 0.0, 0.0);
    for (c, e) in counts.iter().zip(expected) {
        if *e < 5.0 {
            pool_c += c;
            pool_e += e;
        } else {
            statistic += (c - e) * (c - e) / e;
            dof += 1.0;
        }
    }
    if pool_e >= 1.0 {
        statistic += (pool_c - pool_e) * (pool_c - pool_e) / pool_e;
        dof += 1.0;
    } else {
        assert!(pool_c <= 12.0, "{name}: {pool_c} samples where {pool_e} are expected");
    }
    family.compare(format!("{name}: chi² {statistic:.1} at {dof} degrees of freedom"), chi2_z(statistic, dof), 1.0);
}

const ROWS: usize = 48;
const COLUMNS: usize = 96;
const SAMPLES: usize = 400_000;

/// Compares a sampler of directions with its density over a grid in (cos θ, φ), the density integrated by 16² points.
fn compare_directions(family: &mut Family, name: &str, sample: impl Fn([f32; 2]) -> Vec3, pdf: impl Fn(Vec3) -> f32) {
    let mut rng = Pcg32::new(11, name.len() as u64);
    let mut counts = vec![0.0; ROWS * COLUMNS];
    for _ in 0..SAMPLES {
        let d = sample(rng.next_2d());
        assert!((d.length() - 1.0).abs() < 1e-4, "{name}: {d}");
        let row = (((d.z + 1.0) * 0.5 * ROWS as f32) as usize).min(ROWS - 1);
        let column = (((d.y.atan2(d.x) / TAU + 1.0).fract() * COLUMNS as f32) as usize).min(COLUMNS - 1);
        counts[row * COLUMNS + column] += 1.0;
    }
    let steps = 16;
    let cell = 2.0 * TAU / (ROWS * COLUMNS * steps * steps) as f32;
    let mut expected = vec![0.0f64; ROWS * COLUMNS];
    for (i, e) in expected.iter_mut().enumerate() {
        for k in 0..steps * steps {
            let z = ((i / COLUMNS) as f32 + ((k / steps) as f32 + 0.5) / steps as f32) / ROWS as f32 * 2.0 - 1.0;
            let phi = ((i % COLUMNS) as f32 + ((k % steps) as f32 + 0.5) / steps as f32) / COLUMNS as f32 * TAU;
            let r = (1.0 - z * z).max(0.0).sqrt();
            *e += f64::from(pdf(Vec3::new(r * phi.cos(), r * phi.sin(), z)) * cell) * SAMPLES as f64;
        }
    }
    let total: f64 = expected.iter().sum();
    assert!(
        (total / SAMPLES as f64 - 1.0).abs() < 5e-3,
        "{name}: the density integrates to {}",
        total / SAMPLES as f64
    );
    // Cells cut by the support's border carry the error of the integration: they are pooled with their neighbours'
    // by leaving out those whose density is not smooth.
    let smooth: Vec<bool> = (0..ROWS * COLUMNS)
        .map(|i| {
            let (row, column) = (i / COLUMNS, i % COLUMNS);
            let mean = expected[i];
            [(0, 1), (0, COLUMNS - 1), (1, 0), (ROWS - 1, 0)].iter().all(|(dr, dc)| {
                let j = (row + dr) % ROWS * COLUMNS + (column + dc) % COLUMNS;
                (expected[j] - mean).abs() <= 0.5 * mean
            })
        })
        .collect();
    let pick = |v: &[f64]| {
        let mut inside: Vec<f64> = v.iter().zip(&smooth).filter(|(_, s)| **s).map(|(x, _)| *x).collect();
        inside.push(v.iter().zip(&smooth).filter(|(_, s)| !**s).map(|(x, _)| *x).sum());
        inside
    };
    let (counts, mut expected) = (pick(&counts), pick(&expected));
    let scale = SAMPLES as f64 / total;
    expected.iter_mut().for_each(|e| *e *= scale);
    // The border cells together: only a coarse check, their integral is known to a few percent.
    let (c, e) = (counts[counts.len() - 1], expected[expected.len() - 1]);
    family.compare_within(format!("{name}: border cells"), c - e, e.sqrt(), 0.05 * e + 12.0);
    compare_counts(family, name, &counts[..counts.len() - 1], &expected[..expected.len() - 1]);
}

#[test]
fn directions_follow_their_densities() {
    let mut family = Family::of_known_errors();
    for n in [Vec3::Z, -Vec3::Z, Vec3::new(0.6, -0.48, 0.64), Vec3::new(-1.0, 1e-4, 0.0).normalize()] {
        compare_directions(
            &mut family,
            "cosine hemisphere",
            |u| cosine_hemisphere(n, u),
            |d| cosine_hemisphere_pdf(n, d),
        );
    }
    compare_directions(&mut family, "sphere", uniform_sphere, |_| uniform_sphere_pdf());
    for (center, radius) in [(Vec3::new(0.3, 2.0, 1.0), 1.5), (Vec3::new(0.0, 0.0, -1.0), 0.99)] {
        let cone = Cone::to_sphere(Vec3::ZERO, center, radius).unwrap();
        compare_directions(&mut family, "cone to a sphere", |u| cone.sample(u), |d| cone.pdf(d));
    }
    for corners in [
        [Vec3::new(-1.0, -1.0, 0.5), Vec3::new(2.0, -1.0, 0.5), Vec3::new(-1.0, 2.0, 0.7)],
        [Vec3::new(1.0, 0.2, 0.1), Vec3::new(-0.4, 1.0, 0.2), Vec3::new(-0.5, -1.0, 0.3)],
    ] {
        let triangle = SphericalTriangle::new(Vec3::ZERO, corners).unwrap();
        let inside = |d: Vec3| (0..3).all(|i| corners[i].cross(corners[(i + 1) % 3]).dot(d) >= 0.0);
        let sign = corners[0].cross(corners[1]).dot(corners[2]).signum();
        compare_directions(
            &mut family,
            "spherical triangle",
            |u| triangle.sample(u),
            |d| {
                if inside(d * sign) { triangle.pdf() } else { 0.0 }
            },
        );
    }
    family.assert_agrees();
}

#[test]
fn mixtures_over_spheres_follow_their_density() {
    let tile = |c: Vec3, r: f32| [c + Vec3::X * r, c + Vec3::Y * r, c - Vec3::X * r];
    let far = [
        tile(Vec3::new(1.0, 0.5, 2.0), 0.4),
        tile(Vec3::new(1.4, 0.5, 2.0), 0.4),
        tile(Vec3::new(-2.0, 0.0, 0.6), 0.3),
    ];
    let near = [tile(Vec3::new(0.0, 0.1, 0.2), 0.5), tile(Vec3::new(2.0, 0.0, 1.0), 0.5)];
    let mut family = Family::of_known_errors();
    for (name, triangles) in [("mixture, far", &far[..]), ("mixture, inside a sphere", &near[..])] {
        let mixture = Mixture::new(&Spheres::new(triangles), Vec3::ZERO, Vec3::Z).unwrap();
        compare_directions(&mut family, name, |u| mixture.sample(u), |d| mixture.pdf(d));
    }
    family.assert_agrees();
    let below = Spheres::new(&[tile(Vec3::new(0.0, 0.0, -3.0), 0.5)]);
    assert!(Mixture::new(&below, Vec3::ZERO, Vec3::Z).is_none());
}

/// Texels of many sizes: the test's own cells lie across them, about another axis.
#[test]
fn texels_are_chosen_by_their_weight() {
    let grid = Equirect { width: 12, height: 7 };
    let weight = |row: usize, column: usize| ((row * 12 + column) % 5) as f32 + if row == 0 { 9.0 } else { 0.2 };
    let choice = TexelChoice::new(grid, weight).unwrap();
    let mut family = Family::of_known_errors();
    compare_directions(&mut family, "texels", |u| choice.sample(u), |d| choice.pdf(d));
    family.assert_agrees();
    let one = TexelChoice::new(grid, |row, column| f32::from(u8::from((row, column) == (5, 11)))).unwrap();
    let mut rng = Pcg32::new(3, 3);
    for _ in 0..1000 {
        let d = one.sample(rng.next_2d());
        assert!(grid.texel(d) == (5, 11) && (f64::from(one.pdf(d)) * grid.solid_angle(5) - 1.0).abs() < 1e-5);
    }
    assert!(TexelChoice::new(grid, |_, _| 0.0).is_none());
    // Whatever the grid, its texels are the sphere.
    let whole: f64 = (0..7).map(|row| grid.solid_angle(row) * 12.0).sum();
    assert!((whole / f64::from(2.0 * TAU) - 1.0).abs() < 1e-6);
}

#[test]
fn a_cone_keeps_its_precision_far_away() {
    let cone = Cone::to_sphere(Vec3::ZERO, Vec3::new(0.0, 0.0, 4000.0), 0.5).unwrap();
    let exact = f64::from(PI) * (0.5f64 / 4000.0).powi(2);
    assert!((f64::from(cone.solid_angle()) / exact - 1.0).abs() < 1e-4);
    for i in 0..100 {
        let d = cone.sample([i as f32 / 100.0, 0.3]);
        assert!(cone.pdf(d) > 0.0 && d.z > 0.999_999);
    }
}

#[test]
fn barycentrics_are_uniform() {
    let mut rng = Pcg32::new(5, 5);
    let mut counts = vec![0.0; 16];
    let n = 160_000;
    for _ in 0..n {
        let (b1, b2) = uniform_barycentrics(rng.next_2d());
        assert!(b1 >= 0.0 && b2 >= 0.0 && b1 + b2 <= 1.0 + 1e-6);
        // Four congruent rows of 1, 3, 5, 7 small triangles of equal area.
        let (x, y) = ((b1 * 4.0).min(3.999), (b2 * 4.0).min(3.999));
        let upper = usize::from(x.fract() + y.fract() > 1.0);
        let row = x as usize + y as usize + upper;
        let cell = [0, 1, 4, 9][row.min(3)] + 2 * (y as usize) + upper;
        counts[cell.min(15)] += 1.0;
    }
    let mut family = Family::of_known_errors();
    compare_counts(&mut family, "uniform barycentrics", &counts, &[n as f64 / 16.0; 16]);
    family.assert_agrees();
}

#[test]
fn discrete_follows_its_weights_and_never_picks_zero() {
    let weights = [0.0, 1.0, 0.0, 3.0, 0.5, 0.0];
    let discrete = Discrete::new(weights.iter().copied()).unwrap();
    let mut rng = Pcg32::new(9, 1);
    let (mut counts, n) = (vec![0.0; 6], 90_000);
    for _ in 0..n {
        let (i, rest) = discrete.sample(rng.next_f32());
        assert!((0.0..1.0).contains(&rest));
        counts[i] += 1.0;
    }
    assert_eq!((counts[0], counts[2], counts[5]), (0.0, 0.0, 0.0));
    let expected: Vec<f64> = weights.iter().map(|w| w / 4.5 * f64::from(n)).collect();
    let mut family = Family::of_known_errors();
    compare_counts(&mut family, "discrete", &counts, &expected);
    family.assert_agrees();
    assert!(Discrete::new([0.0, 0.0].into_iter()).is_none());
}
