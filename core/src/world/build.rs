//! From a scene to a world: subdivision, slots, trees, emitters, validity.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, Vec3};
use rayon::prelude::*;

use super::by_light::laid_out_by_light;
use super::emitters::{Emissive, EmissiveTriangle};
use super::openings::Openings;
use super::options::Spread;
use super::{Coarse, Emitters, Placed, Resolution, Trees, Validity, World, WorldError, WorldOptions, probe};
use crate::allowed::check_spacing;
use crate::bvh::{BuildQuality, Bvh};
use crate::scene::{Object, Scene};
use crate::space::{Albedos, Density, Distances, Elements, Layout, Part, Sizing, Space, object_areas};
use crate::surface::{Facet, Facets, SeeThrough, Surface, facet_area, object_area};

/// Edge of the cells that smooth light is evaluated in, in units of [`Resolution::smooth`].
pub(crate) const COARSE_RADIUS: f32 = 2.5;

/// How far apart elements lie at least, over their distance from the scene's middle: some steps of `f32` there.
const FINEST: f32 = 4.0 * f32::EPSILON;

/// As many elements as asked for, and so much more, are what was asked for.
const ROUGHLY: f64 = 1.1;

pub(super) fn build(mut scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
    let areas = object_areas(&scene);
    let density = density_of(options, &scene, &areas)?;
    if !(0.0..=1.0).contains(&options.max_albedo) {
        return Err(WorldError::MaxAlbedo(options.max_albedo));
    }
    warn_where_coarse(&mut scene, &areas, density);
    let resolution = Resolution { density, smooth: smooth_of(options, &areas, density.spacing), sizing: None };
    let mut world = match options.spread {
        Spread::Uniform => laid_out(scene, resolution, options, None)?,
        Spread::ByLight | Spread::ByLightWithin => laid_out_by_light(scene, resolution, options)?,
    };
    warn_where_more(&mut world);
    world.mark_solids();
    world.validity = Arc::new(Validity::of_all(&world));
    world.look_around(None, |_| true);
    world.find_behind(None, |_| true);
    world.atlas = options.atlas.map(|atlas| world.new_atlas(None, atlas)).transpose()?.map(Arc::new);
    Ok(world)
}

/// The elements of all objects, what rays meet and where light comes from. Where there is a world of the same scene its
/// elements alone are laid out anew.
pub(super) fn laid_out(
    scene: Scene,
    resolution: Resolution,
    options: &WorldOptions,
    like: Option<&World>,
) -> Result<World, WorldError> {
    let new = |(index, object): (usize, &Arc<Object>)| match like {
        None => Ready::new(&scene, object, &resolution, options),
        Some(like) => Shape::of(&like.placed[index]).laid_out(object, &resolution, options),
    };
    let ready: Vec<Ready> = scene.objects.par_iter().enumerate().map(new).collect::<Result<_, _>>()?;
    check_size(ready.iter().map(|r| &*r.layout), resolution.density.spacing, options)?;

    let mut placed = Vec::with_capacity(ready.len());
    let mut space = Space::default();
    let with_back = |index: usize| like.is_some_and(|like| like.placed[index].with_back);
    let sides = |(index, ready): (usize, &Ready)| ready.layout.len() * if with_back(index) { 2 } else { 1 };
    space.reserve(ready.iter().enumerate().map(sides).sum());
    for (key, (object, ready)) in scene.objects.iter().zip(ready).enumerate() {
        placed.push(ready.place(&mut space, object, key as u32, with_back(key)));
    }
    // Triangle slots are the same, and so are the trees.
    let trees = like.map_or_else(|| big_tree(&placed, 0), |like| like.trees.clone());
    let next_key = placed.len() as u32;
    let mut world = World {
        scene: Arc::new(scene),
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
    match like {
        None => give_backs(&mut world)?,
        Some(_) => check_slots(&world)?,
    }
    Ok(world)
}

/// Meshes may be finer than a spacing that is given, and light then shows details that large cells would blur.
fn smooth_of(options: &WorldOptions, areas: &[f64], spacing: f32) -> f32 {
    if options.spacing.is_some() { spacing.min(Density::even_spacing(areas)) } else { spacing }
}

fn density_of(options: &WorldOptions, scene: &Scene, areas: &[f64]) -> Result<Density, WorldError> {
    let density = match (options.spacing, options.elements) {
        (Some(spacing), _) => Density::even(spacing),
        (None, Some(elements)) => Density::of_elements(scene, elements)?,
        (None, None) => Density::chosen(areas),
    };
    let density = Density { object_squares: options.object_squares.unwrap_or(density.object_squares), ..density };
    let Density { spacing, object_squares } = density;
    check_spacing(spacing).map_err(WorldError::Spacing)?;
    match object_squares > 0.0 {
        true => Ok(density),
        false => Err(WorldError::ObjectSquares(object_squares)),
    }
}

impl Resolution {
    /// How far apart elements lie on an object of `area` m². Where a spacing is given, and not their number, it is the largest,
    /// and what a file has is kept as fine as it would be without.
    pub(super) fn distances(&self, area: f64, options: &WorldOptions) -> Distances<'static> {
        let spacing = self.density.of_object(area);
        let kept = self.smooth * spacing / self.density.spacing;
        let is_given = options.spacing.is_some() && options.elements.is_none();
        Distances { shared: if is_given { kept } else { f32::INFINITY }, ..Distances::even(spacing) }
    }
}

