//! What edits say of lights, checked, in the engine's terms.

use glam::{DVec3, Vec3};
use rebake_core::allowed::Allowed;
use rebake_core::scene::LightKind;

use super::checks::{check_group, check_name, check_strength};
use super::edit_parse::finite;
use super::edit_types::{GroupLights, InsertLight, MoveLight, NewLight, Relight};
use super::misread::join;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{dvec3, vec3};
use crate::engine::{self, Edit};

pub(super) fn relight(relight: &Relight, path: &str, allowed: Allowed) -> ApiResult<Edit> {
    names_lights(relight.lights.len(), path)?;
    let mut lights = Vec::with_capacity(relight.lights.len());
    for (i, one) in relight.lights.iter().enumerate() {
        let at = join(path, &format!("lights[{i}]"));
        if one.color.is_none() && one.intensity.is_none() {
            let reason = "neither it nor `color` is given";
            return Err(Problem::field(Kind::InvalidValue, join(&at, "intensity"), reason));
        }
        check_strength(allowed, one.color.as_ref(), one.intensity, &at)?;
        let (color, intensity) = (one.color.map(vec3), one.intensity);
        lights.push(engine::Relight { light: one.light.clone(), color, intensity });
    }
    Ok(Edit::Relight { lights })
}

pub(super) fn insert(new: &InsertLight, path: &str, allowed: Allowed) -> ApiResult<Edit> {
    check_name(allowed, &new.name, &join(path, "name"))?;
    let at = join(path, "light");
    let (kind, color, intensity) = light_kind(&new.light, &at)?;
    check_strength(allowed, Some(&color), Some(intensity), &at)?;
    Ok(Edit::InsertLight { name: new.name.clone(), kind, color: vec3(color), intensity })
}

/// A light that is dragged gets a layer of its own.
pub(super) fn move_one(place: &MoveLight, path: &str) -> ApiResult<Edit> {
    if place.position.is_none() && place.direction.is_none() {
        let reason = "neither it nor `direction` is given";
        return Err(Problem::field(Kind::InvalidValue, join(path, "position"), reason));
    }
    place.position.map_or(Ok(()), |position| finite(path, "position", &position))?;
    let direction = place.direction.map(|d| unit(d, &join(path, "direction"))).transpose()?;
    let position = place.position.map(dvec3);
    Ok(Edit::MoveLight { light: place.light.clone(), position, direction, own_layer: place.drag })
}

pub(super) fn group(group: &GroupLights, path: &str, allowed: Allowed) -> ApiResult<Edit> {
    group.name.as_ref().map_or(Ok(()), |name| check_group(allowed, name, &join(path, "name")))?;
    names_lights(group.lights.len(), path)?;
    Ok(Edit::GroupLights { group: group.name.clone(), lights: group.lights.clone() })
}

fn names_lights(count: usize, path: &str) -> ApiResult<()> {
    match count {
        0 => Err(Problem::field(Kind::InvalidValue, join(path, "lights"), "names no light")),
        _ => Ok(()),
    }
}

/// The engine's kind of a new light, its colour and intensity.
fn light_kind(light: &NewLight, path: &str) -> ApiResult<(LightKind, [f32; 3], f32)> {
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
                && inner_cone_angle <= outer_cone_angle
                && outer_cone_angle > 0.0
                && outer_cone_angle <= std::f32::consts::FRAC_PI_2;
            if !is_cone {
                let reason = "the angles have to be 0 ≤ inner ≤ outer ≤ π/2, and the outer one above 0";
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

fn unit(direction: [f32; 3], field: &str) -> ApiResult<Vec3> {
    let direction = DVec3::from_array(direction.map(f64::from));
    let unit = direction.try_normalize().filter(|unit| unit.is_finite());
    let unit = unit.ok_or_else(|| Problem::field(Kind::InvalidValue, field, "has to be finite and not zero"))?;
    Ok(unit.as_vec3())
}
