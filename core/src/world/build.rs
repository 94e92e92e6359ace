//! From a scene to a world: subdivision, slots, trees, emitters, validity.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, Vec3};
use rayon::prelude::*;

use super::emitters::{Emissive, EmissiveTriangle};
use super::openings::Openings;
use super::{Coarse, Emitters, Placed, Resolution, Trees, Validity, World, WorldError, WorldOptions, probe};
use crate::bvh::{BuildQuality, Bvh};
use crate::scene::{Object, Scene};
use crate::space::{Albedo, Albedos, Elements, Layout, Space};
use crate::surface::{DEFAULT_ELEMENTS, SeeThrough, Surface, default_spacing, object_area};

/// Edge of the cells that smooth light is evaluated in, in units of [`Resolution::smooth`].
pub(crate) const COARSE_RADIUS: f32 = 2.5;

pub(super) fn build(scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
    let default = default_spacing(scene.objects.par_iter().map(object_area).sum(), DEFAULT_ELEMENTS);
    let spacing = spacing_of(options, default)?;
    if !(0.0..=1.0).contains(&options.max_albedo) {
        return Err(WorldError::MaxAlbedo(options.max_albedo));
    }
    // Meshes may be finer than a spacing that is given, and light then shows details that large cells would blur.
    let resolution = Resolution { spacing, smooth: spacing.min(default) };
    let ready: Vec<Ready> =
        scene.objects.par_iter().map(|o| Ready::new(&scene, o, resolution, options)).collect::<Result<_, _>>()?;
    check_size(ready.iter().map(|r| &*r.layout), spacing, options)?;

    let mut placed = Vec::with_capacity(ready.len());
    let mut space = Space::default();
    space.reserve(ready.iter().map(|r| r.layout.len()).sum());
    for (key, (object, ready)) in scene.objects.iter().zip(ready).enumerate() {
        placed.push(ready.place(&mut space, object, key as u32, false));
    }
    let trees = big_tree(&placed, 0);
    let next_key = placed.len() as u32;
    let mut world = World {
        scene,
        options: *options,
        resolution,
        placed: placed.into_iter().map(Arc::new).collect(),
        space,
        trees,
        emitters: Arc::default(),
        validity: Arc::default(),
        sight: BTreeMap::new(),
        atlas: None,
        next_key,
    };
    world.emitters = Arc::new(world.resolve_emitters());
    give_backs(&mut world)?;
    world.mark_solids();
    world.validity = Arc::new(Validity::of_all(&world));
    world.look_around(None, |_| true);
    world.find_behind(None, |_| true);
    world.atlas = options.atlas.map(|atlas| world.new_atlas(None, atlas)).transpose()?.map(Arc::new);
    Ok(world)
}

fn spacing_of(options: &WorldOptions, default: f32) -> Result<f32, WorldError> {
    match options.spacing {
        Some(s) if s.is_finite() && s > 0.0 => Ok(s),
        Some(s) => Err(WorldError::Spacing(s)),
        None => Ok(default),
    }
}

/// Scene space from the object's space.
pub(super) fn scene_from_object(scene: &Scene, object: &Object) -> DMat4 {
    DMat4::from_translation(-scene.origin) * object.world_from_object
}

/// An object that has no slots yet.
pub(super) struct Ready {
    pub surface: Arc<Surface>,
    pub see_through: Option<Arc<SeeThrough>>,
    pub layout: Arc<Layout>,
    pub coarse: Arc<Coarse>,
    pub elements: Elements,
    pub albedos: Albedos,
}

impl Ready {
    /// Lays out the elements of an object.
    pub(super) fn new(
        scene: &Scene,
        object: &Object,
        resolution: Resolution,
        options: &WorldOptions,
    ) -> Result<Ready, WorldError> {
        let error = |source| WorldError::Surface { object: object.name.clone(), source };
        let to_scene = scene_from_object(scene, object);
        let surface = Surface::build(object, to_scene).map_err(error)?;
        let see_through = SeeThrough::of(object, &surface, to_scene);
        let (layout, elements) = Layout::new(&surface, resolution.spacing, options.max_elements).map_err(error)?;
        let Elements { positions, normals, areas } = &elements;
        let albedos = Albedos::new(object, &surface, &layout, areas, options.max_albedo);
        let coarse = Coarse::new(positions, normals, areas, COARSE_RADIUS * resolution.smooth);
        let (surface, layout, coarse) = (Arc::new(surface), Arc::new(layout), Arc::new(coarse));
        Ok(Ready { surface, see_through, layout, coarse, elements, albedos })
    }

    /// One that is placed, as it was before it had slots.
    pub(super) fn again(world: &World, placed: &Placed) -> Ready {
        Ready {
            surface: Arc::clone(&placed.surface),
            see_through: placed.see_through.clone(),
            layout: Arc::clone(&placed.layout),
            coarse: Arc::clone(&placed.coarse),
            elements: world.space.elements_of(&placed.placement, &placed.layout),
            albedos: albedos_of(world, placed),
        }
    }

