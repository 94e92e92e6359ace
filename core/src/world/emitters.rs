//! Lights as transport samples them: resolved from [`Light`]s into scene space.

use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

use glam::Vec3;

use crate::bvh::{Hit, Ray};
use crate::sampling::{Discrete, SphericalTriangle, uniform_barycentrics};
use crate::scene::{Light, LightKind};
use crate::space::ray_offset;
use crate::surface::{SeeThrough, barycentrics};
use crate::value::Value;

/// Emitters of at most so many triangles are sampled by the solid angle of all of them from near.
const FEW: usize = 4;

/// Shadow rays end this part of their length before the light.
const SHADOW_END: f32 = 1e-4;

/// An emissive triangle in scene space.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmissiveTriangle {
    /// Index in its object's surface.
    pub face: u32,
    /// Corners, counter-clockwise from the front.
    pub corners: [Vec3; 3],
    /// Unit geometric normal.
    pub normal: Vec3,
    /// m².
    pub area: f32,
}

/// The emissive triangles of an object's material.
pub(crate) struct Emissive {
    /// Key of the object.
    pub key: u32,
    /// Ascending by face.
    pub triangles: Vec<EmissiveTriangle>,
    /// Both sides emit.
    pub double_sided: bool,
    /// What of the object lets light through.
    pub see_through: Option<Arc<SeeThrough>>,
}

/// Where a light's rays come from.
#[derive(Clone, Debug)]
pub(crate) enum Shape {
    /// Emissive triangles.
    Surface {
        /// Ascending by face, along a curve in space: neighbours mostly follow each other, so that inversion keeps
        /// stratification.
        triangles: Vec<EmissiveTriangle>,
        /// By area.
        choice: Discrete,
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
        /// They let light through, and shine by as much less there.
        see_through: Option<Arc<SeeThrough>>,
    },
    /// Point or spot: candela; `spot` holds direction, cosines of inner and outer angle.
    Point { position: Vec3, spot: Option<(Vec3, f32, f32)>, range: Option<f32> },
    /// Parallel light: lux.
    Directional { direction: Vec3 },
}

/// One light ready to be sampled.
#[derive(Clone, Debug)]
pub(crate) struct Emitter {
    /// Name of the light.
    pub name: String,
    /// Geometry.
    pub shape: Shape,
    /// Radiance, candela or lux.
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
pub(crate) struct LightSample {
    /// Unit direction towards the light.
    pub direction: Vec3,
    /// Metres; infinite for parallel light.
    pub distance: f32,
    /// Contribution to irradiance / π at unit strength, divided by the density of the sample.
    pub weight: f32,
    /// Share of it that is sent out there: places of a lamp that let light through shine by as much less.
    pub share: f32,
}

impl LightSample {
    /// How far before the light a shadow ray from `point` ends, metres.
    #[inline]
    pub(crate) fn end(&self, point: Vec3) -> f32 {
        if self.distance.is_finite() { self.distance * SHADOW_END + ray_offset(point, self.distance) } else { 0.0 }
    }
}

/// All lights of a world.
#[derive(Clone, Debug, Default)]
pub(crate) struct Emitters {
    /// Everything but the environment.
    pub list: Vec<Emitter>,
    /// By power, for paths that follow one light at a time.
    pub choice: Option<Discrete>,
    /// Constant radiance from outside, all of it.
    pub environment: Vec3,
    /// Constant radiance from outside, by layer.
    pub skies: Vec<(u32, Vec3)>,
    /// m.
    pub scene_radius: f32,
}

impl Emitters {
    /// Of lights that are resolved already. `scene_radius` (m) tells the power of parallel light.
    pub(crate) fn of(list: Vec<Emitter>, skies: Vec<(u32, Vec3)>, scene_radius: f32) -> Emitters {
        let choice = Discrete::new(list.iter().map(|e| f64::from(e.power(scene_radius) * e.importance)));
        let environment = skies.iter().map(|(_, radiance)| *radiance).sum();
        Emitters { list, choice, environment, skies, scene_radius }
    }

    /// Radiance from outside.
    #[inline]
    pub(crate) fn sky<V: Value>(&self) -> V {
        self.skies.iter().map(|&(layer, radiance)| V::of_layer(layer, radiance)).sum()
    }

