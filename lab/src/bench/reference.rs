//! Truth of known noise: path tracing of elements drawn by area, in two independent halves.
//!
//! With halves `r₁`, `r₂` of a reference and any two estimates `a`, `b` whose own noise is independent of it,
//! `E[(a − r₁)(b − r₂)] = E[(a − t)(b − t)]` for the truth `t`: the reference's noise drops out, and does not have to
//! be estimated and subtracted. With `a = b` that is the squared error of a light map; with `a` and `b` from
//! independent runs it is its squared bias.

use crate::path::{PathTraced, path_trace};
use glam::DVec3;
use rebake_core::{LightMap, Stated, Unobserved, World};

/// Path-traced values of elements drawn with probability proportional to area.
pub struct Reference {
    /// Element slots, ascending; one may occur more than once.
    pub slots: Vec<u32>,
    /// Paths per element, both halves together.
    pub samples: u32,
    halves: [Vec<PathTraced>; 2],
}

/// Mean over the reference's elements, with its standard error.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measured {
    /// Estimate of a mean square; noise can make it negative where it is near zero.
    pub mean: f64,
    /// Standard error, from the scatter over elements.
    pub error: f64,
}

impl Measured {
    /// Root of the mean square, zero where noise hides it.
    pub fn root(&self) -> f64 {
        self.mean.max(0.0).sqrt()
    }

    /// Standard error of [`Measured::root`]; where noise hides the root, what noise could pass for one.
    pub fn root_error(&self) -> f64 {
        let root = self.root();
        if self.mean > self.error { self.error / (2.0 * root) } else { self.error.sqrt() }
    }
}

/// One value of a light map, RGB, as it is measured.
fn value(map: &LightMap, slot: usize, mode: Stated) -> DVec3 {
    match mode {
        Stated::Full => map.total(slot).as_dvec3(),
        Stated::Indirect => map.light.indirect[slot].as_dvec3(),
    }
}

impl Reference {
    /// Draws `count` valid elements by systematic sampling over the area and traces `samples` paths for each.
    pub fn trace(world: &World, count: usize, samples: u32, seed: u64) -> Reference {
        Reference::trace_among(world, count, samples, seed, |_| true)
    }

    /// Draws `count` among the valid elements that `is_wanted`, by systematic sampling over the area, and traces
    /// `samples` paths for each.
    pub fn trace_among(
        world: &World,
        count: usize,
        samples: u32,
        seed: u64,
        is_wanted: impl Fn(usize) -> bool,
    ) -> Reference {
        Reference::trace_at(world, draw(world, count, is_wanted), samples, seed)
    }

    fn trace_at(world: &World, slots: Vec<u32>, samples: u32, seed: u64) -> Reference {
        let mut distinct = slots.clone();
        distinct.dedup();
        let half = samples.div_ceil(2).max(1);
        let trace = |seed| {
            let traced = path_trace(world, &distinct, half, seed, &Unobserved).map(|(v, _)| v).unwrap_or_default();
            slots.iter().map(|s| traced[distinct.partition_point(|d| d < s)]).collect()
        };
        // Far from the seeds of the methods, which count up from the user's.
        let halves = [trace(seed ^ 0x5eed_0001_0000_0000), trace(seed ^ 0x5eed_0002_0000_0000)];
        Reference { slots, samples: 2 * half, halves }
    }

    /// What the light map after an edit would be if the change were exact: `base`, the light map before it in the slots
    /// of the world after it, plus the change of the truth. Elements without a value before keep their whole truth.
    /// Errors against it are an update's own; those of the old map drop out.
    pub fn given(&self, base: &LightMap, before: &World, after: &World, seed: u64) -> Reference {
        let had_value = |slot: usize| {
            let same = before.positions().get(slot) == after.positions().get(slot);
            same && before.areas()[slot] > 0.0 && before.is_valid(slot)
        };
        let kept: Vec<u32> = self.slots.iter().copied().filter(|slot| had_value(*slot as usize)).collect();
        // The same paths, as far as both worlds look alike: much of the noise of the difference cancels.
        let past = Reference::trace_at(before, kept, self.samples, seed);
        let shifted = |half: usize| {
            let mut past = past.slots.iter().zip(&past.halves[half]).peekable();
            let shift = |(&slot, truth): (&u32, &PathTraced)| match past.next_if(|(kept, _)| **kept == slot) {
                Some((_, then)) => PathTraced {
                    direct: truth.direct - then.direct + base.light.direct[slot as usize],
                    indirect: truth.indirect - then.indirect + base.light.indirect[slot as usize],
                    ..*truth
                },
                None => *truth,
            };
            self.slots.iter().zip(&self.halves[half]).map(shift).collect()
        };
        Reference { slots: self.slots.clone(), samples: self.samples, halves: [shifted(0), shifted(1)] }
    }

