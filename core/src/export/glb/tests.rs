//! Files written here are read back by [`load`] as they were.

use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec2, Vec3};

use super::*;
use crate::export::{ObjectExport, write_object_glb};
use crate::scene::{AlphaMode, Camera, Light, LightKind, LoadLimits, Look, Mesh, NodeSource, Object, Scene, load};

/// Numbers in 0..1 that repeat (SplitMix64).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ (x >> 31)) >> 40) as f32 / (1 << 24) as f32
    }

    fn vec3(&mut self) -> Vec3 {
        Vec3::new(self.next(), self.next(), self.next())
    }

    /// A rotation, an uneven scale that may mirror, a translation.
    fn transform(&mut self) -> DMat4 {
        let axis = (self.vec3() - 0.5).as_dvec3().normalize_or(DVec3::X);
        let rotation = DQuat::from_axis_angle(axis, f64::from(self.next()) * 6.0);
        let mut scale = (self.vec3() * 3.0 + 0.1).as_dvec3();
        scale.x *= if self.next() < 0.5 { -1.0 } else { 1.0 };
        DMat4::from_scale_rotation_translation(scale, rotation, (self.vec3() * 20.0 - 10.0).as_dvec3())
    }
}

fn random_object(random: &mut Random, name: String) -> Object {
    let mut mesh = match (random.next() * 3.0) as u32 {
        0 => Mesh::quad(random.vec3(), Vec3::X * (0.1 + random.next()), Vec3::Y * (0.1 + random.next())),
        1 => Mesh::cuboid(random.vec3(), random.vec3() + 1.1),
        _ => Mesh::icosphere(0.1 + random.next(), 1),
    };
    if random.next() < 0.3 {
        mesh.normals = Vec::new();
    }
    let materials: Vec<Material> = (0..1 + (random.next() * 3.0) as u32)
        .map(|_| {
            let is_lamp = random.next() < 0.3;
            let emission = if is_lamp { random.vec3() * 20.0 + 0.1 } else { Vec3::ZERO };
            Material { albedo: random.vec3(), emission, double_sided: random.next() < 0.5 }
        })
        .collect();
    let count = materials.len();
    // Sorted as the writer groups them, and every material used.
    let total = mesh.triangle_materials.len();
    for (index, material) in mesh.triangle_materials.iter_mut().enumerate() {
        *material = (index * count / total) as u32;
    }
    let materials = if total < count { materials[..total].to_vec() } else { materials };
    if total < count {
        mesh.triangle_materials = (0..total as u32).collect();
    }
    let material_names = vec!["".into(); materials.len()];
    let world_from_object = random.transform();
    let placed = Object::new(name, mesh, Material::diffuse(Vec3::ONE)).placed(world_from_object);
    Object { materials, material_names, ..placed }
}

fn random_scene(seed: u64) -> Scene {
    let random = &mut Random(seed);
    let objects = (0..1 + (random.next() * 5.0) as u32).map(|i| random_object(random, format!("Object \"{i}\" ä\n")));
    let mut scene = Scene::from_objects(objects.collect());
    let color = random.vec3();
    let direction = (random.vec3() - 0.5).normalize_or(Vec3::X);
    let position = random.vec3().as_dvec3();
    let range = (random.next() < 0.5).then_some(3.0);
    let kinds = [
        LightKind::Point { position, range },
        LightKind::Spot { position, direction, inner_cone_angle: 0.1, outer_cone_angle: 0.7, range },
        LightKind::Directional { direction: Vec3::Z, angle: 0.0 },
    ];
    for (index, kind) in kinds.into_iter().enumerate() {
        scene = scene.with_light(Light { name: format!("Lamp {index}"), kind, color, intensity: 40.0 * random.next() });
    }
    let world_from_camera = DMat4::from_rotation_translation(DQuat::from_rotation_y(1.0), DVec3::new(1.0, 2.0, 3.0));
    scene.cameras.push(Camera { name: "Camera".into(), world_from_camera, fov_y: 0.7 });
    scene
}

