//! The trees that rays meet: one over all that stands still, small ones beside it for what is being edited, a mask for
//! what is gone. Two levels, a tree of instances over trees of objects, would halve the rate of rays.

use std::sync::Arc;

use glam::Vec3;

use crate::bvh::{Bvh, Hit, Ray, TriangleMask};

/// A set of trees seen as one.
#[derive(Clone)]
pub struct Trees {
    /// Over everything that stood when it was built.
    pub(crate) big: Arc<Bvh>,
    /// Triangles of `big` that are gone or have moved into a small tree.
    pub(crate) gone: Option<Arc<TriangleMask>>,
    /// Objects edited since, by key.
    pub(crate) small: Vec<(u32, Arc<Bvh>)>,
    /// Counts changes of geometry: trees built for one state do not fit another.
    pub(crate) generation: u64,
}

impl Trees {
    /// The closest hit in any tree.
    #[inline]
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        let mut best = self.big.closest_hit(ray, self.gone.as_deref());
        for (_, tree) in &self.small {
            let clipped = Ray { t_max: best.map_or(ray.t_max, |h| h.t), ..*ray };
            if let Some(hit) = tree.closest_hit(&clipped, None) {
                best = Some(hit);
            }
        }
        best
    }

    /// Whether anything lies between the ray's ends.
    #[inline]
    pub fn any_hit(&self, ray: &Ray) -> bool {
        self.small.iter().any(|(_, tree)| tree.any_hit(ray, None)) || self.big.any_hit(ray, self.gone.as_deref())
    }

    /// Whether the segment between two points is free. `from` has been moved off its surface already; the segment ends
    /// `epsilon` metres short of `to`.
    #[inline]
    pub(crate) fn visible(&self, from: Vec3, direction: Vec3, distance: f32, epsilon: f32) -> bool {
        let t_max = distance - epsilon;
        t_max <= 0.0 || !self.any_hit(&Ray { origin: from, direction, t_min: 0.0, t_max })
    }

    /// Bytes held.
    pub fn memory_bytes(&self) -> usize {
        self.big.memory_bytes() + self.small.iter().map(|(_, t)| t.memory_bytes()).sum::<usize>()
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
