//! Invariants of surfaces.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec3};

use super::*;
use crate::scene::{LoadLimits, Material, Mesh, Object, load};

fn white() -> Material {
    Material::diffuse(Vec3::ONE)
}

fn build(mesh: Mesh) -> Surface {
    build_at(mesh, DMat4::IDENTITY)
}

fn build_at(mesh: Mesh, scene_from_object: DMat4) -> Surface {
    let object = Object::new("thing", mesh, white());
    let surface = Surface::build(&object, scene_from_object).unwrap();
    surface.validate().unwrap();
    surface
}

#[test]
fn mirroring_keeps_the_front_outside() {
    let scale = DVec3::new(-2.0, 1.0, 0.5);
    let turn = DQuat::from_rotation_x(0.3);
    let matrix = DMat4::from_scale_rotation_translation(scale, turn, DVec3::new(5.0, -3.0, 8.0));
    let surface = build_at(Mesh::icosphere(1.0, 3), matrix);
    let exact = 4.0 / 3.0 * std::f64::consts::PI;
    assert!(surface.closed && (surface.volume / exact - 1.0).abs() < 0.03, "{}", surface.volume);
    let centre = Vec3::new(5.0, -3.0, 8.0);
    assert!(surface.positions.iter().zip(&surface.normals).all(|(v, n)| (*v - centre).dot(*n) > 0.0));
    assert!(surface.sources.iter().all(|source| source.turned()));
    let room = build_at(Mesh::icosphere(1.0, 3).inside_out(), matrix);
    assert!(room.closed && room.volume < 0.0);
}

/// A file's normals against its winding: the winding gives way where both sides count, the normals where one does.
#[test]
fn winding_and_normals_are_reconciled() {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    mesh.normals = vec![Vec3::NEG_Z; 4];
    for (double_sided, up) in [(false, 1.0), (true, -1.0)] {
        let object = Object::new("q", mesh.clone(), Material { double_sided, ..white() });
        let surface = Surface::build(&object, DMat4::IDENTITY).unwrap();
        surface.validate().unwrap();
        assert!(surface.normals.iter().all(|normal| *normal == Vec3::Z * up));
        assert!(surface.sources.iter().all(|source| source.turned() == double_sided));
    }
    // One normal along the surface: of no use, so that corner is flat.
    mesh.normals = vec![Vec3::Z, Vec3::Z, Vec3::X, Vec3::Z];
    let surface = build(mesh);
    assert!(surface.normals.iter().all(|normal| *normal == Vec3::Z));
}

/// Where a triangle comes from: its corners are those of the mesh, the last two in changed places where it was turned.
#[test]
fn sources_tell_the_corners_of_the_mesh() {
    let matrix = DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    for matrix in [DMat4::IDENTITY, matrix] {
        let mesh = Mesh::icosphere(1.0, 2);
        let surface = build_at(mesh.clone(), matrix);
        for (index, source) in surface.sources.iter().enumerate() {
            let [a, b, c] = mesh.triangles[source.triangle()]
                .map(|v| matrix.transform_point3(mesh.positions[v as usize].as_dvec3()).as_vec3() + Vec3::ZERO);
            assert_eq!(surface.corners(index), if source.turned() { [a, c, b] } else { [a, b, c] });
        }
    }
}

#[test]
fn useless_input_is_refused_or_dropped() {
    let object = Object::new("q", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), white());
    for scale in [0.0, f64::NAN, 1e300] {
        let error = Surface::build(&object, DMat4::from_scale(DVec3::splat(scale))).unwrap_err();
        assert_eq!(error, SurfaceError::Transform);
    }
    let mut broken = object.clone();
    Arc::make_mut(&mut broken.mesh).triangles[0][0] = 4;
    assert_eq!(Surface::build(&broken, DMat4::IDENTITY).unwrap_err(), SurfaceError::Mesh);
    let mut flat = object;
    Arc::make_mut(&mut flat.mesh).triangles = vec![[0, 1, 1], [0, 0, 0]];
    let surface = Surface::build(&flat, DMat4::IDENTITY).unwrap();
    surface.validate().unwrap();
    assert!(surface.positions.is_empty() && !surface.closed);
    assert_eq!(surface.dropped, 2);
}

#[test]
fn open_and_doubled_surfaces_are_not_closed() {
    let cube = Mesh::cuboid(Vec3::ZERO, Vec3::ONE);
    assert!((build(cube.clone()).volume - 1.0).abs() < 1e-6 && build(cube.clone()).closed);
    let mut open = cube.clone();
    open.triangles.pop();
    open.triangle_materials.pop();
    assert!(!build(open).closed);
    let mut doubled = cube;
    doubled.triangles.extend_from_within(..);
    doubled.triangle_materials.extend_from_within(..);
    assert!(!build(doubled).closed);
}

/// The scenes of the workshop, where they are at hand: their surfaces hold what they promise.
#[test]
fn real_scenes_have_valid_surfaces() {
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
        let scene = load(&bytes, &LoadLimits::default()).unwrap_or_else(|error| panic!("{name}: {error}"));
        for object in &scene.objects {
            let place = DMat4::from_translation(-scene.origin) * object.world_from_object;
            let surface = Surface::build(object, place).unwrap_or_else(|error| panic!("{name}: {error}"));
            surface.validate().unwrap_or_else(|error| panic!("{name}, {}: {error}", object.name));
            // Objects that are all glass have no triangle.
            if !object.mesh.triangles.is_empty() {
                let ratio = surface.area() / object_area(object);
                assert!((ratio - 1.0).abs() < 1e-3, "{name}, {}: {ratio}", object.name);
            }
        }
    }
}

/// A sphere as pages write it: at the poles and along the seam, vertices are apart by what sine and cosine are off.
#[test]
fn poles_and_seams_are_closed() {
    let (columns, rows) = (16, 12);
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..=columns {
            let theta = f64::from(row) / f64::from(rows) * std::f64::consts::PI;
            let phi = f64::from(column) / f64::from(columns) * std::f64::consts::TAU;
            let place = DVec3::new(-phi.cos() * theta.sin(), theta.cos(), phi.sin() * theta.sin()) * 0.3;
            mesh.positions.push(place.as_vec3());
            mesh.normals.push(place.normalize().as_vec3());
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let [b, c] = [row, row + 1].map(|row| (row * (columns + 1) + column) as u32);
            let [a, d] = [b + 1, c + 1];
            if row > 0 {
                mesh.triangles.push([a, b, d]);
            }
            if row < rows - 1 {
                mesh.triangles.push([b, c, d]);
            }
        }
    }
    mesh.triangle_materials = vec![0; mesh.triangles.len()];
    let surface = build(mesh);
    let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.3_f64.powi(3);
    assert!(surface.closed && (surface.volume / exact - 1.0).abs() < 0.1, "{}", surface.volume);
    let places: BTreeSet<[u32; 3]> = surface.positions.iter().map(|p| p.to_array().map(f32::to_bits)).collect();
    assert_eq!(places.len(), 2 + (rows - 1) as usize * columns as usize);
}
