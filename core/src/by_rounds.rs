//! A bake whose rounds are done anywhere, in any order: each is a function of the world, a seed and what the rounds go
//! by, and their sum has the bits of [`crate::bake`] with the same rounds.

use std::collections::BTreeMap;
use std::fmt;

use glam::Vec3;

use crate::accumulate::Accumulator;
use crate::bake::{self, Baker, effort_after, seed_of};
use crate::job::{Canceled, Observer};
use crate::layers::{Apart, Header, groups_of, weights_of, weights_within};
use crate::lightmap::{LightMap, LightValues};
use crate::random::subseed;
use crate::rounds::{Estimator, Round};
use crate::transport::{Effort, Work};
use crate::value::{Value, with_layers};
use crate::world::World;

pub use crate::estimate::{Estimate, EstimateError};

/// So many rounds wait for one that is missing.
const MOST_EARLY: u32 = 64;

/// What all rounds of a bake share: the same for the same world and seed, wherever it is made.
pub struct RoundBaker {
    baker: Baker,
    seed: u64,
    layers: usize,
    first: bake::Prior,
}

/// What a round is told.
#[derive(Clone, Debug)]
pub struct RoundSpec {
    /// Which round of the bake it is; its seed follows from that.
    pub index: u32,
    /// Samples per element, at least one.
    pub samples: u32,
    /// Where samples are of most use, as the rounds before tell it.
    pub prior: Prior,
}

/// Where samples are of most use. The mean of all rounds is right whatever it says. It is not sent: whoever has added the
/// same rounds up makes the same ([`Collector::prior`]).
#[derive(Clone, Debug, Default)]
pub struct Prior(Effort);

impl RoundBaker {
    /// For the rounds of `bake(world, …, seed, …)`. Traces some rays, whose light tells rounds where to look.
    ///
    /// # Errors
    /// [`Canceled`] where the observer says so.
    pub fn new(world: &World, seed: u64, observer: &dyn Observer) -> Result<RoundBaker, Canceled> {
        let Lit { world, headers, weights } = Lit::new(world);
        let baker = Baker::new(&world, weights_within(&weights), seed_of(seed));
        let first = with_layers!(headers.len(), first_prior(&baker, &Work::new(observer)))?;
        Ok(RoundBaker { baker, seed: seed_of(seed), layers: weights.len(), first })
    }

    /// One independent estimate of all light.
    ///
    /// # Errors
    /// [`Canceled`] where the observer says so.
    pub fn round(&self, spec: &RoundSpec, observer: &dyn Observer) -> Result<Estimate, Canceled> {
        with_layers!(self.layers, one_round(self, spec, &Work::new(observer)))
    }
}

fn first_prior<V: Value>(baker: &Baker, work: &Work) -> Result<bake::Prior, Canceled> {
    Ok(baker.first_prior::<V>(work)?.0)
}

fn one_round<V: Value>(rounds: &RoundBaker, spec: &RoundSpec, work: &Work) -> Result<Estimate, Canceled> {
    let prior = rounds.first.with_effort(spec.prior.0.clone());
    let (samples, seed) = (spec.samples.max(1), subseed(rounds.seed, u64::from(spec.index)));
    let mut light = LightValues::<V>::default();
    let round = Round { samples, earlier: 0, seed, begin: &|_, _| {} };
    rounds.baker.rounds(work).round(&prior, &round, &mut light)?;
    Ok(Estimate::new(spec.index, samples, rounds.layers, &light))
}

/// A world as its layers are baked.
struct Lit {
    world: World,
    /// None where all light is one.
    headers: Vec<Header>,
    weights: Vec<Vec3>,
}

impl Lit {
    fn new(world: &World) -> Lit {
        let headers = groups_of(&world.scene);
        if headers.is_empty() {
            return Lit { world: world.clone(), headers, weights: vec![Vec3::ONE] };
        }
        let weights = weights_of(&headers, &world.scene);
        Lit { world: world.only_layers(&headers, &weights), headers, weights }
    }
}

