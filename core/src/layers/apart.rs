//! Layers each by itself, as they are kept and published.

use std::borrow::Cow;
use std::ops::AddAssign;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use super::blocks::where_they_matter;
use super::{Layer, LayerHeader, Stack, whole, whole_with};
use crate::accumulate::Accumulator;
use crate::lightmap::{AnyLight, BLOCK_SLOTS, LightBlock, LightMap, LightValues, SparseLight};
use crate::transport::black;
use crate::value::{Scalars, Value};
use crate::world::{Transition, Validity};

/// Slots per task, some blocks: all layers of theirs fit in the cache.
const CHUNK: usize = 4 * BLOCK_SLOTS;

/// Light that is there before an edit, layer by layer.
pub(crate) struct Old<'a> {
    /// In the slots of the world before it.
    parts: Vec<AnyLight<'a>>,
    /// Of the weighted sum of all.
    variance: Cow<'a, [f32]>,
    /// Per slot of the world after it: whether its old value stays.
    keeps: Vec<bool>,
}

impl<'a> Old<'a> {
    /// Layers whose weighted sum has `variance`; for a single one its own is taken.
    pub(crate) fn new(parts: Vec<AnyLight<'a>>, variance: &'a [f32], transition: &Transition) -> Old<'a> {
        let variance = match *parts {
            [AnyLight::Dense(light)] => Cow::Borrowed(&*light.variance),
            [AnyLight::Sparse(light)] => light.variance(),
            _ => Cow::Borrowed(variance),
        };
        Old { parts, variance, keeps: kept(transition) }
    }

    /// Variance of all light together, of a slot whose value stays.
    #[inline]
    pub(crate) fn variance(&self, slot: usize) -> f32 {
        self.variance[slot]
    }

    /// Direct and indirect light, side by side, in the slots of the world before the edit.
    pub(crate) fn total<V: Value>(&self) -> Vec<V> {
        let slots = self.parts.first().map_or(0, AnyLight::len);
        let mut total: Vec<V> = black(slots);
        self.for_blocks(&mut total, |out, block, k| {
            let light = out.iter_mut().zip(block.direct).zip(block.indirect);
            light.for_each(|((out, direct), indirect)| out.add_to_layer(k, *direct + *indirect));
        });
        total
    }

    /// Direct light, indirect light and variances of every layer, side by side per slot, in the slots of the world
    /// after it: zero where no value stays.
    pub(crate) fn stack<V: Value>(&self) -> Stack<V> {
        let slots = || self.keeps.par_iter().enumerate().with_min_len(CHUNK);
        let light = |of: for<'b> fn(&LightBlock<'b>) -> &'b [Vec3]| -> Vec<V> {
            let mut light: Vec<V> = black(self.parts.first().map_or(0, AnyLight::len));
            self.for_blocks(&mut light, |out, block, k| {
                out.iter_mut().zip(of(block)).for_each(|(out, value)| out.add_to_layer(k, *value));
            });
            slots().map(|(slot, keeps)| if *keeps { light[slot] } else { V::default() }).collect()
        };
        let mut layer_variance = vec![V::Scalars::default(); self.parts.first().map_or(0, AnyLight::len)];
        self.for_blocks(&mut layer_variance, |out, block, k| {
            out.iter_mut().zip(block.variance).for_each(|(out, value)| out.add_to_layer(k as usize, *value));
        });
        let of_layers = |(slot, keeps): (usize, &bool)| if *keeps { layer_variance[slot] } else { Default::default() };
        Stack {
            light: LightValues {
                direct: light(|block| block.direct),
                indirect: light(|block| block.indirect),
                variance: slots().map(|(slot, keeps)| if *keeps { self.variance[slot] } else { 0.0 }).collect(),
            },
            layer_variance: slots().map(of_layers).collect(),
        }
    }

    /// Calls `f` with the values of every block, the light of a layer in it, and which layer that is.
    fn for_blocks<T: Send>(&self, values: &mut [T], f: impl Fn(&mut [T], &LightBlock, u32) + Sync) {
        values.par_chunks_mut(BLOCK_SLOTS).enumerate().for_each(|(index, values)| {
            for (part, k) in self.parts.iter().zip(0..) {
                part.block(index).iter().for_each(|block| f(values, block, k));
            }
        });
    }

    /// Adds what stays of a layer's values to those of the slots from `first` on, where a block begins.
    #[inline]
    fn add<T: AddAssign + Copy>(
        &self,
        layer: usize,
        of: for<'b> fn(&LightBlock<'b>) -> &'b [T],
        first: usize,
        to: &mut [T],
    ) {
        for (start, to) in (first..).step_by(BLOCK_SLOTS).zip(to.chunks_mut(BLOCK_SLOTS)) {
            let in_parts = start < self.parts[layer].len();
            let Some(block) = in_parts.then(|| self.parts[layer].block(start / BLOCK_SLOTS)).flatten() else {
                continue;
            };
            let slots = to.iter_mut().zip(of(&block)).zip(&self.keeps[start..]);
            slots.filter(|(_, keeps)| **keeps).for_each(|((to, value), _)| *to += *value);
        }
    }
}

