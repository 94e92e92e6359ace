//! Invariants of layouts: no cracks, no long edges, nothing more than light needs; a point is found in its cell.

mod shared;

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat4, DVec3, Vec3};

use super::*;
use crate::random::Pcg32;
use crate::sampling::uniform_barycentrics;
use crate::scene::{Material, Mesh, Object};
use crate::surface::SurfaceError;

const LIMIT: usize = 1_000_000;

/// A surface with its elements.
struct Laid {
    surface: Surface,
    layout: Layout,
    elements: Elements,
}

impl Laid {
    fn cells(&self) -> Vec<Patch> {
        self.layout.of_cells(&self.surface, |patch| Some(*patch))
    }

    /// Where cells have their corners, per element.
    fn corners(&self) -> Vec<Vec3> {
        self.layout.corners(&self.surface)
    }

    fn area(&self) -> f64 {
        self.elements.areas.iter().map(|&area| f64::from(area)).sum()
    }

    fn longest_edge(&self) -> f32 {
        let edges = |cell: &Patch| [0, 1, 2].map(|i| cell.corners[i].distance(cell.corners[(i + 1) % 3]));
        self.cells().iter().flat_map(edges).fold(0.0, f32::max)
    }
}

fn lay(mesh: Mesh, spacing: f32) -> Laid {
    lay_at(mesh, DMat4::IDENTITY, spacing)
}

fn lay_at(mesh: Mesh, scene_from_object: DMat4, spacing: f32) -> Laid {
    let object = Object::new("thing", mesh, Material::diffuse(Vec3::ONE));
    let surface = Surface::build(&object, scene_from_object).unwrap();
    let (layout, elements) = Layout::new(&surface, &Distances::even(spacing), LIMIT).unwrap();
    let laid = Laid { surface, layout, elements };
    assert!(laid.elements.normals.iter().all(|normal| normal.is_normalized()));
    assert!(laid.elements.positions.iter().all(|position| position.is_finite()));
    laid
}

/// Directed edges between elements, with how often they occur.
fn edges(laid: &Laid) -> BTreeMap<(u32, u32), usize> {
    let mut edges = BTreeMap::new();
    for cell in laid.cells() {
        for i in 0..3 {
            *edges.entry((cell.elements[i], cell.elements[(i + 1) % 3])).or_insert(0) += 1;
        }
    }
    edges
}

/// Directed edges without an opposite.
fn open_edges(laid: &Laid) -> usize {
    let edges = edges(laid);
    edges.iter().filter(|((a, b), count)| edges.get(&(*b, *a)) != Some(count)).count()
}

/// An ellipsoid whose triangles are uneven.
fn ellipsoid() -> Mesh {
    let mut mesh = Mesh::icosphere(1.0, 2);
    for (position, normal) in mesh.positions.iter_mut().zip(&mut mesh.normals) {
        *position *= Vec3::new(3.0, 1.0, 0.7);
        *normal = (*normal / Vec3::new(3.0, 1.0, 0.7)).normalize();
    }
    mesh
}

/// One triangle, without normals.
fn triangle(corners: [Vec3; 3]) -> Mesh {
    Mesh { positions: corners.to_vec(), triangles: vec![[0, 1, 2]], triangle_materials: vec![0], ..Mesh::default() }
}

#[test]
fn no_edge_is_longer_than_the_spacing_and_no_crack_opens() {
    for spacing in [0.03, 0.11, 0.4, 10.0] {
        for mesh in [Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 0.37, 2.1)), ellipsoid()] {
            let is_smooth = mesh.triangles.len() > 12;
            let laid = lay(mesh, spacing);
            assert!(laid.longest_edge() <= spacing * 1.120_01, "{spacing}: {}", laid.longest_edge());
            assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-5);
            // Elements of a smooth surface are shared across its edges; V − E + F = 2 with E = 3 F / 2. At the largest spacing
            // triangles share them, too.
            if is_smooth && spacing < 1.0 {
                assert_eq!(open_edges(&laid), 0, "{spacing}");
                assert_eq!(laid.layout.len(), laid.layout.cell_count() / 2 + 2);
            }
        }
    }
}