/// Adds the rounds of a bake up in the order of their seeds, whatever order they come in: the bits of the sum do not
/// depend on it.
pub struct Collector {
    sum: Box<dyn Sum>,
    /// Slots and layers.
    shape: (u64, u64),
    /// The first round that has not come.
    next: u32,
    /// Rounds behind it.
    early: BTreeMap<u32, Estimate>,
    /// Samples per element of all that have come.
    samples: u32,
}

impl Collector {
    /// No round yet of a bake of this world.
    pub fn new(world: &World) -> Collector {
        let lit = Lit::new(world);
        let shape = (world.slots() as u64, lit.weights.len() as u64);
        let sum = with_layers!(lit.headers.len(), summed(lit));
        Collector { sum, shape, next: 0, early: BTreeMap::new(), samples: 0 }
    }

    /// Adds a round, at once or as soon as those before it have come. One that has come before counts once.
    ///
    /// # Errors
    /// Where it is of another world, has no samples or more than can be counted, or where too many before it are missing;
    /// the sum stays as it was.
    pub fn add(&mut self, estimate: Estimate) -> Result<(), EstimateError> {
        let Estimate { index, samples, .. } = estimate;
        if estimate.shape() != self.shape {
            return Err(EstimateError::Shape { expected: self.shape, found: estimate.shape() });
        }
        if index < self.next || self.early.contains_key(&index) {
            return Ok(());
        }
        if index - self.next > MOST_EARLY {
            return Err(EstimateError::Early { index, next: self.next });
        }
        let all = self.samples.checked_add(samples).filter(|_| samples > 0);
        self.samples = all.ok_or(EstimateError::Samples(samples))?;
        self.early.insert(index, estimate);
        while let Some(estimate) = self.early.remove(&self.next) {
            self.sum.add(&estimate);
            self.next += 1;
        }
        Ok(())
    }

    /// Rounds that are in the sum: all before the first that is missing.
    pub fn rounds(&self) -> u32 {
        self.next
    }

    /// What the round after those in the sum goes by.
    pub fn prior(&self) -> Prior {
        Prior(self.sum.effort())
    }

    /// The light map of the rounds in the sum, with their error; none where there is no round.
    pub fn map(&self) -> Option<LightMap> {
        (self.next > 0).then(|| self.sum.map())
    }
}

impl fmt::Debug for RoundBaker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RoundBaker").field("seed", &self.seed).field("layers", &self.layers).finish_non_exhaustive()
    }
}

impl fmt::Debug for Collector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let early: Vec<&u32> = self.early.keys().collect();
        f.debug_struct("Collector").field("rounds", &self.next).field("early", &early).finish_non_exhaustive()
    }
}

/// A sum of rounds, whatever number of layers they have.
trait Sum: Send {
    fn add(&mut self, estimate: &Estimate);
    fn effort(&self) -> Effort;
    fn map(&self) -> LightMap;
}

struct Summed<V> {
    lit: Lit,
    rounds: Accumulator<V>,
}

fn summed<V: Value>(lit: Lit) -> Box<dyn Sum> {
    let rounds = Accumulator::<V>::new(weights_within(&lit.weights), lit.world.stated());
    Box::new(Summed { lit, rounds })
}

impl<V: Value> Sum for Summed<V> {
    fn add(&mut self, estimate: &Estimate) {
        self.rounds.add(estimate.samples, &mut estimate.light());
        self.rounds.ask_neighbours(&self.lit.world);
    }

    fn effort(&self) -> Effort {
        effort_after(&self.lit.world, &self.rounds)
    }

