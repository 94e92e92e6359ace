//! Values on the command line: numbers with a range, colours, points, transforms.

use std::path::Path;
use std::str::FromStr;

use rebake::LARGEST_ALBEDO;

/// Comma-separated numbers, all finite.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let parse = |part: &str| match part.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err(format!("{:?} is not a finite number", part.trim())),
    };
    text.split(',').map(parse).collect()
}

/// Linear RGB, each ≥ 0; one number stands for grey, `#rrggbb` for 8-bit sRGB.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rgb(pub(super) [f64; 3]);

impl FromStr for Rgb {
    type Err = String;

    fn from_str(text: &str) -> Result<Rgb, String> {
        if let Some(hex) = text.trim().strip_prefix('#') {
            return srgb(hex).map(Rgb).ok_or_else(|| "expected six hexadecimal digits after #".to_owned());
        }
        let rgb = match numbers(text)?[..] {
            [grey] => [grey; 3],
            [r, g, b] => [r, g, b],
            _ => return Err("expected r,g,b or one number".to_owned()),
        };
        if rgb.iter().any(|x| *x < 0.0) {
            return Err("a colour cannot be negative".to_owned());
        }
        Ok(Rgb(rgb))
    }
}

/// A diffuse albedo: a colour whose channels are at most 1.
pub(super) fn albedo(text: &str) -> Result<Rgb, String> {
    let rgb: Rgb = text.parse()?;
    if rgb.0.iter().any(|x| *x > 1.0) {
        let reason = "an albedo is the share of light that is reflected, between 0 and 1 in each channel; 8-bit sRGB \
                      values are written #rrggbb";
        return Err(reason.to_owned());
    }
    Ok(rgb)
}

/// Linear values of `rrggbb`, by the curve of IEC 61966-2-1.
fn srgb(hex: &str) -> Option<[f64; 3]> {
    let is_hex = hex.len() == 6 && hex.bytes().all(|digit| digit.is_ascii_hexdigit());
    let number = u32::from_str_radix(hex, 16).ok().filter(|_| is_hex)?;
    let linear = |shift: u32| match f64::from(number >> shift & 0xff) / 255.0 {
        dark if dark <= 0.04045 => dark / 12.92,
        bright => ((bright + 0.055) / 1.055).powf(2.4),
    };
    Some([linear(16), linear(8), linear(0)])
}

/// A field of view in degrees, above 0 and below 180.
pub(super) fn field_of_view(text: &str) -> Result<f32, String> {
    let angle = text.parse().ok().filter(|angle: &f32| *angle > 0.0 && *angle < 180.0);
    angle.ok_or_else(|| "expected degrees, above 0 and below 180".to_owned())
}

/// A point or direction in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point(pub(super) [f64; 3]);

impl FromStr for Point {
    type Err = String;

    fn from_str(text: &str) -> Result<Point, String> {
        match numbers(text)?[..] {
            [x, y, z] => Ok(Point([x, y, z])),
            _ => Err("expected x,y,z".to_owned()),
        }
    }
}

/// A 4 × 4 matrix, column-major.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Matrix(pub(super) [f64; 16]);

impl FromStr for Matrix {
    type Err = String;

    fn from_str(text: &str) -> Result<Matrix, String> {
        let numbers = numbers(text)?;
        let found = numbers.len();
        numbers.try_into().map(Matrix).map_err(|_| format!("expected 16 numbers, column-major, found {found}"))
    }
}

/// A finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x > 0.0 => Ok(x),
        _ => Err("expected a number above 0".to_owned()),
    }
}

/// Whether a word of the command line names a file with a scene or an asset, not one that the service has.
pub(super) fn is_scene_file(path: &Path) -> bool {
    let ending = path.extension().unwrap_or_default();
    ["glb", "gltf", "zip"].iter().any(|known| ending.eq_ignore_ascii_case(known))
}

/// What `--max-albedo` may be.
pub(super) fn max_albedo(text: &str) -> Result<f32, String> {
    let albedo = text.parse().ok().filter(|albedo: &f32| *albedo > 0.0 && *albedo <= LARGEST_ALBEDO);
    albedo.ok_or_else(|| format!("has to be above 0 and at most {LARGEST_ALBEDO}"))
}

/// A finite number of at least 0.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && x >= 0.0 => Ok(x),
        _ => Err("expected a number of at least 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_well_formed_parses() {
        assert_eq!("1,0.5, 2".parse(), Ok(Rgb([1.0, 0.5, 2.0])));
        assert_eq!("0.5".parse(), Ok(Rgb([0.5; 3])));
        assert_eq!("#ff0000".parse(), Ok(Rgb([1.0, 0.0, 0.0])));
        let Rgb([r, g, b]) = "#0A80fE".parse().unwrap();
        assert!(
            (r - 0.003_035_27).abs() < 1e-8 && (g - 0.215_860_5).abs() < 1e-7 && b < 1.0 && b > 0.99,
            "{r} {g} {b}"
        );
        assert_eq!(field_of_view("60"), Ok(60.0));
        assert_eq!("-1,2,3e1".parse(), Ok(Point([-1.0, 2.0, 30.0])));
        assert!("1,0,0,0,0,1,0,0,0,0,1,0,4,5,6,1".parse::<Matrix>().is_ok());
    }

    #[test]
    fn what_is_not_is_refused() {
        for text in ["", "1,2", "1,2,3,4", "a", "1,,2", "nan", "inf,1,1", "-1", "#fff", "#gg0000", "#+f00000"] {
            assert!(text.parse::<Rgb>().is_err(), "{text:?}");
        }
        assert!(albedo("0.2,0.3,1.01").unwrap_err().contains("#rrggbb"));
        assert!(["0", "180", "-60", "nan", "x"].iter().all(|text| field_of_view(text).is_err()));
        assert!("1,2".parse::<Point>().is_err());
        assert_eq!("1,2".parse::<Matrix>(), Err("expected 16 numbers, column-major, found 2".to_owned()));
        for text in ["0", "-1", "nan", "inf", "x"] {
            assert!(positive(text).is_err(), "{text:?}");
        }
        assert_eq!(not_negative("0"), Ok(0.0));
    }
}
