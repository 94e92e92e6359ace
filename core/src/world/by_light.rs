//! Elements where light needs them, in a few layouts: one to look at the light from, and those that it asks for.

use std::sync::Arc;

use rayon::prelude::*;

use super::build::laid_out;
use super::options::Spread;
use super::sized::{COARSE, Wanted, fixed_of};
use super::{Placed, Resolution, World, WorldError, WorldOptions};
use crate::scene::{Object, Scene};
use crate::space::{Density, Layout};
use crate::surface::object_area;

/// Sizes by light leave elements at most this many spacings apart.
const COARSEST: f32 = 2.5;

/// Elements beside those that are fixed where they are never farther apart than a spacing, as a multiple of those that are
/// a spacing apart.
const MORE: f64 = 1.5;

/// Elements by light are laid out again where they are not as many as they are to be, up to this part, and so often at most.
const NEAR: f64 = 0.05;
const AGAIN: usize = 4;

/// Least and greatest power of what is aimed at that the number of elements goes with, as two layouts tell it.
const POWERS: (f64, f64) = (0.25, 2.0);

/// Elements where light needs them: about as many as a spacing for all would have, and half as many more where that
/// is not to be exceeded.
pub(super) fn laid_out_by_light(
    scene: Scene,
    resolution: Resolution,
    options: &WorldOptions,
) -> Result<World, WorldError> {
    let Density { spacing, object_squares } = resolution.density;
    let coarse = Density { spacing: COARSE * spacing, object_squares: object_squares / f64::from(COARSE * COARSE) };
    let coarse = Resolution { density: coarse, ..resolution.clone() };
    let mut world = laid_out(scene.clone(), coarse, options, None)?;
    let (largest, more) = match options.spread {
        Spread::ByLightWithin => (spacing, MORE),
        Spread::ByLight | Spread::Uniform => (COARSEST * spacing, 1.0),
    };
    let even = even_count(&world, &scene, &resolution, options)?;
    let fixed = fixed_of(world.element_count(), even);
    let Some(wanted) = Wanted::new(&world, fixed, spacing, largest) else {
        return laid_out(scene, resolution, options, None);
    };
    let goal = more * even.saturating_sub(fixed) as f64;
    let mut by_light = |aim: f64| {
        let sizing = Some(Arc::new(wanted.sizing(aim)));
        world = laid_out(scene.clone(), Resolution { sizing, ..resolution.clone() }, options, Some(&world))?;
        Ok::<_, WorldError>((world.clone(), world.element_count().saturating_sub(fixed) as f64))
    };
    let off = |count: f64| (count - goal).abs();
    let (mut aim, mut power) = (goal, 1.0);
    let (mut best, mut count) = by_light(aim)?;
    let mut least = off(count);
    for _ in 0..AGAIN {
        if off(count) <= NEAR * (goal + fixed as f64) {
            break;
        }
        let (last, there) = (aim, count.max(1.0));
        aim *= (goal / there).powf(1.0 / power);
        let world;
        (world, count) = by_light(aim)?;
        // What is there whatever the aim is told apart by two of them.
        let told = (count.max(1.0) / there).ln() / (aim / last).ln();
        power = if told.is_finite() { told.clamp(POWERS.0, POWERS.1) } else { 1.0 };
        if off(count) < least {
            (best, least) = (world, off(count));
        }
    }
    Ok(best)
}

/// Elements that the objects of a world would have at one density.
fn even_count(
    world: &World,
    scene: &Scene,
    resolution: &Resolution,
    options: &WorldOptions,
) -> Result<usize, WorldError> {
    let count = |(placed, object): (&Arc<Placed>, &Arc<Object>)| {
        let error = |source| WorldError::Surface { object: object.name.clone(), source };
        let distances = resolution.distances(object_area(object), options);
        let count = Layout::count(&placed.surface, &distances, options.max_elements).map_err(error)?;
        Ok(count * placed.sides().count())
    };
    let counts: Vec<usize> =
        world.placed.par_iter().zip(&scene.objects).map(count).collect::<Result<_, WorldError>>()?;
    Ok(counts.into_iter().sum())
}