/// New slots keep no value, wherever they are.
fn kept(transition: &Transition) -> Vec<bool> {
    let slots = (0..transition.after.slots()).into_par_iter().with_min_len(CHUNK);
    let mut keeps: Vec<bool> = slots.map(|slot| transition.keeps(slot)).collect();
    transition.new_slots.iter().for_each(|&slot| keeps[slot as usize] = false);
    keeps
}

/// Layers that were computed along the same rays.
pub(crate) struct Apart {
    layers: Values,
    /// Variance of their weighted sum. None for a single one, which is computed at its own scale.
    variance: Option<Vec<f32>>,
}

/// Values of layers, each by itself.
#[derive(Debug, PartialEq)]
enum Values {
    /// In all slots.
    Dense(Vec<LightValues>),
    /// Where they matter.
    Sparse(Vec<SparseLight>),
}

impl Apart {
    /// The mean of all rounds, with its variance, added to old light, which is independent of it. Invalid elements take
    /// their neighbours' values.
    pub(crate) fn of_mean<V: Value>(sum: &Accumulator<V>, old: Option<&Old>, validity: &Validity) -> Apart {
        if V::IS_FEW {
            return Apart::of_stack(&Stack::of_mean(sum, old.map(Old::stack).as_ref(), validity), sum.layers());
        }
        let (mean, scatter) = (sum.mean(), sum.scatter());
        let (layers, slots) = (sum.layers(), mean.len());
        let light = |values: &[V], of: for<'b> fn(&LightBlock<'b>) -> &'b [Vec3]| {
            apart(layers, slots, |k, first, out: &mut [Vec3]| {
                out.iter_mut().zip(&values[first..]).for_each(|(out, value)| *out = value.layer(k));
                old.iter().for_each(|old| old.add(k, of, first, out));
            })
        };
        let (direct, indirect) = (light(&mean.direct, |b| b.direct), light(&mean.indirect, |b| b.indirect));
        let variance = apart(layers, slots, |k, first, out: &mut [f32]| {
            out.iter_mut().zip(first..).for_each(|(out, slot)| *out = scatter.of_layer(k, slot));
            old.iter().for_each(|old| old.add(k, |block| block.variance, first, out));
        });
        let whole = apart(usize::from(layers > 1), slots, |_, first, out: &mut [f32]| {
            out.iter_mut().zip(first..).for_each(|(out, slot)| *out = scatter.of_whole(slot));
            old.iter().for_each(|old| {
                let slots = out.iter_mut().zip(first..).filter(|(_, slot)| old.keeps[*slot]);
                slots.for_each(|(out, slot)| *out += old.variance[slot]);
            });
        });
        let mut apart = Apart::new(direct, indirect, variance, whole);
        apart.fill(validity);
        apart
    }

    /// What lies side by side, of so many layers.
    pub(crate) fn of_stack<V: Value>(stack: &Stack<V>, layers: usize) -> Apart {
        let slots = stack.light.len();
        if V::IS_FEW {
            let layers = Values::Sparse(where_they_matter(stack, layers));
            return Apart { layers, variance: Some(stack.light.variance.clone()) };
        }
        let light = |values: &[V]| {
            apart(layers, slots, |k, first, out: &mut [Vec3]| {
                out.iter_mut().zip(&values[first..]).for_each(|(out, value)| *out = value.layer(k));
            })
        };
        let variance = apart(layers, slots, |k, first, out: &mut [f32]| match layers {
            1 => out.copy_from_slice(&stack.light.variance[first..][..out.len()]),
            _ => {
                let slots = out.iter_mut().zip(&stack.layer_variance[first..]);
                slots.for_each(|(out, variance)| *out = variance.of_layer(k));
            }
        });
        let whole = (layers > 1).then(|| stack.light.variance.clone()).into_iter().collect();
        Apart::new(light(&stack.light.direct), light(&stack.light.indirect), variance, whole)
    }

    fn new(direct: Vec<Vec<Vec3>>, indirect: Vec<Vec<Vec3>>, variance: Vec<Vec<f32>>, whole: Vec<Vec<f32>>) -> Apart {
        let parts = direct.into_iter().zip(indirect).zip(variance);
        let layer = |((direct, indirect), variance)| LightValues { direct, indirect, variance };
        Apart { layers: Values::Dense(parts.map(layer).collect()), variance: whole.into_iter().next() }
    }

    fn fill(&mut self, validity: &Validity) {
        if let Values::Dense(layers) = &mut self.layers {
            layers.par_iter_mut().for_each(|layer| validity.fill_light(layer));
        }
        self.variance.iter_mut().for_each(|variance| validity.fill(variance));
    }

    /// The layers, with their headers.
    pub(crate) fn named(self, headers: &[LayerHeader]) -> Computed {
        let layers: Vec<SparseLight> = match self.layers {
            Values::Dense(layers) => layers.into_par_iter().map(SparseLight::from).collect(),
            Values::Sparse(layers) => layers,
        };
        let named = |(light, header): (SparseLight, &LayerHeader)| {
            Arc::new(Layer { name: header.name.clone(), lights: header.lights.clone(), light })
        };
        Computed { layers: layers.into_iter().zip(headers).map(named).collect(), variance: self.variance }
    }

    /// A single layer as a map without any.
    pub(crate) fn into_map(self) -> LightMap {
        match self.layers {
            Values::Dense(layers) => layers.into_iter().next().unwrap_or_default().into(),
            Values::Sparse(layers) => layers.first().map(SparseLight::to_dense).unwrap_or_default().into(),
        }
    }
}

