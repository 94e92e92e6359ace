//! Light maps brought up to date after an edit by equation (1) of the design,
//! `L_B − L_A = (I − T_B)⁻¹ S` with `S = (E_B − E_A) + (T_B − T_A) L_A`.
//!
//! In terms of the stored `M = D + I` (direct and indirect irradiance / π) and the gather G:
//! - new rows (elements of what came) are gathered from the old light, with the new direct light, to convergence;
//! - `ΔD` on static rows is the change of direct light, `S` what their rays see of the objects and no more of what
//!   lies behind them: `S = (G_B − G_A)[ρ M]`, along rays that meet what came or went;
//! - everything else is transport in the new scene: `X = Σ_k u_k`, `u_1 = G_B[ρ (S + ΔD) + Δρ M_A]`,
//!   `u_{k+1} = G_B[ρ u_k]`, a contraction whatever the edit.

mod direct;
mod extent;
mod new_rows;
mod source;

use std::cell::{Cell, OnceCell};
use std::sync::Arc;

use glam::Vec3;

use self::extent::Extent;
use crate::accumulate::Accumulator;
use crate::bake::Baker;
use crate::focus::Focus;
use crate::job::{Budget, Canceled, Observer, Pass, Progress};
use crate::lightmap::LightMap;
use crate::random::{Pcg32, subseed};
use crate::refine::refine_with;
use crate::rounds::{Phase, Round, Rounds};
use crate::solve::{Exchange, Rows, Source, Subset};
use crate::transport::{Surfel, Work};
use crate::world::{Transition, World};

/// Samples of the propagation per representative and round: at least, at most.
const PROPAGATION_SAMPLES: (u32, u32) = (8, 64);

/// Part of them that a change gets that drowns in the noise of the old map.
const LEAST_WEIGHT: f64 = 0.25;

/// Part of the old map's variance below which that of the change is settled: more samples of it would not show.
const SETTLED: f64 = 0.25;

/// Samples per element of what somebody looks at, before the rest of the scene gets any.
const FOCUS_SAMPLES: u32 = 32;

/// Brings `map`, which is right for `transition.before`, up to date with `transition.after`. Progressive as
/// [`crate::bake`] is; answering 0 to the first [`Observer::plan_round`] gives the old map in its new slots.
///
/// Where `target_rmse` is below what the old map's own noise allows, the update ends by refining ([`crate::refine`]).
///
/// With a `focus`, the elements that are looked at come first: snapshots hold new values there and old ones elsewhere,
/// until the rest follows.
pub fn update(
    transition: &Transition,
    map: &LightMap,
    budget: &Budget,
    focus: Option<&Focus>,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Arc<LightMap>, Canceled> {
    let work = Work::new(observer);
    let world = &transition.after;
    let updater = Updater::new(transition, map, &work);
    if let Some(factor) = updater.dimmed() {
        return Ok(updater.dim(factor));
    }
    let seed = subseed(seed, 0xed17);
    let first = focus.map(|f| updater.look_first(f, budget, subseed(seed, 0xf0c), &work)).transpose()?.flatten();
    let extents = updater.extents(|_| true);
    let baker = OnceCell::new();
    let round = |r: &Round| {
        if baker.get().is_none() {
            let (direct, indirect) = updater.round(r, &extents)?;
            if r.sum.samples() > 0 || !updater.outgrows_the_light(&direct, &indirect) {
                return Ok((direct, indirect));
            }
        }
        baker.get_or_init(|| Baker::new(world, seed, &work)).round(r)
    };
    let compose = |s: &Accumulator| match (baker.get(), &first) {
        (Some(baker), _) => baker.compose(s),
        (None, None) => updater.compose(s),
        (None, Some(first)) => updater.merge(first, updater.compose(s), s.samples()),
    };
    let stated = |map: &LightMap| Some(map.estimated_rmse(world.areas()));
    // What the old map brings along in noise no number of samples of the change takes away.
    let mean = |variance: &[f32]| updater.mean(variance);
    let carried = mean(&updater.old.variance);
    let enough =
        |s: &Accumulator| budget.target_rmse.is_some() && s.knows_variance() && mean(&s.variance()) < SETTLED * carried;
    let phase = if first.is_some() { Phase::Rest } else { Phase::Whole };
    let rounds = Rounds { len: world.slots(), budget, seed, work: &work, phase };
    let result = rounds.run(stated, enough, round, compose)?;
    let result = match (&result, budget.target_rmse) {
        (Some(map), Some(target)) if map.estimated_rmse(world.areas()) > target && baker.get().is_none() => {
            refine_with(world, map, budget, seed, &work)?.or(result)
        }
        _ => result,
    };
    Ok(result.unwrap_or_else(|| Arc::new(transition.carry_over(map))))
}

/// What was brought up to date first.
struct First {
    map: Arc<LightMap>,
    is_seen: Vec<bool>,
    samples: u32,
}

/// Where the parts of a round are estimated element by element.
struct Extents {
    direct: Extent,
    source: Extent,
}

/// What all rounds of an update share.
struct Updater<'a> {
    transition: &'a Transition,
    world: &'a World,
    work: &'a Work<'a>,
    /// The old map in the new slots; zero on new rows.
    old: LightMap,
    /// direct + indirect of `old`.
    old_total: Vec<Vec3>,
    /// direct + indirect of the map of `before`, in its slots.
    before_total: Vec<Vec3>,
    /// Computed elements that keep an old value.
    static_rows: Vec<u32>,
    subset: Subset,
    rows: Rows,
    source: source::Source<'a>,
    direct: direct::DirectChange<'a>,
    /// Change of albedo per part of the new world.
    repaint: Vec<Vec3>,
}

