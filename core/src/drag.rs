//! Lights that are dragged (Nielsen 2000, "moving lights"): a new frame of a moved light without waiting
//! for an update.
//!
//! The paper precomputes responses of coarse patches to unit light. Here the transport between representatives is kept
//! instead, sampled once ([`crate::solve::Exchange`]): it answers any direct light with all its bounces by solving a
//! sparse system, so the only rays of a frame are shadow rays towards the light. What a frame leaves out is light that
//! arrives by way of surfaces nearer than the map can be trusted (the near-field rule), and variation finer than the
//! representatives; the exact update follows when the light rests.

use std::sync::Arc;

use glam::Vec3;

use crate::job::{Canceled, Observer};
use crate::layers::{Layer, LayerHeader, moved_layers, whole_of};
use crate::lightmap::{LightMap, LightValues};
use crate::random::{PartSeed, subseed};
use crate::solve::{Exchange, Paths, Rows, Subset};
use crate::space::Space;
use crate::transport::direct::direct_of;
use crate::transport::{Effort, Source, Surfel, Work};
use crate::world::{Transition, World};

/// Paths per representative.
const PATHS: u32 = 48;

/// Samples of a light with an extent, per element and frame.
const LIGHT_SAMPLES: u32 = 4;

/// Transport of a scene whose surfaces stay, ready for lights that move.
pub struct DragBasis {
    space: Space,
    slots: Vec<u32>,
    subset: Subset,
    exchange: Exchange<Vec3>,
}

impl std::fmt::Debug for DragBasis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DragBasis").field("elements", &self.slots.len()).finish_non_exhaustive()
    }
}

impl DragBasis {
    /// Samples the transport of a world, at the representatives of smooth light only: a tenth of the time of a bake of
    /// 16 samples per element (`benches/layers.rs`).
    pub fn new(world: &World, seed: u64, observer: &dyn Observer) -> Result<DragBasis, Canceled> {
        let subset = Subset::new(world);
        let rows = Arc::new(Rows::all(&subset));
        let dark = |_: u32, _: &Surfel, _: bool, _: Vec3, _: &mut crate::random::Pcg32, _: &mut u64, _: &mut Vec3| {};
        let source = Source { radiance: dark, looked_up: &[], skies: &[], spots: None };
        let work = Work::new(observer);
        let exchange = Exchange::trace(
            world,
            &subset,
            &rows,
            &source,
            Paths::Each(PATHS),
            PartSeed::whole(subseed(seed, 0xd4a6)),
            &work,
        )?;
        Ok(DragBasis { space: world.space.clone(), slots: world.computed_slots(), subset, exchange })
    }

    /// Whether a world's surfaces are those that this is of.
    pub fn fits(&self, world: &World) -> bool {
        self.space.has_slots_of(&world.space) && self.space.parts() == world.space.parts()
    }

    /// Bytes that it holds.
    pub fn memory_bytes(&self) -> usize {
        self.exchange.memory_bytes() + self.subset.memory_bytes() + self.slots.len() * size_of::<u32>()
    }

    /// The map after lights have moved that have layers of their own, first shot. None where anything else has changed,
    /// or the surfaces are not those of this basis. The variance of moved layers is that of the layers before.
    pub fn frame(
        &self,
        transition: &Transition,
        map: &LightMap,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Option<LightMap>, Canceled> {
        let world = &transition.after;
        if !self.fits(world) || !self.fits(&transition.before) {
            return Ok(None);
        }
        let Some(moved) = moved_layers(transition, map) else { return Ok(None) };
        let work = Work::new(observer);
        let mut layers = map.layers.clone();
        for (place, header) in moved {
            let layer = self.layer(world, &header, &layers[place], subseed(seed, place as u64), &work)?;
            layers[place] = Arc::new(layer);
        }
        Ok(Some(whole_of(layers, map, &transition.before.scene, &world.scene)))
    }

    fn layer(
        &self,
        world: &World,
        header: &LayerHeader,
        old: &Layer,
        seed: u64,
        work: &Work,
    ) -> Result<Layer, Canceled> {
        let lit = world.only_layers(std::slice::from_ref(header), &[Vec3::ONE]);
        let found: Vec<Vec3> = direct_of(&lit, &self.slots, LIGHT_SAMPLES, &Effort::default(), seed, work)?;
        let mut direct = vec![Vec3::ZERO; world.slots()];
        self.slots.iter().zip(found).for_each(|(&slot, light)| direct[slot as usize] = light);
        world.validity.fill(&mut direct);
        let bounces = self.exchange.further_bounces(&direct);
        let mut indirect = Vec::new();
        self.subset.interpolate(&self.exchange.to_representatives(&self.subset, &bounces), &mut indirect);
        world.validity.fill(&mut indirect);
        let light = LightValues { direct, indirect, variance: old.light.variance().into_owned() };
        Ok(Layer { name: header.name.clone(), lights: header.lights.clone(), light: light.into() })
    }
}