/// Values of so many layers, each by itself. `write(layer, first, values)` writes those of the slots from `first` on:
/// of all layers at once, since they lie side by side, and read one by one each would bring the others along from
/// memory.
fn apart<T: Default + Clone + Send>(
    layers: usize,
    slots: usize,
    write: impl Fn(usize, usize, &mut [T]) + Sync,
) -> Vec<Vec<T>> {
    let mut out: Vec<Vec<T>> = (0..layers).into_par_iter().map(|_| black(slots)).collect();
    let mut chunks: Vec<_> = out.iter_mut().map(|layer| layer.chunks_mut(CHUNK)).collect();
    let of_chunk = |first| (first, chunks.iter_mut().filter_map(Iterator::next).collect());
    let tasks: Vec<(usize, Vec<&mut [T]>)> = (0..slots).step_by(CHUNK).map(of_chunk).collect();
    tasks.into_par_iter().for_each(|(first, layers)| {
        layers.into_iter().enumerate().for_each(|(k, values)| write(k, first, values));
    });
    out
}

/// Layers with their headers.
pub(crate) struct Computed {
    pub layers: Vec<Arc<Layer>>,
    /// Variance of their weighted sum. None for a single one, which is computed at its own scale.
    pub variance: Option<Vec<f32>>,
}

