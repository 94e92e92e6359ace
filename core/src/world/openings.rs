//! Rays and what lets light through: which triangle slots do, and what a ray makes of them.
//!
//! Where part of the light goes through a place, a ray that looks for a surface meets it by chance, as often as the
//! place is opaque: the mean is right, and one ray is still one ray. The chance is a function of the ray and the
//! distance alone, so that the same ray has the same fate in every tree and on every machine. Rays that ask how much of
//! a light arrives need no chance: they multiply what all places on the way let through.

use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;

use super::Placed;
use crate::bits::Bits;
use crate::bvh::{Filter, Ray, TriangleMask};
use crate::random::{mix, unit};
use crate::scene::Passage;
use crate::surface::SeeThrough;

/// Triangle slots that let light through, and how. Worlds without any have none of this.
#[derive(Debug)]
pub(crate) struct Openings {
    slots: Bits,
    /// Triangle slots of an object, and what it lets through; ascending.
    objects: Vec<(Range<u32>, Arc<SeeThrough>)>,
    /// Some tint light.
    is_tinted: bool,
}

impl Openings {
    /// Of the objects of a world.
    pub(crate) fn of<'a>(placed: impl IntoIterator<Item = &'a Placed>) -> Option<Arc<Openings>> {
        let object = |p: &'a Placed| Some((p.placement.faces.clone(), Arc::clone(p.see_through.as_ref()?)));
        let mut objects: Vec<_> = placed.into_iter().filter_map(object).collect();
        if objects.is_empty() {
            return None;
        }
        objects.sort_by_key(|(slots, _)| slots.start);
        let slots = objects.iter().flat_map(|(slots, of)| of.triangles().map(|t| slots.start as usize + t)).collect();
        let is_tinted = objects.iter().any(|(_, of)| of.is_tinted());
        Some(Arc::new(Openings { slots, objects, is_tinted }))
    }

    /// Whether some triangle tints light.
    #[inline]
    pub(super) fn is_tinted(&self) -> bool {
        self.is_tinted
    }

    /// Whether a triangle slot lets light through somewhere.
    #[inline]
    pub(super) fn contains(&self, id: u32) -> bool {
        self.slots.contains(id as usize)
    }

    /// What happens to light at a place of a triangle slot; none where it is opaque all over.
    #[inline]
    pub(super) fn at(&self, id: u32, place: impl FnOnce() -> [f32; 2]) -> Option<Passage> {
        if !self.contains(id) {
            return None;
        }
        let object = self.objects.partition_point(|(slots, _)| slots.start <= id).checked_sub(1)?;
        let (slots, see_through) = &self.objects[object];
        see_through.at((id - slots.start) as usize, place())
    }

    /// Bytes held beside what objects hold.
    pub(super) fn memory_bytes(&self) -> usize {
        self.slots.memory_bytes() + self.objects.capacity() * size_of::<(Range<u32>, Arc<SeeThrough>)>()
    }
}

/// Meets what lets light through by chance.
pub(super) struct Chance<'a> {
    openings: &'a Openings,
    ray: &'a Ray,
    /// Of the ray, once it is asked for.
    seed: Option<u64>,
    /// Whether light was tinted by something that the ray passed, be it behind what it meets.
    pub(super) is_tinted: bool,
}

impl<'a> Chance<'a> {
    pub(super) fn new(openings: &'a Openings, ray: &'a Ray) -> Chance<'a> {
        Chance { openings, ray, seed: None, is_tinted: false }
    }

    /// Uniform in [0, 1).
    fn draw(&mut self, t: f32) -> f32 {
        let seed = *self.seed.get_or_insert_with(|| {
            let [x, y, z] = self.ray.origin.to_array().map(|part| u64::from(part.to_bits()));
            let [u, v, w] = self.ray.direction.to_array().map(|part| u64::from(part.to_bits()));
            mix(mix(mix(x << 32 | u) ^ (y << 32 | v)) ^ (z << 32 | w))
        });
        unit(mix(seed ^ u64::from(t.to_bits())))
    }
}

