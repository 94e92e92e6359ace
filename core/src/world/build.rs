//! From a scene to a world: subdivision, slots, trees, emitters, validity.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, Vec3};
use rayon::prelude::*;

use super::emitters::EmissiveTriangle;
use super::{
    Coarse, Emitters, Geometry, Part, Placed, Resolution, Trees, Validity, World, WorldError, WorldOptions, probe,
};
use crate::bvh::{BuildQuality, Bvh};
use crate::scene::{Object, Scene};
use crate::surface::{DEFAULT_ELEMENTS, Surface, default_spacing, object_area};

/// Edge of the cells that smooth light is evaluated in, in units of [`Resolution::smooth`].
pub(crate) const COARSE_RADIUS: f32 = 2.5;

/// Ray offset over the largest coordinate: about thirty units in the last place of `f32`.
const EPSILON: f32 = 4e-6;

pub(super) fn build(scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
    let default = default_spacing(scene.objects.par_iter().map(object_area).sum(), DEFAULT_ELEMENTS);
    let spacing = spacing_of(options, default)?;
    // Meshes may be finer than a spacing that is given, and light then shows details that large cells would blur.
    let resolution = Resolution { spacing, smooth: spacing.min(default) };
    let surfaces: Vec<(Arc<Surface>, Arc<Coarse>)> =
        scene.objects.par_iter().map(|o| subdivide(&scene, o, resolution, options)).collect::<Result<_, _>>()?;
    check_size(surfaces.iter().map(|(s, _)| &**s), spacing, options)?;

    let mut placed = Vec::with_capacity(surfaces.len());
    let mut parts = Vec::new();
    let mut geometry = Geometry::default();
    for (key, (object, (surface, coarse))) in scene.objects.iter().zip(surfaces).enumerate() {
        placed.push(place(&mut geometry, &mut parts, object, surface, coarse, key as u32, false));
    }
    let epsilon = epsilon_of(&geometry);
    let trees = big_tree(&geometry, &placed, 0);
    let next_key = placed.len() as u32;
    let mut world = World {
        scene,
        options: *options,
        resolution,
        placed: placed.into_iter().map(Arc::new).collect(),
        geometry: Arc::new(geometry),
        parts: Arc::new(parts),
        trees,
        emitters: Arc::default(),
        validity: Arc::default(),
        sight: BTreeMap::new(),
        epsilon,
        next_key,
    };
    world.emitters = Arc::new(world.resolve_emitters());
    give_backs(&mut world)?;
    world.mark_solids();
    world.validity = Arc::new(Validity::of_all(&world));
    world.look_around(None, |_| true);
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

pub(super) fn subdivide(
    scene: &Scene,
    object: &Object,
    resolution: Resolution,
    options: &WorldOptions,
) -> Result<(Arc<Surface>, Arc<Coarse>), WorldError> {
    let surface = Surface::build(object, scene_from_object(scene, object), resolution.spacing, options.max_elements)
        .map_err(|source| WorldError::Surface { object: object.name.clone(), source })?;
    let coarse = Coarse::new(&surface.positions, &surface.normals, &surface.areas, COARSE_RADIUS * resolution.smooth);
    Ok((Arc::new(surface), Arc::new(coarse)))
}

pub(super) fn check_size<'a>(
    surfaces: impl Iterator<Item = &'a Surface>,
    spacing: f32,
    options: &WorldOptions,
) -> Result<(), WorldError> {
    let (elements, triangles) = surfaces.fold((0, 0), |(e, t), s| (e + s.positions.len(), t + s.triangles.len()));
    let too_large = |what, limit| Err(WorldError::TooLarge { what, limit, spacing });
    if elements > options.max_elements {
        return too_large("elements", options.max_elements);
    }
    if triangles > options.max_triangles {
        return too_large("triangles", options.max_triangles);
    }
    Ok(())
}

/// Gives an object slots and parts.
pub(super) fn place(
    geometry: &mut Geometry,
    parts: &mut Vec<Part>,
    object: &Object,
    surface: Arc<Surface>,
    coarse: Arc<Coarse>,
    key: u32,
    with_back: bool,
) -> Placed {
    let parts_first = parts.len() as u32;
    let back_offset = if with_back { surface.positions.len() as u32 } else { 0 };
    parts.extend(object.materials.iter().map(|m| Part {
        albedo: m.albedo,
        object: key,
        double_sided: m.double_sided,
        solid: false,
        back_offset,
    }));
    let placement = geometry.place(&surface, key, with_back, parts_first);
    Placed { key, surface, coarse, placement, with_back, parts_first }
}

