//! How far apart elements are to lie from place to place: by a first look at the light.
//!
//! A coarse layout of one spacing is looked at: direct light at its elements and in the middle of its cells, where it is
//! off what the elements around say by so much as a light map of that spacing would be; and from there a few rays, which
//! tell how far away surfaces are (Ward, Rubinstein and Clear 1988, by their harmonic mean distance) and what they send
//! back. Of a smooth function the error of linear interpolation is as the square of the distance between elements, and
//! for a given number of them the sum of squared errors is least where that distance goes with the inverse cube root of
//! the second derivative: the square root goes too far, and so does a power of the light alone.

use glam::Vec3;
use rayon::prelude::*;

use super::{Emitter, Placed, World, visible_light};
use crate::bvh::Ray;
use crate::random::{Pcg32, R2};
use crate::sampling::cosine_hemisphere;
use crate::space::{Cone, Patch, Sizing, ray_offset};
use crate::surface::triangle_area;

/// Distance between the elements that are looked at, in spacings.
pub(super) const COARSE: f32 = 2.5;

/// Samples of a light that is aimed at, where it has an extent.
const SAMPLES: u32 = 4;

/// Rays around from the middle of a cell.
const RAYS: u32 = 6;

/// Nothing is nearer than this, m.
const NEAREST: f32 = 1e-4;

/// Light after the first bounce, as a multiple of what has bounced once.
const BOUNCES: f32 = 2.0;

/// What is wanted of the light over the distance of surfaces, and everywhere, beside what is measured as off.
const NEAR: f32 = 0.03;
const EVERYWHERE: f32 = 0.01;

/// The least size, in spacings.
const FINEST: f32 = 0.2;

/// How far around the middle of a cell its size is wanted, in edges of the cell.
const REACH: f32 = 0.6;

/// Sizes are chosen until elements are so near to how many there are to be, or that often.
const NEAR_ENOUGH: f64 = 0.01;
const TRIES: usize = 12;

/// Cells that are counted by to choose them, at most.
const COUNTED: usize = 4096;

/// A cell, and what was seen there.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Its middle, scene space.
    at: Vec3,
    /// Of a triangle of its area with equal sides, m.
    edge: f32,
    /// m²
    area: f32,
    /// It is a triangle of the file.
    is_whole: bool,
    /// By how much direct light is off what the corners say, irradiance / π.
    off: f32,
    /// irradiance / π
    light: f32,
    /// Mean inverse distance of what is around, 1/m.
    nearness: f32,
}

/// A cell that is to be looked at.
struct Cell {
    slots: [u32; 3],
    edge: f32,
    area: f32,
    is_whole: bool,
}

fn luminance(light: Vec3) -> f32 {
    light.element_sum() / 3.0
}

/// Looks at light by the same numbers everywhere: what changes from place to place is the light.
struct Eye<'w> {
    world: &'w World,
    /// Samples per emitter.
    samples: Vec<u32>,
    sequence: R2,
}

