use std::f32::consts::PI as PI32;

use super::*;
use crate::export::write_picture_exr;
use crate::random::Pcg32;
use crate::scene::{LoadError, LoadLimits};

/// Random texels, some of them a thousand times as bright.
fn stormy(width: usize, height: usize) -> Vec<f32> {
    let mut random = Pcg32::new(7, 7);
    let texel = |_| {
        let factor = if random.next_f32() < 0.01 { 1000.0 } else { 1.0 };
        [0; 3].map(|_| factor * random.next_f32())
    };
    (0..width * height).flat_map(texel).collect()
}

fn vectors(rgb: &[f32]) -> Vec<Vec3> {
    rgb.as_chunks::<3>().0.iter().map(|rgb| Vec3::from(*rgb)).collect()
}

#[test]
fn both_parts_are_the_whole_and_the_even_one_is_even() {
    let sky = SkyPicture::new(64, 32, &stormy(64, 32)).unwrap();
    let (_, power) = sky.bright_places().expect("bright places");
    let (mut most, mut sum) = (0.0f32, DVec3::ZERO);
    let samples = 200;
    for k in 0..samples * samples {
        let u = [(k % samples) as f32 + 0.5, (k / samples) as f32 + 0.5].map(|x| x / samples as f32);
        let direction = Equirect { width: 1, height: 1 }.direction((0, 0), u);
        let (even, bright) = (sky.even(direction), sky.bright(direction));
        assert!((even + bright).abs_diff_eq(sky.radiance(direction), 1e-3));
        most = most.max(luminance(even));
        sum += bright.as_dvec3();
    }
    let limit = EVEN * luminance(sky.mean());
    assert!(most <= 1.001 * limit && most > 0.9 * limit, "{most} {limit}");
    let found = sum.element_sum() / 3.0 * 4.0 * PI / f64::from(samples * samples);
    assert!((found / f64::from(power) - 1.0).abs() < 0.1, "{found} {power}");
    // Where nothing stands out nothing is aimed at.
    let gradient: Vec<f32> = (0..16 * 8).flat_map(|i| [1.0 + 0.01 * (i / 16) as f32; 3]).collect();
    let gradient = SkyPicture::new(16, 8, &gradient).unwrap();
    assert!(gradient.bright_places().is_none() && gradient.even(Vec3::Y) == Vec3::ONE);
    // A hundredth of all light, in one texel of ten thousand, is what makes noise.
    let spot: Vec<f32> = (0..200 * 100).flat_map(|i| [if i == 9000 { 130.0 } else { 1.0 }; 3]).collect();
    assert!(SkyPicture::new(200, 100, &spot).unwrap().bright_places().is_some());
}

#[test]
fn directions_are_where_three_js_has_them() {
    // Four texels around, three rows: top, horizon, bottom.
    let rgb: Vec<f32> = (0..12).flat_map(|i| [1.0 + i as f32, 0.0, 0.0]).collect();
    let sky = SkyPicture::new(4, 3, &rgb).unwrap();
    let red = |x: f32, y: f32, z: f32| sky.radiance(Vec3::new(x, y, z).normalize()).x;
    assert_eq!((red(0.1, 1.0, 0.1), red(-0.1, -1.0, -0.1)), (3.0, 9.0));
    // From left to right: −x, −z, +x, +z begin a quarter each, halfway turned.
    let around = [(-1.0, -0.5), (0.5, -1.0), (1.0, 0.5), (-0.5, 1.0)].map(|(x, z)| red(x, 0.0, z));
    assert_eq!(around, [5.0, 6.0, 7.0, 8.0]);
}

#[test]
fn large_pictures_send_the_same_light() {
    let (width, height) = (2500, 1700);
    let rgb = stormy(width, height);
    let sky = SkyPicture::new(width, height, &rgb).unwrap();
    assert_eq!(sky.size(), (2048, 1024));
    let exact = integral(Equirect { width, height }, &vectors(&rgb), |texel| texel.as_dvec3()) / (4.0 * PI);
    assert!((sky.mean().as_dvec3() / exact - 1.0).abs().max_element() < 1e-6, "{} {exact}", sky.mean());
    // And by direction: light weighted by height is the same, but for what moves within a texel.
    let up = |grid: Equirect, texels: &[Vec3]| {
        let rows = texels.chunks_exact(grid.width).enumerate();
        let height = |row: usize| (PI * (row as f64 + 0.5) / grid.height as f64).cos() * grid.solid_angle(row);
        rows.map(|(row, texels)| texels.iter().map(|t| f64::from(t.y)).sum::<f64>() * height(row)).sum::<f64>()
    };
    let (coarse, fine) = (up(sky.grid, &sky.texels), up(Equirect { width, height }, &vectors(&rgb)));
    assert!((coarse - fine).abs() < 1e-3 * exact.y, "{coarse} {fine}");
    assert!(
        overlaps(5, 2)
            == [vec![(0, 0.0, 0.2), (1, 0.2, 0.4), (2, 0.4, 0.5)], vec![(2, 0.5, 0.6), (3, 0.6, 0.8), (4, 0.8, 1.0)]]
    );
}

