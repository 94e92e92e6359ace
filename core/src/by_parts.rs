//! Parts of a bake's rounds that are done elsewhere: each is a function of the world and of what the bake offers
//! ([`crate::Observer::offer`]), with the bits that the bake itself would have given.

use std::fmt;

use glam::Vec3;

use crate::bake::{self, Baker};
use crate::estimate::Estimate;
use crate::job::{Canceled, Observer};
use crate::layers::{weights_of, weights_within};
use crate::lightmap::{LayerHeader, LightValues, MAX_LAYERS};
use crate::random::subseed;
use crate::rounds::{Estimator, Round};
use crate::solve::Solvable;
use crate::transport::{Effort, Work};
use crate::value::with_layers;
use crate::world::World;

/// What all rounds of a bake share: the same for the same world, layers and seed, wherever it is made.
pub struct PartBaker {
    baker: Baker,
    seed: u64,
    layers: usize,
    prior: bake::Prior,
}

/// Why there is no estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PartError {
    /// The observer ended it.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// What it was to go by is of another world, or nonsense.
    #[error("these samples of elements are not for a world of {slots} slots")]
    Effort {
        /// Of the world.
        slots: usize,
    },
    /// No light map has so many layers.
    #[error("{0} layers are more than a light map has")]
    Layers(usize),
}

impl PartBaker {
    /// For the parts of a bake of `world` that offers this seed and these layers. Traces some rays, whose light tells
    /// rounds where to look.
    ///
    /// # Errors
    /// [`PartError::Canceled`] where the observer says so, [`PartError::Layers`] where there are too many.
    pub fn new(
        world: &World,
        layers: &[LayerHeader],
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<PartBaker, PartError> {
        if layers.len() > MAX_LAYERS {
            return Err(PartError::Layers(layers.len()));
        }
        let weights = if layers.is_empty() { vec![Vec3::ONE] } else { weights_of(layers, &world.scene) };
        let baker = match layers.is_empty() {
            true => Baker::new(world, &weights, seed),
            false => Baker::new(&world.only_layers(layers, &weights), weights_within(&weights), seed),
        };
        let prior = with_layers!(layers.len(), first_prior(&baker, &Work::new(observer)))?;
        Ok(PartBaker { baker, seed, layers: weights.len(), prior })
    }

    /// One part, with the offer's `effort`.
    ///
    /// # Errors
    /// [`PartError::Canceled`] where the observer says so, [`PartError::Effort`] where the effort is that of no world of
    /// this size.
    pub fn part(&self, spec: PartSpec, effort: &[u8], observer: &dyn Observer) -> Result<Estimate, PartError> {
        let slots = self.baker.slots();
        let effort = Effort::of_factors(effort, slots).ok_or(PartError::Effort { slots })?;
        let prior = self.prior.with_effort(effort);
        Ok(with_layers!(self.layers, one_part(self, spec, &prior, &Work::new(observer)))?)
    }
}

/// Which part of which round.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PartSpec {
    /// The round of the bake.
    pub round: u32,
    /// The part of the round.
    pub part: u32,
    /// Its samples per element, at least one.
    pub samples: u32,
}

fn first_prior<V: Solvable>(baker: &Baker, work: &Work) -> Result<bake::Prior, Canceled> {
    Ok(baker.first_prior::<V>(work)?.0)
}

fn one_part<V: Solvable>(
    parts: &PartBaker,
    spec: PartSpec,
    prior: &bake::Prior,
    work: &Work,
) -> Result<Estimate, Canceled> {
    let PartSpec { round, part, samples } = spec;
    let seed = subseed(parts.seed, round.into());
    let mut light = LightValues::<V>::default();
    let given = Round { samples: samples.max(1), earlier: 0, seed, part, begin: &|_, _| {} };
    parts.baker.rounds(work).round(prior, &given, &mut light)?;
    Ok(Estimate::new((round, part), given.samples, parts.layers, &light))
}

