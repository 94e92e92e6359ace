//! Seams: where a smooth surface is cut, look-ups on either side of the cut are made to agree.
//!
//! Both sides read the same field, but between other texels. Texels beside cuts change a little, by least squares: the
//! differences of bilinear look-ups along all cuts of an object, those of look-ups along borders to other objects from what
//! both are to have there, and what the texels differ from what they were. The
//! iteration has a fixed number of steps whose coefficients are fixed, too, so that it is linear: sums of layers stay
//! sums.

use glam::{Vec2, Vec3};

use crate::atlas::Entry;
use crate::hash::FastMap;
use crate::surface::Surface;

/// What a change of a texel counts beside a difference of look-ups.
const STAY: f32 = 0.03;

/// Look-ups per texel of a seam.
const PER_TEXEL: f32 = 2.0;

/// Most look-ups of one edge.
const MOST: usize = 8192;

const STEPS: usize = 40;

const NONE: u32 = u32::MAX;

/// Places of both ends of an edge, in two triangles.
pub(super) type Seam = [[Vec2; 2]; 2];

/// Look-ups along an edge of so many texels, less one.
pub(super) fn look_ups(length: f32) -> usize {
    ((length * PER_TEXEL).ceil() as usize).clamp(1, MOST)
}

/// Changes `values` (per texel of a rectangle `width` wide) so that look-ups agree across seams, and find the targets that
/// there are for some places. Texels that are not valid are left alone, and so are edges beside them.
pub(super) fn close((seams, targets): (&[Seam], &[(Vec2, Vec3)]), width: usize, valid: &[bool], values: &mut [Vec3]) {
    let mut system = System::new(valid);
    seams.iter().for_each(|seam| system.add_seam(seam, width));
    targets.iter().filter(|(_, value)| value.is_finite()).for_each(|(at, value)| system.add_target(*at, *value, width));
    let own: Vec<Vec3> = system.texels.iter().map(|&texel| values[texel as usize]).collect();
    if own.is_empty() || own.iter().any(|value| !value.is_finite()) {
        return;
    }
    for ((&texel, own), change) in system.texels.iter().zip(&own).zip(system.changes(&own)) {
        // Light stays light; noise may have either sign.
        values[texel as usize] = (*own + change).max(own.min(Vec3::ZERO));
    }
}

/// Edges that two triangles share, normals at their ends included, and that lie apart in the rectangle.
pub(super) fn seams(surface: &Surface, entry: &Entry) -> Vec<Seam> {
    const SAME: f32 = 1e-2;
    let places: Vec<[Vec2; 3]> = surface.sources.iter().map(|source| entry.places_of(*source)).collect();
    let mut of_edge: FastMap<(u32, u32), (u32, u32)> = FastMap::default();
    let edges = |face: usize| (0..3).map(move |k| (k, (k + 1) % 3, face));
    for (from, to, face) in (0..places.len()).flat_map(edges) {
        let corners = surface.triangles[face];
        of_edge.entry((corners[from], corners[to])).or_insert((face as u32, from as u32));
    }
    let seam = |(from, to, face): (usize, usize, usize)| {
        let corners = surface.triangles[face];
        let &(other, first) = of_edge.get(&(corners[to], corners[from]))?;
        let (other, first) = (other as usize, first as usize);
        let here = [places[face][from], places[face][to]];
        let there = [places[other][(first + 1) % 3], places[other][first]];
        let is_cut = here.iter().zip(&there).any(|(a, b)| (*a - *b).abs().max_element() > SAME);
        (face < other && is_cut).then_some([here, there])
    };
    (0..places.len()).flat_map(edges).filter_map(seam).collect()
}

/// Look-ups, and differences of two, as a sparse matrix, and what they are to be.
struct System<'v> {
    valid: &'v [bool],
    /// By texel: its index in `texels`.
    indices: Vec<u32>,
    /// The texels that they read.
    texels: Vec<u32>,
    /// Of each: indices into `texels`, with weights.
    rows: Vec<[(u32, f32); 8]>,
    /// Per row.
    wanted: Vec<Vec3>,
}

