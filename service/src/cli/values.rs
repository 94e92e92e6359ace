//! Values on the command line: numbers with a range, colours, points, transforms.

use std::str::FromStr;

/// Comma-separated numbers, all finite.
fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let parse = |part: &str| match part.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err(format!("{:?} is not a finite number", part.trim())),
    };
    text.split(',').map(parse).collect()
}

/// Linear RGB, each ≥ 0; one number stands for grey.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rgb(pub(super) [f64; 3]);

impl FromStr for Rgb {
    type Err = String;

    fn from_str(text: &str) -> Result<Rgb, String> {
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
    if rgb.0.iter().any(|x| *x > 1.0) { Err("an albedo is between 0 and 1".to_owned()) } else { Ok(rgb) }
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
        assert_eq!("-1,2,3e1".parse(), Ok(Point([-1.0, 2.0, 30.0])));
        assert!("1,0,0,0,0,1,0,0,0,0,1,0,4,5,6,1".parse::<Matrix>().is_ok());
    }

    #[test]
    fn what_is_not_is_refused() {
        for text in ["", "1,2", "1,2,3,4", "a", "1,,2", "nan", "inf,1,1", "-1"] {
            assert!(text.parse::<Rgb>().is_err(), "{text:?}");
        }
        assert!(albedo("0.2,0.3,1.01").is_err());
        assert!("1,2".parse::<Point>().is_err());
        assert_eq!("1,2".parse::<Matrix>(), Err("expected 16 numbers, column-major, found 2".to_owned()));
        for text in ["0", "-1", "nan", "inf", "x"] {
            assert!(positive(text).is_err(), "{text:?}");
        }
        assert_eq!(not_negative("0"), Ok(0.0));
    }
}
