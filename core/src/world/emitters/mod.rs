//! Lights as transport samples them: resolved from [`Light`]s into scene space.
//!
//! Most are aimed at. What comes evenly from outside is not: samples by the cosine are the best there are of it, and rays
//! that leave the scene find it anyway. A picture of the sky is both: its even part, and its bright places.

mod outside;
mod surface;
mod tree;

use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::Arc;

use glam::Vec3;

use self::outside::TurnedSky;
pub(super) use self::surface::{Emissive, EmissiveTriangle};
use self::tree::LightTree;
use super::choice::WEIGHED;
use crate::bvh::Hit;
use crate::sampling::{Cone, Discrete};
use crate::scene::{Light, LightKind};
use crate::space::ray_offset;
use crate::surface::{Facets, SeeThrough};
use crate::value::Value;

/// Shadow rays end this part of their length before the light.
const SHADOW_END: f32 = 1e-4;

/// Where a light's rays come from.
#[derive(Clone, Debug)]
pub(crate) enum Shape {
    /// Emissive triangles.
    Surface {
        /// Ascending by face, along a curve in space: neighbours mostly follow each other, so that inversion keeps
        /// stratification.
        triangles: Vec<EmissiveTriangle>,
        /// By area; of facets by what they send out.
        choice: Discrete,
        /// What each triangle sends out, where that varies.
        facets: Option<Arc<Facets>>,
        /// Both sides emit.
        double_sided: bool,
        /// Bounding sphere.
        center: Vec3,
        /// m.
        radius: f32,
        /// Least and greatest corner of the bounding box.
        low: Vec3,
        high: Vec3,
        /// Area of the largest triangle, m².
        largest: f32,
        /// Area of all, m².
        area: f32,
        /// Mean of what they send out at unit strength, over RGB, too.
        brightness: f32,
        /// They let light through, and shine by as much less there.
        see_through: Option<Arc<SeeThrough>>,
    },
    /// Point or spot: candela; `spot` holds direction, cosines of inner and outer angle.
    Point { position: Vec3, spot: Option<(Vec3, f32, f32)>, range: Option<f32> },
    /// Light from afar: lux; parallel, or over a disc.
    Directional { direction: Vec3, disc: Option<Cone> },
    /// What comes evenly from outside: the same from everywhere, or by a picture.
    Sky(Option<TurnedSky>),
    /// What is bright in a picture of the sky.
    BrightSky(TurnedSky),
}

/// One light ready to be sampled.
#[derive(Clone, Debug)]
pub struct Emitter {
    /// Name of the light.
    pub name: String,
    /// Geometry.
    pub(crate) shape: Shape,
    /// Radiance, candela or lux; a factor where there is a picture.
    pub strength: Vec3,
    /// Layer that its light is carried in; 0 where light is not told apart.
    pub layer: u32,
    /// How much its samples matter beside those of others at the same strength.
    pub importance: f32,
    /// Key of the object it belongs to, for emissive surfaces.
    pub object: Option<u32>,
}

/// A sample of incoming light at a point, before visibility.
#[derive(Clone, Copy, Debug)]
pub struct LightSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// Metres; infinite for light from afar.
    pub distance: f32,
    /// Contribution to irradiance / π at unit strength, divided by the density of the sample.
    pub weight: f32,
    /// What is sent out there of unit strength, linear RGB: what a picture shows, of a screen or of the sky, and as much less
    /// where a lamp lets light through.
    pub tint: Vec3,
}

impl LightSample {
    /// How far before the light a shadow ray from `point` ends, metres.
    #[inline]
    pub fn end(&self, point: Vec3) -> f32 {
        if self.distance.is_finite() { self.distance * SHADOW_END + ray_offset(point, self.distance) } else { 0.0 }
    }
}

/// All lights of a world.
#[derive(Clone, Debug, Default)]
pub(crate) struct Emitters {
    /// Those that are aimed at.
    pub list: Vec<Emitter>,
    /// By power, for paths that follow one light at a time.
    pub choice: Option<Discrete>,
    /// Over those that are aimed at, where they are more than are weighed at every vertex.
    pub(super) tree: Option<Arc<LightTree>>,
    /// What comes evenly from outside: paths find it where they leave the scene.
    pub skies: Vec<Emitter>,
    /// m.
    pub scene_radius: f32,
}

