//! The only module that calls the engine: parses, builds worlds, bakes, updates, exports.
//!
//! [`Engine`] is the seam for tests: a stand-in can stop at a round, fail or panic, on real worlds.

mod files;

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};
pub(crate) use rebake_core::LAYOUT_VERSION;
use rebake_core::allowed::check_spacing;
pub(crate) use rebake_core::atlas::{Atlas, AtlasError, AtlasOptions};
pub(crate) use rebake_core::export::{LightAbout, Originals};
pub(crate) use rebake_core::layers::{Layer, MAX_GROUPS, SHARED_LAYER, SIDE_BY_SIDE};
pub(crate) use rebake_core::object_areas;
pub(crate) use rebake_core::resolution::{MeanSquare, Meter, ResolutionError, noise_of_objects};
pub(crate) use rebake_core::scene::Object;
use rebake_core::scene::{self, DEFAULT_MAX_ALBEDO, LoadLimits};
pub use rebake_core::scene::{LoadError, Scene};
pub(crate) use rebake_core::scene::{NodeSource, Outside, SkyPicture};
pub use rebake_core::surface::SurfaceError;
pub use rebake_core::{
    Budget, Canceled, DragBasis, Edit, EditError, EditErrorKind, Focus, Importance, LightMap, NextPart, Observer,
    Offer, Pass, Progress, Relight, Snapshot, TileMode, Tiles,
};
pub use rebake_core::{Density, Spread, Stated, Transition, World, WorldError, WorldOptions};

pub(crate) use self::files::*;
use crate::config::Limits;

/// Bytes of one slot of a light map, or of one of its layers: direct and indirect light, and their variance.
pub(crate) const VALUE_BYTES: usize = 2 * size_of::<Vec3>() + size_of::<f32>();

/// What computes light for a job, called on the threads of a job slot. The defaults are the real thing.
pub trait Engine: Send + Sync + Debug {
    /// Lays out elements and builds trees: seconds for large scenes. On a thread for builds.
    fn build(&self, scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
        World::new(scene, options)
    }