/// Says on which objects elements lie farther apart than elsewhere.
fn warn_where_coarse(scene: &mut Scene, areas: &[f64], density: Density) {
    let coarse = |(object, area): (&Arc<Object>, &f64)| {
        let spacing = density.of_object(*area);
        (spacing > density.spacing).then(|| format!("{:?} ({spacing:.2} m)", object.name))
    };
    let coarse: Vec<String> = scene.objects.iter().zip(areas).filter_map(coarse).collect();
    if !coarse.is_empty() {
        let spacing = density.spacing;
        let list = coarse.join(", ");
        scene.warnings.push(format!("objects that are large have elements farther apart than {spacing} m: {list}"));
    }
}

/// Says where there are more elements than asked for: each piece of surface has some.
fn warn_where_more(world: &mut World) {
    let count = world.element_count();
    if let Some(asked) = world.options.elements.filter(|asked| count as f64 > ROUGHLY * *asked as f64) {
        let warning =
            format!("there are {count} elements, since the file's surfaces need so many: {asked} were asked for");
        Arc::make_mut(&mut world.scene).warnings.push(warning);
    }
}

/// Scene space from the object's space.
pub(super) fn scene_from_object(scene: &Scene, object: &Object) -> DMat4 {
    DMat4::from_translation(-scene.origin) * object.world_from_object
}

/// What an object is, whatever its elements are.
struct Shape {
    surface: Arc<Surface>,
    see_through: Option<Arc<SeeThrough>>,
    facets: Vec<Option<Arc<Facets>>>,
}

impl Shape {
    fn new(scene: &Scene, object: &Object, resolution: &Resolution) -> Result<Shape, WorldError> {
        let to_scene = scene_from_object(scene, object);
        let error = |source| WorldError::Surface { object: object.name.clone(), source };
        let surface = Surface::build(object, to_scene).map_err(error)?;
        let see_through = SeeThrough::of(object, &surface, to_scene);
        let facets = Facets::of_materials(object, &surface, resolution.density.spacing);
        Ok(Shape { surface: Arc::new(surface), see_through, facets })
    }

    fn of(placed: &Placed) -> Shape {
        Shape {
            surface: Arc::clone(&placed.surface),
            see_through: placed.see_through.clone(),
            facets: placed.facets.clone(),
        }
    }

