//! What other methods of computing the light of a world build on: its trees, its lights, which object a triangle is of,
//! and its objects taken apart from each other.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::Vec3;

use super::{Emitter, Placed, Shape, Trees, Validity, World};
use crate::bvh::{BuildQuality, Bvh, Hit, Ray};

impl World {
    /// Its objects with their slots, in the order of `scene.objects`.
    pub fn placed(&self) -> &[Arc<Placed>] {
        &self.placed
    }

    /// What rays meet.
    pub fn trees(&self) -> &Trees {
        &self.trees
    }

    /// Which elements have values of their own.
    pub fn validity(&self) -> &Validity {
        &self.validity
    }

    /// Emitters that are aimed at: all but what comes evenly from outside.
    pub fn emitters(&self) -> &[Emitter] {
        &self.emitters.list
    }

    /// What comes evenly from outside, which rays find that leave the scene.
    pub fn skies(&self) -> &[Emitter] {
        &self.emitters.skies
    }

    /// Radiance that a ray finds which leaves the scene, linear RGB; what is aimed at is left out.
    #[inline]
    pub fn even_sky(&self, direction: Vec3) -> Vec3 {
        self.emitters.sky(direction)
    }

    /// Index of an emitter of [`World::lights`] for a surface with unit normal `n`, and the probability of that choice;
    /// none where no light can come there. `u` is uniform.
    #[inline]
    pub fn choose_light(&self, point: Vec3, n: Vec3, u: f32) -> Option<(usize, f32)> {
        self.emitters.choose(point, n, u)
    }

    /// Probability with which [`World::choose_light`] answers `index`.
    pub fn light_choice_pdf(&self, point: Vec3, n: Vec3, index: usize) -> f32 {
        self.emitters.choice_pdf(point, n, index)
    }

    /// Index of the part (object and material) that a triangle is of which a ray met; below [`World::part_count`].
    #[inline]
    pub fn part_index(&self, triangle: u32) -> u32 {
        self.space.part_index(triangle)
    }

    /// Indices of parts are below this.
    pub fn part_count(&self) -> usize {
        self.space.parts().len()
    }

    /// Keys of the objects that parts belong to, part by part; that of a free one belongs to none.
    pub fn part_objects(&self) -> impl Iterator<Item = u32> {
        self.space.parts().iter().map(|part| part.object)
    }

    /// Diffuse albedos of an object, material by material, linear RGB.
    pub fn albedos_of(&self, placed: &Placed) -> Vec<Vec3> {
        self.space.parts_of(&placed.placement).iter().map(|part| part.albedo).collect()
    }

    /// The objects with these keys alone, and everything without them.
    pub fn apart(&self, keys: &BTreeSet<u32>) -> (Trees, Trees) {
        let (mut corners, mut ids) = (Vec::new(), Vec::new());
        let mut mask = self.trees.removed.as_deref().cloned().unwrap_or_default();
        for placed in self.placed.iter().filter(|placed| keys.contains(&placed.key)) {
            corners.extend(placed.surface.all_corners());
            ids.extend(placed.placement.faces.clone());
            if !self.trees.small.iter().any(|(key, _)| *key == placed.key) {
                placed.placement.faces.clone().for_each(|id| mask.set(id, true));
            }
        }
        let mut without = self.trees.clone();
        without.small.retain(|(key, _)| !keys.contains(key));
        without.removed = Some(Arc::new(mask));
        let alone = Bvh::build(&corners, &ids, BuildQuality::Good);
        (Trees::of(alone, self.trees.openings.clone(), 0), without)
    }
}

impl Emitter {
    /// What a ray finds of a light that it met at triangle `face` of the light's surface: radiance, linear RGB, and the
    /// density per solid angle with which [`Emitter::sample`] finds that place from the ray's origin. None where it
    /// does not shine there, or not to that side.
    #[inline]
    pub fn found(&self, ray: &Ray, hit: &Hit, face: u32) -> Option<(Vec3, f32)> {
        let Shape::Surface { triangles, double_sided, see_through, .. } = &self.shape else { return None };
        let (tint, known) = self.met(hit, face)?;
        if hit.normal.dot(ray.direction) >= 0.0 && !double_sided {
            return None;
        }
        let which = || known.or_else(|| triangles.binary_search_by_key(&face, |triangle| triangle.face).ok());
        // Where light goes through, a ray meets less of the surface by chance than is there to shine.
        let passage = see_through.as_ref().and_then(|see_through| see_through.at(face as usize, [hit.u, hit.v]));
        let there = passage.filter(|passage| passage.opacity > 0.0).map_or(1.0, |p| p.covered / p.opacity);
        Some((self.strength * tint * there, self.pdf(ray, hit, which)))
    }
}

impl Validity {
    /// Gives invalid slots the means of their neighbours.
    pub fn fill_invalid(&self, light: &mut [Vec3]) {
        self.fill(light);
    }
}
