//! What a camera ray sees.

use std::collections::BTreeMap;

use glam::Vec3;

use super::camera::Rays;
use super::lines::Lines;
use super::{RenderOptions, View};
use crate::bvh::{Hit, Ray};
use crate::lightmap::{LightMap, LightPart};
use crate::random::{Pcg32, R2, subseed};
use crate::sampling::cosine_hemisphere;
use crate::scene::{LightKind, Object, Passage, TextureUse};
use crate::surface::Corners;
use crate::transport::direct::one_light;
use crate::transport::{Field, Rough, Surfel};
use crate::world::{Emitters, Placed, World, visible_light};

/// Backs that a camera ray passes through at most.
const MAX_BACKS: u32 = 64;

/// Surfaces that let light through, one behind the other, that a picture shows at most.
const MAX_SURFACES: u32 = 64;

/// Up to so many lights each gets a shadow ray per sample; of more, as many are chosen by power.
const MAX_LIGHTS: usize = 32;

/// Everything that pixels share.
pub(super) struct Shading<'a> {
    world: &'a World,
    view: View,
    /// Per part: emitted radiance …
    emission: Vec<Vec3>,
    /// … and by what a texture multiplies it by place.
    pictures: BTreeMap<u32, Picture<'a>>,
    /// Direct + indirect, as it is delivered; empty where no view needs it.
    totals: Vec<Vec3>,
    /// Indirect light, as it is delivered; empty where no view needs it.
    indirect: Vec<Vec3>,
    /// Between elements, where these are shown.
    lines: Option<Lines>,
}

/// An emissive texture where it is shown.
struct Picture<'a> {
    texture: &'a TextureUse,
    object: &'a Object,
    placed: &'a Placed,
}

