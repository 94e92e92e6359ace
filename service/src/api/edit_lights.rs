//! What edits say of lights, checked.

use glam::{DVec3, Vec3};
use rebake_core::scene::LightKind;

use super::edit_parse::{check_name, join};
use super::edit_types::NewLight;
use super::problem::{ApiResult, Kind, Problem};
use super::types::dvec3;
use crate::engine::{Edit, SHARED_LAYER, Scene};

/// The engine's kind of a new light, its colour and intensity.
pub(super) fn light_kind(light: &NewLight, path: &str) -> ApiResult<(LightKind, [f32; 3], f32)> {
    let place = |position: &[f64; 3]| match position.iter().all(|x| x.is_finite()) {
        true => Ok(dvec3(*position)),
        false => Err(Problem::field(Kind::InvalidValue, join(path, "position"), "has to be finite")),
    };
    let range = |range: Option<f32>| match range {
        Some(r) if !(r.is_finite() && r > 0.0) => {
            Err(Problem::field(Kind::InvalidValue, join(path, "range"), "has to be above 0"))
        }
        range => Ok(range),
    };
    Ok(match light {
        NewLight::Point(p) => {
            (LightKind::Point { position: place(&p.position)?, range: range(p.range)? }, p.color, p.intensity)
        }
        NewLight::Spot(s) => {
            let inner_cone_angle = s.inner_cone_angle.unwrap_or(0.0);
            let outer_cone_angle = s.outer_cone_angle.unwrap_or(std::f32::consts::FRAC_PI_4);
            let is_cone = 0.0 <= inner_cone_angle
                && inner_cone_angle < outer_cone_angle
                && outer_cone_angle <= std::f32::consts::FRAC_PI_2;
            if !is_cone {
                let reason = "the angles have to be 0 ≤ inner < outer ≤ π/2";
                return Err(Problem::field(Kind::InvalidValue, join(path, "outer_cone_angle"), reason));
            }
            let kind = LightKind::Spot {
                position: place(&s.position)?,
                direction: unit(s.direction, &join(path, "direction"))?,
                inner_cone_angle,
                outer_cone_angle,
                range: range(s.range)?,
            };
            (kind, s.color, s.intensity)
        }
        NewLight::Directional(d) => {
            let direction = unit(d.direction, &join(path, "direction"))?;
            let angle = d.angle.unwrap_or(0.0);
            if !(0.0..std::f32::consts::PI).contains(&angle) {
                let reason = "has to be at least 0 and below π";
                return Err(Problem::field(Kind::InvalidValue, join(path, "angle"), reason));
            }
            (LightKind::Directional { direction, angle }, d.color, d.intensity)
        }
        NewLight::Environment(e) => (LightKind::Environment, e.color, e.intensity),
    })
}

pub(super) fn unit(direction: [f32; 3], field: &str) -> ApiResult<Vec3> {
    let direction = DVec3::from_array(direction.map(f64::from));
    let unit = direction.try_normalize().filter(|unit| unit.is_finite());
    let unit = unit.ok_or_else(|| Problem::field(Kind::InvalidValue, field, "has to be finite and not zero"))?;
    Ok(unit.as_vec3())
}

/// Colours and intensities beyond it are mistakes; below it nothing overflows.
pub(super) const BRIGHTEST: f32 = 1e9;

pub(super) fn check_strength(color: Option<&[f32; 3]>, intensity: Option<f32>, path: &str) -> ApiResult<()> {
    let ok = |x: &f32| (0.0..=BRIGHTEST).contains(x);
    if color.is_some_and(|color| !color.iter().all(ok)) {
        let reason = format!("each has to be at least 0 and at most {BRIGHTEST:e}");
        return Err(Problem::field(Kind::InvalidValue, join(path, "color"), reason));
    }
    if intensity.is_some_and(|intensity| !ok(&intensity)) {
        let reason = format!("has to be at least 0 and at most {BRIGHTEST:e}");
        return Err(Problem::field(Kind::InvalidValue, join(path, "intensity"), reason));
    }
    if color.is_none() && intensity.is_none() {
        return Err(Problem::field(Kind::InvalidValue, join(path, "intensity"), "neither it nor `color` is given"));
    }
    Ok(())
}

/// Refuses lights that are relit to more than is possible by colour and intensity together, one of which may be from
/// before. `path`: where the edit at an index stands.
pub(super) fn check_products(edits: &[Edit], scene: &Scene, path: impl Fn(usize) -> String) -> ApiResult<()> {
    for (i, edit) in edits.iter().enumerate() {
        let Edit::Relight { lights } = edit else { continue };
        for (k, relight) in lights.iter().enumerate() {
            // One that is gone by the end of the request is nobody's concern.
            let Some(light) = scene.lights.iter().find(|light| light.name == relight.light) else { continue };
            if !(light.color * light.intensity).cmple(Vec3::splat(BRIGHTEST)).all() {
                let field = if relight.intensity.is_some() { "intensity" } else { "color" };
                let reason = format!("color × intensity has to be at most {BRIGHTEST:e}");
                return Err(Problem::field(
                    Kind::InvalidValue,
                    join(&path(i), &format!("lights[{k}].{field}")),
                    reason,
                ));
            }
        }
    }
    Ok(())
}

/// A name for a group of lights and their layer.
pub(super) fn check_group(name: &str, field: &str, max_chars: usize) -> ApiResult<()> {
    check_name(name, field, max_chars)?;
    if name == SHARED_LAYER {
        let reason = format!("{name:?} is the layer of the lights that are in no group");
        return Err(Problem::field(Kind::InvalidValue, field, reason));
    }
    Ok(())
}
