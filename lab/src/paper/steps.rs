//! Insertion by equations (3) and (4), removal by section 3.6, the object's own map last.

use glam::Vec3;

use super::operators::{Field, Sampled};
use super::scenes::ObjectScene;
use super::{Equation, PaperOptions, State};
use rebake_core::Canceled;
use rebake_core::bvh::Ray;
use rebake_core::random::{Pcg32, R2, subseed};
use rebake_core::sampling::cosine_hemisphere;
use rebake_core::transport::{Work, direct_light};

/// Samples of the object's own elements per sample of the scene's: "generated from scratch, which calls for more
/// samples" (section 3.5).
const OBJECT_SAMPLES: u32 = 4;

/// A light map over `len` slots from values of the rows of S, ready to be looked up.
fn scatter(scene: &ObjectScene, values: impl Iterator<Item = Vec3>, len: usize) -> Vec<Vec3> {
    let mut map = vec![Vec3::ZERO; len];
    scene.rows.iter().zip(values).for_each(|(&slot, value)| map[slot as usize] = value);
    scene.validity.fill_invalid(&mut map);
    map
}

/// The first term of an insertion, and all of a removal, before the bounces.
struct First {
    /// 𝒪[L_e]: the change of direct light.
    direct: Vec<Vec3>,
    /// 𝒪 applied to all that is reflected.
    reflected: Vec<Vec3>,
}

impl First {
    fn new(scene: &ObjectScene, field: &Field, samples: u32, seed: u64, work: &Work) -> Result<First, Canceled> {
        let mut direct = scene.direct_change(samples, seed, work)?;
        let change = scene.apply_object(field, samples, seed, work)?;
        direct.iter_mut().zip(&change).for_each(|(d, (_, sky))| *d += *sky);
        Ok(First { direct, reflected: change.into_iter().map(|(light, _)| light).collect() })
    }

    /// With all bounces in S: the light that 𝒪 and T_S* make of the field, less the direct light.
    fn bounced(
        &self,
        scene: &ObjectScene,
        len: usize,
        options: &PaperOptions,
        seed: u64,
        work: &Work,
    ) -> Result<Vec<Vec3>, Canceled> {
        let both = self.direct.iter().zip(&self.reflected).map(|(d, r)| *d + *r);
        let map = scatter(scene, both, len);
        let bounced = scene.bounce(&map, options.path_length, options.samples, seed, work)?;
        Ok(self.reflected.iter().zip(bounced).map(|(r, b)| *r + b).collect())
    }
}

/// Brings S to S ∪ O.
///
/// Equation (4): `L̃₀ = L̃_S − 𝒪[L_e] + T_S* 𝒪[L_e + T_{S∪O} L_e]`, the first bounce of `T_S* 𝒪[L_e]` being direct
/// light that is taken out again; then `L̃_{n+1} = T_S* 𝒪[L̃_n]`. Equation (3): `L_0 = L_S` and `L_{n+1} = T_S*
/// 𝒪[L_n]`, all light in one map; its emission is sampled by area, too, which it is not bound to.
pub(super) fn insert(
    scene: &ObjectScene,
    state: &mut State,
    options: &PaperOptions,
    seed: u64,
    work: &Work,
) -> Result<(), Canceled> {
    let (rows, len) = (&scene.rows, state.direct.len());
    let full = options.equation == Equation::Full;
    let all = full.then(|| {
        let values = rows.iter().map(|&slot| state.direct[slot as usize] + state.indirect[slot as usize]);
        scatter(scene, values, len)
    });
    let lights = if full { Sampled::OnObject } else { Sampled::Everywhere };
    let field = Field { map: all.as_deref(), lights, on_object: false };
    let first = First::new(scene, &field, options.samples, seed, work)?;
    let change = first.bounced(scene, len, options, seed, work)?;
    for (k, &slot) in rows.iter().enumerate() {
        state.direct[slot as usize] += first.direct[k];
        state.indirect[slot as usize] += change[k];
    }
    // What the next application is to: L_1, direct light and all, or L̃_0.
    let of_full = |k: usize| first.direct[k] + change[k];
    let of_indirect = |k: usize| state.indirect[rows[k] as usize];
    let values = (0..rows.len()).map(|k| if full { of_full(k) } else { of_indirect(k) });
    let mut last = scatter(scene, values, len);
    let done = if full { 1 } else { 0 };
    for n in done + 1..=options.iterations {
        last = iterate(scene, state, &last, options, subseed(seed, u64::from(n)), work)?;
    }
    object_map(scene, state, options, subseed(seed, 0x0b), work)
}