    /// Resolves lights; `triangles` gives the emissive triangles of (object name, material) and the object's key.
    pub(crate) fn new(
        lights: &[Light],
        origin: glam::DVec3,
        scene_radius: f32,
        triangles: impl Fn(&str, u32) -> Option<Emissive>,
    ) -> Emitters {
        let mut skies = Vec::new();
        let mut list = Vec::new();
        for light in lights {
            let strength = light.strength();
            let (shape, object) = match &light.kind {
                LightKind::Environment => {
                    skies.push((0, strength));
                    continue;
                }
                LightKind::Emissive { object, material } => match triangles(object, *material) {
                    Some(emissive) if !emissive.triangles.is_empty() => {
                        let key = emissive.key;
                        (surface(emissive), Some(key))
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
                LightKind::Directional { direction } => (Shape::Directional { direction: *direction }, None),
            };
            list.push(Emitter { name: light.name.clone(), shape, strength, layer: 0, importance: 1.0, object });
        }
        Emitters::of(list, skies, scene_radius)
    }
}

fn surface(Emissive { triangles, double_sided, see_through, .. }: Emissive) -> Shape {
    let choice = Discrete::new(triangles.iter().map(|t| f64::from(t.area))).unwrap_or_default();
    let corners = || triangles.iter().flat_map(|t| t.corners);
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    corners().for_each(|c| {
        low = low.min(c);
        high = high.max(c);
    });
    let center = (low + high) * 0.5;
    let radius = corners().map(|c| c.distance(center)).fold(0.0, f32::max) * 1.0001;
    let largest = triangles.iter().map(|t| t.area).fold(0.0, f32::max);
    let area = triangles.iter().map(|t| t.area).sum();
    Shape::Surface { triangles, choice, double_sided, center, radius, low, high, largest, area, see_through }
}

/// The specification's window: the inverse square law, ended smoothly at `range`.
fn attenuation(distance2: f32, range: Option<f32>) -> f32 {
    let window = range.map_or(1.0, |r| (1.0 - (distance2 / (r * r)).powi(2)).clamp(0.0, 1.0));
    window / distance2
}

impl Emitter {
    /// Flux at unit-free scale, for choosing between lights only.
    pub(crate) fn power(&self, scene_radius: f32) -> f32 {
        use std::f32::consts::PI;
        let mean = self.strength.element_sum() / 3.0;
        mean * match &self.shape {
            Shape::Surface { triangles, double_sided, .. } => {
                triangles.iter().map(|t| t.area).sum::<f32>() * PI * if *double_sided { 2.0 } else { 1.0 }
            }
            Shape::Point { .. } => 4.0 * PI,
            Shape::Directional { .. } => PI * scene_radius * scene_radius,
        }
    }

    /// Whether its light at a point is known from one ray.
    pub(crate) fn is_delta(&self) -> bool {
        !matches!(self.shape, Shape::Surface { .. })
    }

    /// A sphere that holds all segments' far ends; none for parallel light.
    pub(crate) fn sphere(&self) -> Option<(Vec3, f32)> {
        match &self.shape {
            Shape::Surface { center, radius, .. } => Some((*center, *radius)),
            Shape::Point { position, .. } => Some((*position, 0.0)),
            Shape::Directional { .. } => None,
        }
    }

    /// Samples the light's contribution to irradiance / π at `point` with unit normal `n`, at unit strength. None
    /// where the sample brings no light.
    #[inline]
    pub(crate) fn sample(&self, point: Vec3, n: Vec3, u: [f32; 2]) -> Option<LightSample> {
        match &self.shape {
            Shape::Surface { triangles, choice, double_sided, see_through, .. } => {
                let (sample, triangle) = sample_surface(triangles, choice, *double_sided, point, n, u)?;
                let Some(see_through) = see_through else { return Some(sample) };
                let share = triangle.opacity(see_through, point + sample.direction * sample.distance);
                (share > 0.0).then_some(LightSample { share, ..sample })
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
                (weight > 0.0).then_some(LightSample { direction, distance, weight, share: 1.0 })
            }
            Shape::Directional { direction } => {
                let cos = -n.dot(*direction);
                (cos > 0.0).then_some(LightSample {
                    direction: -*direction,
                    distance: f32::INFINITY,
                    weight: cos * FRAC_1_PI,
                    share: 1.0,
                })
            }
        }
    }
}

/// Few triangles that are near together by solid angle; else triangles by area, and the point on one by area from afar
/// and by solid angle from near, where 1/r² would explode.
#[inline]
fn sample_surface<'t>(
    triangles: &'t [EmissiveTriangle],
    choice: &Discrete,
    double_sided: bool,
    point: Vec3,
    n: Vec3,
    [u, v]: [f32; 2],
) -> Option<(LightSample, &'t EmissiveTriangle)> {
    if triangles.len() <= FEW && triangles.iter().any(|t| t.is_near(point)) {
        return sample_few(triangles, double_sided, point, n, [u, v]);
    }
    let (index, u) = if triangles.len() == 1 { (0, u) } else { choice.sample(u) };
    let triangle = &triangles[index];
    let probability = choice.pdf(index);
    if !triangle.shines_at(point, double_sided) {
        return None;
    }
    if triangle.is_near(point) {
        let spherical = SphericalTriangle::new(point, triangle.corners)?;
        let sample = triangle.towards(point, n, spherical.sample([u, v]), probability * spherical.pdf())?;
        return Some((sample, triangle));
    }
    let [a, b, c] = triangle.corners;
    let (b1, b2) = uniform_barycentrics([u, v]);
    let w = a + (b - a) * b1 + (c - a) * b2 - point;
    let distance2 = w.length_squared();
    let distance = distance2.sqrt();
    let direction = w / distance;
    let cos = n.dot(direction);
    let cos_light = direction.dot(triangle.normal).abs();
    let weight = cos * cos_light * triangle.area / (distance2 * probability) * FRAC_1_PI;
    (cos > 0.0).then_some((LightSample { direction, distance, weight, share: 1.0 }, triangle))
}

/// Uniform over the solid angle of all triangles together.
fn sample_few(
    triangles: &[EmissiveTriangle],
    double_sided: bool,
    point: Vec3,
    n: Vec3,
    [u, v]: [f32; 2],
) -> Option<(LightSample, &EmissiveTriangle)> {
    let mut seen = [None; FEW];
    let mut total = 0.0;
    for (slot, triangle) in seen.iter_mut().zip(triangles) {
        if triangle.shines_at(point, double_sided) {
            *slot = SphericalTriangle::new(point, triangle.corners);
            total += slot.map_or(0.0, |s| s.solid_angle);
        }
    }
    let mut left = f64::from(u) * total;
    let mut last = None;
    for (spherical, triangle) in seen.iter().zip(triangles) {
        let Some(spherical) = spherical else { continue };
        last = Some((spherical, triangle, left));
        if left < spherical.solid_angle {
            break;
        }
        left -= spherical.solid_angle;
    }
    let (spherical, triangle, left) = last?;
    let u = ((left / spherical.solid_angle) as f32).clamp(0.0, 0.999_999_94);
    Some((triangle.towards(point, n, spherical.sample([u, v]), (1.0 / total) as f32)?, triangle))
}

impl Emitter {
    /// Density per steradian with which [`Emitter::sample`] finds the point that a ray met on this emissive surface;
    /// zero where it never does. `which` tells the index of the triangle, where it is needed: near many triangles.
    pub(crate) fn pdf(&self, ray: &Ray, hit: &Hit, which: impl FnOnce() -> Option<usize>) -> f32 {
        let Shape::Surface { triangles, choice, double_sided, center, radius, largest, area, .. } = &self.shape else {
            return 0.0;
        };
        let point = ray.origin;
        let slope = ray.direction.dot(hit.normal).abs();
        let few = triangles.len() <= FEW;
        if few && triangles.iter().any(|t| t.is_near(point)) {
            let seen = triangles.iter().filter(|t| t.shines_at(point, *double_sided));
            let total: f64 = seen.filter_map(|t| SphericalTriangle::new(point, t.corners)).map(|s| s.solid_angle).sum();
            return if total > 0.0 && slope >= 1e-7 { (1.0 / total) as f32 } else { 0.0 };
        }
        if !few && point.distance(*center) < radius + (8.0 * largest).sqrt() {
            let Some(index) = which() else { return 0.0 };
            let triangle = &triangles[index];
            if triangle.is_near(point) {
                let spherical = SphericalTriangle::new(point, triangle.corners).filter(|_| slope >= 1e-7);
                return spherical.map_or(0.0, |s| choice.pdf(index) * s.pdf());
            }
        }
        // By area, whatever the triangle.
        if slope > 0.0 { hit.t * hit.t / (slope * area) } else { 0.0 }
    }
}

impl EmissiveTriangle {
    /// Whether it is so near that points on it differ much in distance.
    #[inline]
    fn is_near(&self, point: Vec3) -> bool {
        let [a, b, c] = self.corners;
        ((a + b + c) * (1.0 / 3.0) - point).length_squared() < 8.0 * self.area
    }

