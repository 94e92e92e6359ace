//! The tail of a bounce series by a small exact solve: elements fall into clusters by place and normal, the
//! cluster-to-cluster transport is counted from the rays that the gathers trace anyway (design, section 3.3).

use std::collections::BTreeMap;

use glam::{DVec3, Vec3};

use super::Subset;
use crate::world::World;

/// Clusters at most. The solve is dense: memory and time grow with the square.
const MAX_CLUSTERS: usize = 400;

/// Stop iterating when the change is this part of the solution.
const TOLERANCE: f64 = 1e-5;

/// Clusters of a subset's representatives.
pub(crate) struct Clusters {
    /// Representatives (indices into `Subset::slots`) cluster by cluster.
    pub members: Vec<Vec<u32>>,
    /// Area that every representative stands for, m².
    pub areas: Vec<f32>,
    /// Cluster of every representative.
    of_representative: Vec<u32>,
    /// Cluster of every element slot; `u32::MAX` in holes.
    pub of_slot: Vec<u32>,
}

impl Clusters {
    /// Cells of one size, doubled until there are few enough.
    pub(crate) fn new(world: &World, subset: &Subset) -> Clusters {
        let (positions, normals) = (world.positions(), world.normals());
        let mut size = 8.0 * world.spacing();
        let cells = loop {
            let mut cells: BTreeMap<(u8, i32, i32, i32), Vec<u32>> = BTreeMap::new();
            for (i, &slot) in subset.slots.iter().enumerate() {
                let n = normals[slot as usize];
                let axis = n.abs().max_position();
                let side = axis as u8 * 2 + u8::from(n[axis] < 0.0);
                let c = (positions[slot as usize] / size).floor().as_ivec3();
                cells.entry((side, c.x, c.y, c.z)).or_default().push(i as u32);
            }
            if cells.len() <= MAX_CLUSTERS {
                break cells;
            }
            size *= 1.3;
        };
        let members: Vec<Vec<u32>> = cells.into_values().collect();
        let mut of_representative = vec![0; subset.slots.len()];
        for (cluster, list) in members.iter().enumerate() {
            list.iter().for_each(|&r| of_representative[r as usize] = cluster as u32);
        }
        let nearest = subset.nearest();
        let of_slot = nearest.iter().map(|&r| of_representative.get(r as usize).copied().unwrap_or(u32::MAX)).collect();
        // Representatives that no element leans on still need a weight.
        let areas = subset.areas().into_iter().map(|a| a.max(1e-12)).collect();
        Clusters { members, areas, of_representative, of_slot }
    }

    pub(crate) fn len(&self) -> usize {
        self.members.len()
    }

    /// Area-weighted mean of a value over each cluster's representatives.
    fn means(&self, values: &[Vec3]) -> Vec<DVec3> {
        let mean = |list: &Vec<u32>| {
            let weight = |r: u32| f64::from(self.areas[r as usize]);
            let sum: DVec3 = list.iter().map(|&r| values[r as usize].as_dvec3() * weight(r)).sum();
            sum / list.iter().map(|&r| weight(r)).sum::<f64>()
        };
        self.members.iter().map(mean).collect()
    }

    /// Σ_{j ≥ 1} Tʲ u over clusters, per representative. `transport[a]` is row a: what a ray from cluster a meets,
    /// as sums of albedo times weight per cluster, over rays of total weight `rays[a]`. Gauss–Seidel: T is a contraction.
    pub(crate) fn tail(&self, transport: &[Vec<Vec3>], rays: &[f64], u: &[Vec3]) -> Vec<Vec3> {
        let n = self.len();
        let u = self.means(u);
        let row = |a: usize| {
            let scale = 1.0 / rays[a].max(f64::MIN_POSITIVE);
            transport[a].iter().map(move |t| t.as_dvec3() * scale)
        };
        let sparse: Vec<Vec<(usize, DVec3)>> =
            (0..n).map(|a| row(a).enumerate().filter(|(_, t)| *t != DVec3::ZERO).collect()).collect();
        let mut tail = vec![DVec3::ZERO; n];
        for _ in 0..2000 {
            let (mut change, mut size) = (0.0f64, 0.0f64);
            for a in 0..n {
                let next: DVec3 = sparse[a].iter().map(|(b, t)| *t * (u[*b] + tail[*b])).sum();
                change += (next - tail[a]).abs().element_sum();
                size += next.abs().element_sum();
                tail[a] = next;
            }
            if change <= TOLERANCE * size {
                break;
            }
        }
        self.of_representative.iter().map(|&c| tail[c as usize].as_vec3()).collect()
    }
}