/// `L_{n+1} = T_S* 𝒪[L_n]`, added to the indirect light; answers it over slots.
fn iterate(
    scene: &ObjectScene,
    state: &mut State,
    last: &[Vec3],
    options: &PaperOptions,
    seed: u64,
    work: &Work,
) -> Result<Vec<Vec3>, Canceled> {
    let (rows, len) = (&scene.rows, last.len());
    let field = Field { map: Some(last), lights: Sampled::Nowhere, on_object: false };
    let source = scene.apply_object(&field, options.samples, seed, work)?;
    let map = scatter(scene, source.iter().map(|(light, _)| *light), len);
    let bounced = scene.bounce(&map, options.path_length, options.samples, seed, work)?;
    let next: Vec<Vec3> = source.iter().zip(bounced).map(|((light, _), b)| *light + b).collect();
    rows.iter().zip(&next).for_each(|(&slot, v)| state.indirect[slot as usize] += *v);
    Ok(scatter(scene, next.into_iter(), len))
}

/// Brings S ∪ O to S: the operators of the insertion, once, on the known map of S ∪ O (section 3.6).
pub(super) fn remove(
    scene: &ObjectScene,
    state: &mut State,
    options: &PaperOptions,
    seed: u64,
    work: &Work,
) -> Result<(), Canceled> {
    let known = match options.equation {
        Equation::Indirect => state.indirect.clone(),
        Equation::Full => state.direct.iter().zip(&state.indirect).map(|(d, i)| *d + *i).collect(),
    };
    let lights = if options.equation == Equation::Full { Sampled::Nowhere } else { Sampled::Everywhere };
    let field = Field { map: Some(&known), lights, on_object: true };
    let first = First::new(scene, &field, options.samples, seed, work)?;
    let change = first.bounced(scene, state.direct.len(), options, seed, work)?;
    for (k, &slot) in scene.rows.iter().enumerate() {
        state.direct[slot as usize] -= first.direct[k];
        state.indirect[slot as usize] -= change[k];
    }
    Ok(())
}

/// The object's own elements, last: paths over the object until they leave it, into the updated map (section 3.5).
fn object_map(
    scene: &ObjectScene,
    state: &mut State,
    options: &PaperOptions,
    seed: u64,
    work: &Work,
) -> Result<(), Canceled> {
    let (world, samples) = (scene.with, options.samples * OBJECT_SAMPLES);
    let direct = direct_light(world, &scene.object_rows, samples, seed, work)?;
    let full = options.equation == Equation::Full;
    let mut map = state.indirect.clone();
    if full {
        map.iter_mut().zip(&state.direct).for_each(|(m, d)| *m += *d);
    }
    // Elements of S that the object holds inside it are dark and must not be seen next to it.
    world.validity().fill_invalid(&mut map[..world.slots()]);
    let lights = if full { Sampled::OnObject } else { Sampled::Everywhere };
    let field = Field { map: Some(&map), lights, on_object: false };
    let indirect = work.map(&scene.object_rows, |_, slot, rays| {
        let (origin, n) = world.ray_origin(slot as usize);
        let mut rng = Pcg32::new(seed, u64::from(slot));
        let sequence = R2::new(&mut rng);
        let mut sum = Vec3::ZERO;
        for k in 0..samples {
            let ray =
                Ray { origin, direction: cosine_hemisphere(n, sequence.get(k)), t_min: 0.0, t_max: f32::INFINITY };
            sum += scene.follow(ray, None, &field, &mut rng, rays);
        }
        sum / samples as f32
    })?;
    for ((&slot, d), i) in scene.object_rows.iter().zip(direct).zip(indirect) {
        state.direct[slot as usize] = d;
        state.indirect[slot as usize] = i;
    }
    Ok(())
}
