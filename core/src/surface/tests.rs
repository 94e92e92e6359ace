//! Invariants of subdivided surfaces.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec3};

use super::build::total_area;
use super::*;
use crate::scene::{LoadLimits, Material, Mesh, Object, Scene, load};

const WHITE: Material = Material { albedo: Vec3::ONE, emission: Vec3::ZERO, double_sided: false };
const LIMIT: usize = 1_000_000;

fn build(mesh: Mesh, spacing: f32) -> Surface {
    build_at(mesh, DMat4::IDENTITY, spacing)
}

fn build_at(mesh: Mesh, scene_from_object: DMat4, spacing: f32) -> Surface {
    let object = Object::new("thing", mesh, WHITE);
    let surface = Surface::build(&object, scene_from_object, spacing, LIMIT).unwrap();
    surface.validate().unwrap();
    surface
}

/// Directed edges by exact position: start and end bits, with how often they occur.
fn edges(surfaces: &[&Surface]) -> BTreeMap<([u32; 3], [u32; 3]), usize> {
    let mut edges = BTreeMap::new();
    for surface in surfaces {
        for triangle in &surface.triangles {
            let corners = triangle.map(|corner| surface.vertices[corner as usize].to_array().map(f32::to_bits));
            for i in 0..3 {
                *edges.entry((corners[i], corners[(i + 1) % 3])).or_insert(0) += 1;
            }
        }
    }
    edges
}

/// Directed edges without an opposite.
fn open_edges(surfaces: &[&Surface]) -> usize {
    let edges = edges(surfaces);
    edges.iter().filter(|((a, b), count)| edges.get(&(*b, *a)) != Some(count)).count()
}

fn longest_edge(surface: &Surface) -> f32 {
    let length = |a: u32, b: u32| surface.vertices[a as usize].distance(surface.vertices[b as usize]);
    surface.triangles.iter().flat_map(|&[a, b, c]| [length(a, b), length(b, c), length(c, a)]).fold(0.0, f32::max)
}

/// A sphere with uneven triangles: its vertices are pushed about.
fn potato() -> Mesh {
    let mut mesh = Mesh::icosphere(1.0, 2);
    for (index, position) in mesh.positions.iter_mut().enumerate() {
        *position *= 1.0 + 0.4 * (index as f32 * 1.7).sin();
        position.x *= 3.0;
    }
    mesh.normals = Vec::new();
    mesh
}

#[test]
fn no_edge_is_longer_than_the_spacing_and_no_crack_opens() {
    for spacing in [0.03, 0.11, 0.4, 10.0] {
        for mesh in [Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 0.37, 2.1)), potato()] {
            let surface = build(mesh.clone(), spacing);
            assert!(longest_edge(&surface) <= spacing * 1.000_01, "{spacing}: {}", longest_edge(&surface));
            assert_eq!(open_edges(&[&surface]), 0, "{spacing}");
            let before = total_area(&mesh.positions, &mesh.triangles);
            assert!((surface.area() / before - 1.0).abs() < 1e-5);
            assert!(surface.closed && surface.volume > 0.0);
        }
    }
}

/// Two halves of one closed surface in two objects, the halves' triangles turned and reordered: the seam is tight.
#[test]
fn two_objects_place_the_same_points_on_a_shared_edge() {
    let whole = potato();
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
    let (left, right) = (build(left, 0.13), build(right, 0.13));
    assert!(open_edges(&[&left]) > 100 && !left.closed);
    assert_eq!(open_edges(&[&left, &right]), 0);
}

#[test]
fn smooth_edges_share_elements_and_hard_ones_do_not() {
    let smooth = build(Mesh::icosphere(1.0, 1), 0.2);
    // V − E + F = 2 on a sphere, with E = 3 F / 2.
    assert_eq!(smooth.vertices.len(), smooth.triangles.len() / 2 + 2);
    assert_eq!(smooth.positions, smooth.vertices);
    let side = build(Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), 0.1).vertices.len();
    let cube = build(Mesh::cuboid(Vec3::ZERO, Vec3::ONE), 0.1);
    assert_eq!(cube.vertices.len(), 6 * side);
    assert!((cube.volume - 1.0).abs() < 1e-6 && cube.closed);
}