    /// Gives it slots.
    pub(super) fn place(self, space: &mut Space, object: &Object, key: u32, with_back: bool) -> Placed {
        let Ready { surface, see_through, layout, coarse, elements, albedos } = self;
        let materials = albedos.of_materials.into_iter().zip(object.materials.iter().map(|m| m.double_sided));
        let placement =
            space.place((&surface, &layout, &elements), albedos.by_place.as_ref(), materials, key, with_back);
        Placed { key, surface, see_through, layout, coarse, placement, with_back }
    }
}

/// The albedos of an object that is placed.
fn albedos_of(world: &World, placed: &Placed) -> Albedos {
    let parts = world.space.parts_of(&placed.placement);
    let of_materials = parts.iter().map(|part| Albedo { told: part.told_albedo, reflected: part.albedo }).collect();
    Albedos { of_materials, by_place: parts.first().and_then(|part| part.albedos.clone()) }
}

pub(super) fn check_size<'a>(
    layouts: impl Iterator<Item = &'a Layout>,
    spacing: f32,
    options: &WorldOptions,
) -> Result<(), WorldError> {
    let (elements, triangles) = layouts.fold((0, 0), |(e, t), l| (e + l.len(), t + l.cell_count()));
    let too_large = |what, limit| Err(WorldError::TooLarge { what, limit, spacing });
    if elements > options.max_elements {
        return too_large("elements", options.max_elements);
    }
    if triangles > options.max_triangles {
        return too_large("triangles", options.max_triangles);
    }
    Ok(())
}

/// Corners and slots of the triangles of some objects.
pub(super) fn corners_of<'a>(objects: impl IntoIterator<Item = &'a Placed>) -> (Vec<[Vec3; 3]>, Vec<u32>) {
    let (mut corners, mut ids) = (Vec::new(), Vec::new());
    for placed in objects {
        corners.extend(placed.surface.all_corners());
        ids.extend(placed.placement.faces.clone());
    }
    (corners, ids)
}

/// A small tree of one object, at once.
pub(super) fn small_tree(placed: &Placed) -> Arc<Bvh> {
    let (corners, ids) = corners_of([placed]);
    Arc::new(Bvh::build(&corners, &ids, BuildQuality::Fast))
}

pub(super) fn big_tree<P: std::borrow::Borrow<Placed>>(placed: &[P], generation: u64) -> Trees {
    let (corners, ids) = corners_of(placed.iter().map(P::borrow));
    let openings = Openings::of(placed.iter().map(P::borrow));
    Trees::of(Bvh::build(&corners, &ids, BuildQuality::Good), openings, generation)
}

/// Double-sided surfaces whose back is seen get elements there; slots are laid out anew, once.
fn give_backs(world: &mut World) -> Result<(), WorldError> {
    let seen = probe::backs_seen(world);
    if !seen.iter().any(|s| *s) {
        return Ok(());
    }
    let mut space = Space::default();
    let sides = |(old, back): (&Arc<Placed>, &bool)| old.layout.len() * if *back { 2 } else { 1 };
    space.reserve(world.placed.iter().zip(&seen).map(sides).sum());
    let mut placed = Vec::with_capacity(world.placed.len());
    for ((object, old), back) in world.scene.objects.iter().zip(&world.placed).zip(seen) {
        placed.push(Arc::new(Ready::again(world, old).place(&mut space, object, old.key, back)));
    }
    if space.slots().owners.len() > world.options.max_elements {
        let (what, limit) = ("elements", world.options.max_elements);
        return Err(WorldError::TooLarge { what, limit, spacing: world.spacing() });
    }
    // Triangle slots are the same: the tree stays good.
    world.space = space;
    world.placed = placed;
    Ok(())
}

impl World {
    pub(super) fn resolve_emitters(&self) -> Emitters {
        let distances2 = self.positions().par_iter().with_min_len(4096).map(|p| p.length_squared());
        let radius = distances2.reduce(|| 0.0, f32::max).sqrt();
        Emitters::new(&self.scene.lights, self.scene.origin, radius, |name, material| {
            let index = self.scene.objects.iter().position(|o| o.name == name)?;
            let (object, placed) = (&self.scene.objects[index], &self.placed[index]);
            let double_sided = object.materials.get(material as usize)?.double_sided;
            let triangles = emissive_triangles(&placed.surface, material);
            Some(Emissive { key: placed.key, triangles, double_sided, see_through: placed.see_through.clone() })
        })
    }
}

/// The triangles of one material.
fn emissive_triangles(surface: &Surface, material: u32) -> Vec<EmissiveTriangle> {
    let of_material = (0..surface.triangles.len()).filter(|&t| surface.triangle_materials[t] == material);
    of_material.filter_map(|t| EmissiveTriangle::new(t as u32, surface.corners(t))).collect()
}

impl EmissiveTriangle {
    fn new(face: u32, corners: [Vec3; 3]) -> Option<EmissiveTriangle> {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let length = cross.length();
        (length > 0.0).then(|| EmissiveTriangle { face, corners, normal: cross / length, area: 0.5 * length })
    }
}
