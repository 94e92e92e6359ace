//! G. Lu, C. Peters, P. Kellnhofer, E. Eisemann, *Iterative Lightmap Updates for Scene Editing* (2025), as published:
//! the method to beat, and a check of [`rebake_core::update`] by other means.
//!
//! `T_S` carries light by one bounce through the scene S without the object O, `𝒪 = T_{S∪O} − T_S`. Insertion iterates
//! `L_{n+1} = T_S* 𝒪 L_n` from the old light map (equations 3 and 4), with `T_S*` cut at path length M and n at N;
//! removal applies the same operators once to the known map (section 3.6). It can diverge: `T_S* 𝒪` is no contraction
//! where walls are bright and the object is large and dark.
//!
//! A move is a removal and an insertion, a repaint too. Written for stored values `M = irradiance / π`: with radiance
//! `ρ M`, the operators become cosine-weighted means over the hemisphere.

mod direct;
mod operators;
mod scenes;
mod steps;

use glam::Vec3;

use rebake_core::random::subseed;
use rebake_core::transport::Work;
use rebake_core::{Canceled, LightMap, LightValues, Observer, Transition, World};

use self::scenes::{ObjectScene, edited};

/// Which of the published equations is iterated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Equation {
    /// (3): all light in one map.
    Full,
    /// (4): indirect light; direct light is sampled wherever it is needed.
    #[default]
    Indirect,
}

/// Settings of the published method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PaperOptions {
    /// Samples per element of both operators.
    pub samples: u32,
    /// N: applications of the object operator after the first map.
    pub iterations: u32,
    /// M: longest path in the scene without the object between two applications.
    pub path_length: u32,
    /// Which equation.
    pub equation: Equation,
}

impl Default for PaperOptions {
    fn default() -> Self {
        PaperOptions { samples: 64, iterations: 4, path_length: 3, equation: Equation::Indirect }
    }
}

/// An updated map and its cost.
#[derive(Clone, Debug)]
pub struct PaperUpdate {
    /// The map of the world after the edit; its variance is not known and zero.
    pub map: LightMap,
    /// Rays traced.
    pub rays: u64,
}

/// Why there is no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PaperError {
    /// Ended by the observer.
    #[error(transparent)]
    Canceled(#[from] Canceled),
    /// Lights changed otherwise than with the objects they are on.
    #[error("the published method knows objects that are inserted and removed, and no edits of lights")]
    Lights,
}

/// Brings `map`, which is right for `transition.before`, up to date with `transition.after`. The same inputs, options
/// and seed give the same bits on any number of threads.
pub fn paper_update(
    transition: &Transition,
    map: &LightMap,
    options: &PaperOptions,
    seed: u64,
    observer: &dyn Observer,
) -> Result<PaperUpdate, PaperError> {
    let (before, after) = (&transition.before, &transition.after);
    let (gone, come) = edited(transition);
    if scenes::lights_differ(before, after, &gone, &come) {
        return Err(PaperError::Lights);
    }
    let work = Work::new(observer);
    let mut state = State::new(transition, map);
    if !gone.is_empty() {
        let scene = ObjectScene::new(before, &gone);
        state.darken(scene.rows.iter().filter(|&&slot| !before.is_valid(slot as usize)));
        steps::remove(&scene, &mut state, options, subseed(seed, 1), &work)?;
    }
    if !come.is_empty() {
        let scene = ObjectScene::new(after, &come);
        steps::insert(&scene, &mut state, options, subseed(seed, 2), &work)?;
    }
    Ok(PaperUpdate { map: state.finish(after), rays: work.rays() })
}

/// The map under way, in slots that both worlds share.
struct State {
    direct: Vec<Vec3>,
    indirect: Vec<Vec3>,
}

impl State {
    fn new(transition: &Transition, map: &LightMap) -> State {
        let len = transition.before.slots().max(transition.after.slots());
        let resized = |values: &[Vec3]| {
            let mut values = values.to_vec();
            values.resize(len, Vec3::ZERO);
            values
        };
        State { direct: resized(&map.light.direct), indirect: resized(&map.light.indirect) }
    }

    /// Elements of the scene inside the object: they are dark, where the map has copied values.
    fn darken<'a>(&mut self, slots: impl Iterator<Item = &'a u32>) {
        for &slot in slots {
            self.direct[slot as usize] = Vec3::ZERO;
            self.indirect[slot as usize] = Vec3::ZERO;
        }
    }

    fn finish(mut self, after: &World) -> LightMap {
        let len = after.slots();
        self.direct.truncate(len);
        self.indirect.truncate(len);
        for slot in (0..len).filter(|&slot| after.areas()[slot] <= 0.0) {
            (self.direct[slot], self.indirect[slot]) = (Vec3::ZERO, Vec3::ZERO);
        }
        let mut light = LightValues { direct: self.direct, indirect: self.indirect, variance: vec![0.0; len] };
        after.validity().fill_invalid(&mut light.direct);
        after.validity().fill_invalid(&mut light.indirect);
        light.into()
    }
}