impl Eye<'_> {
    fn new(world: &World) -> Eye<'_> {
        let lights = world.emitters.list.len();
        let each = (2 * SAMPLES / lights.max(1) as u32).clamp(1, SAMPLES);
        let of = |(index, emitter): (usize, &Emitter)| match () {
            () if emitter.strength == Vec3::ZERO => 0,
            () if emitter.is_delta() => 1,
            () if index < lights => each,
            () => SAMPLES,
        };
        let samples = world.emitters.all().enumerate().map(of).collect();
        Eye { world, samples, sequence: R2::new(&mut Pcg32::new(0x51ed, 0)) }
    }

    /// Direct light at a point with unit normal `n`.
    fn direct(&self, (point, n): (Vec3, Vec3)) -> f32 {
        let of = |(emitter, &samples): (&Emitter, &u32)| {
            if samples == 0 || emitter.is_below_horizon(point, n) {
                return Vec3::ZERO;
            }
            let sample = |k| visible_light(emitter, &self.world.trees, point, n, self.sequence.get(k), &mut 0);
            (0..samples).map(sample).sum::<Vec3>() / samples as f32
        };
        luminance(self.world.emitters.all().zip(&self.samples).map(of).sum())
    }

    /// Light that has bounced once, and the mean inverse distance of what it comes from.
    fn around(&self, (point, n): (Vec3, Vec3), stream: u64) -> (f32, f32) {
        let mut rng = Pcg32::new(0xb0c5, stream);
        let (mut light, mut nearness) = (Vec3::ZERO, 0.0);
        for k in 0..RAYS {
            let direction = cosine_hemisphere(n, self.sequence.get(k));
            let ray = Ray { origin: point, direction, t_min: 0.0, t_max: f32::INFINITY };
            let Some(hit) = self.world.trees.closest_hit(&ray) else { continue };
            nearness += 1.0 / hit.t.max(NEAREST);
            let (part, is_back) = (self.world.space.part(hit.triangle), hit.normal.dot(direction) > 0.0);
            if is_back && !part.double_sided {
                continue;
            }
            let (n, met) = (if is_back { -hit.normal } else { hit.normal }, point + direction * hit.t);
            let from = met + n * ray_offset(met, part.extent.max(hit.t));
            let Some((index, probability)) = self.world.emitters.choose(from, n, rng.next_f32()) else { continue };
            let emitter = &self.world.emitters.list[index];
            let sent = visible_light(emitter, &self.world.trees, from, n, rng.next_2d(), &mut 0);
            light += part.albedo * sent / probability;
        }
        (luminance(light) / RAYS as f32, nearness / RAYS as f32)
    }

    /// Looks at all cells with an edge of more than `least` m: others are never divided.
    fn looks(&self, least: f32) -> Vec<Look> {
        let world = self.world;
        let cells: Vec<Cell> = world.placed.iter().flat_map(|placed| cells_of(placed, least)).collect();
        let mut is_asked = vec![false; world.slots()];
        cells.iter().flat_map(|cell| cell.slots).for_each(|slot| is_asked[slot as usize] = true);
        let direct =
            |(slot, is_asked): (usize, &bool)| if *is_asked { self.direct(world.ray_origin(slot)) } else { 0.0 };
        let direct: Vec<f32> = is_asked.par_iter().enumerate().map(direct).collect();
        let look = |(stream, cell): (usize, &Cell)| {
            let corners = cell.slots.map(|slot| world.ray_origin(slot as usize));
            let at = corners.iter().map(|corner| corner.0).sum::<Vec3>() / 3.0;
            let n = corners.iter().map(|corner| corner.1).sum::<Vec3>().try_normalize().unwrap_or(corners[0].1);
            let (own, (bounced, nearness)) = (self.direct((at, n)), self.around((at, n), stream as u64));
            let told = cell.slots.map(|slot| direct[slot as usize]).iter().sum::<f32>() / 3.0;
            let light = 0.25 * own + 0.75 * told + BOUNCES * bounced;
            let Cell { edge, area, is_whole, .. } = *cell;
            Look { at, edge, area, is_whole, off: (own - told).abs(), light, nearness }
        };
        cells.par_iter().enumerate().map(look).collect()
    }
}

/// The cells of both sides of an object that have an edge of more than `least` m. Those of the same elements are one.
fn cells_of(placed: &Placed, least: f32) -> Vec<Cell> {
    let is_shared = placed.layout.is_shared();
    let edge = |area: f32| (area * (4.0 / 3.0_f32.sqrt())).sqrt();
    let of_patch = |patch: &Patch| {
        let [a, b, c] = patch.corners;
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let area = triangle_area(patch.corners) as f32;
        let is_wanted = area > 0.0 && (longest > least || is_shared);
        is_wanted.then_some((patch.elements, area, patch.cell == patch.face))
    };
    let mut cells = placed.layout.of_cells(&placed.surface, of_patch);
    if is_shared {
        cells.iter_mut().for_each(|(elements, ..)| elements.sort_unstable());
        cells.sort_unstable_by_key(|&(elements, ..)| elements);
        let one = |same: &[([u32; 3], f32, bool)]| {
            let area = same.iter().map(|(_, area, _)| area).sum();
            (same[0].0, area, same.len() == 1 && same[0].2)
        };
        cells = cells.chunk_by(|a, b| a.0 == b.0).map(one).filter(|&(_, area, _)| edge(area) > least).collect();
    }
    let of_side = |first: u32| {
        cells.iter().map(move |&(elements, area, is_whole)| Cell {
            slots: elements.map(|element| first + element),
            edge: edge(area),
            area,
            is_whole,
        })
    };
    placed.sides().flat_map(|side| of_side(side.start)).collect()
}

