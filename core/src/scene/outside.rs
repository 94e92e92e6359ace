//! Light from outside that a file has not, added to its scene.

use glam::Vec3;

use super::{ENVIRONMENT, Light, LightKind, Scene};

/// Radiance of [`Outside::default_sky`], from everywhere.
const DEFAULT_SKY: f32 = 1.0;

/// What is added to the lights of a file.
#[derive(Clone, Debug, Default)]
pub struct Outside {
    /// Light from outside: [`LightKind::Environment`] or [`LightKind::Sky`], linear RGB colour and intensity.
    pub sky: Option<(LightKind, Vec3, f32)>,
    /// Radiance 1 from everywhere, where there is no light at all.
    pub default_sky: bool,
    /// Angle that the discs of directional lights take up, radians, below π.
    pub sun_angle: f32,
}

impl Outside {
    /// Adds it to a scene, with a warning where it is the default or the scene stays without light; false where the scene
    /// has a light named [`ENVIRONMENT`] already.
    pub fn add_to(&self, scene: &mut Scene) -> bool {
        for light in &mut scene.lights {
            if let LightKind::Directional { angle, .. } = &mut light.kind {
                *angle = self.sun_angle;
            }
        }
        let sky = |kind, color, intensity| Light { name: ENVIRONMENT.to_owned(), kind, color, intensity };
        match &self.sky {
            Some(_) if scene.lights.iter().any(|light| light.name == ENVIRONMENT) => return false,
            Some((kind, color, intensity)) => scene.lights.push(sky(kind.clone(), *color, *intensity)),
            None if self.default_sky && scene.lights.is_empty() => {
                scene.lights.push(sky(LightKind::Environment, Vec3::ONE, DEFAULT_SKY));
                let text =
                    format!("the scene has no light: it gets the default sky, radiance {DEFAULT_SKY} from everywhere");
                scene.warnings.push(text);
            }
            None => {}
        }
        scene.warn_where_dark();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_sky_is_for_scenes_without_light() {
        let dark = || Scene::from_objects(Vec::new());
        let plain = Outside { default_sky: true, ..Outside::default() };
        let sun = |angle| Light {
            name: "sun".to_owned(),
            kind: LightKind::Directional { direction: Vec3::NEG_Y, angle },
            color: Vec3::ONE,
            intensity: 1.0,
        };
        let mut scene = dark();
        assert!(plain.add_to(&mut scene));
        assert_eq!((scene.lights[0].name.as_str(), scene.lights[0].strength()), (ENVIRONMENT, Vec3::ONE));
        assert!(scene.warnings.len() == 1 && scene.warnings[0].contains("default sky"));
        let mut scene = dark();
        assert!(Outside::default().add_to(&mut scene));
        assert!(scene.lights.is_empty() && scene.warnings[0].contains("default_sky"), "{:?}", scene.warnings);
        let mut scene = dark().with_light(sun(0.0));
        assert!(Outside { sun_angle: 0.01, ..plain }.add_to(&mut scene));
        assert!(scene.lights == [sun(0.01)] && scene.warnings.is_empty());
        // One that is off lights nothing; it is not what the sky is for.
        let mut off = dark().with_light(Light { intensity: 0.0, ..sun(0.0) });
        assert!(Outside { default_sky: true, ..Outside::default() }.add_to(&mut off));
        assert!(off.lights.len() == 1 && off.warnings[0].contains("no light"), "{:?}", off.warnings);
        let sky = Outside { sky: Some((LightKind::Environment, Vec3::ONE, 2.0)), ..Outside::default() };
        assert!(sky.add_to(&mut scene) && !sky.add_to(&mut scene));
        assert_eq!((scene.lights.len(), scene.lights[1].strength()), (2, Vec3::splat(2.0)));
    }
}