    fn map(&self) -> LightMap {
        let Lit { world, headers, weights } = &self.lit;
        let layers = Apart::of_mean(&self.rounds, None, &world.validity);
        if headers.is_empty() { layers.into_map() } else { layers.named(headers).into_map(weights) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::{Budget, Unobserved};
    use crate::scene::{Material, Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// A closed room with a lamp and a ball of light, which have layers of their own where they are grouped.
    fn room(groups: &[(&str, &str)]) -> World {
        let white = Material::diffuse(Vec3::splat(0.6));
        let lamp = |name: &str, corner: Vec3, light: Vec3| {
            let mesh = Mesh::quad(corner, Vec3::X * 0.4, Vec3::Z * 0.4);
            Object::new(name, mesh, Material::emissive(light).double_sided())
        };
        let mut scene = Scene::from_objects(vec![
            Object::new("room", Mesh::cuboid(Vec3::ZERO, Vec3::splat(2.0)).inside_out(), white),
            lamp("lamp", Vec3::new(0.8, 1.9, 0.8), Vec3::splat(8.0)),
            lamp("screen", Vec3::new(0.2, 0.6, 1.2), Vec3::new(0.1, 0.4, 2.0)),
        ]);
        let light = |object: &str| {
            let name = scene.lights.iter().map(|light| &light.name).find(|name| name.starts_with(object));
            name.cloned().expect("a light on every lamp")
        };
        scene.groups = groups.iter().map(|(object, group)| (light(object), (*group).to_owned())).collect();
        World::new(scene, &WorldOptions { spacing: Some(0.2), ..WorldOptions::default() }).expect("a room")
    }

    /// The rounds of a bake of 16 samples, each done where nothing is known but the world, the seed and bytes.
    fn rounds(world: &World, seed: u64) -> Vec<Vec<u8>> {
        let mut done: Vec<Vec<u8>> = Vec::new();
        for (index, samples) in (0..).zip([4, 4, 8]) {
            let mut known = Collector::new(world);
            done.iter().for_each(|bytes| known.add(read(bytes, world)).expect("a round of this world"));
            let spec = RoundSpec { index, samples, prior: known.prior() };
            let baker = RoundBaker::new(world, seed, &Unobserved).expect("nobody cancels");
            done.push(baker.round(&spec, &Unobserved).expect("nobody cancels").to_bytes());
        }
        done
    }

    fn read(bytes: &[u8], world: &World) -> Estimate {
        Estimate::from_bytes(bytes, world.slots()).expect("an estimate")
    }

    #[test]
    fn rounds_that_come_in_any_order_are_the_bake() {
        for groups in [&[][..], &[("screen", "a")], &[("lamp", "a"), ("screen", "a")]] {
            let world = room(groups);
            let budget = Budget { samples_per_element: 16, target_rmse: None };
            let baked = crate::bake(&world, &budget, 5, &Unobserved).expect("nobody cancels");
            let rounds = rounds(&world, 5);
            for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
                let mut collector = Collector::new(&world);
                assert!(collector.map().is_none());
                for round in order {
                    // A message may come twice.
                    (0..2).for_each(|_| collector.add(read(&rounds[round], &world)).expect("a round of this world"));
                    assert_eq!(collector.map().is_some(), collector.rounds() > 0);
                }
                assert_eq!((collector.rounds(), collector.samples), (3, 16));
                assert!(collector.map().is_some_and(|map| map == *baked), "{groups:?} {order:?}");
            }
        }
    }

    #[test]
    fn what_does_not_belong_to_the_sum_is_refused() {
        let (world, grouped) = (room(&[]), room(&[("screen", "a")]));
        let spec = RoundSpec { index: 0, samples: 1, prior: Prior::default() };
        let baker = RoundBaker::new(&world, 1, &Unobserved).expect("nobody cancels");
        let estimate = baker.round(&spec, &Unobserved).expect("nobody cancels");
        let other = |index, samples| {
            let mut other = estimate.clone();
            (other.index, other.samples) = (index, samples);
            other
        };
        let shape = |layers| (world.slots() as u64, layers);
        let refused = Collector::new(&grouped).add(estimate.clone());
        assert_eq!(refused, Err(EstimateError::Shape { expected: shape(2), found: shape(1) }));
        let mut collector = Collector::new(&world);
        let index = MOST_EARLY + 1;
        let refused = collector.add(other(index, 1));
        assert_eq!(refused, Err(EstimateError::Early { index, next: 0 }));
        collector.add(other(1, 2)).expect("a round that is early");
        let refused = collector.add(other(0, u32::MAX - 1));
        assert_eq!(refused, Err(EstimateError::Samples(u32::MAX - 1)));
        assert_eq!((collector.rounds(), collector.samples), (0, 2));
        collector.add(estimate).expect("the first round");
        assert_eq!(collector.rounds(), 2);
    }
}