    /// With its elements: by light where it is of the scene's file, at the spacing of its size otherwise. What is
    /// inserted was not there when the light was looked at.
    fn laid_out(self, object: &Object, resolution: &Resolution, options: &WorldOptions) -> Result<Ready, WorldError> {
        let Shape { surface, see_through, facets } = self;
        let error = |source| WorldError::Surface { object: object.name.clone(), source };
        let spacing = resolution.density.of_object(object_area(object));
        let farthest = surface.positions.iter().map(|p| p.abs().max_element()).fold(0.0, f32::max);
        let finest = FINEST * farthest;
        let is_told = |sizing: &&Sizing| !object.is_inserted && sizing.least() >= finest;
        let sizing = resolution.sizing.as_deref().filter(is_told);
        let even = resolution.distances(object_area(object), options);
        let distances = Distances { sizing, spacing: even.spacing.max(finest), shared: even.shared.max(finest) };
        let (layout, elements) = Layout::new(&surface, &distances, options.max_elements).map_err(error)?;
        let Elements { positions, normals, areas } = &elements;
        let albedos = Albedos::new(object, &surface, &layout, areas, options.max_albedo);
        let coarser = spacing / resolution.density.spacing;
        let coarse = Coarse::new(positions, normals, areas, COARSE_RADIUS * resolution.smooth * coarser);
        let (layout, coarse) = (Arc::new(layout), Arc::new(coarse));
        Ok(Ready { surface, see_through, facets, layout, coarse, elements, albedos })
    }
}

/// An object that has no slots yet.
pub(super) struct Ready {
    pub surface: Arc<Surface>,
    pub see_through: Option<Arc<SeeThrough>>,
    pub facets: Vec<Option<Arc<Facets>>>,
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
        resolution: &Resolution,
        options: &WorldOptions,
    ) -> Result<Ready, WorldError> {
        Shape::new(scene, object, resolution)?.laid_out(object, resolution, options)
    }

    /// One that is placed, as it was before it had slots.
    pub(super) fn again(world: &World, placed: &Placed) -> Ready {
        Ready {
            surface: Arc::clone(&placed.surface),
            see_through: placed.see_through.clone(),
            facets: placed.facets.clone(),
            layout: Arc::clone(&placed.layout),
            coarse: Arc::clone(&placed.coarse),
            elements: world.space.elements_of(&placed.placement, &placed.layout),
            albedos: albedos_of(world, placed),
        }
    }

    /// Gives it slots.
    pub(super) fn place(self, space: &mut Space, object: &Object, key: u32, with_back: bool) -> Placed {
        let Ready { surface, see_through, facets, layout, coarse, elements, albedos } = self;
        let materials = albedos.of_materials.into_iter().zip(object.materials.iter().map(|m| m.double_sided));
        let placement =
            space.place((&surface, &layout, &elements), albedos.by_place.as_ref(), materials, key, with_back);
        let reach = elements.reach();
        Placed { key, surface, see_through, facets, layout, coarse, placement, with_back, reach }
    }
}

/// The albedos of an object that is placed.
fn albedos_of(world: &World, placed: &Placed) -> Albedos {
    let parts = world.space.parts_of(&placed.placement);
    let of_materials = parts.iter().map(Part::albedo).collect();
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
    // Triangle slots are the same: the tree stays good.
    world.space = space;
    world.placed = placed;
    check_slots(world)
}

fn check_slots(world: &World) -> Result<(), WorldError> {
    let (what, limit) = ("elements", world.options.max_elements);
    match world.slots() > limit {
        true => Err(WorldError::TooLarge { what, limit, spacing: world.spacing() }),
        false => Ok(()),
    }
}

impl World {
    pub(super) fn resolve_emitters(&self) -> Emitters {
        let radius = self.placed.iter().map(|placed| placed.reach).fold(0.0, f32::max);
        Emitters::new(&self.scene.lights, self.scene.origin, radius, |name, material| {
            let index = self.scene.objects.iter().position(|o| o.name == name)?;
            let (object, placed) = (&self.scene.objects[index], &self.placed[index]);
            let double_sided = object.materials.get(material as usize)?.double_sided;
            let facets = placed.facets.get(material as usize).cloned().flatten();
            let triangles = match &facets {
                Some(facets) => facets.list().iter().map(|facet| of_facet(&placed.surface, facet)).collect(),
                None => emissive_triangles(&placed.surface, material),
            };
            let see_through = placed.see_through.clone();
            Some(Emissive { key: placed.key, triangles, facets, double_sided, see_through })
        })
    }
}

