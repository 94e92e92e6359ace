//! Which of many lights a vertex of a path samples: a tree over them, descended by what each half could bring there
//! (Conty Estevez and Kulla 2018, Importance Sampling of Many Lights with Adaptive Tree Splitting, without splitting).

use glam::Vec3;

use super::{Emitter, Shape};

/// The largest number below 1: rounding must not choose what has no share.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A tree over the lights that have a place.
#[derive(Clone, Debug)]
pub(crate) struct LightTree {
    /// Children come behind their parent, the first right behind it.
    nodes: Vec<Node>,
    /// Per light of the list: the way to it, a bit for each node from the root on, 1 for the second child; none where the
    /// light has no place.
    ways: Vec<Option<u32>>,
    /// Lights without a place.
    far: Vec<u32>,
}

#[derive(Clone, Debug)]
struct Node {
    low: Vec3,
    high: Vec3,
    /// Strength × area of all, or intensity.
    power: f32,
    kind: Kind,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// Index of the second child.
    Inner(u32),
    /// Index in the list.
    Light(u32),
}

/// A light with its place.
struct Placed {
    index: u32,
    low: Vec3,
    high: Vec3,
    power: f32,
}

impl Node {
    /// About the most that it can bring to a surface, without shadows. Zero only where it brings nothing.
    #[inline]
    fn weight_at(&self, point: Vec3, n: Vec3) -> f32 {
        let farthest = Vec3::select(n.cmpgt(Vec3::ZERO), self.high, self.low);
        if self.power <= 0.0 || n.dot(farthest - point) <= 0.0 {
            return 0.0;
        }
        let (center, size) = ((self.low + self.high) * 0.5, self.high - self.low);
        self.power / (center - point).length_squared().max(0.25 * size.length_squared()).max(1e-6)
    }
}

impl LightTree {
    /// Over the lights of a list.
    pub(crate) fn new(list: &[Emitter]) -> LightTree {
        let placed = |(index, emitter): (u32, &Emitter)| {
            let strength = emitter.strength.element_sum() * emitter.importance;
            let (low, high, power) = match &emitter.shape {
                Shape::Surface { low, high, area, brightness, .. } => (*low, *high, area * brightness),
                Shape::Point { position, .. } => (*position, *position, 1.0),
                Shape::Directional { .. } | Shape::Sky(_) | Shape::BrightSky(_) => return None,
            };
            Some(Placed { index, low, high, power: strength * power })
        };
        let mut lights: Vec<Placed> = (0..).zip(list).filter_map(placed).collect();
        let is_far = |index: &u32| lights.binary_search_by_key(index, |light| light.index).is_err();
        let far = (0..list.len() as u32).filter(is_far).collect();
        let mut tree = LightTree { nodes: Vec::new(), ways: vec![None; list.len()], far };
        if !lights.is_empty() {
            tree.build(&mut lights, 0, 0);
        }
        tree
    }

    /// Halves by the middles of the lights along the longest side: a tree of log₂ of their number levels.
    fn build(&mut self, lights: &mut [Placed], way: u32, level: u32) {
        let low = lights.iter().fold(Vec3::INFINITY, |low, light| low.min(light.low));
        let high = lights.iter().fold(Vec3::NEG_INFINITY, |high, light| high.max(light.high));
        let power = lights.iter().map(|light| light.power).sum();
        let own = self.nodes.len();
        if let [light] = lights {
            self.ways[light.index as usize] = Some(way);
            self.nodes.push(Node { low, high, power, kind: Kind::Light(light.index) });
            return;
        }
        self.nodes.push(Node { low, high, power, kind: Kind::Inner(0) });
        let axis = (high - low).max_position();
        let middle = |light: &Placed| (light.low[axis] + light.high[axis], light.index);
        let compare = |a: &Placed, b: &Placed| {
            let (a, b) = (middle(a), middle(b));
            a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
        };
        lights.sort_unstable_by(compare);
        let (first, second) = lights.split_at_mut(lights.len() / 2);
        self.build(first, way, level + 1);
        self.nodes[own].kind = Kind::Inner(self.nodes.len() as u32);
        self.build(second, way | 1 << level, level + 1);
    }

    /// What lights without a place could bring, and the tree.
    fn weights(&self, list: &[Emitter], point: Vec3, n: Vec3) -> (f32, f32) {
        let far = self.far.iter().map(|&index| list[index as usize].weight_at(point, n)).sum();
        (far, self.nodes.first().map_or(0.0, |root| root.weight_at(point, n)))
    }

    /// A light for a surface with unit normal `n`, and its probability; none where none can bring light there. `u` is
    /// uniform.
    pub(crate) fn choose(&self, list: &[Emitter], point: Vec3, n: Vec3, u: f32) -> Option<(usize, f32)> {
        let (far, near) = self.weights(list, point, n);
        let total = far + near;
        let mut left = u * total;
        for &index in &self.far {
            let weight = list[index as usize].weight_at(point, n);
            left -= weight;
            if weight > 0.0 && left < 0.0 {
                return Some((index as usize, weight / total));
            }
        }
        if near <= 0.0 {
            return None;
        }
        let (mut node, mut probability) = (0, near / total);
        let mut u = (left / near).clamp(0.0, BELOW_ONE);
        loop {
            let second = match self.nodes[node].kind {
                Kind::Light(index) => return Some((index as usize, probability)),
                Kind::Inner(second) => second as usize,
            };
            let first = self.share_of_first(node, second, point, n)?;
            let (chosen, share, rest) = if u < first { (node + 1, first, u) } else { (second, 1.0 - first, u - first) };
            (node, probability, u) = (chosen, probability * share, (rest / share).min(BELOW_ONE));
        }
    }