impl Emitters {
    /// Of lights that are resolved already. `scene_radius` (m) tells the power of light from afar.
    pub(crate) fn of(emitters: Vec<Emitter>, scene_radius: f32) -> Emitters {
        let is_sky = |emitter: &Emitter| matches!(emitter.shape, Shape::Sky(_));
        let (skies, list): (Vec<Emitter>, Vec<Emitter>) = emitters.into_iter().partition(is_sky);
        let choice = Discrete::new(list.iter().map(|e| f64::from(e.power(scene_radius) * e.importance)));
        let tree = (list.len() > WEIGHED).then(|| Arc::new(LightTree::new(&list)));
        Emitters { list, choice, tree, skies, scene_radius }
    }

    /// Those that are aimed at, then those that are not.
    pub(crate) fn all(&self) -> impl Iterator<Item = &Emitter> {
        self.list.iter().chain(&self.skies)
    }

    /// Whether a ray that leaves the scene may find light.
    #[inline]
    pub(crate) fn has_sky(&self) -> bool {
        self.skies.iter().any(|sky| sky.strength != Vec3::ZERO)
    }

    /// Radiance that a ray finds which leaves the scene; what is aimed at is left out.
    #[inline]
    pub(crate) fn sky<V: Value>(&self, direction: Vec3) -> V {
        sky(&self.skies, direction)
    }

    /// All radiance from outside, as a camera sees it: but for discs of directional lights.
    pub(crate) fn background(&self, direction: Vec3) -> Vec3 {
        let radiance = |emitter: &Emitter| match &emitter.shape {
            Shape::Sky(Some(sky)) => emitter.strength * sky.radiance(direction),
            _ => emitter.strength,
        };
        self.skies.iter().map(radiance).sum()
    }

    /// Resolves lights; `triangles` gives the emissive triangles of (object name, material) and the object's key.
    pub(crate) fn new(
        lights: &[Light],
        origin: glam::DVec3,
        scene_radius: f32,
        triangles: impl Fn(&str, u32) -> Option<Emissive>,
    ) -> Emitters {
        let mut emitters = Vec::new();
        for light in lights {
            let strength = light.strength();
            let emitter = |shape: Shape, object: Option<u32>| {
                let name = light.name.clone();
                Emitter { name, shape, strength, layer: 0, importance: 1.0, object }
            };
            let (shape, object) = match &light.kind {
                LightKind::Environment => (Shape::Sky(None), None),
                LightKind::Sky { picture, rotation } => {
                    let sky = TurnedSky::new(picture, *rotation);
                    if sky.has_bright_places() {
                        emitters.push(emitter(Shape::BrightSky(sky.clone()), None));
                    }
                    (Shape::Sky(Some(sky)), None)
                }
                LightKind::Emissive { object, material } => match triangles(object, *material) {
                    Some(emissive) if !emissive.triangles.is_empty() => {
                        let key = emissive.key;
                        (surface::shape(emissive), Some(key))
                    }
                    _ => continue,
                },
                LightKind::Point { position, range } => {
                    (Shape::Point { position: (*position - origin).as_vec3(), spot: None, range: *range }, None)
                }
                LightKind::Spot { position, direction, inner_cone_angle, outer_cone_angle, range } => {
                    let spot = Some((*direction, inner_cone_angle.cos(), outer_cone_angle.cos()));
                    (Shape::Point { position: (*position - origin).as_vec3(), spot, range: *range }, None)
                }
                LightKind::Directional { direction, angle } => {
                    let disc = outside::disc(*direction, *angle);
                    (Shape::Directional { direction: *direction, disc }, None)
                }
            };
            emitters.push(emitter(shape, object));
        }
        Emitters::of(emitters, scene_radius)
    }
}

/// The specification's window: the inverse square law, ended smoothly at `range`.
fn attenuation(distance2: f32, range: Option<f32>) -> f32 {
    let window = range.map_or(1.0, |r| (1.0 - (distance2 / (r * r)).powi(2)).clamp(0.0, 1.0));
    window / distance2
}

impl Emitter {
    /// Flux at unit-free scale, for choosing between lights only.
    pub(crate) fn power(&self, scene_radius: f32) -> f32 {
        let mean = self.strength.element_sum() / 3.0;
        mean * match &self.shape {
            Shape::Surface { triangles, double_sided, brightness, .. } => {
                let area = triangles.iter().map(|t| t.area).sum::<f32>();
                area * PI * if *double_sided { 2.0 } else { 1.0 } * brightness
            }
            Shape::Point { .. } => 4.0 * PI,
            Shape::Directional { .. } => PI * scene_radius * scene_radius,
            Shape::BrightSky(sky) => sky.bright_power() * PI * scene_radius * scene_radius,
            Shape::Sky(_) => 0.0,
        }
    }

    /// Whether its light at a point is known from one ray.
    pub(crate) fn is_delta(&self) -> bool {
        matches!(self.shape, Shape::Point { .. } | Shape::Directional { disc: None, .. })
    }