    /// From scratch.
    fn bake(
        &self,
        world: &World,
        budget: &Budget,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Arc<LightMap>, Canceled> {
        rebake_core::bake(world, budget, seed, observer)
    }

    /// From the map of `transition.before` to that of `transition.after`.
    fn update(&self, work: &Update<'_>, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        rebake_core::update(work.transition, work.map, work.budget, work.importance, work.seed, observer)
    }

    /// A map that is right for `world`, more accurate.
    fn refine(
        &self,
        world: &World,
        map: &LightMap,
        budget: &Budget,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Arc<LightMap>, Canceled> {
        rebake_core::refine(world, map, budget, seed, observer)
    }

    /// What frames of dragged lights are made with: the transport of the world.
    fn drag_basis(&self, world: &World, seed: u64, observer: &dyn Observer) -> Result<DragBasis, Canceled> {
        DragBasis::new(world, seed, observer)
    }
}

/// The work of an edit job.
#[derive(Clone, Copy)]
pub struct Update<'a> {
    /// From which world to which.
    pub transition: &'a Transition,
    /// Right for `transition.before`.
    pub map: &'a LightMap,
    /// When to stop.
    pub budget: &'a Budget,
    /// What comes first.
    pub importance: Option<&'a Importance>,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// The real thing.
#[derive(Clone, Copy, Debug, Default)]
pub struct CoreEngine;

impl Engine for CoreEngine {}

/// Bytes per slot that filtering takes for its time.
pub(crate) const FILTER_BYTES: usize = rebake_core::filter::BYTES_PER_SLOT;

/// A light map whose noise is averaged away where it may be.
pub(crate) fn filter(
    world: &World,
    map: &LightMap,
    is_known: impl Fn(usize) -> bool + Sync,
    observer: &dyn Observer,
) -> Result<LightMap, Canceled> {
    rebake_core::filter::filter(world, map, is_known, observer)
}

/// Whether a file begins as a picture of the sky does.
pub(crate) fn is_sky(file: &[u8]) -> bool {
    scene::is_sky(file)
}

/// Reads a picture of the sky of at most `max_bytes` bytes, with what is odd about it.
pub(crate) fn load_sky(file: &[u8], max_bytes: usize) -> Result<(SkyPicture, Vec<String>), LoadError> {
    let limits = LoadLimits { max_bytes, ..LoadLimits::default() };
    scene::load_sky(file, &limits).map(|loaded| (loaded.picture, loaded.warnings))
}

/// Reads an uploaded file for a world whose largest albedo is `max_albedo`; where it is not given, the default.
pub(crate) fn load(file: &[u8], limits: &Limits, max_albedo: Option<f32>) -> Result<Scene, LoadError> {
    let default = LoadLimits::default();
    let limits = LoadLimits {
        max_bytes: limits.upload_bytes,
        max_triangles: limits.triangles,
        max_albedo: max_albedo.unwrap_or(default.max_albedo),
        ..default
    };
    load_within(file, &limits)
}

/// Reads a file that was accepted at some time: whatever the limits of uploads are now, it is there.
pub(crate) fn load_again(file: &[u8], max_albedo: Option<f32>) -> Result<Scene, LoadError> {
    load_within(file, &accepted_before(max_albedo))
}

/// What was accepted once is read again, whatever the limits are now.
fn accepted_before(max_albedo: Option<f32>) -> LoadLimits {
    let default = LoadLimits::default();
    LoadLimits {
        max_bytes: usize::MAX,
        max_read_bytes: usize::MAX,
        max_zero_bytes: usize::MAX,
        max_triangles: usize::MAX,
        max_albedo: max_albedo.unwrap_or(default.max_albedo),
        ..default
    }
}

fn load_within(file: &[u8], limits: &LoadLimits) -> Result<Scene, LoadError> {
    let mut scene = scene::load(file, limits)?;
    if limits.max_albedo > LoadLimits::default().max_albedo {
        // Light of a closed room is down to a thousandth after as many bounces.
        let bounces = (1e-3_f32.ln() / limits.max_albedo.ln()).ceil();
        scene.warnings.push(format!(
            "max_albedo is {}: in closed rooms of such materials light takes up to {bounces} bounces to end, and a bake \
             as much longer",
            limits.max_albedo
        ));
    }
    Ok(scene)
}

/// Mean light of a map over the scene's area, mean over RGB.
pub(crate) fn mean_light(world: &World, map: &LightMap) -> f64 {
    world.area_mean(0..world.slots(), |slot| f64::from(map.total(slot).element_sum()) / 3.0)
}

/// How a scene is laid out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plan {
    /// How far elements lie apart.
    pub(crate) density: Density,
    /// How many there were to be, where that is how the density was chosen.
    pub(crate) elements: Option<usize>,
    /// How elements are spread.
    pub(crate) spread: Spread,
    pub(crate) stated: Stated,
    pub(crate) max_albedo: Option<f32>,
    pub(crate) atlas: Option<AtlasOptions>,
}

impl Plan {
    fn options(&self, max_elements: usize, max_triangles: usize) -> WorldOptions {
        let Plan { density, elements, spread, stated, max_albedo, atlas } = *self;
        WorldOptions {
            spacing: Some(density.spacing),
            elements,
            spread,
            object_squares: Some(density.object_squares),
            max_elements,
            max_triangles,
            stated,
            max_albedo: max_albedo.unwrap_or(DEFAULT_MAX_ALBEDO),
            atlas,
        }
    }