/// The triangles of one material.
fn emissive_triangles(surface: &Surface, material: u32) -> Vec<EmissiveTriangle> {
    let of_material = (0..surface.triangles.len()).filter(|&t| surface.triangle_materials[t] == material);
    of_material.filter_map(|t| EmissiveTriangle::new(t as u32, surface.corners(t))).collect()
}

/// A facet as a triangle. What has no area is never chosen.
fn of_facet(surface: &Surface, facet: &Facet) -> EmissiveTriangle {
    let whole = surface.corners(facet.face as usize);
    let [a, b, c] = whole;
    let corners = facet.corners.map(|corner| a + (b - a) * corner.x + (c - a) * corner.y);
    let (normal, area) = ((b - a).cross(c - a).normalize_or_zero(), facet_area(surface, facet));
    EmissiveTriangle { face: facet.face, corners, normal, area: if normal == Vec3::ZERO { 0.0 } else { area } }
}

impl EmissiveTriangle {
    fn new(face: u32, corners: [Vec3; 3]) -> Option<EmissiveTriangle> {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let length = cross.length();
        (length > 0.0).then(|| EmissiveTriangle { face, corners, normal: cross / length, area: 0.5 * length })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::Edit;
    use crate::scene::{Material, Mesh};

    #[test]
    fn what_stands_on_a_ground_has_elements_of_its_own_spacing() {
        let grey = || Material::diffuse(Vec3::splat(0.5));
        let ground = Mesh::quad(Vec3::new(-500.0, 0.0, -500.0), Vec3::Z * 1000.0, Vec3::X * 1000.0);
        let house = Mesh::cuboid(Vec3::new(0.0, 0.01, 0.0), Vec3::new(5.0, 3.0, 4.0));
        let objects = vec![Object::new("ground", ground, grey()), Object::new("house", house, grey())];
        let world = World::new(Scene::from_objects(objects), &WorldOptions::default()).unwrap();
        assert!(world.spacing() < 0.2, "{}", world.spacing());
        let elements = |world: &World, name: &str| -> usize {
            world.objects().find(|object| object.name == name).map_or(0, |object| object.element_count as usize)
        };
        let of_ground = elements(&world, "ground");
        assert!((40_000..80_000).contains(&of_ground), "{of_ground}");
        assert!((10_000..20_000).contains(&elements(&world, "house")), "{}", elements(&world, "house"));
        assert!(
            world.scene.warnings.iter().any(|warning| warning.contains("\"ground\" (6.15 m)")),
            "{:?}",
            world.scene.warnings
        );
        // It is laid out alike whenever it comes back.
        let hidden = world.apply(&[Edit::Hide { objects: vec!["ground".into()] }]).unwrap().after;
        assert_eq!(elements(&hidden, "ground"), 0);
        let shown = hidden.apply(&[Edit::Show { objects: vec!["ground".into()] }]).unwrap().after;
        assert_eq!(elements(&shown, "ground"), of_ground);
    }

    /// Steps of `f32` are 6 cm there: no subdivision gets below, and none is tried.
    #[test]
    fn far_from_everything_elements_are_as_far_apart_as_numbers_are() {
        let far = Vec3::new(1e6, 0.0, 1e6);
        let lone = Mesh::cuboid(far, far + Vec3::splat(2.0));
        let near = Mesh::cuboid(Vec3::ZERO, Vec3::ONE);
        let object = |(name, mesh)| Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)));
        let objects = [("near", near.clone()), ("far", lone), ("near too", near)].map(object).to_vec();
        let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
        let world = World::new(Scene::from_objects(objects), &options).unwrap();
        let counts: Vec<u32> = world.objects().map(|object| object.element_count).collect();
        assert!(counts[0] == counts[2] && counts[0] > 600 && (8..500).contains(&counts[1]), "{counts:?}");
    }
}