impl Computed {
    /// The map of these layers alone.
    pub(crate) fn into_map(self, weights: &[Vec3]) -> LightMap {
        match self.variance {
            Some(variance) => whole_with(self.layers, weights, variance),
            None => whole(self.layers, weights, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DMat4;

    use super::*;
    use crate::edit::Edit;
    use crate::random::Pcg32;
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::value::Layered;
    use crate::world::{Stated, World, WorldOptions};

    fn cube(name: &str) -> Object {
        Object::new(name, Mesh::cuboid(Vec3::ZERO, Vec3::ONE), Material::diffuse(Vec3::splat(0.5)))
    }

    /// One cube in place of another, half of it in a third: slots that are unchanged, removed, inserted, and in a
    /// solid.
    fn transition() -> Transition {
        let objects = vec![cube("stays"), cube("goes"), cube("stays, too")];
        let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
        let world = World::new(Scene::from_objects(objects), &options).expect("three cubes");
        let asset = Arc::new(Scene::from_objects(vec![cube("comes")]));
        let transform = DMat4::from_translation(glam::DVec3::new(0.5, 0.5, 0.0));
        let edits =
            [Edit::Remove { objects: vec!["goes".into()] }, Edit::Insert { asset, name: "comes".into(), transform }];
        world.apply(&edits).expect("edits")
    }

    /// Layers that are taken apart at once, and by way of all side by side, are the same, bit for bit.
    fn both_ways_agree<V: Value>(layers: usize, weights: &[Vec3]) {
        let transition = transition();
        let (before, after) = (transition.before.slots(), transition.after.slots());
        assert!(!transition.new_slots.is_empty() && (0..after).any(|slot| !transition.after.is_valid(slot)));
        let mut rng = Pcg32::new(7, layers as u64);
        let mut light = |slots: usize| -> Vec<Vec3> { (0..slots).map(|_| Vec3::splat(rng.next_f32())).collect() };
        let mut sum = Accumulator::<V>::new(weights, Stated::Full);
        for samples in [4, 4, 8] {
            let mut of = |_| {
                let parts: Vec<Vec<Vec3>> = (0..layers).map(|_| light(after)).collect();
                let value = |slot: usize| {
                    parts.iter().zip(0..).fold(V::default(), |mut value, (part, k)| {
                        value.add_to_layer(k, part[slot]);
                        value
                    })
                };
                (0..after).map(value).collect::<Vec<V>>()
            };
            sum.add(samples, &mut LightValues { direct: of(0), indirect: of(1), variance: Vec::new() });
        }
        let layer = |k: usize| {
            let variance = light(before).iter().map(|light| light.x + k as f32).collect();
            LightValues { direct: light(before), indirect: light(before), variance }
        };
        let old: Vec<LightValues> = (0..layers).map(layer).collect();
        let old = Old::new(old.iter().map(AnyLight::Dense).collect(), &old[0].variance, &transition);
        let validity = &transition.after.validity;
        let at_once = Apart::of_mean(&sum, Some(&old), validity);
        let stack = Stack::of_mean(&sum, Some(&old.stack()), validity);
        let by_way = Apart::of_stack(&stack, layers);
        assert!(at_once.layers == by_way.layers && at_once.variance == by_way.variance);
        // What has gone leaves nothing, and new slots have nothing but their own.
        let (slot, mean) = (transition.new_slots[0] as usize, sum.mean());
        let Values::Dense(apart) = &at_once.layers else { panic!("of few layers all are there") };
        assert_eq!(apart[layers - 1].direct[slot], mean.direct[slot].layer(layers - 1));
        let total: Vec<V> = old.total();
        assert_eq!(total.len(), before);
    }

    #[test]
    fn layers_are_apart_as_they_were_side_by_side() {
        both_ways_agree::<Vec3>(1, &[Vec3::ONE]);
        both_ways_agree::<Layered<4>>(3, &[Vec3::ONE, Vec3::splat(0.5), Vec3::X]);
    }
}
