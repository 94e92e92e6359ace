//! An unwrap: pieces of a mesh that are nearly flat, each laid on the plane that fits it.
//!
//! A piece grows from a triangle over shared edges while its normals stay within a cone, is projected at right angles to
//! the mean of them, and gives back what lies on top of it there. So nothing is ever folded over, areas shrink by the
//! cosine to the mean at most, and the work is bounded whatever the mesh.

use std::collections::VecDeque;

use glam::{DVec2, DVec3, Vec2};

use super::raster::{for_rows, weights};
use crate::hash::FastMap;

/// Least cosine between a triangle and the mean of its piece while that grows.
const GROWS: f64 = 0.8;

/// Least cosine between a triangle and the mean of its whole piece: texels are at most twice as large as asked for.
const STAYS: f64 = 0.5;

/// Pieces that give triangles back are counted; after so many per triangle of the mesh, what is left is a piece each.
const MAX_GIVEN_BACK: usize = 4;

/// No triangle.
const NONE: u32 = u32::MAX;

/// Triangles side by side on a plane.
#[derive(Clone, Debug)]
pub(super) struct Chart {
    /// Triangles of the mesh, with where their corners lie on the plane, texels. Least and greatest coordinates are
    /// centres of texels: straight edges lie where a look-up reads one texel.
    pub triangles: Vec<Flat>,
    /// Texels across and down.
    pub size: [u32; 2],
}

/// Why there are no charts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unfit {
    /// One is wider or higher than a page: so many texels.
    TooWide(f64),
    /// All of them together take more texels than are allowed.
    TooMany,
}

/// What charts may take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Room {
    /// Longest side of a chart, texels.
    pub max_side: f64,
    /// Texels of the boxes of all charts of a mesh.
    pub max_texels: f64,
}

/// The charts of a mesh whose vertices lie at `positions` (metres), at so many texels per metre. Triangles without an
/// area are in none.
pub(super) fn charts(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    texels_per_metre: f64,
    room: Room,
) -> Result<Vec<Chart>, Unfit> {
    let normals: Vec<DVec3> = triangles.iter().map(|corners| double_area(positions, corners)).collect();
    let neighbours = neighbours(positions, triangles, &normals);
    let mut left: Vec<bool> = normals.iter().map(|n| n.length_squared() > 0.0 && n.is_finite()).collect();
    let mut seeds: Vec<u32> = (0..triangles.len() as u32).filter(|&t| left[t as usize]).collect();
    seeds.sort_by(|&a, &b| {
        let area = |t: u32| normals[t as usize].length_squared();
        area(b).total_cmp(&area(a)).then(a.cmp(&b))
    });
    let (mut charts, mut allowance, mut texels) = (Vec::new(), MAX_GIVEN_BACK * triangles.len(), 0.0);
    let mut flattener = Flattener { positions, triangles, normals: &normals, texels_per_metre, owners: Vec::new() };
    // What is given back seeds again: it is still to the left of the end.
    let mut seeds = VecDeque::from(seeds);
    while let Some(seed) = seeds.pop_front() {
        if !left[seed as usize] {
            continue;
        }
        let alone = allowance == 0;
        let piece = grow(seed, &normals, &neighbours, &mut left, alone);
        let mut flat = flattener.flat(&piece);
        turn_upright(&mut flat.kept);
        let size = to_centres(&mut flat.kept);
        if size.max_element().is_nan() || size.max_element() > room.max_side {
            return Err(Unfit::TooWide(size.max_element()));
        }
        texels += size.x * size.y;
        if texels > room.max_texels {
            return Err(Unfit::TooMany);
        }
        let (chart, back) = flattener.without_overlaps(flat, [size.x as u32, size.y as u32]);
        allowance = allowance.saturating_sub(back.len());
        for triangle in back {
            left[triangle as usize] = true;
            seeds.push_back(triangle);
        }
        charts.push(chart);
    }
    Ok(charts)
}

/// Twice the area, along the normal.
fn double_area(positions: &[DVec3], corners: &[u32; 3]) -> DVec3 {
    let [a, b, c] = corners.map(|corner| positions[corner as usize]);
    (b - a).cross(c - a)
}