/// Sizes that are wanted over a scene, but for a factor on all of them.
pub(super) struct Wanted {
    looks: Vec<Look>,
    /// Per look, m.
    sizes: Vec<f32>,
    /// m
    bounds: (f32, f32),
    /// Elements per square of the size.
    per_square: f64,
}

impl Wanted {
    /// What is wanted where elements would lie `spacing` m apart otherwise, and are to lie at most `largest` m apart.
    /// `world` has elements [`COARSE`] spacings apart, of which `fixed` are there whatever the spacing. None where there is
    /// no light.
    pub(super) fn new(world: &World, fixed: usize, spacing: f32, largest: f32) -> Option<Wanted> {
        let bounds = (FINEST * spacing, largest);
        let looks = Eye::new(world).looks(bounds.0);
        let sum = |of: &dyn Fn(&Look) -> f32| looks.iter().map(|look| f64::from(look.area * of(look))).sum::<f64>();
        let area = sum(&|_| 1.0);
        let (light, nearness) = ((sum(&|look| look.light) / area) as f32, (sum(&|look| look.nearness) / area) as f32);
        if !(light > 0.0 && light.is_finite()) {
            return None;
        }
        let size = |look: &Look| {
            let off = look.off / light * (spacing / look.edge).powi(2);
            let near = if nearness > 0.0 { look.light / light * look.nearness / nearness } else { 0.0 };
            spacing / (off + NEAR * near + EVERYWHERE).cbrt()
        };
        let sizes = looks.iter().map(size).collect();
        let coarse = f64::from(COARSE * spacing);
        let beside = world.element_count().saturating_sub(fixed) as f64;
        let per_square = (beside * coarse * coarse / area).max(1.0);
        Some(Wanted { looks, sizes, bounds, per_square })
    }

    /// Elements that sizes make, beside those that are fixed.
    fn count(&self, sizing: &Sizing) -> f64 {
        let step = self.looks.len().div_ceil(COUNTED).max(1);
        let squares = |look: &Look| {
            let size = sizing.at(look.at);
            let there = if look.is_whole { look.edge.powi(-2) } else { 0.0 };
            f64::from(look.area * (size.powi(-2) - there).max(0.0))
        };
        let counted: Vec<f64> = self.looks.par_iter().step_by(step).map(squares).collect();
        self.per_square * step as f64 * counted.iter().sum::<f64>()
    }

    fn with_factor(&self, factor: f32) -> Sizing {
        let cone = |(look, size): (&Look, &f32)| Cone { at: look.at, radius: REACH * look.edge, size: factor * size };
        let cones: Vec<Cone> = self.looks.iter().zip(&self.sizes).map(cone).collect();
        Sizing::new(&cones, self.bounds)
    }

    /// Sizes by which there are so many elements beside those that are fixed, as far as cells tell.
    pub(super) fn sizing(&self, elements: f64) -> Sizing {
        let mut factor = 0.5;
        let mut sizing = self.with_factor(factor);
        for _ in 0..TRIES {
            let ratio = self.count(&sizing) / elements.max(1.0);
            if (ratio - 1.0).abs() < NEAR_ENOUGH {
                break;
            }
            factor *= ratio.sqrt().clamp(0.25, 4.0) as f32;
            sizing = self.with_factor(factor);
        }
        sizing
    }
}

