//! The elements of one object's surface.

use glam::{DMat4, Vec3};

use super::cells::{Cells, NONE, Patch};
use super::decimate::{Decimated, Fine};
use super::elements::sample_points;
use super::neighbours::Neighbours;
use super::reads::Read;
use super::sizing::Sizing;
use super::subdivide::{Subdivided, subdivide};
use crate::order::{along_curve, in_order};
use crate::surface::{
    ROUNDED, Surface, SurfaceError, barycentrics, moved_normals, moved_points, overlap, triangle_area,
};

/// How the elements of one side of a surface are laid out; moving the surface leaves it as it is.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layout {
    pub(super) cells: Cells,
    neighbours: Neighbours,
    /// How far from the corners of its cells an element may be, m.
    reach: f32,
}

/// What elements are, before they have slots.
#[derive(Clone, Debug, Default)]
pub(crate) struct Elements {
    /// Where they are evaluated, scene space: a corner of cells, or a little inside of it at borders and hard edges.
    pub positions: Vec<Vec3>,
    /// Unit.
    pub normals: Vec<Vec3>,
    /// A third of the area of the cells at each, m²; always above zero. They sum to the area of the surface.
    pub areas: Vec<f32>,
}

/// Lifts elements off flat triangles to the round surface that shading normals promise, or rays that start on them
/// would meet the next triangle beside the terminator (Hanika 2021, Hacking the Shadow Terminator): by the distance to
/// the tangent planes at the triangle's vertices, where those lie above. Flat and hollow surfaces stay as they are.
fn raise(surface: &Surface, cells: &Cells, positions: &mut [Vec3]) {
    let is_round = |face: u32| {
        let [a, b, c] = surface.triangles[face as usize].map(|vertex| surface.normals[vertex as usize]);
        a != b || b != c
    };
    let of_round = |patch: &Patch| is_round(patch.face).then_some((patch.face, patch.elements));
    let round = cells.collect(surface, |_| true, of_round);
    let mut is_raised = vec![false; if round.is_empty() { 0 } else { positions.len() }];
    for (face, element) in round.into_iter().flat_map(|(face, elements)| elements.map(|e| (face, e as usize))) {
        if std::mem::replace(&mut is_raised[element], true) {
            continue;
        }
        let point = positions[element];
        let vertices = surface.triangles[face as usize].map(|v| v as usize);
        let weights = barycentrics(point, surface.corners(face as usize));
        let lift = |(vertex, weight): (usize, f32)| {
            let normal = surface.normals[vertex];
            normal * (weight * (surface.positions[vertex] - point).dot(normal).max(0.0))
        };
        positions[element] = point + vertices.into_iter().zip(weights).map(lift).sum::<Vec3>();
    }
}

/// How far apart elements are to lie.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Distances<'s> {
    /// m
    pub spacing: f32,
    /// In place of the spacing.
    pub sizing: Option<&'s Sizing>,
    /// Corners share elements as if these were to lie at most so far apart, m: less than the spacing where what a file has
    /// finer than that is to be kept.
    pub shared: f32,
}

impl Distances<'_> {
    /// Equally far, m.
    pub(crate) fn even(spacing: f32) -> Distances<'static> {
        Distances { spacing, sizing: None, shared: f32::INFINITY }
    }
}

/// The corners of all cells of a surface, along a curve.
struct Arranged {
    cells: Cells,
    /// Scene space; per corner.
    positions: Vec<Vec3>,
    /// Unit.
    normals: Vec<Vec3>,
    /// Which of them are no elements; none where all are.
    decimated: Option<Decimated>,
}