/// Across each edge, the triangle that has it the other way round.
fn neighbours(positions: &[DVec3], triangles: &[[u32; 3]], normals: &[DVec3]) -> Vec<[u32; 3]> {
    let mut ids: FastMap<[u64; 3], u32> = FastMap::default();
    let mut id = |corner: u32| {
        let next = ids.len() as u32;
        // Adding zero turns −0 into 0.
        *ids.entry((positions[corner as usize] + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert(next)
    };
    let welded: Vec<[u32; 3]> = triangles.iter().map(|corners| corners.map(&mut id)).collect();
    let edge = |triangle: usize, k: usize| {
        let corners = welded[triangle];
        (corners[k], corners[(k + 1) % 3])
    };
    let mut of_edge: FastMap<(u32, u32), u32> = FastMap::default();
    let has_area = |triangle: usize| normals[triangle].length_squared() > 0.0;
    for triangle in (0..triangles.len()).filter(|&t| has_area(t)) {
        for k in 0..3 {
            of_edge.entry(edge(triangle, k)).or_insert(triangle as u32);
        }
    }
    let across = |triangle: usize, k: usize| {
        let (a, b) = edge(triangle, k);
        of_edge.get(&(b, a)).copied().unwrap_or(NONE)
    };
    (0..triangles.len()).map(|triangle| std::array::from_fn(|k| across(triangle, k))).collect()
}

/// Takes a piece out of what is left.
fn grow(seed: u32, normals: &[DVec3], neighbours: &[[u32; 3]], left: &mut [bool], alone: bool) -> Vec<u32> {
    left[seed as usize] = false;
    let (mut piece, mut sum) = (vec![seed], normals[seed as usize]);
    let mut next = 0;
    while next < piece.len() && !alone {
        for &other in &neighbours[piece[next] as usize] {
            if other == NONE || !left[other as usize] {
                continue;
            }
            let normal = normals[other as usize];
            if normal.dot(sum) >= GROWS * normal.length() * sum.length() {
                left[other as usize] = false;
                sum += normal;
                piece.push(other);
            }
        }
        next += 1;
    }
    piece
}

/// A triangle of the mesh on a plane.
type Flat = (u32, [DVec2; 3]);

/// A piece on its plane, and the triangles of it that lean too much to be there.
struct Piece {
    kept: Vec<Flat>,
    back: Vec<u32>,
}

/// Puts pieces of a mesh on planes.
struct Flattener<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    /// As long as twice the areas.
    normals: &'a [DVec3],
    texels_per_metre: f64,
    /// By texel of the chart at hand: the triangle that has it.
    owners: Vec<u32>,
}

impl Flattener<'_> {
    /// Projects a piece to the plane across its mean normal. Its first triangle always stays.
    fn flat(&self, piece: &[u32]) -> Piece {
        let first = piece[0];
        let leans = |t: u32, n: DVec3| self.normals[t as usize].dot(n) < STAYS * self.normals[t as usize].length();
        let own = self.normals[first as usize].normalize();
        let sum: DVec3 = piece.iter().map(|&t| self.normals[t as usize]).sum();
        let mean = sum.try_normalize().filter(|mean| !leans(first, *mean)).unwrap_or(own);
        let (back, kept): (Vec<u32>, Vec<u32>) = piece.iter().partition(|&&t| t != first && leans(t, mean));
        let (across, down) = mean.any_orthonormal_pair();
        let place = |corner: u32| {
            let position = self.positions[corner as usize] * self.texels_per_metre;
            DVec2::new(position.dot(across), position.dot(down))
        };
        let kept = kept.into_iter().map(|t| (t, self.triangles[t as usize].map(place))).collect();
        Piece { kept, back }
    }

    /// Leaves out of a piece of some size what lies on top of the rest.
    fn without_overlaps(&mut self, piece: Piece, size: [u32; 2]) -> (Chart, Vec<u32>) {
        let Piece { kept, mut back } = piece;
        self.owners.clear();
        if kept.len() > 1 {
            self.owners.resize(size[0] as usize * size[1] as usize, NONE);
        }
        let mut triangles: Vec<Flat> = Vec::with_capacity(kept.len());
        let is_alone = kept.len() == 1;
        for (triangle, corners) in kept {
            if is_alone || self.take(triangle, corners.map(DVec2::as_vec2), size) {
                triangles.push((triangle, corners));
            } else {
                back.push(triangle);
            }
        }
        let size = if back.is_empty() { size } else { cropped(&mut triangles) };
        (Chart { triangles, size }, back)
    }

    /// Gives a triangle the texels whose centres it covers, unless one of them is another's.
    fn take(&mut self, triangle: u32, corners: [Vec2; 3], size: [u32; 2]) -> bool {
        let index = |x: u32, y: u32| y as usize * size[0] as usize + x as usize;
        let mut is_free = true;
        for_rows(corners, 0.0, size, |x, y| is_free &= self.owners[index(x, y)] == NONE || !is_inside(corners, x, y));
        if is_free {
            for_rows(corners, 0.0, size, |x, y| {
                if is_inside(corners, x, y) {
                    self.owners[index(x, y)] = triangle;
                }
            });
        }
        is_free
    }
}

