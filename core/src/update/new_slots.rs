//! Elements without an old value: gathered from the old light, with the new direct light, and from one another.

use std::sync::Arc;

use super::updater::Updater;
use crate::job::Canceled;
use crate::random::{PartSeed, subseed};
use crate::rounds::Round;
use crate::solve::{Exchange, Paths, Rows, Solvable};
use crate::transport::direct::direct_of;
use crate::transport::{Effort, Field, Rough, Spots, gather};

/// Samples of new slots per sample of the others: they have no old map to lean on.
const NEW_SLOT_SAMPLES: u32 = 4;

/// Samples of the solve among the new slots themselves.
const SELF_SAMPLES: u32 = 32;

impl<V: Solvable> Updater<'_, V> {
    /// Direct light of new slots, written over their slots.
    pub(super) fn direct_of_new_slots(&self, round: &Round, slots: &[u32], direct: &mut [V]) -> Result<(), Canceled> {
        let (samples, seed) = (round.samples * NEW_SLOT_SAMPLES, subseed(round.seed, 0xd0));
        let found: Vec<V> = direct_of(self.world, slots, samples, &Effort::default(), seed, self.work)?;
        slots.iter().zip(found).for_each(|(&slot, light)| direct[slot as usize] = light);
        Ok(())
    }

    /// Indirect light of new slots, written over their slots. `direct` holds ΔD of the unchanged slots, and direct
    /// light of all new slots; `known` is the indirect light of all new slots, where there is any yet.
    pub(super) fn new_slots(
        &self,
        round: &Round,
        slots: &[u32],
        known: Option<&[V]>,
        spots: Option<&Spots>,
        direct: &[V],
        indirect: &mut [V],
    ) -> Result<(), Canceled> {
        if slots.is_empty() {
            return Ok(());
        }
        let (world, work) = (self.world, self.work);
        let (samples, nominal) = (round.samples * NEW_SLOT_SAMPLES, Effort::default());
        // What they see of the unchanged elements: old light, changed direct light.
        let mut field = self.with_direct(direct);
        world.validity.fill(&mut field);
        match known {
            None => self.self_passes(round.seed, direct, spots, &mut field)?,
            Some(known) => {
                let all = &self.transition.new_slots;
                all.iter().zip(known).for_each(|(&slot, known)| field[slot as usize] += *known);
            }
        }
        let rough = Rough::default();
        let light = Field { total: &field, indirect: &[], rough: &rough };
        let gathered =
            gather(world, &light.source(world, spots), slots, samples, &nominal, subseed(round.seed, 0x0b), work)?;
        slots.iter().zip(gathered).for_each(|(&slot, i)| indirect[slot as usize] = i);
        self.buffers.give(field);
        Ok(())
    }

    /// All bounces among the new slots, on their subset: what they gather of the light around them, and of one another.
    fn self_passes(&self, seed: u64, direct: &[V], spots: Option<&Spots>, field: &mut [V]) -> Result<(), Canceled> {
        let (world, slots) = (self.world, &self.transition.new_slots);
        let is_new = self.new_flags();
        let rows = Arc::new(Rows::only(&self.subset, |slot| is_new[slot as usize]));
        let rough = Rough::default();
        let light = Field { total: field, indirect: &[], rough: &rough };
        let seed = PartSeed::whole(subseed(seed, 0x5e1f));
        let exchange = Exchange::trace(
            world,
            &self.subset,
            &rows,
            &light.source(world, spots),
            Paths::Each(SELF_SAMPLES),
            seed,
            self.work,
        )?;
        let values = exchange.to_representatives(&self.subset, &exchange.all_bounces(&exchange.first));
        slots.iter().for_each(|&slot| field[slot as usize] = direct[slot as usize]);
        self.subset.add_where(|slot| is_new[slot as usize], &values, field);
        world.validity.fill(field);
        Ok(())
    }
}