/// Corners and ids of an object's triangles.
pub(super) fn corners_of(placed: &Placed) -> (Vec<[Vec3; 3]>, Vec<u32>) {
    let vertices = &placed.surface.vertices;
    let corners = placed.surface.triangles.iter().map(|t| t.map(|i| vertices[i as usize])).collect();
    (corners, placed.placement.triangles.clone().collect())
}

/// A small tree of one object, at once.
pub(super) fn small_tree(placed: &Placed) -> Arc<Bvh> {
    let (corners, ids) = corners_of(placed);
    Arc::new(Bvh::build(&corners, &ids, BuildQuality::Fast))
}

pub(super) fn big_tree<P: std::borrow::Borrow<Placed>>(geometry: &Geometry, placed: &[P], generation: u64) -> Trees {
    let mut corners = Vec::with_capacity(geometry.triangles.len());
    let mut ids = Vec::with_capacity(geometry.triangles.len());
    for p in placed {
        let (c, i) = corners_of(p.borrow());
        corners.extend(c);
        ids.extend(i);
    }
    Trees { big: Arc::new(Bvh::build(&corners, &ids, BuildQuality::Good)), gone: None, small: Vec::new(), generation }
}

pub(super) fn epsilon_of(geometry: &Geometry) -> f32 {
    let sizes = geometry.positions.par_iter().with_min_len(4096).map(|p| p.abs().max_element());
    let largest = sizes.reduce(|| 0.0, f32::max);
    EPSILON * largest.max(f32::MIN_POSITIVE * 1e10)
}

/// Double-sided surfaces whose back is seen get elements there; slots are laid out anew, once.
fn give_backs(world: &mut World) -> Result<(), WorldError> {
    let seen = probe::backs_seen(world);
    if !seen.iter().any(|s| *s) {
        return Ok(());
    }
    let mut geometry = Geometry::default();
    let mut parts = Vec::new();
    let mut placed = Vec::with_capacity(world.placed.len());
    for ((object, old), back) in world.scene.objects.iter().zip(&world.placed).zip(seen) {
        let (surface, coarse) = (Arc::clone(&old.surface), Arc::clone(&old.coarse));
        placed.push(Arc::new(place(&mut geometry, &mut parts, object, surface, coarse, old.key, back)));
    }
    if geometry.owners.len() > world.options.max_elements {
        let (what, limit) = ("elements", world.options.max_elements);
        return Err(WorldError::TooLarge { what, limit, spacing: world.spacing() });
    }
    // Triangle slots are the same: the tree stays good.
    world.geometry = Arc::new(geometry);
    world.parts = Arc::new(parts);
    world.placed = placed;
    Ok(())
}

impl World {
    pub(super) fn resolve_emitters(&self) -> Emitters {
        let distances2 = self.geometry.positions.par_iter().with_min_len(4096).map(|p| p.length_squared());
        let radius = distances2.reduce(|| 0.0, f32::max).sqrt();
        Emitters::new(&self.scene.lights, self.scene.origin, radius, |name, material| {
            let index = self.scene.objects.iter().position(|o| o.name == name)?;
            let (object, placed) = (&self.scene.objects[index], &self.placed[index]);
            let double_sided = object.materials.get(material as usize)?.double_sided;
            let place = scene_from_object(&self.scene, object);
            Some((placed.key, emissive_triangles(object, place, material), double_sided))
        })
    }
}

/// The triangles of one material as the file has them: few and large ones are sampled better than their subdivision.
fn emissive_triangles(object: &Object, place: DMat4, material: u32) -> Vec<EmissiveTriangle> {
    let mirrored = place.determinant() < 0.0;
    let mesh = &object.mesh;
    let corner = |i: u32| place.transform_point3(mesh.positions[i as usize].as_dvec3()).as_vec3();
    let of_material = mesh.triangles.iter().zip(&mesh.triangle_materials).filter(|(_, m)| **m == material);
    let triangles = of_material.filter_map(|(&[a, b, c], _)| {
        EmissiveTriangle::new((if mirrored { [a, c, b] } else { [a, b, c] }).map(corner))
    });
    triangles.collect()
}

impl EmissiveTriangle {
    fn new(corners: [Vec3; 3]) -> Option<EmissiveTriangle> {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let length = cross.length();
        (length > 0.0).then(|| EmissiveTriangle { corners, normal: cross / length, area: 0.5 * length })
    }
}