impl Filter for Chance<'_> {
    #[inline]
    fn passes(&mut self, id: u32, t: f32, place: impl FnOnce() -> [f32; 2]) -> bool {
        let Some(Passage { opacity, tint, .. }) = self.openings.at(id, place) else { return false };
        let passes = opacity <= 0.0 || opacity < 1.0 && self.draw(t) >= opacity;
        self.is_tinted |= passes && tint != Vec3::ONE;
        passes
    }
}

/// Meets everything but holes: places that let light through in part are places.
pub(super) struct Places<'a>(pub(super) &'a Openings);

impl Filter for Places<'_> {
    #[inline]
    fn passes(&mut self, id: u32, _: f32, place: impl FnOnce() -> [f32; 2]) -> bool {
        self.0.at(id, place).is_some_and(|passage| passage.covered <= 0.0)
    }
}

/// Passes every triangle that lets light through somewhere.
pub(super) struct Opaque<'a>(pub(super) &'a Openings);

impl Filter for Opaque<'_> {
    #[inline]
    fn passes(&mut self, id: u32, _: f32, _: impl FnOnce() -> [f32; 2]) -> bool {
        self.0.contains(id)
    }
}

/// Passes every place that shows half or more of what is behind it.
pub(super) struct Hiding<'a>(pub(super) &'a Openings);

impl Filter for Hiding<'_> {
    #[inline]
    fn passes(&mut self, id: u32, _: f32, place: impl FnOnce() -> [f32; 2]) -> bool {
        self.0.at(id, place).is_some_and(|passage| passage.opacity <= 0.5)
    }
}

/// What is left of light along a ray.
pub(super) struct Left<'a> {
    openings: &'a Openings,
    /// Product over what was met.
    pub(super) light: Vec3,
    /// Only the tint counts, of what a ray that left by [`Chance`] passed; and nothing ends the ray.
    of_passed: bool,
    met: [f32; 4],
    count: usize,
}

impl<'a> Left<'a> {
    /// Of what all places on the way let through.
    pub(super) fn of_all(openings: &'a Openings) -> Left<'a> {
        Left { openings, light: Vec3::ONE, of_passed: false, met: [f32::NAN; 4], count: 0 }
    }

    /// Of what passes by chance.
    pub(super) fn of_passed(openings: &'a Openings) -> Left<'a> {
        Left { of_passed: true, ..Left::of_all(openings) }
    }

    /// Whether something was met at this distance already: triangles that share an edge are one surface.
    fn is_known(&mut self, t: f32) -> bool {
        let is_known = self.met.iter().any(|met| (met - t).abs() <= 4.0 * f32::EPSILON * t);
        self.met[self.count % self.met.len()] = t;
        self.count += 1;
        is_known
    }
}

impl Filter for Left<'_> {
    #[inline]
    fn passes(&mut self, id: u32, t: f32, place: impl FnOnce() -> [f32; 2]) -> bool {
        let Some(passage) = self.openings.at(id, place) else { return self.of_passed };
        let left = if self.of_passed { passage.tint } else { passage.transmittance() };
        if left == Vec3::ONE {
            return true;
        }
        if !self.is_known(t) {
            self.light *= left;
        }
        self.of_passed || self.light != Vec3::ZERO
    }
}

/// Another filter, of a tree some of whose triangles are gone.
pub(super) struct Among<'a, F> {
    pub(super) removed: Option<&'a TriangleMask>,
    pub(super) filter: &'a mut F,
}

