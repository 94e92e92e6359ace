//! Truth of known noise: path tracing of a subset of the elements, drawn by area.

use glam::{DVec3, Vec3};
use rebake_core::path::{PathTraced, path_trace};
use rebake_core::{LightMap, Unobserved, World};

/// Path-traced values of elements drawn with probability proportional to area.
pub struct Reference {
    /// Element slots; one may occur more than once.
    pub slots: Vec<u32>,
    /// Their values.
    pub values: Vec<PathTraced>,
    /// Paths per element.
    pub samples: u32,
}

/// Error of a light map against a reference.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Area-weighted RMSE over RGB of direct + indirect, the reference's noise taken out.
    pub rmse: f64,
    /// The same of the indirect part.
    pub rmse_indirect: f64,
    /// Area-weighted mean of the map over that of the reference, direct + indirect.
    pub mean_ratio: f64,
    /// The same of the indirect part.
    pub mean_ratio_indirect: f64,
}

impl Reference {
    /// Draws `count` valid elements by systematic sampling over the area and traces `samples` paths for each.
    pub fn trace(world: &World, count: usize, samples: u32, seed: u64) -> Reference {
        let areas = world.areas();
        let valid = |i: &usize| areas[*i] > 0.0 && world.is_valid(*i);
        let total: f64 = (0..world.slots()).filter(valid).map(|i| f64::from(areas[i])).sum();
        let step = total / count as f64;
        let (mut slots, mut covered, mut next) = (Vec::with_capacity(count), 0.0, 0.37 * step);
        for i in (0..world.slots()).filter(valid) {
            covered += f64::from(areas[i]);
            while next < covered {
                slots.push(i as u32);
                next += step;
            }
        }
        let mut distinct = slots.clone();
        distinct.dedup();
        let traced = path_trace(world, &distinct, samples, seed, &Unobserved).map(|(v, _)| v).unwrap_or_default();
        let values = slots.iter().map(|s| traced[distinct.partition_point(|d| d < s)]).collect();
        Reference { slots, values, samples }
    }

    /// Root of the mean variance of the reference itself.
    pub fn noise(&self) -> f64 {
        self.mean(|v| v.total_variance.as_dvec3().element_sum() / 3.0).sqrt()
    }

    /// The same of the indirect part.
    pub fn noise_indirect(&self) -> f64 {
        self.mean(|v| v.indirect_variance.as_dvec3().element_sum() / 3.0).sqrt()
    }

    /// Area-weighted mean of direct + indirect, over RGB.
    pub fn mean_total(&self) -> f64 {
        self.mean(|v| (v.direct + v.indirect).as_dvec3().element_sum() / 3.0)
    }

    /// Area-weighted mean of the indirect part, over RGB.
    pub fn mean_indirect(&self) -> f64 {
        self.mean(|v| v.indirect.as_dvec3().element_sum() / 3.0)
    }

    fn mean(&self, f: impl Fn(&PathTraced) -> f64) -> f64 {
        self.values.iter().map(f).sum::<f64>() / self.values.len().max(1) as f64
    }

    /// Measures a light map.
    pub fn measure(&self, map: &LightMap) -> Measured {
        self.measure_values(|slot| (map.direct[slot], map.indirect[slot]))
    }

    /// Measures (direct, indirect) per slot.
    pub fn measure_values(&self, value: impl Fn(usize) -> (Vec3, Vec3)) -> Measured {
        let (mut total, mut indirect) = (0.0, 0.0);
        let (mut sum, mut sum_indirect) = (DVec3::ZERO, DVec3::ZERO);
        for (&slot, v) in self.slots.iter().zip(&self.values) {
            let (d, i) = value(slot as usize);
            total += (d + i - v.direct - v.indirect).as_dvec3().length_squared() / 3.0;
            indirect += (i - v.indirect).as_dvec3().length_squared() / 3.0;
            sum += (d + i).as_dvec3();
            sum_indirect += i.as_dvec3();
        }
        let n = self.slots.len().max(1) as f64;
        let mean = |s: DVec3| s.element_sum() / 3.0 / n;
        Measured {
            rmse: (total / n - self.noise().powi(2)).max(0.0).sqrt(),
            rmse_indirect: (indirect / n - self.noise_indirect().powi(2)).max(0.0).sqrt(),
            mean_ratio: mean(sum) / self.mean_total(),
            mean_ratio_indirect: mean(sum_indirect) / self.mean_indirect(),
        }
    }
}