impl Arranged {
    fn new(surface: &Surface, subdivided: Subdivided, distances: &Distances) -> Arranged {
        let Subdivided { positions, normals, mut cells } = subdivided;
        let order = along_curve(&positions);
        let mut number = vec![NONE; positions.len()];
        order.iter().zip(0..).for_each(|(&old, new)| number[old as usize] = new);
        cells.renumber(&number);
        let (positions, normals) = (in_order(&positions, &order), in_order(&normals, &order));
        let triangles = cells.collect(surface, |_| true, |patch| Some(patch.elements));
        let fine = Fine { positions: &positions, normals: &normals, triangles: &triangles };
        let Distances { spacing, sizing, shared } = *distances;
        let decimated = match sizing {
            None => fine.decimated(|_| spacing.min(shared), spacing.min(shared)),
            Some(sizing) => fine.decimated(|point| sizing.at(point).min(shared), sizing.largest().min(shared)),
        };
        Arranged { cells, positions, normals, decimated }
    }
}

/// All cells, before any share elements. There may be as many elements more than `limit` as the surface has vertices: these
/// may be the ones that are shared.
fn subdivided(surface: &Surface, distances: &Distances, limit: usize) -> Result<Subdivided, SurfaceError> {
    let Distances { spacing, sizing, .. } = *distances;
    if sizing.is_none() && !(spacing.is_finite() && spacing > 0.0) {
        return Err(SurfaceError::Spacing(spacing));
    }
    // Elements are numbered with 32 bits.
    let room = limit.saturating_add(surface.positions.len()).min(u32::MAX as usize);
    if surface.positions.len() > room {
        return Err(SurfaceError::TooManyElements { limit });
    }
    let too_many = |error| match error {
        SurfaceError::TooManyElements { .. } => SurfaceError::TooManyElements { limit },
        error => error,
    };
    subdivide(surface, spacing, sizing, room).map_err(too_many)
}

fn check_count(count: usize, limit: usize) -> Result<usize, SurfaceError> {
    if count > limit { Err(SurfaceError::TooManyElements { limit }) } else { Ok(count) }
}

impl Elements {
    /// These elements after a rigid motion in scene space.
    pub(crate) fn transformed(&self, motion: &DMat4) -> Elements {
        Elements {
            positions: moved_points(motion, &self.positions),
            normals: moved_normals(motion, &self.normals),
            areas: self.areas.clone(),
        }
    }

    /// Distance of the farthest one from the zero of scene space, m.
    pub(crate) fn reach(&self) -> f32 {
        self.positions.iter().map(|p| p.length_squared()).fold(0.0, f32::max).sqrt()
    }
}

impl Layout {
    /// Divides the triangles of a surface until neighbouring elements are about as far apart as asked for, with one spacing at
    /// most 1.12 times as much; corners that are closer by far share elements. Deterministic, and edges that two objects
    /// share get the same elements in both, where none are shared.
    ///
    /// # Errors
    /// [`SurfaceError`]: a spacing that is not usable, or more than `max_elements` elements.
    pub(crate) fn new(
        surface: &Surface,
        distances: &Distances,
        max_elements: usize,
    ) -> Result<(Layout, Elements), SurfaceError> {
        let subdivided = subdivided(surface, distances, max_elements)?;
        let Arranged { mut cells, positions, normals, decimated } = Arranged::new(surface, subdivided, distances);
        // Rounding to f32 may flatten the smallest cells.
        let has_area = |elements: &[u32; 3]| triangle_area(elements.map(|e| positions[e as usize])) > 0.0;
        let triangles = cells.collect(surface, |_| true, |patch| Some(patch.elements).filter(has_area));
        let mut elements = sample_points(&positions, &normals, &triangles);
        raise(surface, &cells, &mut elements.positions);
        if let Some(Decimated { reads, placed }) = decimated {
            for (element, at, normal) in placed {
                (elements.positions[element as usize], elements.normals[element as usize]) = (at, normal);
            }
            elements = cells.share(surface, reads, &elements);
        }
        check_count(elements.positions.len(), max_elements)?;
        let of_cells = cells.collect(surface, |_| true, |patch| Some(patch.elements));
        let neighbours = Neighbours::new(elements.positions.len(), &of_cells);
        let distance = |patch: &Patch| {
            let at = patch.elements.map(|element| elements.positions[element as usize]);
            Some((0..3).map(|k| at[k].distance(patch.corners[k])).fold(0.0, f32::max))
        };
        let reach = cells.collect(surface, |_| true, distance).into_iter().fold(0.0, f32::max);
        Ok((Layout { cells, neighbours, reach }, elements))
    }