#[test]
fn scenes_are_read_back_as_they_were_written() {
    for seed in 0..300 {
        let scene = random_scene(seed);
        let file = write_scene_glb(&scene).unwrap();
        let read = load(&file, &LoadLimits { max_albedo: 1.0, ..LoadLimits::default() })
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert!(read.warnings.is_empty(), "seed {seed}: {:?}", read.warnings);
        assert_eq!(read.objects.len(), scene.objects.len(), "seed {seed}");
        for (a, b) in scene.objects.iter().zip(&read.objects) {
            assert_eq!((&a.name, &a.mesh.positions), (&b.name, &b.mesh.positions), "seed {seed}");
            assert_eq!(a.mesh.triangles, b.mesh.triangles, "seed {seed}");
            let albedos = |object: &Object| {
                let materials = object.mesh.triangle_materials.iter();
                materials
                    .map(|&m| (object.materials[m as usize].albedo, object.materials[m as usize].double_sided))
                    .collect::<Vec<_>>()
            };
            assert_eq!(albedos(a), albedos(b), "seed {seed}");
            assert!(a.world_from_object.abs_diff_eq(b.world_from_object, 1e-5), "seed {seed}");
            assert_eq!(a.mesh.normals.len(), b.mesh.normals.len(), "seed {seed}");
            let off = a.mesh.normals.iter().zip(&b.mesh.normals).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
            assert!(off < 1e-6, "seed {seed}: {off}");
        }
        assert_lights(&scene.lights, &read.lights, seed);
        assert!(read.cameras[0].world_from_camera.abs_diff_eq(scene.cameras[0].world_from_camera, 1e-6));
    }
}

fn assert_lights(written: &[Light], read: &[Light], seed: u64) {
    assert_eq!(written.len(), read.len(), "seed {seed}");
    for (a, b) in written.iter().zip(read) {
        assert_eq!(a.name, b.name, "seed {seed}");
        assert!(a.strength().distance(b.strength()) <= 1e-5 * a.strength().length(), "seed {seed}: {a:?} {b:?}");
        match (&a.kind, &b.kind) {
            (LightKind::Spot { position: p, direction: d, .. }, LightKind::Spot { position: q, direction: e, .. }) => {
                assert!(p.distance(*q) < 1e-6 && d.distance(*e) < 1e-6, "seed {seed}");
            }
            (LightKind::Point { position: p, range: r }, LightKind::Point { position: q, range: s }) => {
                assert!(p.distance(*q) < 1e-6 && r == s, "seed {seed}");
            }
            (LightKind::Emissive { object: p, material: m }, LightKind::Emissive { object: q, material: n }) => {
                assert_eq!((p, m), (q, n), "seed {seed}");
            }
            (LightKind::Directional { direction: d, .. }, LightKind::Directional { direction: e, .. }) => {
                assert!(d.distance(*e) < 1e-6, "seed {seed}");
            }
            other => panic!("seed {seed}: {other:?}"),
        }
    }
}

/// The emission that is written is that of the lights: a relit scene reads back relit.
#[test]
fn relit_lamps_are_written_as_they_are_lit() {
    let mut scene = Scene::from_objects(vec![Object::new(
        "Lamp",
        Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y),
        Material::emissive(Vec3::ONE),
    )]);
    scene.lights[0].color = Vec3::new(0.5, 0.25, 1.0);
    scene.lights[0].intensity = 12.0;
    let read = load(&write_scene_glb(&scene).unwrap(), &LoadLimits::default()).unwrap();
    assert_eq!((read.lights[0].color, read.lights[0].intensity), (Vec3::new(0.5, 0.25, 1.0), 12.0));
    scene.lights.clear();
    let read = load(&write_scene_glb(&scene).unwrap(), &LoadLimits::default()).unwrap();
    assert_eq!(read.lights, []);
}

fn export<'a>(mesh: &'a Mesh, colors: &'a [Vec3], materials: &'a [Material]) -> MeshExport<'a> {
    MeshExport {
        name: "Thing",
        positions: &mesh.positions,
        normals: &mesh.normals,
        colors,
        reads: (&[], &[]),
        triangles: &mesh.triangles,
        triangle_materials: &mesh.triangle_materials,
        materials,
        opacities: &[],
    }
}

#[test]
fn lists_that_do_not_fit_are_refused() {
    let mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    let (colors, materials) = ([Vec3::ONE; 4], [Material::diffuse(Vec3::ONE)]);
    let object = Object::new("Thing", mesh.clone(), materials[0]);
    let write = |elements| {
        let origin = DVec3::ZERO;
        write_object_glb(&ObjectExport {
            object: &object,
            lights: &[],
            elements,
            origin,
            first_element: 0,
            with_back: false,
        })
    };
    let good = export(&mesh, &colors, &materials);
    assert!(write(good).is_ok());
    let nan = [Vec3::NAN; 4];
    let bad = [
        MeshExport { colors: &colors[..3], ..good },
        MeshExport { normals: &[], ..good },
        MeshExport { materials: &[], ..good },
        MeshExport { triangle_materials: &[0], ..good },
        MeshExport { triangles: &[[0, 1, 4], [0, 1, 2]], ..good },
        MeshExport { colors: &nan, ..good },
    ];
    for (index, mesh) in bad.iter().enumerate() {
        assert!(write(*mesh).is_err(), "case {index}");
    }
}