    fn truth(&self, half: usize, k: usize, mode: Stated) -> DVec3 {
        let v = &self.halves[half][k];
        match mode {
            Stated::Full => (v.direct + v.indirect).as_dvec3(),
            Stated::Indirect => v.indirect.as_dvec3(),
        }
    }

    /// Area-weighted RMSE of the reference itself, the mean of both halves: half of what they differ by.
    pub fn noise(&self, mode: Stated) -> f64 {
        let difference = |k| self.truth(0, k, mode) - self.truth(1, k, mode);
        (0.25 * self.over_elements(|k| mean_square(difference(k), difference(k))).mean).max(0.0).sqrt()
    }

    /// Area-weighted mean over RGB.
    pub fn mean(&self, mode: Stated) -> f64 {
        self.over_elements(|k| (self.truth(0, k, mode) + self.truth(1, k, mode)).element_sum() / 6.0).mean
    }

    /// Standard error of [`Reference::mean`] from its paths: from what the halves differ by, element by element.
    pub fn mean_noise(&self, mode: Stated) -> f64 {
        let difference = |k| (self.truth(0, k, mode) - self.truth(1, k, mode)).element_sum() / 6.0;
        let square = self.over_elements(|k| difference(k) * difference(k)).mean;
        (square / self.slots.len() as f64).sqrt()
    }

    /// Mean of a light map over the reference's elements: area-weighted, over RGB.
    pub fn mean_of(&self, map: &LightMap, mode: Stated) -> f64 {
        self.over_elements(|k| value(map, self.slots[k] as usize, mode).element_sum() / 3.0).mean
    }

    /// Area-weighted mean square error over RGB of a light map.
    pub fn mean_square_error(&self, map: &LightMap, mode: Stated) -> Measured {
        self.product(map, map, mode)
    }

    /// Area-weighted mean square bias of a method, from maps of independent runs: the mean over all pairs of runs of
    /// the product of their errors, to which only what they have in common contributes. None for a single run.
    pub fn mean_square_bias(&self, maps: &[&LightMap], mode: Stated) -> Option<Measured> {
        let n = maps.len();
        (n > 1).then(|| {
            self.over_elements(|k| {
                let (mut a, mut b, mut same) = (DVec3::ZERO, DVec3::ZERO, 0.0);
                for map in maps {
                    let x = value(map, self.slots[k] as usize, mode);
                    let (e, f) = (x - self.truth(0, k, mode), x - self.truth(1, k, mode));
                    a += e;
                    b += f;
                    same += mean_square(e, f);
                }
                (mean_square(a, b) - same) / (n * (n - 1)) as f64
            })
        })
    }

    fn product(&self, a: &LightMap, b: &LightMap, mode: Stated) -> Measured {
        self.over_elements(|k| {
            let slot = self.slots[k] as usize;
            mean_square(value(a, slot, mode) - self.truth(0, k, mode), value(b, slot, mode) - self.truth(1, k, mode))
        })
    }

    /// Mean of `f(k)` over the drawn elements, which is the area-weighted mean over the light map.
    fn over_elements(&self, f: impl Fn(usize) -> f64) -> Measured {
        let n = self.slots.len().max(1) as f64;
        let (mut sum, mut squares) = (0.0, 0.0);
        for x in (0..self.slots.len()).map(f) {
            sum += x;
            squares += x * x;
        }
        let mean = sum / n;
        Measured { mean, error: ((squares / n - mean * mean).max(0.0) / n).sqrt() }
    }
}

fn mean_square(a: DVec3, b: DVec3) -> f64 {
    a.dot(b) / 3.0
}

