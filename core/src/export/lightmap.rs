//! A world's light map as a file.

use glam::Vec3;

use super::{EXR_WIDTH, ExportError, MeshExport, ObjectExport, write_exr, write_glb, write_object_glb};
use crate::scene::{LightKind, Material};
use crate::space::Patch;
use crate::world::World;

/// The subdivided mesh with `values` (per slot) as float `COLOR_0`. Backs that have elements are triangles of their
/// own, wound the other way. Vertices are in the order of slots.
///
/// # Errors
/// [`ExportError`]: values that do not fit the world or are not finite, more than the format can hold.
pub fn lightmap_glb(world: &World, values: &[Vec3]) -> Result<Vec<u8>, ExportError> {
    if values.len() != world.slots() {
        return Err(ExportError::Lists("the light map".to_owned()));
    }
    let pieces: Vec<Piece> = (0..world.placed.len()).map(|index| Piece::new(world, index)).collect();
    let meshes: Vec<MeshExport> = pieces.iter().map(|p| p.export(world, values)).collect();
    write_glb(&meshes, world.scene.origin)
}

/// One object of a world, by its position in [`World::objects`], with `values` (per slot) as the light of its
/// elements: see [`write_object_glb`]. None where there is no such object.
///
/// # Errors
/// [`ExportError`]: values that do not fit the world or are not finite, more than the format can hold.
pub fn object_glb(world: &World, index: usize, values: &[Vec3]) -> Option<Result<Vec<u8>, ExportError>> {
    let (placed, object) = (world.placed.get(index)?, &world.scene.objects[index]);
    if values.len() != world.slots() {
        return Some(Err(ExportError::Lists("the light map".to_owned())));
    }
    let piece = Piece::new(world, index);
    Some(write_object_glb(&ObjectExport {
        object,
        lights: &world.scene.lights,
        elements: piece.export(world, values),
        origin: world.scene.origin,
        first_element: placed.placement.elements.start,
        with_back: placed.with_back,
    }))
}

/// `values` (per slot) as an OpenEXR picture of one pixel per slot.
///
/// # Errors
/// [`ExportError`]: no values, more than the format can hold.
pub fn lightmap_exr(values: &[Vec3]) -> Result<Vec<u8>, ExportError> {
    write_exr(&[("", values)], EXR_WIDTH, &[])
}

/// One object's lists that are not stored as they are exported.
struct Piece {
    index: usize,
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    triangle_materials: Vec<u32>,
    materials: Vec<Material>,
    opacities: Vec<f32>,
}

impl Piece {
    fn new(world: &World, index: usize) -> Piece {
        let (placed, object) = (&world.placed[index], &world.scene.objects[index]);
        let n = placed.layout.len();
        let cells = placed.layout.of_cells(&placed.surface, |patch| Some(*patch));
        let material = |patch: &Patch| placed.surface.triangle_materials[patch.face as usize];
        let mut piece = Piece {
            index,
            positions: placed.layout.corners(&placed.surface),
            normals: world.normals().copy(placed.placement.element_indices()),
            triangles: cells.iter().map(|patch| patch.elements).collect(),
            triangle_materials: cells.iter().map(material).collect(),
            materials: object.materials.clone(),
            opacities: (0..object.materials.len()).map(|material| object.mean_opacity(material)).collect(),
        };
        if placed.with_back {
            piece.positions.extend_from_within(..);
            let back = |[a, b, c]: [u32; 3]| [a, c, b].map(|element| element + n as u32);
            piece.triangles.extend(cells.iter().map(|patch| back(patch.elements)));
            piece.triangle_materials.extend_from_within(..);
            // Both copies drawn from either side would show one side's light on the other.
            piece.materials.iter_mut().for_each(|material| material.double_sided = false);
        }
        // The radiance in force is that of the light, not of the upload; of a texture the mean is written.
        for (number, material) in piece.materials.iter_mut().enumerate() {
            let of_this = |kind: &LightKind| {
                matches!(kind, LightKind::Emissive { object: o, material: m }
                    if *o == object.name && *m as usize == number)
            };
            let light = world.scene.lights.iter().find(|l| of_this(&l.kind));
            material.emission = light.map_or(Vec3::ZERO, |l| l.strength() * object.mean_emission(number));
        }
        piece
    }

    fn export<'a>(&'a self, world: &'a World, values: &'a [Vec3]) -> MeshExport<'a> {
        let range = world.placed[self.index].placement.element_indices();
        MeshExport {
            name: &world.scene.objects[self.index].name,
            positions: &self.positions,
            normals: &self.normals,
            colors: &values[range],
            triangles: &self.triangles,
            triangle_materials: &self.triangle_materials,
            materials: &self.materials,
            opacities: &self.opacities,
        }
    }
}