/// Two halves of one closed surface in two objects, the halves' triangles turned and reordered: the seam is tight.
#[test]
fn two_objects_place_the_same_points_on_a_shared_edge() {
    let whole = ellipsoid();
    let (mut left, mut right) = (whole.clone(), whole.clone());
    let is_left = |index: usize| index.is_multiple_of(3);
    let pick = |wanted: bool| {
        let chosen = whole.triangles.iter().enumerate().filter(move |(index, _)| is_left(*index) == wanted);
        chosen.map(move |(_, &[a, b, c])| if wanted { [b, c, a] } else { [a, b, c] })
    };
    left.triangles = pick(true).collect();
    right.triangles = pick(false).collect();
    right.triangles.reverse();
    for mesh in [&mut left, &mut right] {
        mesh.triangle_materials = vec![0; mesh.triangles.len()];
    }
    let (left, right) = (lay(left, 0.13), lay(right, 0.13));
    assert!(open_edges(&left) > 100 && !left.surface.closed);
    // Elements within a surface are its vertices exactly: those at the seam have a twin in the other half.
    let rim = |laid: &Laid| -> Vec<Vec3> {
        let edges = edges(laid);
        let corners = laid.corners();
        let open = edges.iter().filter(|((a, b), count)| edges.get(&(*b, *a)) != Some(count));
        open.map(|((a, _), _)| corners[*a as usize]).collect()
    };
    let (left, right) = (rim(&left), rim(&right));
    let is_near = |p: &Vec3, others: &[Vec3]| others.iter().any(|q| p.distance(*q) < 1e-5);
    assert!(left.iter().all(|p| is_near(p, &right)) && right.iter().all(|p| is_near(p, &left)));
}

/// A point of every cell, at random: it is found in that cell, with the weights that put it where it is.
#[test]
fn points_are_found_in_their_cells() {
    let mut rng = Pcg32::new(8, 1);
    let needle = triangle([Vec3::ZERO, Vec3::new(3.0, 0.02, 0.0), Vec3::new(0.0, 0.03, 0.0)]);
    let flat = triangle([Vec3::ZERO, Vec3::X * 3.0, Vec3::new(1.3, 0.02, 0.0)]);
    let narrow = triangle([Vec3::ZERO, Vec3::new(3.0, 0.1, 0.0), Vec3::new(0.1, 0.35, 0.0)]);
    for mesh in [ellipsoid(), needle, flat, narrow, Mesh::quad(Vec3::ZERO, Vec3::X * 1.7, Vec3::Y)] {
        let laid = lay(mesh, 0.05);
        let (corners, mut strayed, mut count) = (laid.corners(), 0, 0);
        for cell in laid.cells() {
            let (u, v) = uniform_barycentrics([rng.next_f32(), rng.next_f32()]);
            let [a, b, c] = cell.corners;
            let point = (a * (1.0 - u - v) + b * u + c * v).as_dvec3();
            let [x, y, z] = laid.surface.corners(cell.face as usize).map(|corner| corner.as_dvec3());
            let n = (y - x).cross(z - x);
            let part = |p: DVec3, q: DVec3| ((p - point).cross(q - point).dot(n) / n.length_squared()) as f32;
            let place = laid.layout.cells.locate(cell.face, [part(y, z), part(z, x), part(x, y)]);
            let found: Vec3 = place.elements.iter().zip(place.weights).map(|(&e, w)| corners[e as usize] * w).sum();
            assert!((found.as_dvec3() - point).length() < 2e-5, "{found} for {point}");
            assert!((place.weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            // At an edge rounding may put it beside.
            strayed += usize::from(place.cell != cell.cell || place.elements != cell.elements);
            count += 1;
        }
        assert!(strayed * 200 <= count, "{strayed} of {count}");
    }
}

/// Strips need elements along their edges (a quadrilateral's two triangles have three long ones), and no more: were
/// they split like other triangles, a strip of n segments would get n^1.6 elements, and a flat triangle n².
#[test]
fn slivers_do_not_explode() {
    let strip = |length: f32, width: f32| Mesh::quad(Vec3::ZERO, Vec3::X * length, Vec3::Y * width);
    for (mesh, least, most) in [
        (strip(10.0, 0.02), 600, 610),
        (strip(100.0, 0.01), 6000, 6010),
        (strip(10.0, 0.12), 600, 1800),
        (triangle([Vec3::ZERO, Vec3::X * 10.0, Vec3::new(5.1, 0.01, 0.0)]), 400, 530),
        (triangle([Vec3::ZERO, Vec3::X * 10.0, Vec3::new(2.0, 0.2, 0.0)]), 600, 2600),
    ] {
        let laid = lay(mesh, 0.05);
        let count = laid.layout.len();
        assert!((least..=most).contains(&count), "{count} elements, not {least} to {most}");
        assert!(laid.longest_edge() <= 0.05 * 1.12, "{}", laid.longest_edge());
        assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-4);
    }
}

/// Sample points: the vertex within the face, and off all its edges at the border, but not far.
#[test]
fn sample_points_keep_off_borders() {
    let spacing = 0.1;
    let laid = lay(Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), spacing);
    let border = |p: Vec3| p.x.min(p.y).min(1.0 - p.x).min(1.0 - p.y);
    for (corner, position) in laid.corners().iter().zip(&laid.elements.positions) {
        assert!(position.z == 0.0 && corner.distance(*position) < 0.05 * spacing);
        if border(*corner) > 1e-4 {
            assert!(corner.distance(*position) < 1e-6);
        } else {
            assert!(border(*position) > 0.005 * spacing, "{corner} -> {position}");
        }
    }
}

