//! What names, strengths, places and spacings may be: the same for uploads, edits and what is brought back from a disk.

use glam::{DVec3, Vec3};

/// Bounds on what a client may ask for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed {
    /// Characters of a name, at most.
    pub name_chars: usize,
    /// Largest colour, intensity, and product of both: beyond it are mistakes; below it nothing overflows.
    pub brightest: f32,
    /// Greatest extent of a scene in a file, distance from the zero of scene space along an axis, metres, and factor of a
    /// transform: products of four lengths must stay far from the end of `f32`.
    pub farthest: f64,
    /// Names may hold control characters.
    allows_control: bool,
}

/// A strength that is out of its bounds.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct StrengthError {
    /// `color` or `intensity`.
    pub field: &'static str,
    /// What is wrong with it.
    pub reason: String,
}

impl Allowed {
    /// Of what is asked for now.
    pub const ASKED: Allowed = Allowed { name_chars: 256, brightest: 1e9, farthest: 1e8, allows_control: false };
    /// Of what is in files, and of what was accepted once: nothing that was acknowledged is lost, whatever bounds an earlier
    /// version had.
    pub const KEPT: Allowed =
        Allowed { name_chars: usize::MAX, brightest: 1e12, farthest: f64::INFINITY, allows_control: true };

    /// A name for something.
    ///
    /// # Errors
    /// What is wrong with it, for people.
    pub fn check_name(&self, name: &str) -> Result<(), String> {
        let chars = name.chars().count();
        match () {
            () if chars == 0 && self.name_chars == usize::MAX => Err("is empty".to_owned()),
            () if chars == 0 || chars > self.name_chars => {
                Err(format!("has to have 1 to {} characters, not {chars}", self.name_chars))
            }
            () if !self.allows_control && name.chars().any(char::is_control) => {
                Err("holds control characters".to_owned())
            }
            () => Ok(()),
        }
    }

    /// Colour (linear RGB) and intensity of a light, as far as they are given.
    ///
    /// # Errors
    /// [`StrengthError`]
    pub fn check_strength(&self, color: Option<Vec3>, intensity: Option<f32>) -> Result<(), StrengthError> {
        let brightest = self.brightest;
        let is_within = |x: &f32| (0.0..=brightest).contains(x);
        if color.is_some_and(|color| !color.to_array().iter().all(is_within)) {
            let reason = format!("each has to be at least 0 and at most {brightest:e}");
            return Err(StrengthError { field: "color", reason });
        }
        if intensity.is_some_and(|intensity| !is_within(&intensity)) {
            let reason = format!("has to be at least 0 and at most {brightest:e}");
            return Err(StrengthError { field: "intensity", reason });
        }
        let (Some(color), Some(intensity)) = (color, intensity) else { return Ok(()) };
        self.check_product(color, intensity).map_err(|reason| StrengthError { field: "intensity", reason })
    }

    /// A place in a scene whose scene space has its zero at `origin`.
    ///
    /// # Errors
    /// What is wrong with it, for people.
    pub fn check_place(&self, place: DVec3, origin: DVec3) -> Result<(), String> {
        match place.is_finite() && (place - origin).abs().max_element() <= self.farthest {
            true => Ok(()),
            false => Err(format!("has to be finite and within {:e} m of the scene", self.farthest)),
        }
    }

    /// Colour and intensity of a light together.
    ///
    /// # Errors
    /// What is wrong with them, for people.
    pub fn check_product(&self, color: Vec3, intensity: f32) -> Result<(), String> {
        match (color * intensity).cmple(Vec3::splat(self.brightest)).all() {
            true => Ok(()),
            false => Err(format!("color × intensity has to be at most {:e}", self.brightest)),
        }
    }
}

/// A distance between elements, metres.
///
/// # Errors
/// What is wrong with it, for people.
pub fn check_spacing(spacing: f32) -> Result<(), String> {
    match spacing.is_finite() && spacing > 0.0 {
        true => Ok(()),
        false => Err(format!("has to be a finite number above 0, not {spacing}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_counted_in_characters() {
        let name = |chars: usize| "ä".repeat(chars);
        assert!(Allowed::ASKED.check_name(&name(256)).is_ok());
        assert_eq!(Allowed::ASKED.check_name(&name(257)), Err("has to have 1 to 256 characters, not 257".to_owned()));
        assert!(Allowed::ASKED.check_name("a\u{7}").is_err() && Allowed::ASKED.check_name("").is_err());
        assert!(Allowed::KEPT.check_name(&name(257)).is_ok() && Allowed::KEPT.check_name("a\u{7}").is_ok());
        assert!(Allowed::KEPT.check_name("").is_err());
    }

    #[test]
    fn strengths_are_bounded_alone_and_together() {
        let field = |allowed: Allowed, color: Option<Vec3>, intensity: Option<f32>| {
            allowed.check_strength(color, intensity).err().map(|error| error.field)
        };
        let asked = |color: Option<f32>, intensity| field(Allowed::ASKED, color.map(Vec3::splat), intensity);
        assert_eq!(asked(Some(1e9), None), None);
        assert_eq!(asked(Some(1e9), Some(1.0)), None);
        assert_eq!(asked(Some(1.1e9), None), Some("color"));
        assert_eq!(asked(Some(-1.0), Some(1.0)), Some("color"));
        assert_eq!(asked(Some(f32::NAN), None), Some("color"));
        assert_eq!(asked(None, Some(f32::INFINITY)), Some("intensity"));
        assert_eq!(asked(Some(1e5), Some(1.1e4)), Some("intensity"));
        assert_eq!(field(Allowed::KEPT, Some(Vec3::splat(1e5)), Some(1e7)), None);
        assert_eq!(field(Allowed::KEPT, Some(Vec3::splat(1e6)), Some(1.1e6)), Some("intensity"));
    }

    #[test]
    fn places_are_near_the_scene() {
        let origin = DVec3::splat(6.4e9);
        let is_within = |allowed: Allowed, x: f64| allowed.check_place(origin + DVec3::X * x, origin).is_ok();
        assert!(is_within(Allowed::ASKED, 0.9e8) && !is_within(Allowed::ASKED, -1.1e8));
        assert!(is_within(Allowed::KEPT, 1e300) && !is_within(Allowed::KEPT, f64::NAN));
    }

    #[test]
    fn spacings_are_above_zero() {
        assert!(check_spacing(0.1).is_ok());
        assert!([0.0, -1.0, f32::NAN, f32::INFINITY].into_iter().all(|spacing| check_spacing(spacing).is_err()));
    }
}