/// Of what lets light through the mean is written.
#[test]
fn panes_are_written_with_their_mean_opacity() {
    let mut pane = Object::new("Pane", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y), Material::diffuse(Vec3::splat(0.5)));
    let look = Look { alpha: 0.8, alpha_mode: AlphaMode::Blend, transmission: 0.5, ..Look::plain(Vec3::splat(0.5)) };
    pane.looks = vec![Some(Arc::new(look))];
    let file = write_scene_glb(&Scene::from_objects(vec![pane])).unwrap();
    let read = load(&file, &LoadLimits::default()).unwrap();
    let look = read.objects[0].looks[0].as_ref().unwrap();
    assert_eq!((look.alpha_mode, look.alpha), (AlphaMode::Blend, 0.4));
}

/// The JSON of a binary glTF.
fn document(file: &[u8]) -> Value {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    ::gltf::json::deserialize::from_slice(&file[20..20 + length]).unwrap()
}

#[test]
fn an_object_is_written_as_the_file_has_it_beside_its_elements() {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    mesh.texcoords[1] = vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
    let cells = Mesh::icosphere(1.0, 1);
    let place = DMat4::from_translation(DVec3::new(3.0, 0.5, -2.0));
    let mut object = Object::new("Lamp / left", mesh, Material::emissive(Vec3::ONE)).placed(place);
    object.material_names = vec!["bulb".into()];
    object.node = Some(NodeSource { index: 7, id: Some("a81f".into()) });
    let colors: Vec<Vec3> = (0..cells.positions.len()).map(|i| Vec3::splat(i as f32)).collect();
    let materials = [Material::diffuse(Vec3::ONE)];
    let scene = Scene::from_objects(vec![object.clone()]);
    let with = |elements| ObjectExport {
        object: &object,
        lights: &scene.lights,
        elements,
        origin: DVec3::X,
        first_element: 40,
        with_back: true,
    };
    let file = write_object_glb(&with(export(&cells, &colors, &materials))).unwrap();
    let read = &load(&file, &LoadLimits::default()).unwrap().objects;
    assert_eq!((read.len(), &read[0].name, &*read[0].material_names[0]), (1, &object.name, "bulb"));
    assert_eq!(read[0].mesh.positions, object.mesh.positions);
    assert_eq!((read[0].mesh.triangles.clone(), read[0].world_from_object), (object.mesh.triangles.clone(), place));
    assert_eq!(read[0].node.as_ref().unwrap().id.as_deref(), Some("a81f"));
    let json = document(&file);
    let primitive = &json["meshes"][0]["primitives"][0]["attributes"];
    let (first, second) = (&primitive["TEXCOORD_0"], &primitive["TEXCOORD_1"]);
    assert!(first.is_number() && second.is_number() && first != second, "{primitive}");
    assert_eq!(json["materials"][0]["emissiveFactor"], numbers([1.0; 3]));
    assert_eq!(json["scenes"][1]["name"], "elements");
    let elements = &json["nodes"][1];
    assert_eq!((&elements["extras"]["first_element"], &elements["extras"]["with_back"]), (&40.into(), &true.into()));
    let bytes: Vec<u8> = colors.iter().flat_map(|color| color.to_array()).flat_map(f32::to_le_bytes).collect();
    assert!(file.windows(bytes.len()).any(|window| window == bytes));
    // Hidden: no elements.
    let none = MeshExport { triangles: &[], triangle_materials: &[], ..export(&cells, &colors, &materials) };
    assert_eq!(document(&write_object_glb(&with(none)).unwrap())["scenes"].as_array().unwrap().len(), 1);
}

#[test]
fn texture_coordinates_that_do_not_fit_are_refused() {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    mesh.texcoords[0] = vec![Vec2::ZERO; 3];
    let object = Object::new("Thing", mesh.clone(), Material::diffuse(Vec3::ONE));
    let (colors, materials) = ([Vec3::ONE; 4], [Material::diffuse(Vec3::ONE)]);
    let (elements, origin) = (export(&mesh, &colors, &materials), DVec3::ZERO);
    let export = ObjectExport { object: &object, lights: &[], elements, origin, first_element: 0, with_back: false };
    assert!(matches!(write_object_glb(&export), Err(ExportError::Lists(_))));
}
