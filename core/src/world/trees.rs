//! The trees that rays meet: one over all that stands still, small ones beside it for what is being edited, a mask for
//! what is gone. Two levels, a tree of instances over trees of objects, would halve the rate of rays.

use std::sync::Arc;

use glam::Vec3;

use super::openings::{Among, Chance, Hiding, Left, Opaque, Openings, Places};
use crate::bvh::{Bvh, Filter, Hit, Ray, TriangleMask};
use crate::scene::Passage;

/// A set of trees seen as one.
#[derive(Clone)]
pub struct Trees {
    /// Over everything that stood when it was built.
    pub(crate) big: Arc<Bvh>,
    /// Triangles of `big` that are gone or have moved into a small tree.
    pub(crate) removed: Option<Arc<TriangleMask>>,
    /// Objects edited since, by key.
    pub(crate) small: Vec<(u32, Arc<Bvh>)>,
    /// What lets light through; none where everything is opaque.
    pub(crate) openings: Option<Arc<Openings>>,
    /// Counts changes of geometry: trees built for one state do not fit another.
    pub(crate) generation: u64,
}

impl Trees {
    /// One tree.
    pub(crate) fn of(big: Bvh, openings: Option<Arc<Openings>>, generation: u64) -> Trees {
        Trees { big: Arc::new(big), removed: None, small: Vec::new(), openings, generation }
    }

    /// The closest hit in any tree of what light meets there. What lets light through is met by chance: as often as it
    /// is opaque. See [`Trees::first_hit`] for what is left of the light then.
    #[inline(always)]
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        match &self.openings {
            None => self.closest_of_all(ray),
            Some(openings) => self.closest_of(ray, &mut Chance::new(openings, ray)),
        }
    }

    /// [`Trees::closest_hit`]; multiplies `light` by what tinted surfaces before it leave.
    #[inline(always)]
    pub fn first_hit(&self, ray: &Ray, light: &mut Vec3) -> Option<Hit> {
        match &self.openings {
            None => self.closest_of_all(ray),
            Some(openings) => self.first_hit_among(openings, ray, light),
        }
    }

    #[inline(never)]
    fn first_hit_among(&self, openings: &Openings, ray: &Ray, light: &mut Vec3) -> Option<Hit> {
        let mut chance = Chance::new(openings, ray);
        let hit = self.closest_of(ray, &mut chance);
        if chance.is_tinted {
            *light *= self.tint(ray, hit.map_or(f32::INFINITY, |hit| hit.t));
        }
        hit
    }

    /// What tinted surfaces nearer than `t` leave of light along a ray that meets nothing before by chance.
    pub fn tint(&self, ray: &Ray, t: f32) -> Vec3 {
        let Some(openings) = self.openings.as_ref().filter(|openings| openings.is_tinted()) else { return Vec3::ONE };
        let mut left = Left::of_passed(openings);
        self.any_of(&Ray { t_max: t.min(ray.t_max), ..*ray }, &mut left);
        left.light
    }

    /// The closest surface, however little of it is there: holes alone are passed.
    pub(crate) fn closest_place(&self, ray: &Ray) -> Option<Hit> {
        match &self.openings {
            None => self.closest_of_all(ray),
            Some(openings) => self.closest_of(ray, &mut Places(openings)),
        }
    }

    /// What happens to light at a hit; none where the surface is opaque.
    pub(crate) fn passage(&self, hit: &Hit) -> Option<Passage> {
        self.openings.as_ref()?.at(hit.triangle, || [hit.u, hit.v])
    }

    /// The closest hit of what is opaque all over: what closes something to light.
    pub(crate) fn closest_opaque(&self, ray: &Ray) -> Option<Hit> {
        match &self.openings {
            None => self.closest_of_all(ray),
            Some(openings) => self.closest_of(ray, &mut Opaque(openings)),
        }
    }

    /// Whether a place that hides more than half of what is behind it lies between the ray's ends.
    #[inline(always)]
    pub(crate) fn any_hiding(&self, ray: &Ray) -> bool {
        match &self.openings {
            None => self.any_of_all(ray),
            Some(openings) => self.any_of(ray, &mut Hiding(openings)),
        }
    }

    /// What is left of light between the ray's ends, linear RGB, each 0..=1: exact, not by chance.
    #[inline(always)]
    pub fn transmittance(&self, ray: &Ray) -> Vec3 {
        match &self.openings {
            None if self.any_of_all(ray) => Vec3::ZERO,
            None => Vec3::ONE,
            Some(openings) => self.transmittance_among(openings, ray),
        }
    }

    #[inline(never)]
    fn transmittance_among(&self, openings: &Openings, ray: &Ray) -> Vec3 {
        let mut left = Left::of_all(openings);
        if self.any_of(ray, &mut left) { Vec3::ZERO } else { left.light }
    }

    /// What is left of light between two points. `from` has been moved off its surface already; the segment ends
    /// `epsilon` metres short of the other.
    #[inline]
    pub(crate) fn transmittance_between(&self, from: Vec3, direction: Vec3, distance: f32, epsilon: f32) -> Vec3 {
        let t_max = distance - epsilon;
        let ray = Ray { origin: from, direction, t_min: 0.0, t_max };
        if t_max <= 0.0 { Vec3::ONE } else { self.transmittance(&ray) }
    }

    #[inline(always)]
    fn closest_of_all(&self, ray: &Ray) -> Option<Hit> {
        let mut best = self.big.closest_hit(ray, self.removed.as_deref());
        for (_, tree) in &self.small {
            let clipped = Ray { t_max: best.map_or(ray.t_max, |h| h.t), ..*ray };
            if let Some(hit) = tree.closest_hit(&clipped, None) {
                best = Some(hit);
            }
        }
        best
    }

    #[inline(always)]
    fn any_of_all(&self, ray: &Ray) -> bool {
        self.small.iter().any(|(_, tree)| tree.any_hit(ray, None)) || self.big.any_hit(ray, self.removed.as_deref())
    }

    #[inline(never)]
    fn closest_of(&self, ray: &Ray, filter: &mut impl Filter) -> Option<Hit> {
        let mut best = self.big.closest_hit_of(ray, &mut Among { removed: self.removed.as_deref(), filter });
        for (_, tree) in &self.small {
            let clipped = Ray { t_max: best.map_or(ray.t_max, |h| h.t), ..*ray };
            if let Some(hit) = tree.closest_hit_of(&clipped, filter) {
                best = Some(hit);
            }
        }
        best
    }

    #[inline(never)]
    fn any_of(&self, ray: &Ray, filter: &mut impl Filter) -> bool {
        self.small.iter().any(|(_, tree)| tree.any_hit_of(ray, filter))
            || self.big.any_hit_of(ray, &mut Among { removed: self.removed.as_deref(), filter })
    }

    /// Triangles in all trees, those that are gone included.
    pub(crate) fn triangle_count(&self) -> usize {
        self.big.triangle_count() + self.small.iter().map(|(_, tree)| tree.triangle_count()).sum::<usize>()
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        self.big.memory_bytes()
            + self.small.iter().map(|(_, t)| t.memory_bytes()).sum::<usize>()
            + self.openings.as_ref().map_or(0, |openings| openings.memory_bytes())
    }
}

impl std::fmt::Debug for Trees {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Trees")
            .field("big", &self.big.triangle_count())
            .field("small", &self.small.len())
            .field("generation", &self.generation)
            .finish_non_exhaustive()
    }
}