/// Systematic sampling over the area of all valid elements that are wanted.
fn draw(world: &World, count: usize, is_wanted: impl Fn(usize) -> bool) -> Vec<u32> {
    let areas = world.areas();
    let valid = |i: &usize| areas[*i] > 0.0 && world.is_valid(*i) && is_wanted(*i);
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
    slots
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rebake_core::LightValues;
    use rebake_core::random::Pcg32;

    use super::*;

    /// Maps of known bias and noise against a reference of known noise: both come out, the reference's noise does not.
    #[test]
    fn noise_of_the_reference_drops_out_and_bias_is_told_from_noise() {
        let n = 40_000;
        let mut rng = Pcg32::new(1, 1);
        let mut noisy = |mean: f32, deviation: f32| -> Vec<Vec3> {
            let uniform = (0..n).map(|_| mean + deviation * 12f32.sqrt() * (rng.next_f32() - 0.5));
            uniform.map(Vec3::splat).collect()
        };
        let mut half = || {
            let values = noisy(1.0, 0.05);
            values.into_iter().map(|indirect| PathTraced { indirect, ..PathTraced::default() }).collect()
        };
        let halves = [half(), half()];
        let light = |indirect| LightValues { indirect, ..LightValues::black(n) };
        let maps: Vec<LightMap> = (0..3).map(|_| LightMap::from(light(noisy(1.02, 0.1)))).collect();
        let reference = Reference { slots: (0..n as u32).collect(), samples: 2, halves };
        let error = reference.mean_square_error(&maps[0], Stated::Indirect);
        let bias = reference.mean_square_bias(&maps.iter().collect::<Vec<_>>(), Stated::Indirect).expect("three runs");
        let truth = 0.1f64.powi(2) + 0.02f64.powi(2);
        assert!((error.mean - truth).abs() < 5.0 * error.error, "{error:?} against {truth}");
        assert!((bias.mean - 4e-4).abs() < 5.0 * bias.error, "{bias:?} against 4e-4");
        assert!(bias.error < 6e-5 && error.error < 2e-4, "{bias:?} {error:?}: a test that sees nothing");
        let noise = reference.noise(Stated::Indirect);
        assert!((noise / (0.05 / 2f64.sqrt()) - 1.0).abs() < 0.02, "{noise}");
        assert!(reference.mean_square_bias(&[&maps[0]], Stated::Indirect).is_none());
    }

    /// Where nothing has changed the old map is right, whatever its errors; elements that were inserted count whole.
    #[test]
    fn errors_of_the_old_map_drop_out_of_the_change() {
        use rebake_core::scene::{Material, Mesh, Object, Scene};
        use rebake_core::{Edit, WorldOptions};

        let quad = |name: &str, height: f32, material| {
            Object::new(name, Mesh::quad(Vec3::Y * height, Vec3::Z, Vec3::X), material)
        };
        let (white, lamp) = (Material::diffuse(Vec3::splat(0.5)), Material::emissive(Vec3::ONE).double_sided());
        let scene = Scene::from_objects(vec![quad("floor", 0.0, white), quad("lamp", 1.0, lamp)]);
        let before =
            World::new(scene, &WorldOptions { spacing: Some(0.2), ..WorldOptions::default() }).expect("a floor");
        let asset = Scene::from_objects(vec![quad("far", -3.0, white)]).into();
        let insert = Edit::Insert { asset, name: "far".into(), transform: glam::DMat4::IDENTITY };
        let transition = before.apply(&[insert]).expect("an insert");
        let mut wrong = LightMap::black(before.slots());
        wrong.light.indirect.fill(Vec3::splat(7.0));
        let mut map = transition.carry_over(&wrong);
        let far = transition.after.objects().find(|object| object.name == "far").map(|object| object.first_element);
        let is_far = |slot: usize| slot >= far.expect("the new object") as usize;
        let after = &transition.after;
        let truth = Reference::trace(after, 200, 64, 3);
        let given = truth.given(&map, &before, after, 3);
        // The far floor hides nothing from the other and is hidden by it: the lamp does not reach it.
        map.light.indirect.iter_mut().enumerate().filter(|(slot, _)| is_far(*slot)).for_each(|(_, i)| *i = Vec3::ZERO);
        let square = |truth: &Reference, map: &LightMap| truth.mean_square_error(map, Stated::Indirect).mean;
        assert!(square(&truth, &map) > 1.0, "the old map is wrong");
        let of_far = square(&given, &map);
        assert!(of_far.abs() < 1e-4, "{of_far}");
        map.light.indirect.iter_mut().for_each(|i| *i += 0.5);
        let shifted = square(&given, &map);
        assert!((shifted - 0.25).abs() < 1e-2, "{shifted}");
    }
}
