//! A world's light map as a file.

use glam::Vec3;

use super::{EXR_WIDTH, ExportError, MeshExport, ObjectExport, write_exr, write_glb, write_object_glb};
use crate::hash::FastMap;
use crate::scene::{LightKind, Material};
use crate::space::{Patch, Read};
use crate::world::{Placed, World};

/// The subdivided mesh with `values` (per slot) as float `COLOR_0`. Backs that have elements are triangles of their
/// own, wound the other way. Vertices are in the order of slots; those of the file that share elements follow, and corners of
/// cells that reach into walls, with what they read ([`write_glb`]).
///
/// # Errors
/// [`ExportError`]: values that do not fit the world or are not finite, more than the format can hold.
pub fn lightmap_glb(world: &World, values: &[Vec3]) -> Result<Vec<u8>, ExportError> {
    if values.len() != world.slots() {
        return Err(ExportError::Lists("the light map".to_owned()));
    }
    let pieces: Vec<Piece> = (0..world.placed.len()).map(|index| Piece::new(world, index)).collect();
    let mut mixed: Vec<Mixed> = pieces.iter().map(|_| Mixed::default()).collect();
    let meshes: Vec<MeshExport> =
        pieces.iter().zip(&mut mixed).map(|(piece, mixed)| piece.export(world, values, mixed)).collect();
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
    let (piece, mut mixed) = (Piece::new(world, index), Mixed::default());
    Some(write_object_glb(&ObjectExport {
        object,
        lights: &world.scene.lights,
        elements: piece.export(world, values, &mut mixed),
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

/// Corners of cells so near to each other, over their longest edge, are one: each cell computes its own.
const SAME: f32 = 1e-3;

/// One object's lists that are not stored as they are exported.
struct Piece {
    index: usize,
    /// Elements first, those of the front before those of the back.
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    /// Per vertex, where some are no elements.
    reads: Vec<Read>,
    triangles: Vec<[u32; 3]>,
    triangle_materials: Vec<u32>,
    materials: Vec<Material>,
    opacities: Vec<f32>,
}

impl Piece {
    fn new(world: &World, index: usize) -> Piece {
        let (placed, object) = (&world.placed[index], &world.scene.objects[index]);
        let cells = placed.layout.of_cells(&placed.surface, |patch| Some(*patch));
        let material = |patch: &Patch| placed.surface.triangle_materials[patch.face as usize];
        let corners = placed.layout.corners(&placed.surface);
        let sides = placed.sides().count();
        let mut piece = Piece {
            index,
            positions: corners.repeat(sides),
            normals: world.normals().copy(placed.placement.element_indices()),
            reads: Vec::new(),
            triangles: Vec::new(),
            triangle_materials: cells.iter().map(material).collect::<Vec<_>>().repeat(sides),
            materials: object.materials.clone(),
            opacities: (0..object.materials.len()).map(|material| object.mean_opacity(material)).collect(),
        };
        for is_back in [false, true].into_iter().take(sides) {
            piece.add_cells(world, placed, &cells, is_back);
        }
        if placed.with_back {
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

    /// The triangles of one side. Corners that are no elements, or show others, become vertices of their own.
    fn add_cells(&mut self, world: &World, placed: &Placed, cells: &[Patch], is_back: bool) {
        let first = if is_back { placed.layout.len() as u32 } else { 0 };
        // By position, elements read and their weights.
        let mut known: FastMap<[[u32; 3]; 3], u32> = FastMap::default();
        for patch in cells {
            let reads = world.shown_at(placed, patch, is_back);
            let [a, b, c] = patch.corners;
            let rounding = SAME * a.distance(b).max(b.distance(c)).max(c.distance(a));
            let [a, b, c] = [0, 1, 2].map(|k| {
                let (read, at) = (reads[k].after(first), patch.corners[k]);
                let is_there = |element: u32| self.positions[element as usize].distance(at) <= rounding;
                let is_own = patch.elements[k] + first == read.elements[0];
                if read.is_one() && if placed.layout.is_shared() { is_there(read.elements[0]) } else { is_own } {
                    return read.elements[0];
                }
                let key = [at.to_array().map(f32::to_bits), read.elements, read.weights.map(f32::to_bits)];
                *known.entry(key).or_insert_with(|| {
                    let of_surface = placed.surface.normals[placed.surface.triangles[patch.face as usize][k] as usize];
                    let normal = match placed.layout.is_shared() {
                        true if is_back => -of_surface,
                        true => of_surface,
                        false => self.normals[(patch.elements[k] + first) as usize],
                    };
                    self.add_vertex(at, normal, read)
                })
            });
            self.triangles.push(if is_back { [a, c, b] } else { [a, b, c] });
        }
    }

    fn add_vertex(&mut self, at: Vec3, normal: Vec3, read: Read) -> u32 {
        let there = self.positions.len() as u32;
        if self.reads.is_empty() {
            self.reads = (0..there).map(Read::own).collect();
        }
        self.positions.push(at);
        self.normals.push(normal);
        self.reads.push(read);
        there
    }

    fn export<'a>(&'a self, world: &'a World, values: &'a [Vec3], mixed: &'a mut Mixed) -> MeshExport<'a> {
        let values = &values[world.placed[self.index].placement.element_indices()];
        if !self.reads.is_empty() {
            mixed.colors = self.reads.iter().map(|read| read.of(values)).collect();
            mixed.elements =
                self.reads.iter().map(|read| Vec3::from(read.elements.map(|element| element as f32))).collect();
            mixed.weights = self.reads.iter().map(|read| Vec3::from(read.weights)).collect();
        }
        MeshExport {
            name: &world.scene.objects[self.index].name,
            positions: &self.positions,
            normals: &self.normals,
            colors: if self.reads.is_empty() { values } else { &mixed.colors },
            reads: (&mixed.elements, &mixed.weights),
            triangles: &self.triangles,
            triangle_materials: &self.triangle_materials,
            materials: &self.materials,
            opacities: &self.opacities,
        }
    }
}

/// What is made for an export alone, per vertex: light, elements and weights. Empty where every vertex is an element.
#[derive(Default)]
struct Mixed {
    colors: Vec<Vec3>,
    elements: Vec<Vec3>,
    weights: Vec<Vec3>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Mesh, Object, Scene};
    use crate::world::WorldOptions;

    /// A wall of 10 cm between a lit room and a dark one, with a single row of the floor's elements in it, wherever it stands.
    #[test]
    fn cells_at_a_wall_have_the_light_of_their_own_side() {
        let mut rows_inside = 0;
        for step in 0..8 {
            let wall = 1.5 + 0.0125 * step as f32;
            let grey = |name: &str, mesh| Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)));
            let room = Mesh::cuboid(Vec3::ZERO, Vec3::new(3.0, 1.0, 1.5)).inside_out();
            let between = Mesh::cuboid(Vec3::new(wall, -0.1, -0.1), Vec3::new(wall + 0.1, 1.1, 1.6));
            let objects = vec![grey("room", room), grey("wall", between)];
            let options = WorldOptions { spacing: Some(0.1), ..WorldOptions::default() };
            let world = World::new(Scene::from_objects(objects), &options).expect("a room");
            let mut values: Vec<Vec3> =
                world.positions().iter().map(|p| if p.x < wall + 0.05 { Vec3::ONE } else { Vec3::ZERO }).collect();
            world.validity.fill(&mut values);
            let (piece, mut mixed) = (Piece::new(&world, 0), Mixed::default());
            let export = piece.export(&world, &values, &mut mixed);
            // Where the wall meets an edge of the room, half of what an element sees is the room.
            let is_at_edge = |vertex: &u32| {
                let at = export.positions[*vertex as usize];
                (at.y - 0.5).abs() > 0.49 && (at.z - 0.75).abs() > 0.74
            };
            for triangle in export.triangles.iter().filter(|triangle| !triangle.iter().any(is_at_edge)) {
                let corners =
                    triangle.map(|vertex| (export.positions[vertex as usize].x, export.colors[vertex as usize].x));
                let is_in_wall = |x: f32| (wall - 1e-3..wall + 0.101).contains(&x);
                rows_inside += corners.iter().filter(|(x, _)| is_in_wall(*x)).count();
                let own = corners.iter().find(|(x, _)| !is_in_wall(*x));
                let Some(&(x, light)) = own else { continue };
                assert_eq!(light, if x < wall { 1.0 } else { 0.0 });
                assert!(corners.iter().all(|(_, other)| *other == light), "{corners:?}, wall at {wall}");
            }
        }
        assert!(rows_inside > 1000, "{rows_inside}");
    }
}