/// Turns triangles so that the box around them is small: along one of their longest edges, or in between where that is
/// better by far.
fn turn_upright(flat: &mut [Flat]) {
    const EDGES: usize = 8;
    const BETWEEN: usize = 16;
    let edges = flat.iter().flat_map(|(_, [a, b, c])| [*b - *a, *c - *b, *a - *c]);
    let mut edges: Vec<(f64, DVec2)> = edges.map(|edge| (edge.length_squared(), edge)).collect();
    edges.sort_by(|a, b| b.0.total_cmp(&a.0));
    let along = edges.iter().take(EDGES).filter_map(|(_, edge)| edge.try_normalize());
    let extent = |direction: DVec2| {
        let (low, high) = bounds(flat.iter().flat_map(|(_, corners)| corners).map(|p| turned(*p, direction)));
        (high - low).max(DVec2::ONE)
    };
    let longest = along.clone().next().unwrap_or(DVec2::X);
    let step = std::f64::consts::FRAC_PI_2 / BETWEEN as f64;
    let between = (1..BETWEEN).map(|k| DVec2::from_angle(k as f64 * step).rotate(longest));
    let mut best = (DVec2::X, DVec2::INFINITY, f64::INFINITY);
    for (direction, factor) in along.map(|direction| (direction, 1.0)).chain(between.map(|d| (d, 1.05))) {
        let extent = extent(direction);
        let area = extent.element_product() * factor;
        if area < best.2 {
            best = (direction, extent, area);
        }
    }
    // Rather wide than high.
    let direction = if best.1.y > best.1.x { best.0.perp() } else { best.0 };
    flat.iter_mut().flat_map(|(_, corners)| corners).for_each(|point| *point = turned(*point, direction));
}

fn turned(point: DVec2, direction: DVec2) -> DVec2 {
    DVec2::new(point.dot(direction), direction.perp_dot(point))
}

fn bounds(points: impl Iterator<Item = DVec2>) -> (DVec2, DVec2) {
    points.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), point| (low.min(point), high.max(point)))
}

/// Moves and widens triangles so that their box begins and ends at centres of texels; answers how many texels that is.
fn to_centres(flat: &mut [Flat]) -> DVec2 {
    /// Texels that are rounding.
    const ROUNDING: f64 = 1e-3;
    let (low, high) = bounds(flat.iter().flat_map(|(_, corners)| corners).copied());
    let size = high - low;
    let cells = size.map(|side| (side - ROUNDING).ceil().max(1.0));
    let stretch = DVec2::select(size.cmpgt(DVec2::ZERO), cells / size, DVec2::ZERO);
    let points = flat.iter_mut().flat_map(|(_, corners)| corners);
    points.for_each(|point| *point = (*point - low) * stretch + 0.5);
    cells + 1.0
}

/// Takes away the rows and columns of texels that nothing is on; answers how many texels are left.
fn cropped(flat: &mut [Flat]) -> [u32; 2] {
    let (low, high) = bounds(flat.iter().flat_map(|(_, corners)| corners).copied());
    let first = (low - 0.5).floor();
    flat.iter_mut().flat_map(|(_, corners)| corners).for_each(|point| *point -= first);
    let size = (high - first - 0.5).ceil() + 1.0;
    [size.x as u32, size.y as u32]
}

/// Whether a texel's centre is within a triangle, and not just on an edge.
pub(super) fn is_inside(corners: [Vec2; 3], x: u32, y: u32) -> bool {
    const EDGE: f64 = 1e-4;
    let centre = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
    weights(corners, centre).is_some_and(|weights| weights.iter().all(|w| *w > EDGE))
}