    /// Of a scene that is uploaded.
    pub(crate) fn within(&self, limits: &Limits) -> WorldOptions {
        self.options(limits.elements, limits.subdivided_triangles)
    }
}

/// Lays out a scene that was accepted at some time: its edits are to be applied again, whatever the limits are now.
/// [`limited`] ends that.
pub(crate) fn build_again(scene: Scene, plan: &Plan) -> Result<World, WorldError> {
    // Slots are numbers of 32 bits.
    World::new(scene, &plan.options(u32::MAX as usize, usize::MAX))
}

/// The world with the limits that hold for further edits.
pub(crate) fn limited(world: World, limits: &Limits) -> World {
    world.with_limits(limits.elements, limits.subdivided_triangles)
}

/// A world without anything in it: what is shown of a scene that cannot be built. A spacing that no world can have, as
/// a damaged record tells it, gives way to 1 m.
pub(crate) fn empty_world(spacing: f32) -> World {
    let spacing = if check_spacing(spacing).is_ok() { spacing } else { 1.0 };
    let scene = Scene::from_objects(Vec::new());
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    // Nothing can be too large or malformed.
    World::new(scene, &options).expect("an empty scene can be built")
}

/// A world that tells these warnings.
pub(crate) fn warned(mut world: World, warnings: &[String]) -> World {
    Arc::make_mut(&mut world.scene).warnings = warnings.to_vec();
    world
}

/// The old map with the slots of the new world.
pub(crate) fn carry_over(transition: &Transition, map: &LightMap) -> Arc<LightMap> {
    Arc::new(transition.carry_over(map))
}

/// Whether every object has the same slots in both worlds. Where it has, a map of the shorter world is one of the
/// longer, followed by holes.
pub(crate) fn have_same_slots(short: &World, long: &World) -> bool {
    let slots = |world: &World| -> BTreeMap<String, (u32, u32, bool)> {
        let slots = |object: ObjectSummary| (object.name, (object.first_element, object.elements, object.with_back));
        objects(world).map(slots).collect()
    };
    short.slots() <= long.slots() && slots(short) == slots(long)
}

/// A map of another world with the same elements, whose slots may end with other holes.
pub(crate) fn fitted(map: &Arc<LightMap>, slots: usize) -> Arc<LightMap> {
    if map.len() <= slots {
        return lengthened(map, slots);
    }
    Arc::new(map.resized(slots))
}

/// A map with holes at its end, up to `slots`.
pub(crate) fn lengthened(map: &Arc<LightMap>, slots: usize) -> Arc<LightMap> {
    if map.len() >= slots {
        return map.clone();
    }
    Arc::new(map.resized(slots))
}

/// One object, as clients see it.
pub(crate) struct ObjectSummary {
    pub(crate) index: u32,
    pub(crate) name: String,
    pub(crate) first_element: u32,
    pub(crate) elements: u32,
    pub(crate) with_back: bool,
    pub(crate) triangles: u32,
    pub(crate) bounds: (DVec3, DVec3),
    pub(crate) albedo: Vec3,
    pub(crate) world_from_object: DMat4,
    pub(crate) is_hidden: bool,
    pub(crate) node: Option<NodeSource>,
}

/// All objects of a world.
pub(crate) fn objects(world: &World) -> impl Iterator<Item = ObjectSummary> + '_ {
    let source = |object: &rebake_core::ObjectInfo<'_>| &world.scene.objects[object.index as usize];
    world.objects().map(move |object| ObjectSummary {
        index: object.index,
        name: object.name.to_owned(),
        first_element: object.first_element,
        elements: object.element_count,
        with_back: object.with_back,
        triangles: object.triangle_count,
        bounds: object.bounds,
        albedo: object.albedo,
        world_from_object: source(&object).world_from_object,
        is_hidden: source(&object).is_hidden,
        node: source(&object).node.clone(),
    })
}

/// The node of the file that a light is, or that shines.
pub(crate) fn node_of<'a>(of: &'a Scene, light: &scene::Light) -> Option<&'a NodeSource> {
    match &light.kind {
        scene::LightKind::Emissive { object, .. } => {
            of.objects.iter().find(|found| found.name == *object).and_then(|found| found.node.as_ref())
        }
        _ => of.light_nodes.get(&light.name),
    }
}

/// A hash of all elements: two worlds with the same one have the same slots, bit for bit.
pub(crate) fn layout_hash(world: &World) -> String {
    blake3::hash(&element_records(world)).to_hex().to_string()
}

/// An atlas of a world that has none of its own, one texel per spacing; objects stay where they lie in `earlier`.
pub(crate) fn new_atlas(world: &World, earlier: Option<&Atlas>, max_texels: u64) -> Result<Atlas, AtlasError> {
    world.new_atlas(earlier, AtlasOptions { texels_per_metre: None, max_texels })
}

/// A map from before an edit that only relights, with the layers of the map from after it, where these still add up to
/// it: who dims a light and takes that back has no use for rays at the next touch of the slider.
pub(crate) fn with_layers_of(known: Arc<LightMap>, later: &LightMap, scene: &Scene) -> Arc<LightMap> {
    if known.layers.len() >= later.layers.len() || known.len() != later.len() {
        return known;
    }
    match adds_up(&known, &later.layers, &later.layer_weights(scene)) {
        true => Arc::new(LightMap { light: known.light.clone(), layers: later.layers.clone() }),
        false => known,
    }
}

/// Whether weight × layer add up to a map, up to rounding.
fn adds_up(map: &LightMap, layers: &[Arc<Layer>], weights: &[Vec3]) -> bool {
    /// Relative to what is added: some dozen roundings of `f32`.
    const ROUNDING: f32 = 4e-6;
    let fits = |whole: Vec3, parts: &mut dyn Iterator<Item = Vec3>| {
        let (mut sum, mut size) = (Vec3::ZERO, whole.abs());
        for value in parts {
            sum += value;
            size += value.abs();
        }
        (sum - whole).abs().cmple(size * ROUNDING).all()
    };
    (0..map.len()).all(|slot| {
        let parts = || layers.iter().zip(weights).map(move |(layer, weight)| (layer.light.at(slot), *weight));
        fits(map.light.direct[slot], &mut parts().map(|((direct, _), weight)| direct * weight))
            && fits(map.light.indirect[slot], &mut parts().map(|((_, indirect), weight)| indirect * weight))
    })
}