#[test]
fn smooth_edges_share_elements_and_hard_ones_do_not() {
    let side = lay(Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), 0.1).layout.len();
    let cube = lay(Mesh::cuboid(Vec3::ZERO, Vec3::ONE), 0.1);
    assert_eq!(cube.layout.len(), 6 * side);
}

#[test]
fn useless_spacings_and_too_many_elements_are_refused() {
    let object = Object::new("q", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::ONE));
    let surface = Surface::build(&object, DMat4::IDENTITY).unwrap();
    let refused = |spacing| Layout::new(&surface, &Distances::even(spacing), 1000).map(|_| ()).unwrap_err();
    for spacing in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(refused(spacing), SurfaceError::Spacing(_)));
    }
    for spacing in [1e-2, 1e-6, 1e-30, f32::MIN_POSITIVE] {
        assert_eq!(refused(spacing), SurfaceError::TooManyElements { limit: 1000 });
    }
}

/// Far finer than `f32` can resolve: no endless splitting.
#[test]
fn splitting_ends_where_numbers_do() {
    let corner = Vec3::new(1000.0, 1000.0, 1000.0);
    let side = 3e-3;
    let object = Object::new("q", Mesh::quad(corner, Vec3::X * side, Vec3::Y * side), Material::diffuse(Vec3::ONE));
    let surface = Surface::build(&object, DMat4::IDENTITY).unwrap();
    match Layout::new(&surface, &Distances::even(1e-6), 100_000) {
        Ok((layout, elements)) => assert!(layout.len() == elements.areas.len()),
        Err(error) => assert_eq!(error, SurfaceError::TooManyElements { limit: 100_000 }),
    }
}

/// Scales of 1e-3 and 1e4: the same elements, moved and scaled.
#[test]
fn scale_changes_nothing_but_size() {
    let counts = [1e-3_f32, 1.0, 1e4].map(|scale| {
        let laid = lay_at(ellipsoid(), DMat4::from_scale(DVec3::splat(f64::from(scale))), 0.1 * scale);
        laid.layout.len()
    });
    assert!(counts.iter().all(|&count| count.abs_diff(counts[1]) < counts[1] / 50), "{counts:?}");
}

#[test]
fn the_same_object_gives_the_same_layout() {
    let (a, b) = (lay(ellipsoid(), 0.1), lay(ellipsoid(), 0.1));
    assert_eq!(a.elements.positions, b.elements.positions);
    let elements = |laid: &Laid| -> Vec<[u32; 3]> { laid.cells().iter().map(|cell| cell.elements).collect() };
    assert_eq!(elements(&a), elements(&b));
}

/// What comes and goes leaves nothing behind: slots, faces, parts and cells are used again.
#[test]
fn what_is_freed_is_used_again() {
    let laid = lay(Mesh::cuboid(Vec3::ZERO, Vec3::ONE), 0.2);
    let layout = Arc::new(laid.layout.clone());
    let place = |space: &mut Space, key| {
        let materials = [(Albedo::new(Vec3::ONE, 1.0), false), (Albedo::default(), true)];
        let parts = (&laid.surface, &layout, &laid.elements);
        space.place(parts, None, materials.into_iter(), key, key % 2 == 1)
    };
    let mut space = Space::default();
    let first = place(&mut space, 0);
    let (bytes, cells) = (space.memory_bytes(), space.cells());
    let mut placement = first.clone();
    for key in 1..50 {
        space.set_cuts([(placement.cells.start, true)]);
        space.clear(&placement);
        assert!(space.parts().iter().all(|part| part.object == NO_OBJECT));
        placement = place(&mut space, 2 * key);
        assert_eq!(placement, first);
        assert!(!space.is_cut(placement.cells.start), "what stood on a cell went with it");
    }
    // But for what is kept of every key, four bytes.
    assert!(space.memory_bytes() <= bytes + 1024 && space.cells() == cells);
}