/// Sample points: the vertex within the face, and off all its edges at the border, but not far.
#[test]
fn sample_points_keep_off_borders() {
    let spacing = 0.1;
    let surface = build(Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), spacing);
    let border = |p: Vec3| p.x.min(p.y).min(1.0 - p.x).min(1.0 - p.y);
    for (vertex, position) in surface.vertices.iter().zip(&surface.positions) {
        assert!(position.z == 0.0 && vertex.distance(*position) < 0.05 * spacing);
        if border(*vertex) > 1e-4 {
            assert_eq!(vertex, position);
        } else {
            assert!(border(*position) > 0.005 * spacing, "{vertex} -> {position}");
        }
    }
}

#[test]
fn mirroring_keeps_the_front_outside() {
    let scale = DVec3::new(-2.0, 1.0, 0.5);
    let turn = DQuat::from_rotation_x(0.3);
    let matrix = DMat4::from_scale_rotation_translation(scale, turn, DVec3::new(5.0, -3.0, 8.0));
    let surface = build_at(Mesh::icosphere(1.0, 3), matrix, 0.2);
    let exact = 4.0 / 3.0 * std::f64::consts::PI;
    assert!(surface.closed && (surface.volume / exact - 1.0).abs() < 0.03, "{}", surface.volume);
    let centre = Vec3::new(5.0, -3.0, 8.0);
    assert!(surface.vertices.iter().zip(&surface.normals).all(|(v, n)| (*v - centre).dot(*n) > 0.0));
    let room = build_at(Mesh::icosphere(1.0, 3).inside_out(), matrix, 0.2);
    assert!(room.closed && room.volume < 0.0);
}

/// A file's normals against its winding: the winding gives way where both sides count, the normals where one does.
#[test]
fn winding_and_normals_are_reconciled() {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    mesh.normals = vec![Vec3::NEG_Z; 4];
    for (double_sided, up) in [(false, 1.0), (true, -1.0)] {
        let object = Object::new("q", mesh.clone(), Material { double_sided, ..WHITE });
        let surface = Surface::build(&object, DMat4::IDENTITY, 0.5, LIMIT).unwrap();
        surface.validate().unwrap();
        assert!(surface.normals.iter().all(|normal| *normal == Vec3::Z * up));
    }
    // One normal along the surface: of no use, so that corner is flat.
    mesh.normals = vec![Vec3::Z, Vec3::Z, Vec3::X, Vec3::Z];
    let surface = build(mesh, 2.0);
    assert!(surface.normals.iter().all(|normal| *normal == Vec3::Z));
}

#[test]
fn useless_input_is_refused_or_dropped() {
    let object = Object::new("q", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), WHITE);
    let build = |object: &Object, matrix, spacing| Surface::build(object, matrix, spacing, 1000);
    for spacing in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(build(&object, DMat4::IDENTITY, spacing), Err(SurfaceError::Spacing(_))));
    }
    for spacing in [1e-2, 1e-6, 1e-30, f32::MIN_POSITIVE] {
        let error = build(&object, DMat4::IDENTITY, spacing).unwrap_err();
        assert_eq!(error, SurfaceError::TooManyElements { limit: 1000 });
    }
    for scale in [0.0, f64::NAN, 1e300] {
        let error = build(&object, DMat4::from_scale(DVec3::splat(scale)), 1.0).unwrap_err();
        assert_eq!(error, SurfaceError::Transform);
    }
    let mut broken = object.clone();
    Arc::make_mut(&mut broken.mesh).triangles[0][0] = 4;
    assert_eq!(build(&broken, DMat4::IDENTITY, 1.0).unwrap_err(), SurfaceError::Mesh);
    let mut flat = object;
    Arc::make_mut(&mut flat.mesh).triangles = vec![[0, 1, 1], [0, 0, 0]];
    let surface = build(&flat, DMat4::IDENTITY, 1.0).unwrap();
    surface.validate().unwrap();
    assert!(surface.vertices.is_empty() && !surface.closed);
}

/// Far finer than `f32` can resolve: no endless splitting, no broken surface.
#[test]
fn splitting_ends_where_numbers_do() {
    let corner = Vec3::new(1000.0, 1000.0, 1000.0);
    let side = 3e-3;
    let object = Object::new("q", Mesh::quad(corner, Vec3::X * side, Vec3::Y * side), WHITE);
    match Surface::build(&object, DMat4::IDENTITY, 1e-6, 100_000) {
        Ok(surface) => surface.validate().unwrap(),
        Err(error) => assert_eq!(error, SurfaceError::TooManyElements { limit: 100_000 }),
    }
}