    /// Probability of the first child; none where neither brings light.
    #[inline]
    fn share_of_first(&self, node: usize, second: usize, point: Vec3, n: Vec3) -> Option<f32> {
        let (a, b) = (self.nodes[node + 1].weight_at(point, n), self.nodes[second].weight_at(point, n));
        (a + b > 0.0).then(|| a / (a + b))
    }

    /// Probability with which [`LightTree::choose`] answers `index`.
    pub(crate) fn probability(&self, list: &[Emitter], point: Vec3, n: Vec3, index: usize) -> f32 {
        let (far, near) = self.weights(list, point, n);
        let total = far + near;
        if total <= 0.0 {
            return 0.0;
        }
        let Some(mut way) = self.ways[index] else { return list[index].weight_at(point, n) / total };
        let (mut node, mut probability) = (0, near / total);
        while let Kind::Inner(second) = self.nodes[node].kind {
            let Some(first) = self.share_of_first(node, second as usize, point, n) else { return 0.0 };
            let is_second = way & 1 == 1;
            probability *= if is_second { 1.0 - first } else { first };
            node = if is_second { second as usize } else { node + 1 };
            way >>= 1;
        }
        probability
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::Emitters;
    use super::*;
    use crate::metrics::Family;
    use crate::random::Pcg32;
    use crate::scene::{Light, LightKind};

    /// Point lights all over a hall, and a sun.
    fn lights(count: usize) -> Emitters {
        let mut rng = Pcg32::new(3, count as u64);
        let mut place = || f64::from(rng.next_f32());
        let lamp = |k: usize| {
            let position = DVec3::new(20.0 * place(), 4.0 * place(), 30.0 * place());
            Light {
                name: format!("lamp {k}"),
                kind: LightKind::Point { position, range: None },
                color: Vec3::ONE,
                intensity: if k.is_multiple_of(5) { 0.0 } else { 0.1 + k as f32 % 7.0 },
            }
        };
        let mut lights: Vec<Light> = (0..count).map(lamp).collect();
        lights.push(Light {
            name: "sun".to_owned(),
            kind: LightKind::Directional { direction: Vec3::NEG_Y, angle: 0.0 },
            color: Vec3::ONE,
            intensity: 0.2,
        });
        Emitters::new(&lights, DVec3::ZERO, 20.0, |_, _| None)
    }

    #[test]
    fn lights_are_chosen_as_often_as_is_said_and_none_that_could_bring_light_is_left_out() {
        for count in [1, 2, 33, 100] {
            let emitters = lights(count);
            let (tree, list) = (LightTree::new(&emitters.list), &emitters.list);
            let mut rng = Pcg32::new(1, count as u64);
            for n in [Vec3::Y, Vec3::NEG_Y, Vec3::new(0.6, 0.0, 0.8)] {
                let point = Vec3::new(9.0, 1.5, 14.0);
                let probabilities: Vec<f32> = (0..list.len()).map(|k| tree.probability(list, point, n, k)).collect();
                let sum: f32 = probabilities.iter().sum();
                assert!(sum < 1.0 + 1e-4, "{count} lights, {n}: {sum}");
                for (emitter, probability) in list.iter().zip(&probabilities) {
                    assert!(*probability > 0.0 || emitter.weight_at(point, n) == 0.0, "{}", emitter.name);
                }
                const DRAWS: usize = 40_000;
                let mut drawn = vec![0_usize; list.len()];
                for _ in 0..DRAWS {
                    // Where a box is above the horizon and nothing in it is, none is chosen.
                    let Some((index, probability)) = tree.choose(list, point, n, rng.next_f32()) else { continue };
                    assert!((probability - probabilities[index]).abs() <= 1e-4 * probability, "{index}");
                    drawn[index] += 1;
                }
                let mut family = Family::of_known_errors();
                let none = (DRAWS - drawn.iter().sum::<usize>(), 1.0 - sum);
                let each = drawn.iter().copied().zip(probabilities.iter().copied()).chain([none]);
                for (k, (drawn, p)) in each.enumerate().filter(|(_, (_, p))| *p > 1e-3) {
                    let p = f64::from(p);
                    let deviation = (p * (1.0 - p) / DRAWS as f64).sqrt();
                    family.compare(format!("light {k} of {count}"), drawn as f64 / DRAWS as f64 - p, deviation);
                }
                family.assert_agrees();
            }
        }
    }

    #[test]
    fn where_no_light_can_come_from_none_is_chosen() {
        let emitters = lights(50);
        let tree = LightTree::new(&emitters.list[..50]);
        let below = Vec3::new(5.0, -1.0, 5.0);
        assert_eq!(tree.choose(&emitters.list, below, Vec3::NEG_Y, 0.3), None);
        assert!(tree.choose(&emitters.list, below, Vec3::Y, 0.3).is_some());
    }
}