impl<'a> Updater<'a> {
    fn new(transition: &'a Transition, map: &LightMap, work: &'a Work<'a>) -> Updater<'a> {
        let world = &transition.after;
        let mut old = transition.carry_over(map);
        let mut is_new = vec![false; world.slots()];
        for &slot in &transition.new_rows {
            let slot = slot as usize;
            is_new[slot] = true;
            old.direct[slot] = Vec3::ZERO;
            old.indirect[slot] = Vec3::ZERO;
            old.variance[slot] = 0.0;
        }
        let total = |m: &LightMap| m.direct.iter().zip(&m.indirect).map(|(d, i)| *d + *i).collect::<Vec<_>>();
        let static_rows: Vec<u32> = world.computed_slots().into_iter().filter(|&i| !is_new[i as usize]).collect();
        let before = &transition.before.parts;
        let repaint = (world.parts.iter().enumerate())
            .map(|(i, p)| before.get(i).map_or(Vec3::ZERO, |b| p.albedo - b.albedo))
            .collect();
        let subset = Subset::new(world);
        Updater {
            transition,
            world,
            work,
            old_total: total(&old),
            before_total: total(map),
            old,
            rows: Rows::all(&subset),
            source: source::Source::new(transition),
            static_rows,
            subset,
            direct: direct::DirectChange::new(transition),
            repaint,
        }
    }

    /// Area-weighted mean over the rows that keep an old value.
    fn mean(&self, values: &[f32]) -> f64 {
        let area = |slot: u32| f64::from(self.world.areas()[slot as usize]);
        let sum: f64 = self.static_rows.iter().map(|&slot| area(slot) * f64::from(values[slot as usize])).sum();
        sum / self.static_rows.iter().map(|&slot| area(slot)).sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// The common factor of all lights, where nothing else has changed.
    fn dimmed(&self) -> Option<Vec3> {
        let changed = self.transition.moves_geometry()
            || !self.transition.new_rows.is_empty()
            || self.repaint.iter().any(|r| *r != Vec3::ZERO);
        if changed { None } else { self.direct.common_factor() }
    }

    /// Light is linear in the lights: no ray is needed where all of them change alike.
    fn dim(&self, factor: Vec3) -> Arc<LightMap> {
        let mut map = self.old.clone();
        map.direct.iter_mut().chain(&mut map.indirect).for_each(|v| *v *= factor);
        let square = factor.length_squared() / 3.0;
        map.variance.iter_mut().for_each(|v| *v *= square);
        let map = Arc::new(map);
        let progress = Progress {
            pass: Pass::Direct,
            samples_per_element: 1,
            round_samples: 0,
            round_fraction: 1.0,
            rays: 0,
            estimated_rmse: Some(map.estimated_rmse(self.world.areas())),
        };
        self.work.observer().progress(&progress);
        self.work.observer().snapshot(&map, &progress);
        map
    }

    /// Element by element where `is_wanted` says so, and S only near the edit; elsewhere on the subset.
    fn extents(&self, is_wanted: impl Fn(u32) -> bool) -> Extents {
        let is_near = self.source.is_near();
        let slots = self.world.slots();
        Extents {
            direct: Extent::new(&self.static_rows, &self.subset, slots, &is_wanted),
            source: Extent::new(&self.static_rows, &self.subset, slots, |slot| is_wanted(slot) && is_near(slot)),
        }
    }

    /// Brings what is looked at up to date.
    fn look_first(&self, focus: &Focus, budget: &Budget, seed: u64, work: &Work) -> Result<Option<First>, Canceled> {
        let is_seen = focus.covers(self.world);
        if !is_seen.iter().any(|seen| *seen) {
            return Ok(None);
        }
        let extents = self.extents(|slot| is_seen[slot as usize]);
        let samples = Cell::new(0);
        let compose = |s: &Accumulator| {
            samples.set(s.samples());
            let (old, new) = (&self.old, self.compose(s));
            let mut map = new.clone();
            for &slot in self.static_rows.iter().filter(|&&slot| !is_seen[slot as usize]) {
                let slot = slot as usize;
                map.direct[slot] = old.direct[slot];
                map.indirect[slot] = old.indirect[slot];
                map.variance[slot] = old.variance[slot];
            }
            self.world.fill_invalid(&mut map);
            map
        };
        let budget = Budget { samples_per_element: budget.samples_per_element.min(FOCUS_SAMPLES), target_rmse: None };
        // The rest of the map is out of date: nothing can be stated about the whole.
        let rounds = Rounds { len: self.world.slots(), budget: &budget, seed, work, phase: Phase::Part };
        let map = rounds.run(|_| None, |_| false, |r| self.round(r, &extents), compose)?;
        Ok(map.map(|map| First { map, is_seen, samples: samples.get() }))
    }

    /// The mean of what was done first and what followed, by samples.
    fn merge(&self, first: &First, mut map: LightMap, samples: u32) -> LightMap {
        let weight = first.samples as f32 / (first.samples + samples) as f32;
        for &slot in self.static_rows.iter().filter(|&&slot| first.is_seen[slot as usize]) {
            let slot = slot as usize;
            map.direct[slot] = map.direct[slot].lerp(first.map.direct[slot], weight);
            map.indirect[slot] = map.indirect[slot].lerp(first.map.indirect[slot], weight);
            let old = self.old.variance[slot];
            let (a, b) = (first.map.variance[slot] - old, map.variance[slot] - old);
            map.variance[slot] = old + weight * weight * a + (1.0 - weight) * (1.0 - weight) * b;
        }
        self.world.fill_invalid(&mut map);
        map
    }

    /// One independent estimate: changes on static rows, values on new rows.
    fn round(&self, round: &Round, extents: &Extents) -> Result<(Vec<Vec3>, Vec<Vec3>), Canceled> {
        let (world, work) = (self.world, self.work);
        (round.begin)(Pass::Direct, 0.0);
        let mut direct = vec![Vec3::ZERO; world.slots()];
        self.direct.estimate(&extents.direct, &self.subset, round.samples, round.seed, work, &mut direct)?;

        (round.begin)(Pass::Object, 0.2);
        let mut indirect = vec![Vec3::ZERO; world.slots()];
        self.new_rows(round, &mut direct, &mut indirect)?;

        (round.begin)(Pass::Source, 0.4);
        // What the rays of S look up in the new scene: the old map, and the new rows' own values.
        let mut guess = self.old_total.clone();
        for &slot in &self.transition.new_rows {
            guess[slot as usize] = direct[slot as usize] + indirect[slot as usize];
        }
        world.validity.fill(&mut guess);
        let maps = source::Maps { before: &self.before_total, after: &guess };
        let extent = &extents.source;
        self.source.estimate(extent, &self.subset, &maps, round, work, &mut direct, &mut indirect)?;

        (round.begin)(Pass::Propagation, 0.8);
        let bounces = self.propagate(&direct, &indirect, round)?;
        indirect.iter_mut().zip(bounces).for_each(|(i, b)| *i += b);
        Ok((direct, indirect))
    }

    /// Whether the change is larger than the light that is left: its noise would be, too, and a bake is the better
    /// update (design, section 3.9). The new rows' own light is no change.
    fn outgrows_the_light(&self, direct: &[Vec3], indirect: &[Vec3]) -> bool {
        let areas = self.world.areas();
        let (mut change, mut left) = (0.0f64, 0.0f64);
        for &slot in &self.static_rows {
            let slot = slot as usize;
            let delta = direct[slot] + indirect[slot];
            change += f64::from(areas[slot]) * f64::from(delta.length_squared());
            left += f64::from(areas[slot]) * f64::from((self.old_total[slot] + delta).length_squared());
        }
        change > left
    }

    /// X = Σ_k u_k. New rows have gathered ΔD and the repainted surfaces already: they see only what S changed.
    fn propagate(&self, direct: &[Vec3], indirect: &[Vec3], round: &Round) -> Result<Vec<Vec3>, Canceled> {
        let world = self.world;
        let (mut seen_by_old, mut seen_by_new) = (vec![Vec3::ZERO; world.slots()], vec![Vec3::ZERO; world.slots()]);
        for &slot in &self.static_rows {
            let slot = slot as usize;
            seen_by_new[slot] = indirect[slot];
            seen_by_old[slot] = direct[slot] + indirect[slot];
        }
        // Elements that came out of a solid had a value copied from neighbours, and S has looked that up.
        for &slot in &self.transition.filled_rows {
            let slot = slot as usize;
            seen_by_old[slot] = direct[slot] + indirect[slot] - self.before_total[slot];
        }
        world.validity.fill(&mut seen_by_old);
        world.validity.fill(&mut seen_by_new);
        let is_new = self.new_flags();
        let repainted = self.repaint.iter().any(|r| *r != Vec3::ZERO);
        // Near surfaces are looked up too: the change has no other estimate there. Its bounces are not. New rows have
        // gone on from near surfaces through the new scene when they were gathered.
        let change = |slot: u32, s: &Surfel, near: bool, _: &mut Pcg32, _: &mut u64| {
            let Some(elements) = s.elements else { return Vec3::ZERO };
            if is_new.get(slot as usize).copied().unwrap_or(false) {
                return if near { Vec3::ZERO } else { s.albedo * s.interpolate(elements, &seen_by_new) };
            }
            let change = s.albedo * s.interpolate(elements, &seen_by_old);
            if !repainted {
                return change;
            }
            change + self.repaint[s.part as usize] * s.interpolate(elements, &self.old_total)
        };
        let source = Source { radiance: change, sky: Vec3::ZERO };
        let samples = (round.samples * 2).clamp(PROPAGATION_SAMPLES.0, PROPAGATION_SAMPLES.1);
        let samples = (f64::from(samples) * self.weight_of(&seen_by_old)).ceil() as u32;
        let seed = subseed(round.seed, 0x9409);
        let exchange = Exchange::trace(world, &self.subset, &self.rows, &source, samples, seed, self.work)?;
        let bounces = exchange.to_representatives(&self.subset, &exchange.all_bounces(&exchange.first));
        let mut field = self.subset.interpolate(&bounces);
        world.validity.fill(&mut field);
        Ok(field)
    }

    /// How well a change has to be known beside the noise that the old map has anyway, up to 1.
    fn weight_of(&self, change: &[Vec3]) -> f64 {
        let square = |v: &Vec3| v.length_squared() / 3.0;
        let squares: Vec<f32> = change.iter().map(square).collect();
        let carried = self.mean(&self.old.variance);
        let ratio = if carried > 0.0 { self.mean(&squares) / carried } else { 1.0 };
        if ratio.is_finite() { ratio.clamp(LEAST_WEIGHT, 1.0) } else { 1.0 }
    }

    fn new_flags(&self) -> Vec<bool> {
        let mut flags = vec![false; self.world.slots()];
        self.transition.new_rows.iter().for_each(|&slot| flags[slot as usize] = true);
        flags
    }

    /// Old values plus the mean change on static rows, mean values on new rows.
    fn compose(&self, sum: &Accumulator) -> LightMap {
        let mut map = self.old.clone();
        let (direct, indirect, variance) = (sum.direct(), sum.indirect(), sum.variance());
        let add = |a: &mut [Vec3], b: &[Vec3]| a.iter_mut().zip(b).for_each(|(x, y)| *x += *y);
        add(&mut map.direct, &direct);
        add(&mut map.indirect, &indirect);
        map.variance.iter_mut().zip(variance).for_each(|(x, y)| *x += y);
        self.world.fill_invalid(&mut map);
        map
    }
}