/// Scales of 1e-3 and 1e4: the same elements, moved and scaled.
#[test]
fn scale_changes_nothing_but_size() {
    let counts = [1e-3_f32, 1.0, 1e4].map(|scale| {
        let surface = build_at(potato(), DMat4::from_scale(DVec3::splat(f64::from(scale))), 0.1 * scale);
        assert!(surface.closed);
        surface.vertices.len()
    });
    assert!(counts.iter().all(|&count| count.abs_diff(counts[1]) < counts[1] / 50), "{counts:?}");
}

#[test]
fn open_and_doubled_surfaces_are_not_closed() {
    let cube = Mesh::cuboid(Vec3::ZERO, Vec3::ONE);
    let mut open = cube.clone();
    open.triangles.pop();
    open.triangle_materials.pop();
    assert!(!build(open, 0.5).closed);
    let mut doubled = cube;
    doubled.triangles.extend_from_within(..);
    doubled.triangle_materials.extend_from_within(..);
    assert!(!build(doubled, 0.5).closed);
}

#[test]
fn the_same_object_gives_the_same_surface() {
    let (a, b) = (build(potato(), 0.1), build(potato(), 0.1));
    assert_eq!((a.vertices, a.positions, a.triangles), (b.vertices, b.positions, b.triangles));
}

#[test]
fn whole_scenes_are_built_within_their_limit() {
    let cube = |name: &str| Object::new(name, Mesh::cuboid(Vec3::ZERO, Vec3::ONE), WHITE);
    let mut scene = Scene::from_objects(vec![cube("a"), cube("b")]);
    scene.origin = DVec3::new(0.0, 0.0, 10.0);
    let surfaces = build_all(&scene, 0.2, 10_000).unwrap();
    let count = surfaces[0].vertices.len();
    assert_eq!(count, surfaces[1].vertices.len());
    assert!(surfaces[0].vertices.iter().all(|vertex| (-10.0..=-9.0).contains(&vertex.z)));
    assert!(matches!(build_all(&scene, 0.2, 2 * count - 1), Err((_, SurfaceError::TooManyElements { .. }))));
}

#[test]
fn default_spacing_has_two_digits() {
    assert_eq!(default_spacing(130.0 * 0.0123 * 0.0123, 130), 0.012);
    assert_eq!(default_spacing(0.0, 100), 1.0);
    assert_eq!(default_spacing(f64::NAN, 100), 1.0);
    assert_eq!(default_spacing(f64::INFINITY, 100), 1.0);
    assert!(default_spacing(1e-300, 100) > 0.0);
}

/// The scenes of the workshop, where they are at hand: they load, and their surfaces hold what they promise.
#[test]
fn real_scenes_are_loaded_and_subdivided() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/scenes");
    let files = |folder: std::path::PathBuf| std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<_> = files(folder.clone()).chain(files(folder.join("objects"))).map(|f| f.path()).collect();
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "glb"));
    paths.sort();
    if paths.is_empty() {
        eprintln!("skipped: there are no scenes in {}", folder.display());
    }
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).unwrap();
        let start = std::time::Instant::now();
        let scene = load(&bytes, &LoadLimits::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
        let loaded = start.elapsed();
        let spacing = default_spacing(scene.objects.iter().map(object_area).sum(), DEFAULT_ELEMENTS);
        let start = std::time::Instant::now();
        let surfaces = build_all(&scene, spacing, 5_000_000).unwrap_or_else(|error| panic!("{name}: {error:?}"));
        let built = start.elapsed();
        for (surface, object) in surfaces.iter().zip(&scene.objects) {
            surface.validate().unwrap_or_else(|error| panic!("{name}, {}: {error}", object.name));
            // Objects that are all glass have no triangle.
            if object.mesh.triangles.is_empty() {
                continue;
            }
            let ratio = surface.area() / object_area(object);
            assert!((ratio - 1.0).abs() < 1e-3, "{name}, {}: {ratio}", object.name);
        }
        let elements: usize = surfaces.iter().map(|surface| surface.vertices.len()).sum();
        eprintln!("{name}: spacing {spacing} m, {elements} elements, loaded in {loaded:.0?}, built in {built:.0?}");
    }
}