/// Laid out with fine elements around a place.
fn lay_by_sizes(mesh: Mesh) -> (Laid, Sizing) {
    let object = Object::new("thing", mesh, Material::diffuse(Vec3::ONE));
    let surface = Surface::build(&object, DMat4::IDENTITY).unwrap();
    let cone = |at, size| Cone { at, radius: 0.05, size };
    // On the box, in it, and on the ellipsoid.
    let places = [(Vec3::new(1.0, 0.3, 0.1), 0.03), (Vec3::new(0.2, 0.2, 1.5), 0.1), (Vec3::new(3.0, 0.0, 0.0), 0.03)];
    let cones = places.map(|(at, size)| cone(at, size));
    let sizing = Sizing::new(&cones, (0.03, 0.3));
    let (layout, elements) =
        Layout::new(&surface, &Distances { sizing: Some(&sizing), ..Distances::even(f32::INFINITY) }, LIMIT).unwrap();
    (Laid { surface, layout, elements }, sizing)
}

/// Elements lie as far apart as sizes say, no crack opens, and every point finds the cell that it lies in.
#[test]
fn elements_follow_sizes_without_cracks() {
    for (mesh, is_smooth) in [(Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 0.37, 2.1)), false), (ellipsoid(), true)] {
        let (laid, sizing) = lay_by_sizes(mesh);
        assert!((laid.area() / laid.surface.area() - 1.0).abs() < 1e-5);
        if is_smooth {
            assert_eq!(open_edges(&laid), 0);
            assert_eq!(laid.layout.len(), laid.layout.cell_count() / 2 + 2);
        }
        let cells = laid.cells();
        let mut shortest = f32::INFINITY;
        for cell in &cells {
            let [a, b, c] = cell.corners;
            for (a, b) in [(a, b), (b, c), (c, a)] {
                let least = sizing.at(a).min(sizing.at(b));
                assert!(a.distance(b) <= 1.5 * least, "{} {least}", a.distance(b));
                shortest = shortest.min(a.distance(b));
            }
            let middle = (a + b + c) / 3.0;
            let weights = crate::surface::barycentrics(middle, laid.surface.corners(cell.face as usize));
            assert_eq!(laid.layout.cells.locate(cell.face, weights).cell, cell.cell);
        }
        assert!(shortest < 0.03);
        // Far from the corner there are fewer than one size for all would have.
        let even = Layout::count(&laid.surface, &Distances::even(0.03), LIMIT).unwrap();
        assert!(4 * laid.layout.len() < even, "{} {even}", laid.layout.len());
    }
}

/// Two objects that share an edge place the same points on it, whatever the order of their triangles and corners.
#[test]
fn two_objects_place_the_same_points_by_sizes() {
    let whole = Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 0.37, 2.1));
    let part = |wanted: bool| {
        let of_part = |(index, &[a, b, c]): (usize, &[u32; 3])| {
            (index.is_multiple_of(2) == wanted).then_some(if wanted { [b, c, a] } else { [a, b, c] })
        };
        let triangles: Vec<[u32; 3]> = whole.triangles.iter().enumerate().filter_map(of_part).collect();
        let triangle_materials = vec![0; triangles.len()];
        lay_by_sizes(Mesh { triangles, triangle_materials, ..whole.clone() }).0
    };
    // Far apart beside rounding.
    let places = |laid: &Laid| -> BTreeSet<[i32; 3]> {
        laid.corners().into_iter().map(|corner| corner.to_array().map(|x| (x * 1e4).round() as i32)).collect()
    };
    let of_parts: BTreeSet<[i32; 3]> = &places(&part(true)) | &places(&part(false));
    let of_whole = places(&lay_by_sizes(whole.clone()).0);
    assert!(of_whole.len() > 300, "{}", of_whole.len());
    assert_eq!(of_parts, of_whole);
}