impl System<'_> {
    fn new(valid: &[bool]) -> System<'_> {
        System { valid, indices: vec![NONE; valid.len()], texels: Vec::new(), rows: Vec::new(), wanted: Vec::new() }
    }

    fn add_seam(&mut self, [here, there]: &Seam, width: usize) {
        let longest = (here[0] - here[1]).length().max((there[0] - there[1]).length());
        let count = look_ups(longest);
        for k in 0..=count {
            let at = k as f32 / count as f32;
            let sides = [here, there].map(|ends| look_up(ends[0].lerp(ends[1], at), width));
            let entries = [(0, 1.0), (1, -1.0)].map(|(side, sign)| sides[side].map(|(texel, w)| (texel, w * sign)));
            self.add(entries.as_flattened(), Vec3::ZERO);
        }
    }

    fn add_target(&mut self, at: Vec2, value: Vec3, width: usize) {
        self.add(&look_up(at, width), value);
    }

    /// A row, unless it reads texels that are not valid.
    fn add(&mut self, entries: &[(usize, f32)], wanted: Vec3) {
        let is_read = |(texel, w): &(usize, f32)| *w == 0.0 || self.valid.get(*texel).is_some_and(|valid| *valid);
        if !entries.iter().all(is_read) {
            return;
        }
        let mut row = [(0, 0.0); 8];
        for (entry, &(texel, weight)) in row.iter_mut().zip(entries).filter(|(_, (_, weight))| *weight != 0.0) {
            let index = &mut self.indices[texel];
            if *index == NONE {
                *index = self.texels.len() as u32;
                self.texels.push(texel as u32);
            }
            *entry = (*index, weight);
        }
        self.rows.push(row);
        self.wanted.push(wanted);
    }

    /// Aᵀ (A x − b), without b where it is not to count.
    fn normal(&self, x: &[Vec3], wanted: Option<&[Vec3]>) -> Vec<Vec3> {
        let mut result = vec![Vec3::ZERO; x.len()];
        for (index, row) in self.rows.iter().enumerate() {
            let found: Vec3 = row.iter().map(|&(k, weight)| x[k as usize] * weight).sum();
            let difference = wanted.map_or(found, |wanted| found - wanted[index]);
            row.iter().for_each(|&(k, weight)| result[k as usize] += difference * weight);
        }
        result
    }

    /// The least squares: (AᵀA + s) d = Aᵀ (b − A x), by Chebyshev's iteration.
    fn changes(&self, values: &[Vec3]) -> Vec<Vec3> {
        let mut sums = vec![0.0; values.len()];
        self.rows.iter().flatten().for_each(|&(k, weight)| sums[k as usize] += weight.abs());
        // No eigenvalue of AᵀA is above the product of the largest sums of a row, 2, and a column.
        let most = 2.0 * sums.into_iter().fold(0.0, f32::max) + STAY;
        let (middle, half) = (0.5 * (most + STAY), 0.5 * (most - STAY));
        let mut residual: Vec<Vec3> = self.normal(values, Some(&self.wanted)).into_iter().map(|part| -part).collect();
        let mut changes = vec![Vec3::ZERO; values.len()];
        let (mut direction, mut alpha) = (residual.clone(), 1.0 / middle);
        for step in 0..STEPS {
            if step > 0 {
                let beta = if step == 1 { 0.5 } else { 0.25 } * (half * alpha).powi(2);
                alpha = 1.0 / (middle - beta / alpha);
                direction.iter_mut().zip(&residual).for_each(|(d, r)| *d = *r + *d * beta);
            }
            changes.iter_mut().zip(&direction).for_each(|(change, d)| *change += *d * alpha);
            let applied = self.normal(&direction, None);
            for ((r, d), applied) in residual.iter_mut().zip(&direction).zip(applied) {
                *r -= (applied + *d * STAY) * alpha;
            }
        }
        changes
    }
}

/// The texels that a bilinear look-up reads, and their weights.
pub(super) fn look_up(at: Vec2, width: usize) -> [(usize, f32); 4] {
    let at = at - 0.5;
    let (low, part) = (at.floor(), at - at.floor());
    let (x, y) = (low.x as usize, low.y as usize);
    let texel = |dx: usize, dy: usize| {
        let weight = |step: usize, part: f32| if step == 1 { part } else { 1.0 - part };
        ((y + dy) * width + x + dx, weight(dx, part.x) * weight(dy, part.y))
    };
    [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)]
}