/// Of `coarse` elements that lie [`COARSE`] times as far apart as `even` ones do: those that are there whatever the distance,
/// where all others go with the square of it.
pub(super) fn fixed_of(coarse: usize, even: usize) -> usize {
    let ratio = f64::from(COARSE).powi(2);
    ((ratio * coarse as f64 - even as f64) / (ratio - 1.0)).clamp(0.0, coarse as f64) as usize
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DMat4, DVec3};

    use super::*;
    use crate::edit::{Edit, Restore};
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
    use crate::world::{Spread, WorldOptions};

    /// Two rooms, one beside the other; a lamp near a wall of the first, and none in the second.
    fn scene() -> Scene {
        let grey = || Material::diffuse(Vec3::splat(0.5));
        let room = |x: f32| Mesh::cuboid(Vec3::new(x, 0.0, 0.0), Vec3::new(x + 3.0, 2.5, 3.0)).inside_out();
        let kind = LightKind::Point { position: DVec3::new(0.3, 1.2, 1.5), range: None };
        let chest = Mesh::cuboid(Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.7, 0.8, 1.9));
        let objects = vec![
            Object::new("lit", room(0.0), grey()),
            Object::new("dark", room(4.0), grey()),
            Object::new("chest", chest, grey()),
        ];
        Scene::from_objects(objects).with_light(Light { name: "lamp".into(), kind, color: Vec3::ONE, intensity: 2.0 })
    }

    fn world(scene: Scene, options: WorldOptions, spread: Spread) -> World {
        World::new(scene, &WorldOptions { spread, ..options }).expect("a world")
    }

    fn longest_edge(world: &World) -> f32 {
        let longest = |patch: &Patch| {
            let [a, b, c] = patch.corners;
            Some(a.distance(b).max(b.distance(c)).max(c.distance(a)))
        };
        let of = |placed: &Arc<Placed>| placed.layout.of_cells(&placed.surface, longest);
        world.placed.iter().flat_map(of).fold(0.0, f32::max)
    }

    #[test]
    fn there_are_as_many_elements_as_asked_for_and_more_where_the_light_is() {
        for asked in [3000, 12_000] {
            let options = WorldOptions { elements: Some(asked), ..WorldOptions::default() };
            let world = world(scene(), options, Spread::ByLight);
            let count = world.element_count();
            assert!((0.9..1.1).contains(&(count as f64 / asked as f64)), "{asked}: {count}");
            let [lit, dark] = [0, 1].map(|k| world.placed[k].layout.len());
            assert!(lit > 3 * dark, "{lit} {dark}");
            // The wall that the lamp is near has more of them than the one on the other side.
            let near = |x: f32| {
                let of_room = world.placed[0].placement.element_indices();
                of_room
                    .filter(|&slot| (world.positions()[slot].x + world.scene.origin.x as f32 - x).abs() < 0.01)
                    .count()
            };
            assert!(near(0.0) > 2 * near(3.0), "{} {}", near(0.0), near(3.0));
        }
    }

    #[test]
    fn a_spacing_that_is_asked_for_is_the_largest() {
        let options = WorldOptions { spacing: Some(0.2), ..WorldOptions::default() };
        let [even, within] = [Spread::Uniform, Spread::ByLightWithin].map(|s| world(scene(), options, s));
        let ratio = within.element_count() as f64 / even.element_count() as f64;
        assert!((1.2..1.7).contains(&ratio), "{ratio}");
        assert!(longest_edge(&within) <= 1.2 * longest_edge(&even), "{}", longest_edge(&within));
        // Without light there is nothing to go by.
        let mut dark = scene();
        dark.lights.clear();
        let [even, by_light] = [Spread::Uniform, Spread::ByLight].map(|s| world(dark.clone(), options, s));
        assert_eq!(by_light.element_count(), even.element_count());
    }

    #[test]
    fn elements_are_the_same_on_any_number_of_threads_and_after_undo() {
        let options = WorldOptions { spacing: Some(0.15), ..WorldOptions::default() };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| world(scene(), options, Spread::ByLight))
        };
        let (one, four) = (on(1), on(4));
        let bits = |world: &World, object: usize| -> Vec<[u32; 3]> {
            let slots = world.placed[object].placement.element_indices();
            slots.map(|slot| world.positions()[slot].to_array().map(f32::to_bits)).collect()
        };
        (0..3).for_each(|object| assert_eq!(bits(&one, object), bits(&four, object)));
        let removed = one.apply(&[Edit::Remove { objects: vec!["chest".into()] }]).expect("it is there");
        let undo = Edit::Restore(Arc::new(Restore::between(&removed.after.scene, &one.scene)));
        let back = removed.after.apply(&[undo]).expect("it can come back").after;
        assert_eq!(bits(&back, 2), bits(&one, 2));
        // What is inserted was not there when the light was looked at.
        let asset = Arc::new(Scene::from_objects(vec![scene().objects[2].as_ref().clone()]));
        let insert = |world: &World| {
            let transform = DMat4::from_translation(DVec3::Z * 0.2);
            let edit = Edit::Insert { asset: Arc::clone(&asset), name: "new".into(), transform };
            world.apply(&[edit]).expect("there is room").after
        };
        let even = world(scene(), options, Spread::Uniform);
        assert_eq!(bits(&insert(&one), 3), bits(&insert(&even), 3));
    }
}