    /// Whether rays that are not aimed at it can meet it.
    pub fn is_surface(&self) -> bool {
        matches!(self.shape, Shape::Surface { .. })
    }

    /// What is sent out of unit strength by what a ray met, whose place is `hit.u`, `hit.v` of triangle `face` of its surface:
    /// none where it does not shine. And the index of the triangle that [`Emitter::pdf`] asks for, where that is known.
    #[inline]
    pub(crate) fn met(&self, hit: &Hit, face: u32) -> Option<(Vec3, Option<usize>)> {
        match &self.shape {
            Shape::Surface { facets: Some(facets), .. } => {
                let index = facets.at(face, [hit.u, hit.v])?;
                Some((facets.list()[index].color, Some(index)))
            }
            _ => Some((Vec3::ONE, None)),
        }
    }

    /// A sphere that holds all segments' far ends; none for light from afar.
    pub(crate) fn sphere(&self) -> Option<(Vec3, f32)> {
        match &self.shape {
            Shape::Surface { center, radius, .. } => Some((*center, *radius)),
            Shape::Point { position, .. } => Some((*position, 0.0)),
            Shape::Directional { .. } | Shape::Sky(_) | Shape::BrightSky(_) => None,
        }
    }

    /// Samples the light's contribution to irradiance / π at `point` with unit normal `n`, at unit strength. None
    /// where the sample brings no light.
    #[inline]
    pub fn sample(&self, point: Vec3, n: Vec3, u: [f32; 2]) -> Option<LightSample> {
        match &self.shape {
            Shape::Surface { triangles, choice, facets, double_sided, see_through, .. } => {
                let (sample, index) = surface::sample(triangles, choice, *double_sided, point, n, u)?;
                if facets.is_none() && see_through.is_none() {
                    return Some(sample);
                }
                let place = point + sample.direction * sample.distance;
                let pictures = (facets.as_deref(), see_through.as_deref());
                let tint = surface::sent_at(&triangles[index], index, pictures, place);
                (tint != Vec3::ZERO).then_some(LightSample { tint, ..sample })
            }
            Shape::Point { position, spot, range } => {
                let w = *position - point;
                let distance2 = w.length_squared();
                let distance = distance2.sqrt();
                let direction = w / distance;
                let cos = n.dot(direction);
                if cos <= 0.0 || distance <= 0.0 {
                    return None;
                }
                let cone = spot.map_or(1.0, |(axis, inner, outer)| {
                    let t = ((-direction.dot(axis) - outer) / (inner - outer).max(1e-4)).clamp(0.0, 1.0);
                    t * t
                });
                let weight = cos * cone * attenuation(distance2, *range) * FRAC_1_PI;
                (weight > 0.0).then_some(LightSample { direction, distance, weight, tint: Vec3::ONE })
            }
            Shape::Directional { direction, disc } => outside::sample_directional(*direction, disc.as_ref(), n, u),
            Shape::Sky(sky) => Some(outside::sample_even(sky.as_ref(), n, u)),
            Shape::BrightSky(sky) => sky.sample_bright(n, u),
        }
    }
}

impl Emitter {
    /// Whether another emitter shines from the same place. Triangles are compared by the caller.
    pub fn same_shape(&self, other: &Emitter) -> bool {
        match (&self.shape, &other.shape) {
            (Shape::Surface { double_sided: a, facets: f, .. }, Shape::Surface { double_sided: b, facets: g, .. }) => {
                a == b && self.object == other.object && f == g
            }
            (Shape::Point { position: a, spot: s, range: r }, Shape::Point { position: b, spot: t, range: q }) => {
                a == b && s == t && r == q
            }
            (Shape::Directional { direction: a, disc: d }, Shape::Directional { direction: b, disc: e }) => {
                a == b && d.map(|d| d.one_minus_cos) == e.map(|e| e.one_minus_cos)
            }
            (Shape::Sky(None), Shape::Sky(None)) => true,
            (Shape::Sky(Some(a)), Shape::Sky(Some(b))) | (Shape::BrightSky(a), Shape::BrightSky(b)) => a.same_as(b),
            _ => false,
        }
    }
}

/// Radiance that a ray finds which leaves the scene, of some emitters that are not aimed at.
#[inline]
pub(crate) fn sky<V: Value>(skies: &[Emitter], direction: Vec3) -> V {
    let even = |emitter: &Emitter| match &emitter.shape {
        Shape::Sky(Some(sky)) => emitter.strength * sky.even(direction),
        _ => emitter.strength * Vec3::ONE,
    };
    skies.iter().map(|emitter| V::of_layer(emitter.layer, even(emitter))).sum()
}
