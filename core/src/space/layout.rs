//! The elements of one object's surface.

use glam::{DMat4, Vec3};

use super::cells::{Cells, NONE, Patch};
use super::elements::sample_points;
use super::neighbours::Neighbours;
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
    /// Divides the triangles of a surface until neighbouring elements are about `spacing` metres apart, at most 1.12
    /// times as much. Deterministic, and edges that two objects share get the same elements in both.
    ///
    /// # Errors
    /// [`SurfaceError`]: a spacing that is not usable, or more than `max_elements` elements.
    pub(crate) fn new(
        surface: &Surface,
        spacing: f32,
        max_elements: usize,
    ) -> Result<(Layout, Elements), SurfaceError> {
        if !(spacing.is_finite() && spacing > 0.0) {
            return Err(SurfaceError::Spacing(spacing));
        }
        Layout::divided(surface, (spacing, None), max_elements)
    }

    /// Divides the triangles of a surface until neighbouring elements are about as far apart as sizes say there. As
    /// [`Layout::new`] otherwise.
    ///
    /// # Errors
    /// [`SurfaceError`]: more than `max_elements` elements.
    pub(crate) fn by_sizes(
        surface: &Surface,
        sizing: &Sizing,
        max_elements: usize,
    ) -> Result<(Layout, Elements), SurfaceError> {
        Layout::divided(surface, (f32::INFINITY, Some(sizing)), max_elements)
    }

    fn divided(
        surface: &Surface,
        (spacing, sizing): (f32, Option<&Sizing>),
        max_elements: usize,
    ) -> Result<(Layout, Elements), SurfaceError> {
        // Elements are numbered with 32 bits.
        let limit = max_elements.min(u32::MAX as usize);
        if surface.positions.len() > limit {
            return Err(SurfaceError::TooManyElements { limit });
        }
        let Subdivided { positions, normals, mut cells } = subdivide(surface, spacing, sizing, limit)?;
        let order = along_curve(&positions);
        let mut number = vec![NONE; positions.len()];
        order.iter().zip(0..).for_each(|(&old, new)| number[old as usize] = new);
        cells.renumber(&number);
        let (corners, normals) = (in_order(&positions, &order), in_order(&normals, &order));
        // Rounding to f32 may flatten the smallest cells.
        let has_area = |elements: &[u32; 3]| triangle_area(elements.map(|e| corners[e as usize])) > 0.0;
        let of_cells = cells.collect(surface, |_| true, |patch| Some(patch.elements));
        let neighbours = Neighbours::new(corners.len(), &of_cells);
        let triangles: Vec<[u32; 3]> = of_cells.into_iter().filter(has_area).collect();
        let mut elements = sample_points(&corners, &normals, &triangles);
        raise(surface, &cells, &mut elements.positions);
        let distances = elements.positions.iter().zip(&corners).map(|(element, corner)| element.distance(*corner));
        let reach = distances.fold(0.0, f32::max);
        Ok((Layout { cells, neighbours, reach }, elements))
    }

    /// Elements that [`Layout::new`] would lay out.
    ///
    /// # Errors
    /// As it has.
    pub(crate) fn count(surface: &Surface, spacing: f32, max_elements: usize) -> Result<usize, SurfaceError> {
        let limit = max_elements.min(u32::MAX as usize);
        subdivide(surface, spacing, None, limit).map(|subdivided| subdivided.positions.len())
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
        for (elements, at) in self.of_cells(surface, |patch| Some((patch.elements, patch.corners))) {
            elements.into_iter().zip(at).for_each(|(element, corner)| corners[element as usize] = corner);
        }
        corners
    }

    /// Elements of one side.
    pub(crate) fn len(&self) -> usize {
        self.neighbours.len()
    }

    /// Elements beside one along the surface, each once, ascending.
    #[inline]
    pub(crate) fn neighbours_of(&self, element: u32) -> &[u32] {
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