impl<F: Filter> Filter for Among<'_, F> {
    #[inline]
    fn passes(&mut self, id: u32, t: f32, place: impl FnOnce() -> [f32; 2]) -> bool {
        self.removed.is_some_and(|removed| removed.get(id)) || self.filter.passes(id, t, place)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, Vec2, Vec3};

    use super::*;
    use crate::edit::Edit;
    use crate::metrics::Family;
    use crate::random::Pcg32;
    use crate::scene::{AlphaMode, AlphaUse, Look, Material, Mesh, Object, Scene, Texture, TextureUse, Wrap};
    use crate::world::{World, WorldOptions};

    fn world(objects: Vec<Object>) -> World {
        let options = WorldOptions { spacing: Some(0.25), ..WorldOptions::default() };
        World::new(Scene::from_objects(objects), &options).expect("a world")
    }

    fn object(name: &str, mesh: Mesh, look: Option<Look>) -> Object {
        let mut object = Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)));
        object.looks = look.into_iter().map(|look| Some(Arc::new(look))).collect();
        object
    }

    /// Above a floor: a veil of milky glass whose alpha is 0.8.
    fn veil() -> World {
        let factor = Vec3::new(0.2, 0.5, 1.0);
        let look = Look { alpha: 0.8, alpha_mode: AlphaMode::Blend, transmission: 0.5, ..Look::plain(factor) };
        let floor = Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X);
        let above = Mesh::quad(Vec3::Y, Vec3::Z, Vec3::X);
        world(vec![object("floor", floor, None), object("veil", above, Some(look))])
    }

    fn down(rng: &mut Pcg32) -> Ray {
        let [x, z] = rng.next_2d();
        Ray { origin: Vec3::new(x, 2.0, z), direction: Vec3::NEG_Y, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// Met as often as it is opaque; what passes is tinted so that the mean is right.
    #[test]
    fn chance_has_the_right_mean() {
        const RAYS: u32 = 20_000;
        let world = veil();
        let rebuilt = world.rebuilt_trees();
        let (mut met, mut sum, mut rng) = (0, Vec3::ZERO, Pcg32::new(1, 2));
        let expected = Vec3::splat(0.2) + 0.4 * Vec3::new(0.2, 0.5, 1.0);
        for _ in 0..RAYS {
            let ray = down(&mut rng);
            let mut light = Vec3::ONE;
            let hit = world.trees.first_hit(&ray, &mut light).expect("a floor");
            if hit.t < 1.5 {
                (met, light) = (met + 1, Vec3::ZERO);
            }
            sum += light;
            assert_eq!(rebuilt.closest_hit(&ray).map(|hit| hit.t), Some(hit.t), "the same ray, the same fate");
            assert_eq!(world.trees.closest_opaque(&ray).map(|hit| hit.t), Some(2.0));
            assert_eq!(world.trees.closest_place(&ray).map(|hit| hit.t), Some(1.0));
            let left = world.trees.transmittance(&Ray { t_max: 1.9, ..ray });
            assert!(left.distance(expected) < 1e-6, "{left}");
            assert_eq!(world.trees.transmittance(&ray), Vec3::ZERO);
        }
        let n = f64::from(RAYS);
        let mut family = Family::of_known_errors();
        family.compare("met", f64::from(met) - 0.4 * n, (n * 0.4 * 0.6).sqrt());
        for channel in 0..3 {
            let (sum, expected) = (f64::from(sum[channel]), f64::from(expected[channel]));
            // Nothing where it is met, else what has the right mean.
            let variance = expected * expected * (1.0 / 0.6 - 1.0);
            family.compare_within(format!("channel {channel}"), sum - n * expected, (n * variance).sqrt(), 1e-4 * n);
        }
        family.assert_agrees();
    }

    /// Where two triangles of a pane meet, a ray may meet both: it is one surface.
    #[test]
    fn the_diagonal_of_a_pane_counts_once() {
        let world = veil();
        let once = world.trees.transmittance(&Ray { t_max: 1.9, ..down(&mut Pcg32::new(1, 2)) });
        for k in 1..64 {
            let x = k as f32 / 64.0;
            let ray = Ray { origin: Vec3::new(x, 2.0, x), direction: Vec3::NEG_Y, t_min: 0.0, t_max: 1.9 };
            assert_eq!(world.trees.transmittance(&ray), once, "at {x}");
        }
    }

    /// A glass cube is no solid, what stands in it is lit, and its own elements hold light.
    #[test]
    fn glass_closes_nothing() {
        let cube = || Mesh::cuboid(Vec3::splat(-1.0), Vec3::ONE);
        let inner = Mesh::cuboid(Vec3::splat(-0.5), Vec3::splat(0.5));
        let glass = Look { transmission: 1.0, ..Look::plain(Vec3::splat(0.9)) };
        let of = |look: Option<Look>| world(vec![object("cube", cube(), look), object("in it", inner.clone(), None)]);
        let invalid = |world: &World| (0..world.slots()).filter(|&slot| !world.is_valid(slot)).count();
        assert!(invalid(&of(None)) > 0, "an opaque cube hides what is in it");
        assert_eq!(invalid(&of(Some(glass))), 0);
    }

    /// A picture without a place on the mesh counts with its mean.
    #[test]
    fn without_texture_coordinates_the_mean_counts() {
        let texels: Vec<u8> = (0..4).flat_map(|i| [255, 255, 255, if i == 0 { 0 } else { 255 }]).collect();
        let of = |alpha_mode, alpha: AlphaUse| {
            let texture = Arc::new(Texture::new(2, 2, &texels, alpha, 16));
            let linear = glam::Mat2::IDENTITY;
            let base = TextureUse { texture, texcoord: 1, linear, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] };
            let look = Look { alpha_mode, base_color: Some(base), ..Look::plain(Vec3::ONE) };
            let pane = world(vec![object("pane", Mesh::quad(Vec3::Y, Vec3::Z, Vec3::X), Some(look))]);
            pane.trees.transmittance(&down(&mut Pcg32::new(1, 2))).x
        };
        assert!((of(AlphaMode::Blend, AlphaUse::Blend) - 0.25).abs() < 1e-4);
        assert!((of(AlphaMode::Mask(0.5), AlphaUse::Cutoff(0.5)) - 0.25).abs() < 1e-4);
    }

    /// Paint changes what is reflected and nothing of what goes through; and textures count as memory.
    #[test]
    fn paint_leaves_holes() {
        let texels: Vec<u8> = (0..64).flat_map(|i| [255, 0, 0, if i % 2 == 0 { 0 } else { 255 }]).collect();
        let texture = Arc::new(Texture::new(8, 8, &texels, AlphaUse::Cutoff(0.5), 1 << 20));
        let bytes = texture.bytes();
        let linear = glam::Mat2::IDENTITY;
        let base_color = Some(TextureUse { texture, texcoord: 0, linear, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] });
        let look = Look { alpha_mode: AlphaMode::Mask(0.5), base_color, ..Look::plain(Vec3::ONE) };
        let mut mesh = Mesh::quad(Vec3::Y, Vec3::Z, Vec3::X);
        mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.z)).collect();
        let opaque = world(vec![object("leaf", mesh.clone(), None)]);
        let leaf = world(vec![object("leaf", mesh, Some(look))]);
        assert!(leaf.memory_bytes() >= opaque.memory_bytes() + bytes);
        let paint = Edit::Material { object: "leaf".into(), albedo: Vec3::new(0.1, 0.2, 0.3) };
        let painted = leaf.apply(std::slice::from_ref(&paint)).expect("paint").after;
        let albedo = |world: &World| world.objects().next().expect("a leaf").albedo;
        assert!(albedo(&leaf).distance(Vec3::X) < 1e-3, "{}", albedo(&leaf));
        assert!(albedo(&painted).distance(Vec3::new(0.1, 0.2, 0.3)) < 1e-6);
        let moved = Edit::Move { object: "leaf".into(), transform: DMat4::from_translation(glam::DVec3::Y * 0.5) };
        let moved = painted.apply(&[moved]).expect("a move").after;
        let mut rng = Pcg32::new(3, 4);
        let mut holes = 0;
        for _ in 0..1000 {
            let ray = down(&mut rng);
            let left = leaf.trees.transmittance(&ray);
            assert_eq!(left, Vec3::splat(if ((ray.origin.x * 8.0) as u32).is_multiple_of(2) { 1.0 } else { 0.0 }));
            assert_eq!(painted.trees.transmittance(&ray), left);
            assert_eq!(moved.trees.transmittance(&ray), left);
            holes += u32::from(left == Vec3::ONE);
        }
        assert!((400..600).contains(&holes), "{holes}");
        assert!(leaf.is_lit_like(&leaf.clone()) && !leaf.is_lit_like(&opaque));
    }
}