    /// Elements that [`Layout::new`] would lay out.
    ///
    /// # Errors
    /// As it has.
    pub(crate) fn count(surface: &Surface, distances: &Distances, max_elements: usize) -> Result<usize, SurfaceError> {
        let subdivided = subdivided(surface, distances, max_elements)?;
        let Subdivided { positions, normals, cells } = &subdivided;
        let triangles = cells.collect(surface, |_| true, |patch| Some(patch.elements));
        let (count, fine) = (positions.len(), Fine { positions, normals, triangles: &triangles });
        // Which ones are left goes by their order.
        let is_dense = fine.is_dense(distances.spacing.min(distances.shared));
        let decimated = is_dense.then(|| Arranged::new(surface, subdivided, distances).decimated).flatten();
        check_count(decimated.map_or(count, |decimated| decimated.left()), max_elements)
    }

    /// Ids of cells are below this.
    pub(super) fn ids(&self) -> u32 {
        self.cells.ids()
    }

    /// What `f` makes of every cell of a surface that is laid out so, in an order that depends on nothing but the
    /// layout.
    pub(crate) fn of_cells<T: Send>(&self, surface: &Surface, f: impl Fn(&Patch) -> Option<T> + Sync) -> Vec<T> {
        self.cells.collect(surface, |_| true, f)
    }

    /// What `f` makes of those cells of a surface that is laid out so which some of the `boxes` may touch, be it at an
    /// element of theirs, and perhaps of others beside them; in an order that depends on nothing but the layout.
    pub(crate) fn of_cells_in<T: Send>(
        &self,
        surface: &Surface,
        boxes: &[(Vec3, Vec3)],
        f: impl Fn(&Patch) -> Option<T> + Sync,
    ) -> Vec<T> {
        let reach = Vec3::splat(ROUNDED * self.reach);
        let grown: Vec<(Vec3, Vec3)> = boxes.iter().map(|(low, high)| (*low - reach, *high + reach)).collect();
        self.cells.collect(surface, |patch| grown.iter().any(|b| overlap(b, &patch.bounds())), f)
    }

    /// Where the cells of a surface that is laid out so have their corners, per element; scene space.
    pub(crate) fn corners(&self, surface: &Surface) -> Vec<Vec3> {
        let mut corners = vec![Vec3::ZERO; self.len()];
        let cells = self.of_cells(surface, |patch| Some((self.cells.reads_of(patch), patch.corners)));
        for (read, corner) in cells.into_iter().flat_map(|(reads, at)| reads.into_iter().zip(at)) {
            if read.is_one() {
                corners[read.elements[0] as usize] = corner;
            }
        }
        corners
    }

    /// What the corners of a cell read.
    pub(crate) fn reads_of(&self, patch: &Patch) -> [Read; 3] {
        self.cells.reads_of(patch)
    }

    /// Whether some of its corners are no elements.
    pub(crate) fn is_shared(&self) -> bool {
        !self.cells.reads.is_empty()
    }

    /// Elements of one side.
    pub(crate) fn len(&self) -> usize {
        self.neighbours.len()
    }

    /// Elements beside one along the surface, each once, ascending.
    #[inline]
    pub(crate) fn neighbours_of(&self, element: u32) -> impl Iterator<Item = u32> + Clone + '_ {
        self.neighbours.of(element)
    }

    /// Cells of one side.
    pub(crate) fn cell_count(&self) -> usize {
        self.cells.count as usize
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.cells.memory_bytes() + self.neighbours.memory_bytes()
    }
}