    /// How opaque it is at a point on it, as it shines there.
    #[cold]
    fn opacity(&self, see_through: &SeeThrough, point: Vec3) -> f32 {
        let [_, u, v] = barycentrics(point, self.corners);
        see_through.at(self.face as usize, [u, v]).map_or(1.0, |passage| passage.opacity)
    }

    /// Height of a point over the triangle's plane, m.
    #[inline]
    fn height(&self, point: Vec3) -> f32 {
        (point - self.corners[0]).dot(self.normal)
    }

    #[inline]
    fn shines_at(&self, point: Vec3, double_sided: bool) -> bool {
        let height = self.height(point);
        height > 0.0 || double_sided && height < 0.0
    }

    /// The sample in a direction that was drawn with density `pdf` per steradian.
    #[inline]
    fn towards(&self, point: Vec3, n: Vec3, direction: Vec3, pdf: f32) -> Option<LightSample> {
        let cos = n.dot(direction);
        let slope = -direction.dot(self.normal);
        if cos <= 0.0 || slope.abs() < 1e-7 {
            return None;
        }
        let distance = self.height(point) / slope;
        (distance > 0.0).then_some(LightSample { direction, distance, weight: cos * FRAC_1_PI / pdf, share: 1.0 })
    }
}

impl Emitter {
    /// Whether another emitter shines from the same place. Triangles are compared by the caller.
    pub(crate) fn same_shape(&self, other: &Emitter) -> bool {
        match (&self.shape, &other.shape) {
            (Shape::Surface { double_sided: a, .. }, Shape::Surface { double_sided: b, .. }) => {
                a == b && self.object == other.object
            }
            (Shape::Point { position: a, spot: s, range: r }, Shape::Point { position: b, spot: t, range: q }) => {
                a == b && s == t && r == q
            }
            (Shape::Directional { direction: a }, Shape::Directional { direction: b }) => a == b,
            _ => false,
        }
    }
}
