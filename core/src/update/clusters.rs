//! What has changed, as it is seen from afar: some clusters of places.

use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use crate::world::World;

/// Clusters of the change.
const CLUSTERS: usize = 32;

/// Places at most that clusters are made of, of those that have changed most and of the others.
const PLACES: usize = 1 << 12;

/// An element whose light has changed, or that stands for several of them.
#[derive(Clone, Copy)]
pub(super) struct ChangedPoint {
    pub position: Vec3,
    /// m².
    pub area: f32,
    /// Amount of the change, mean over RGB.
    pub light: f32,
}

/// The places that have changed most, and the others; where there are many, some stand for all.
pub(super) fn places(world: &World, amounts: &[f32]) -> Vec<ChangedPoint> {
    let (positions, areas) = (world.positions(), world.areas());
    let square = |slot: usize| f64::from(amounts[slot] * amounts[slot]);
    let limit = world.area_mean(0..amounts.len(), square);
    let (most, others): (Vec<usize>, Vec<usize>) =
        (0..amounts.len()).into_par_iter().filter(|&slot| areas[slot] > 0.0).partition(|&slot| square(slot) > limit);
    let thinned = |slots: &[usize]| -> Vec<ChangedPoint> {
        let step = slots.len().div_ceil(PLACES).max(1);
        let place = |&slot: &usize| {
            let area = areas[slot] * step as f32;
            ChangedPoint { position: positions[slot], area, light: amounts[slot] }
        };
        slots.iter().step_by(step).map(place).collect()
    };
    [thinned(&most), thinned(&others)].concat()
}

/// Places seen as one from afar.
pub(super) struct Cluster {
    middle: Vec3,
    /// Squared, m².
    radius2: f32,
    /// Σ A L and Σ A L², over π.
    pub light: f32,
    pub squares: f32,
}

impl Cluster {
    fn of(places: &[ChangedPoint]) -> Cluster {
        let power = |p: &ChangedPoint| p.light * p.light * p.area;
        let squares: f32 = places.iter().map(power).sum();
        let middle = match squares > 0.0 {
            true => places.iter().map(|p| p.position * power(p)).sum::<Vec3>() / squares,
            false => places.first().map_or(Vec3::ZERO, |p| p.position),
        };
        let spread: f32 = places.iter().map(|p| p.position.distance_squared(middle) * power(p)).sum();
        let radius2 = if squares > 0.0 { spread / squares } else { 0.0 };
        let light: f32 = places.iter().map(|p| p.light * p.area).sum();
        // Never smaller than its own area.
        let area: f32 = places.iter().map(|p| p.area).sum();
        Cluster { middle, radius2: radius2.max(area / PI), light: light / PI, squares: squares / PI }
    }

    /// Cosine over squared distance.
    pub(super) fn seen_from(&self, point: Vec3, normal: Vec3) -> f32 {
        let w = self.middle - point;
        let distance2 = w.length_squared() + self.radius2;
        let distance = distance2.sqrt();
        ((normal.dot(w) + self.radius2.sqrt()) / distance).clamp(0.0, 1.0) / distance2
    }
}

/// Halves what is most spread out, as often as there are clusters.
pub(super) fn clusters(places: Vec<ChangedPoint>) -> Vec<Cluster> {
    let mut parts: Vec<(Vec<ChangedPoint>, Cluster)> = Vec::with_capacity(CLUSTERS);
    let with_cluster = |places: Vec<ChangedPoint>| {
        let cluster = Cluster::of(&places);
        (places, cluster)
    };
    parts.push(with_cluster(places));
    while parts.len() < CLUSTERS {
        let spread = |c: &Cluster| c.squares * c.radius2;
        let Some(widest) = (0..parts.len()).max_by(|&a, &b| spread(&parts[a].1).total_cmp(&spread(&parts[b].1))) else {
            break;
        };
        let (places, cluster) = parts.swap_remove(widest);
        let (low, high) = places
            .iter()
            .filter(|p| p.light > 0.0)
            .fold((cluster.middle, cluster.middle), |(l, h), p| (l.min(p.position), h.max(p.position)));
        let size = high - low;
        let axis = (0..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best });
        let (below, above): (Vec<ChangedPoint>, Vec<ChangedPoint>) =
            places.into_iter().partition(|p| p.position[axis] < cluster.middle[axis]);
        if below.is_empty() || above.is_empty() {
            parts.push(with_cluster([below, above].concat()));
            break;
        }
        parts.extend([with_cluster(below), with_cluster(above)]);
    }
    parts.into_iter().map(|(_, cluster)| cluster).filter(|cluster| cluster.light > 0.0).collect()
}