impl<'a> Shading<'a> {
    pub(super) fn new(world: &'a World, map: &LightMap, view: View, pixel: f32) -> Shading<'a> {
        let part = |part| if view == View::Direct { Vec::new() } else { world.delivered(map, part) };
        let (totals, indirect) = (part(LightPart::Full), part(LightPart::Indirect));
        let (emission, pictures) = emission_of_parts(world);
        let lines = (view == View::Elements).then(|| Lines::new(world, &totals, pixel));
        Shading { world, view, emission, pictures, totals, indirect, lines }
    }

    /// Mean radiance of a pixel.
    pub(super) fn pixel(&self, rays: &Rays, x: usize, y: usize, options: &RenderOptions) -> Vec3 {
        let mut rng = pixel_random(options, x, y);
        // One sequence per dimension and light, each with its own shift: the samples of a pixel cover its square and
        // every light evenly.
        let within = R2::new(&mut rng);
        let emitters = &self.world.emitters;
        let count = emitters.list.len().min(MAX_LIGHTS) + emitters.skies.len();
        let sequences: Vec<R2> = (0..count).map(|_| R2::new(&mut rng)).collect();
        let mut sum = Vec3::ZERO;
        for k in 0..options.samples {
            sum += self.radiance(rays.through(x, y, place(options, &within, k)), k, &sequences, &mut rng);
        }
        sum / options.samples as f32
    }

    /// What comes along a ray: of every surface as much as it is opaque and what is before it lets through.
    fn radiance(&self, mut ray: Ray, k: u32, sequences: &[R2], rng: &mut Pcg32) -> Vec3 {
        let (mut sum, mut left) = (Vec3::ZERO, Vec3::ONE);
        for _ in 0..MAX_SURFACES {
            let Some((there, hit)) = first_front(self.world, ray) else {
                let sky = match self.view {
                    View::Full | View::Direct => self.world.emitters.background(ray.direction),
                    View::Indirect | View::LightMap | View::Elements => Vec3::ZERO,
                };
                return sum + left * sky;
            };
            let passage = self.world.trees.passage(&hit);
            let (opacity, covered) = passage.map_or((1.0, 1.0), |passage| (passage.opacity, passage.covered));
            if covered > 0.0 {
                let (emitted, reflected) = self.surface(&there, &hit, k, sequences, rng);
                sum += left * (covered * emitted + opacity * reflected);
            }
            left *= passage.map_or(Vec3::ZERO, Passage::transmittance);
            if left == Vec3::ZERO {
                break;
            }
            ray.t_min = hit.t.next_up();
        }
        sum
    }

    /// What a surface sends along the ray that met it: what it emits, and what it reflects.
    fn surface(&self, ray: &Ray, hit: &Hit, k: u32, sequences: &[R2], rng: &mut Pcg32) -> (Vec3, Vec3) {
        let Some(surfel) = Surfel::to_look_up(self.world, ray, hit, &mut 0) else { return (Vec3::ZERO, Vec3::ZERO) };
        let mut emission = self.emission[surfel.part as usize];
        if let Some(picture) = self.pictures.get(&surfel.part).filter(|_| emission != Vec3::ZERO) {
            emission *= picture.at(hit);
        }
        match self.view {
            View::Full => {
                let light = self.direct(&surfel, k, sequences, rng) + self.indirect(&surfel, rng);
                (emission, surfel.albedo * light)
            }
            View::Direct => (emission, surfel.albedo * self.direct(&surfel, k, sequences, rng)),
            View::Indirect => (Vec3::ZERO, surfel.albedo * self.indirect(&surfel, rng)),
            View::LightMap | View::Elements => {
                let Some(footprint) = surfel.footprint else { return (Vec3::ZERO, Vec3::ZERO) };
                let light = footprint.interpolate(&self.totals);
                (Vec3::ZERO, self.lines.as_ref().map_or(light, |lines| lines.over(light, self.world, &footprint, ray)))
            }
        }
    }

    /// irradiance / π straight from lights: sample `k` of every light.
    fn direct(&self, surfel: &Surfel, k: u32, sequences: &[R2], rng: &mut Pcg32) -> Vec3 {
        let world = self.world;
        let n = smooth_normal(world, surfel);
        let point = surfel.ray_origin();
        let Emitters { list, skies, .. } = &*world.emitters;
        let mut rays = 0;
        let (each, chosen) = if list.len() <= MAX_LIGHTS { (list.as_slice(), 0) } else { (&[][..], MAX_LIGHTS) };
        let chosen = (0..chosen).map(|_| one_light::<Vec3>(world, point, n, rng, &mut rays)).sum::<Vec3>();
        let mut sum = chosen / MAX_LIGHTS as f32;
        let (of_each, of_skies) = sequences.split_at(sequences.len() - skies.len());
        for (emitter, sequence) in each.iter().zip(of_each).chain(skies.iter().zip(of_skies)) {
            if emitter.strength != Vec3::ZERO && !emitter.is_below_horizon(point, n) {
                sum += visible_light(emitter, &world.trees, point, n, sequence.get(k), &mut rays);
            }
        }
        sum
    }

    /// irradiance / π after at least one bounce: from the map, or by one gather where a back has no elements.
    fn indirect(&self, surfel: &Surfel, rng: &mut Pcg32) -> Vec3 {
        if let Some(footprint) = surfel.footprint {
            return footprint.interpolate(&self.indirect);
        }
        let rough = Rough::default();
        let field = Field { total: &self.totals, indirect: &[], rough: &rough };
        let from = (surfel.ray_origin(), surfel.normal);
        let direction = cosine_hemisphere(surfel.normal, rng.next_2d());
        let (mut light, rays, source) = (Vec3::ZERO, &mut 0, field.source(self.world, None));
        let (_, landed) = source.along(self.world, u32::MAX, from, direction, 0.0, rng, rays, &mut light);
        source.add_landed(landed.as_ref(), rng, rays, &mut light);
        light
    }
}

/// A pixel's random numbers. Camera rays take the first of them, so all pictures of the same options have the same.
pub(super) fn pixel_random(options: &RenderOptions, x: usize, y: usize) -> Pcg32 {
    Pcg32::new(subseed(options.seed, 0x91c), (y * options.width + x) as u64)
}

/// Where in its pixel sample `k` lies.
pub(super) fn place(options: &RenderOptions, within: &R2, k: u32) -> [f32; 2] {
    if options.samples == 1 { [0.5, 0.5] } else { within.get(k) }
}

/// The first surface that a camera sees along a ray, be it seen through: holes and backs that reflect nothing are looked
/// through. The ray keeps its origin, so the hit's distance counts from there.
pub(super) fn first_front(world: &World, mut ray: Ray) -> Option<(Ray, Hit)> {
    for _ in 0..MAX_BACKS {
        let hit = world.trees.closest_place(&ray)?;
        let part = world.space.part(hit.triangle);
        if part.double_sided || hit.normal.dot(ray.direction) <= 0.0 {
            return Some((ray, hit));
        }
        ray.t_min = hit.t.next_up();
    }
    None
}

/// [`first_front`], of surfaces that hide more than half of what is behind them.
pub(super) fn first_seen(world: &World, mut ray: Ray) -> Option<(Ray, Hit)> {
    for _ in 0..MAX_SURFACES {
        let (there, hit) = first_front(world, ray)?;
        if world.trees.passage(&hit).is_none_or(|passage| passage.opacity > 0.5) {
            return Some((there, hit));
        }
        ray.t_min = hit.t.next_up();
    }
    None
}

/// The elements' normals, interpolated: the light map is baked with them, so a sphere looks like one. The geometric
/// normal where there are none, or where they turn away.
pub(super) fn smooth_normal(world: &World, surfel: &Surfel) -> Vec3 {
    let Some(footprint) = surfel.footprint else { return surfel.normal };
    let n = footprint.interpolate(world.normals()).normalize_or(surfel.normal);
    if n.dot(surfel.normal) > 0.1 { n } else { surfel.normal }
}

impl Picture<'_> {
    /// The texel that a ray met, linear RGB.
    fn at(&self, hit: &Hit) -> Vec3 {
        let Placed { surface, placement, .. } = self.placed;
        let corners = Corners::new(&self.object.mesh, surface, hit.triangle - placement.faces.start);
        let texcoord = corners.texcoord(self.texture.texcoord, [1.0 - hit.u - hit.v, hit.u, hit.v]);
        self.texture.texel(texcoord).color
    }
}

/// Per part: the radiance of its light, and the texture that it has.
fn emission_of_parts(world: &World) -> (Vec<Vec3>, BTreeMap<u32, Picture<'_>>) {
    let mut emission = vec![Vec3::ZERO; world.space.parts().len()];
    let mut pictures = BTreeMap::new();
    for light in &world.scene.lights {
        let LightKind::Emissive { object, material } = &light.kind else { continue };
        let Some(index) = world.scene.objects.iter().position(|o| o.name == *object) else { continue };
        let (object, placed) = (&world.scene.objects[index], &*world.placed[index]);
        let part = placed.placement.parts.start + material;
        if let Some(slot) = emission.get_mut(part as usize) {
            *slot = light.strength();
        }
        let look = object.looks.get(*material as usize).and_then(Option::as_deref);
        if let Some(texture) = look.and_then(|look| look.emissive.as_ref()) {
            pictures.insert(part, Picture { texture, object, placed });
        }
    }
    (emission, pictures)
}