impl fmt::Debug for PartBaker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PartBaker").field("seed", &self.seed).field("layers", &self.layers).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::job::{Budget, NextPart, Offer, Unobserved};
    use crate::scene::{Light, LightKind, Material, Mesh, Object, Scene};
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

    /// The room with more lamps, each of which has a layer of its own.
    fn room_of_lamps(count: usize) -> World {
        let room = room(&[]);
        let mut scene = (*room.scene).clone();
        for k in 0..count {
            let position = glam::DVec3::new(0.2 + 0.08 * k as f64, 1.4, 0.3 + 0.3 * (k % 5) as f64);
            let kind = LightKind::Point { position, range: None };
            scene.lights.push(Light { name: format!("lamp {k}"), kind, color: Vec3::ONE, intensity: 0.1 });
            scene.groups.insert(format!("lamp {k}"), format!("group {k}"));
        }
        World::new(scene, &WorldOptions { spacing: Some(0.2), ..WorldOptions::default() }).expect("a room")
    }

    /// Where parts of rounds are done for a bake.
    #[derive(Clone, Copy, Debug)]
    enum Where {
        Here,
        /// One here, the next elsewhere; what is missing last comes first.
        Both,
        /// None here; each comes twice.
        Elsewhere,
        /// Answers that are of no use.
        Nonsense,
    }

    /// Has parts done where nothing is known but the world, the offer and bytes.
    struct Others<'a> {
        world: &'a World,
        place: Where,
        state: Mutex<State>,
    }

    #[derive(Default)]
    struct State {
        baker: Option<PartBaker>,
        effort: Vec<u8>,
        round: u32,
        parts: Vec<u32>,
        asked: u32,
        last: Option<Estimate>,
    }

    impl Others<'_> {
        fn done_elsewhere(&self, state: &State, part: u32) -> Estimate {
            let spec = PartSpec { round: state.round, part, samples: state.parts[part as usize] };
            let baker = state.baker.as_ref().expect("an offer");
            let bytes = baker.part(spec, &state.effort, &Unobserved).expect("nobody cancels").to_bytes();
            Estimate::from_bytes(&bytes, self.world.slots()).expect("its own bytes")
        }
    }

    impl Observer for Others<'_> {
        fn offer(&self, offer: &Offer<'_>) {
            let mut state = self.state.lock().expect("no panic");
            let baker = PartBaker::new(self.world, offer.layers, offer.seed, &Unobserved);
            state.baker.get_or_insert(baker.expect("layers of the world"));
            (state.effort, state.round, state.parts) = (offer.effort.to_vec(), offer.round, offer.parts.to_vec());
        }

        fn next_part(&self, missing: &[u32]) -> NextPart {
            let mut state = self.state.lock().expect("no panic");
            state.asked += 1;
            let last = *missing.last().expect("something is missing");
            match self.place {
                Where::Here => NextPart::Run(missing[0]),
                Where::Both if state.asked.is_multiple_of(2) => NextPart::Run(last),
                Where::Both => NextPart::Take(self.done_elsewhere(&state, last)),
                Where::Elsewhere => match state.last.take() {
                    Some(again) if state.asked.is_multiple_of(3) && missing.len() > 1 => NextPart::Take(again),
                    _ => {
                        let estimate = self.done_elsewhere(&state, last);
                        state.last = Some(estimate.clone());
                        NextPart::Take(estimate)
                    }
                },
                Where::Nonsense => {
                    let mut estimate = self.done_elsewhere(&state, missing[0]);
                    match state.asked % 3 {
                        0 => estimate.round += 1,
                        1 => estimate.samples += 1,
                        _ => return NextPart::Run(missing[0] + 1000),
                    }
                    NextPart::Take(estimate)
                }
            }
        }
    }

    #[test]
    fn a_bake_has_the_same_bits_wherever_its_parts_are_done() {
        let worlds = [&[][..], &[("screen", "a")], &[("lamp", "a"), ("screen", "a")]].map(room);
        for world in worlds.into_iter().chain([room_of_lamps(20)]) {
            let layers = crate::layers::groups_of(&world.scene).len();
            let bake = |place| {
                let others = Others { world: &world, place, state: Mutex::default() };
                let budget = Budget { samples_per_element: 100, target_rmse: None };
                let map = crate::bake(&world, &budget, 5, &others).expect("nobody cancels");
                (map, others.state.into_inner().expect("no panic"))
            };
            let (here, state) = bake(Where::Here);
            // 4, 4, 8, 16, 32, and all that is left.
            assert_eq!((state.round, &*state.parts), (5, &[12, 12, 12][..]));
            for place in [Where::Both, Where::Elsewhere, Where::Nonsense] {
                let (there, state) = bake(place);
                assert!(state.asked > 1 && there == here, "{layers} {place:?}");
            }
            let refine = |place| {
                let others = Others { world: &world, place, state: Mutex::default() };
                let budget = Budget { samples_per_element: 64, target_rmse: None };
                crate::refine(&world, &here, &budget, 6, &others).expect("nobody cancels")
            };
            assert!(refine(Where::Here) == refine(Where::Both), "{layers}");
        }
    }

    #[test]
    fn what_no_part_can_go_by_is_refused() {
        let world = room(&[]);
        let slots = world.slots();
        let many = vec![LayerHeader::default(); MAX_LAYERS + 1];
        let refused = PartBaker::new(&world, &many, 1, &Unobserved).err();
        assert_eq!(refused, Some(PartError::Layers(MAX_LAYERS + 1)));
        let baker = PartBaker::new(&world, &[], 1, &Unobserved).expect("nobody cancels");
        let spec = PartSpec { round: 0, part: 0, samples: 4 };
        for effort in [vec![1; slots - 1], vec![0; slots], vec![17; slots]] {
            let refused = baker.part(spec, &effort, &Unobserved);
            assert_eq!(refused, Err(PartError::Effort { slots }));
        }
        assert!(baker.part(spec, &vec![2; slots], &Unobserved).is_ok());
    }
}