#[test]
fn a_texel_at_a_pole_has_its_own_energy() {
    let mut rgb = vec![0.0; 3 * 32 * 16];
    rgb[..3].fill(5.0);
    let sky = SkyPicture::new(32, 16, &rgb).unwrap();
    let cap = 2.0 * PI32 * (1.0 - (PI32 / 16.0).cos()) / 32.0;
    assert!((sky.mean().x * 4.0 * PI32 / (5.0 * cap) - 1.0).abs() < 1e-5);
    let (choice, _) = sky.bright_places().expect("one texel");
    assert!((choice.pdf(choice.sample([0.5, 0.5])) * cap - 1.0).abs() < 1e-5);
}

/// A Radiance picture, without compression.
fn hdr(head: &str, width: usize, height: usize, rgbe: &[[u8; 4]]) -> Vec<u8> {
    let mut file = format!("{head}\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n").into_bytes();
    rgbe.iter().for_each(|pixel| file.extend(pixel));
    file
}

#[test]
fn pictures_are_read_as_they_were_written() {
    let rgb: Vec<f32> = (0..3 * 8 * 4).map(|i| i as f32 * 0.25).collect();
    let file = write_picture_exr(&vectors(&rgb), 8, &[]).unwrap();
    let limits = LoadLimits::default();
    let sky = load_sky(&file, &limits).unwrap();
    assert!(sky.warnings.is_empty() && sky.picture == SkyPicture::new(8, 4, &rgb).unwrap());
    // 2⁻⁸ · 2^(e − 128) per step.
    let rgbe = [[128, 64, 0, 129], [0, 0, 0, 0], [1, 2, 3, 136], [255, 0, 0, 128]];
    let linear = [1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 255.0 / 256.0, 0.0, 0.0];
    for (head, factor) in [("#?RADIANCE", 1.0), ("#?RGBE", 1.0), ("#?RADIANCE\nEXPOSURE=2.0", 0.5)] {
        let sky = load_sky(&hdr(head, 2, 2, &rgbe), &limits).unwrap();
        assert_eq!(sky.picture.texels, vectors(&linear.map(|x| x * factor)), "{head}");
        assert!(sky.warnings.len() == 1 && sky.warnings[0].contains("2 × 2"), "{:?}", sky.warnings);
    }
}

#[test]
fn what_is_no_sky_is_refused_with_its_reason() {
    let limits = LoadLimits::default();
    let refused = |file: &[u8], limits: &LoadLimits| load_sky(file, limits).expect_err("no sky").to_string();
    let exr = |rgb: &[f32], width: usize| write_picture_exr(&vectors(rgb), width, &[]).unwrap();
    assert!(refused(b"glTF", &limits).contains("neither OpenEXR"));
    assert!(refused(&exr(&[0.0; 6], 2), &limits).contains("black"));
    assert!(refused(&exr(&[1.0, 1.0, 1.0, 1.0, f32::NAN, 1.0], 2), &limits).contains("pixel (1, 0) is not finite"));
    let whole = exr(&stormy(16, 8), 16);
    for end in [3, 20, whole.len() / 2, whole.len() - 1] {
        assert!(matches!(load_sky(&whole[..end], &limits), Err(LoadError::Malformed(_))), "{end} bytes");
    }
    let small = LoadLimits { max_texture_pixels: 127, ..limits.clone() };
    assert!(matches!(load_sky(&whole, &small), Err(LoadError::TooLarge(_))));
    // The size that is said counts, not what is there.
    assert!(matches!(load_sky(&hdr("#?RADIANCE", 1 << 20, 1 << 20, &[]), &limits), Err(LoadError::TooLarge(_))));
    let short = hdr("#?RADIANCE", 4, 2, &[[1, 1, 1, 128]]);
    assert!(matches!(load_sky(&short, &limits), Err(LoadError::Malformed(_))));
    // Negative numbers are what filters leave.
    let negative = load_sky(&exr(&[-1.0, 1.0, 1.0, 1.0, 1.0, 1.0], 2), &limits).unwrap();
    assert_eq!((negative.picture.texels[0].x, negative.warnings.len()), (0.0, 1));
}

/// Whatever is done to a file, it is read or refused.
#[test]
fn damaged_pictures_break_nothing() {
    let limits = LoadLimits { max_texture_pixels: 1 << 14, ..LoadLimits::default() };
    let exr = write_picture_exr(&vectors(&stormy(16, 8)), 16, &[("note", "stormy")]).unwrap();
    // Runs of 8 pixels, channel by channel.
    let mut runs = hdr("#?RADIANCE", 8, 4, &[]);
    (0..4).for_each(|_| runs.extend([2, 2, 0, 8, 136, 9, 136, 8, 136, 7, 136, 129]));
    assert!(load_sky(&runs, &limits).unwrap().picture.mean().min_element() > 0.0);
    let mut random = Pcg32::new(11, 5);
    let mut refused = 0;
    for file in [exr, runs] {
        for _ in 0..2000 {
            let mut damaged = file.clone();
            for _ in 0..1 + random.next_u32() % 3 {
                let at = 4 + random.next_u32() as usize % (damaged.len() - 4);
                match random.next_u32() % 4 {
                    0 => damaged.truncate(at.max(8)),
                    1 => damaged.insert(at, random.next_u32() as u8),
                    _ => damaged[at] = random.next_u32() as u8,
                }
            }
            refused += u32::from(load_sky(&damaged, &limits).is_err());
        }
    }
    assert!(refused > 1000, "{refused}");
}
