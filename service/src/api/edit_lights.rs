//! What edits say of lights, checked.

use glam::{DVec3, Vec3};
use rebake_core::scene::LightKind;

use super::edit_types::NewLight;
use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};
use super::types::dvec3;

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
