//! What is written is read back by [`load`]: the same scene, as edits have left it.

use std::collections::BTreeMap;
use std::sync::Arc;

use ::gltf::json::Value;
use glam::{DMat4, DQuat, DVec3, Vec2, Vec3};
use serde_json::json;

use super::house::{house, picture};
use super::*;
use crate::atlas::AtlasOptions;
use crate::edit::Edit;
use crate::scene::{LoadLimits, Original, Scene, load};
use crate::world::WorldOptions;

fn world(file: &[u8]) -> World {
    let scene = load(file, &LoadLimits::default()).expect("a scene");
    let atlas = Some(AtlasOptions { texels_per_metre: Some(8.0), ..AtlasOptions::default() });
    World::new(scene, &WorldOptions { spacing: Some(0.5), atlas, ..WorldOptions::default() }).expect("a world")
}

fn opened(file: &[u8]) -> Original {
    Original::open(file, &LoadLimits::default()).expect("an original")
}

fn of(file: &[u8]) -> Originals {
    Originals { scene: Some(opened(file)), ..Originals::default() }
}

/// Both layouts: element *i* holds *i* / 100.
fn written(world: &World, originals: &Originals, unlit: bool) -> [Vec<u8>; 2] {
    let values: Vec<Vec3> = (0..world.slots()).map(|slot| Vec3::splat(slot as f32 / 100.0)).collect();
    let atlas = world.atlas().expect("an atlas");
    let page = |page: crate::atlas::Page| {
        let (width, height) = (page.width as usize, page.height as usize);
        TexelPage { width, height, values: vec![Vec3::ONE; width * height], valid: vec![true; width * height] }
    };
    let pages: Vec<TexelPage> = atlas.pages().into_iter().map(page).collect();
    let about = LightAbout { version: Some(7), estimated_rmse: Some(0.5) };
    [LightLayout::Vertices(&values), LightLayout::Atlas(atlas, &pages)]
        .map(|layout| write_lit_glb(&LitExport { world, originals, layout, unlit, about }).expect("a file"))
}

/// The JSON of a binary glTF, and its data.
fn document(file: &[u8]) -> (Value, &[u8]) {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    (::gltf::json::deserialize::from_slice(&file[20..20 + length]).unwrap(), &file[28 + length..])
}

/// Of every node the names from its root on.
fn paths(file: &[u8]) -> Vec<String> {
    fn visit(json: &Value, node: &Value, above: &str, paths: &mut Vec<String>) {
        let node = &json["nodes"][node.as_u64().unwrap() as usize];
        let path = format!("{above}/{}", node["name"].as_str().unwrap());
        node["children"].as_array().into_iter().flatten().for_each(|child| visit(json, child, &path, paths));
        paths.push(path);
    }
    let (json, mut paths) = (document(file).0, Vec::new());
    json["scenes"][0]["nodes"].as_array().unwrap().iter().for_each(|root| visit(&json, root, "", &mut paths));
    paths.sort();
    paths
}

fn material<'j>(json: &'j Value, name: &str) -> &'j Value {
    json["materials"].as_array().unwrap().iter().find(|material| material["name"] == name).expect(name)
}

/// Corners of an object's triangles in the world, counter-clockwise seen from the front, by material.
fn triangles(scene: &Scene, name: &str) -> Vec<(String, [DVec3; 3])> {
    let object = scene.objects.iter().find(|object| object.name == name).expect(name);
    let (mesh, matrix) = (&object.mesh, object.world_from_object);
    let mirrors = DMat3::from_mat4(matrix).determinant() < 0.0;
    let turned = |[a, b, c]: [u32; 3]| if mirrors { [a, c, b] } else { [a, b, c] };
    let place = |corner: u32| matrix.transform_point3(mesh.positions[corner as usize].as_dvec3());
    let all = mesh.triangles.iter().zip(&mesh.triangle_materials);
    let name = |material: u32| object.material_names[material as usize].to_string();
    all.map(|(triangle, material)| (name(*material), turned(*triangle).map(place))).collect()
}

/// Whether every triangle of one scene's object is one of the other's, of the same material and seen from the same
/// side.
fn assert_same_triangles(read: &Scene, scene: &Scene, name: &str) {
    let (read, known) = (triangles(read, name), triangles(scene, name));
    assert_eq!(read.len(), known.len(), "{name}");
    for (material, corners) in known {
        let is_it = |(other, [a, b, c]): &(String, [DVec3; 3])| {
            let turns = [[*a, *b, *c], [*b, *c, *a], [*c, *a, *b]];
            let is_near = |turn: &[DVec3; 3]| turn.iter().zip(corners).all(|(p, q)| p.distance(q) < 1e-5);
            *other == material && turns.iter().any(is_near)
        };
        assert!(read.iter().any(is_it), "{name}: {corners:?} not in {read:?}");
    }
}

fn area(scene: &Scene, name: &str) -> f64 {
    triangles(scene, name).iter().map(|(_, [a, b, c])| (*b - *a).cross(*c - *a).length() * 0.5).sum()
}

fn read(file: &[u8]) -> Scene {
    load(file, &LoadLimits::default()).expect("a file that can be read")
}

const WHOLE: [&str; 11] = [
    "/Floor",
    "/Floor/Planks",
    "/Floor/Planks/Group",
    "/Floor/Planks/Group/Box",
    "/Floor/Planks/Lamp",
    "/Floor/Planks/Lamp/Spot",
    "/Floor/Window",
    "/Top",
    "/Top/Camera",
    "/Top/Cloth",
    "/Top/Marker",
];

#[test]
fn a_scene_is_written_as_its_file_has_it() {
    let file = house();
    let world = world(&file);
    for (layout, written) in written(&world, &of(&file), false).iter().enumerate() {
        let (again, (json, data)) = (read(written), document(written));
        assert_eq!(paths(written), WHOLE);
        for (a, b) in again.objects.iter().zip(&world.scene.objects) {
            assert_eq!(
                (&a.name, a.node.as_ref().and_then(|n| n.id.clone())),
                (&b.name, b.node.as_ref().unwrap().id.clone())
            );
            assert!(a.world_from_object.abs_diff_eq(b.world_from_object, 1e-6));
            match layout {
                1 if a.name != "Cloth" => assert_same_triangles(&again, &world.scene, &a.name),
                _ => {
                    let sides = if a.name == "Cloth" { 2.0 } else { 1.0 };
                    let (got, known) = (area(&again, &a.name), area(&world.scene, &a.name) * sides);
                    assert!((got / known - 1.0).abs() < 1e-3, "{}: {got} {known}", a.name);
                }
            }
        }
        assert_eq!((&again.lights, &again.cameras), (&world.scene.lights, &world.scene.cameras));
        let wood = material(&json, "Wood");
        assert_eq!(wood["pbrMetallicRoughness"]["baseColorFactor"], json!([1.0, 0.5, 0.5, 1.0]));
        let texture = wood["pbrMetallicRoughness"]["baseColorTexture"]["index"].as_u64().unwrap() as usize;
        let texture = &json["textures"][texture];
        assert_eq!(json["samplers"][texture["sampler"].as_u64().unwrap() as usize]["wrapS"], 33648);
        let image = &json["images"][texture["source"].as_u64().unwrap() as usize];
        let view = &json["bufferViews"][image["bufferView"].as_u64().unwrap() as usize];
        let start = view["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!((&image["name"], &data[start..][..picture().len()]), (&json!("wood"), &*picture()));
        // The second set of the file makes way for that of the pages.
        assert_eq!(wood["occlusionTexture"]["texCoord"], 1 + layout);
        assert_eq!(material(&json, "Glow")["emissiveFactor"], json!([1.0, 0.5, 0.25]));
        assert_eq!(material(&json, "Glass")["alphaMode"], "BLEND");
        assert_eq!(
            (&json["asset"]["copyright"], &json["asset"]["extras"]["light_map"]["version"]),
            (&json!("nobody"), &json!(7))
        );
        let node = json["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "Box").unwrap();
        assert_eq!((&node["extras"]["kept"], &node["extras"]["light_map"]["object"]), (&json!(1), &json!("Box")));
        let mesh = &json["meshes"][node["mesh"].as_u64().unwrap() as usize];
        assert_eq!(mesh["name"], "box");
        // The pane is drawn, and no element lies on it.
        let window = json["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "Window").unwrap();
        let window = &json["meshes"][window["mesh"].as_u64().unwrap() as usize]["primitives"];
        let of_pane = |part: &&Value| json["materials"][part["material"].as_u64().unwrap() as usize]["name"] == "Glass";
        assert_eq!(window.as_array().unwrap().iter().filter(of_pane).count(), 1);
    }
}

/// What elements hold is at the vertices: as it is, and as colours that a viewer can show.
#[test]
fn light_is_at_the_vertices_or_on_the_pages() {
    let file = house();
    let world = world(&file);
    assert!(world.slots() > 100, "some light is above 1");
    for unlit in [false, true] {
        let [vertices, atlas] = written(&world, &of(&file), unlit);
        let (json, data) = document(&vertices);
        let mut seen = vec![false; world.slots()];
        for part in json["meshes"].as_array().unwrap().iter().flat_map(|mesh| mesh["primitives"].as_array().unwrap()) {
            let floats = |name: &str| -> Option<Vec<f32>> {
                let accessor = &json["accessors"][part["attributes"].get(name)?.as_u64()? as usize];
                let view = &json["bufferViews"][accessor["bufferView"].as_u64()? as usize];
                let (start, length) = (view["byteOffset"].as_u64()? as usize, view["byteLength"].as_u64()? as usize);
                let words = data[start..start + length].chunks_exact(4);
                Some(words.map(|word| f32::from_le_bytes(word.try_into().unwrap())).collect())
            };
            let Some(colors) = floats("COLOR_0") else { continue };
            let light = floats("_LIGHT").unwrap_or_else(|| colors.clone());
            for (light, color) in light.chunks_exact(3).zip(colors.chunks_exact(3)) {
                assert_eq!((light[0], color[0]), (light[2], if unlit { light[0].min(1.0) } else { light[0] }));
                seen[(light[0] * 100.0).round() as usize] = true;
            }
        }
        assert!(seen.iter().all(|seen| *seen), "every element is a vertex");
        let is_unlit = |name: &str| material(&json, name)["extensions"].get("KHR_materials_unlit").is_some();
        assert_eq!(["Wood", "Red", "Glow", "Glass"].map(is_unlit), [unlit, unlit, false, false]);

        let json = document(&atlas).0;
        for name in ["Wood", "Red", "Glow"] {
            let light_map = &material(&json, name)["extensions"]["MOZ_lightmap"];
            assert_eq!((&light_map["texCoord"], &light_map["extras"]["version"]), (&json!(1), &json!(7)));
            let image = &json["textures"][light_map["index"].as_u64().unwrap() as usize]["source"];
            assert_eq!(json["images"][image.as_u64().unwrap() as usize]["name"], "light map 0");
        }
        let shines = |name: &str| material(&json, name).get("emissiveTexture").is_some();
        assert_eq!(["Wood", "Red", "Glow", "Glass"].map(shines), [unlit, unlit, false, false]);
        let entry = world.atlas().unwrap().entry("Planks").unwrap();
        let node = json["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "Planks").unwrap();
        let (scale, _) = entry.to_page(&entry.front, world.atlas().unwrap().pages()[0]);
        assert_eq!(node["extras"]["light_map"]["scale"], numbers(scale.as_vec2().to_array()));
        // Places on the page are those of the entry.
        let planks = read(&atlas);
        let planks = &planks.objects.iter().find(|object| object.name == "Planks").unwrap().mesh;
        let spread =
            |of: &[Vec2]| of.iter().copied().reduce(Vec2::max).unwrap() - of.iter().copied().reduce(Vec2::min).unwrap();
        let places: Vec<Vec2> = entry.texcoords().flatten().collect();
        assert!((spread(&planks.texcoords[1]) - spread(&places) * scale.as_vec2()).length() < 1e-6);
        assert_eq!(spread(&planks.texcoords[0]), Vec2::ONE);
    }
}

/// A two-sided sheet is two sheets, back to back, each seen from its side alone.
#[test]
fn both_sides_are_apart() {
    let file = house();
    let world = world(&file);
    for written in written(&world, &of(&file), true) {
        let (scene, json) = (read(&written), document(&written).0);
        assert!(material(&json, "Cloth").get("doubleSided").is_none());
        let mut heights: BTreeMap<bool, Vec<f64>> = BTreeMap::new();
        for (_, [a, b, c]) in triangles(&scene, "Cloth") {
            heights.entry((b - a).cross(c - a).y > 0.0).or_default().extend([a.y, b.y, c.y]);
        }
        let (up, down) = (&heights[&true], &heights[&false]);
        assert_eq!(up.len(), down.len());
        let gap = up.iter().copied().fold(f64::INFINITY, f64::min) - down.iter().copied().fold(0.0, f64::max);
        assert!((1e-5..1e-3).contains(&gap), "{gap}");
    }
}

fn edited(world: &World, edits: &[Edit]) -> World {
    world.apply(edits).expect("edits").after
}

#[test]
fn edits_are_in_the_file() {
    let (file, objects) = (house(), |name: &str| vec![name.to_owned()]);
    let (first, mut originals) = (world(&file), of(&file));
    let asset = Arc::new(Scene { asset: Some("a".into()), ..load(&house(), &LoadLimits::default()).unwrap() });
    originals.assets.insert("a".to_owned(), opened(&house()));
    let turn = DQuat::from_axis_angle(DVec3::ONE.normalize(), 0.5);
    let place = DMat4::from_scale_rotation_translation(DVec3::new(-1.0, 2.0, 1.0), turn, DVec3::new(3.0, 9.0, 1.0));
    let albedo = Vec3::new(0.1, 0.2, 0.3);
    let world = edited(
        &first,
        &[
            Edit::Insert { asset, name: "Second".into(), transform: place },
            Edit::Move { object: "Planks".into(), transform: place },
            Edit::Remove { objects: objects("Lamp") },
            Edit::Hide { objects: objects("Window") },
            Edit::Material { object: "Box".into(), albedo },
            Edit::NamedMaterial { object: Some("Planks".into()), material: "Wood".into(), albedo },
        ],
    );
    for (layout, written) in written(&world, &originals, false).iter().enumerate() {
        let (again, json) = (read(written), document(written).0);
        let gone = ["/Floor/Planks/Lamp", "/Floor/Planks/Lamp/Spot", "/Floor/Window"];
        let mut left: Vec<&str> = WHOLE.into_iter().filter(|path| !gone.contains(path)).collect();
        left.extend(["/Second", "/Second/Second\u{2f}Spot"]);
        left.sort_unstable();
        assert_eq!(paths(written), left);
        let shown = || world.scene.objects.iter().filter(|object| !object.is_hidden);
        let names = |scene: &Scene| scene.objects.iter().map(|o| o.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&again), shown().map(|object| object.name.clone()).collect::<Vec<_>>());
        // The box stands on planks that are sheared by it: it stays where it was all the same.
        for object in shown() {
            if layout == 1 && object.name != "Cloth" && object.name != "Second" {
                assert_same_triangles(&again, &world.scene, &object.name);
            }
        }
        let twice = |object: &str| if object == "Second" { area(&world.scene, object) } else { 0.0 };
        assert!(area(&again, "Second") > twice("Second"), "with its cloth on both sides, and its pane");
        let names: Vec<&str> = again.lights.iter().map(|light| light.name.as_str()).collect();
        assert_eq!(names, world.scene.lights.iter().map(|light| light.name.as_str()).collect::<Vec<_>>());
        assert_eq!(again.cameras, world.scene.cameras);
        for name in ["Red", "Blue"] {
            let painted = json["materials"].as_array().unwrap().iter().filter(|material| material["name"] == name);
            let painted =
                painted.filter(|m| m["pbrMetallicRoughness"]["baseColorFactor"] == numbers([0.1, 0.2, 0.3, 1.0]));
            assert_eq!(painted.count(), 1, "{name}");
        }
        let woods = json["materials"].as_array().unwrap().iter().filter(|material| material["name"] == "Wood");
        let has_texture = |wood: &Value| wood["pbrMetallicRoughness"].get("baseColorTexture").is_some();
        let mut woods: Vec<bool> = woods.map(has_texture).collect();
        woods.sort_unstable();
        assert_eq!(woods, [false, true], "painted over in the scene, as it was in the asset");
    }
}

#[test]
fn what_is_tinted_keeps_its_texture() {
    let file = house();
    let first = world(&file);
    let tint = Edit::Tint { object: None, material: Some("Wood".into()), factor: Vec3::new(0.1, 0.2, 0.3) };
    let tinted = edited(&first, &[tint]);
    for written in &written(&tinted, &of(&file), false) {
        let base = material(&document(written).0, "Wood")["pbrMetallicRoughness"].clone();
        assert_eq!(base["baseColorFactor"], numbers([0.1, 0.2, 0.3, 1.0]));
        assert!(base["baseColorTexture"].is_object(), "{base}");
    }
}

#[test]
fn lights_that_move_and_change_are_written_so() {
    let file = house();
    let first = world(&file);
    let moved = Edit::MoveLight {
        light: "Spot".into(),
        position: Some(DVec3::new(5.0, 6.0, 7.0)),
        direction: Some(Vec3::X),
        own_layer: false,
    };
    let relit =
        crate::edit::Relight { light: "Lamp".into(), color: Some(Vec3::new(0.5, 1.0, 0.5)), intensity: Some(3.0) };
    let sun = Edit::InsertLight {
        name: "Sun".into(),
        kind: LightKind::Directional { direction: Vec3::NEG_Y, angle: 0.0 },
        color: Vec3::ONE,
        intensity: 2.0,
    };
    let world = edited(&first, &[moved, Edit::Relight { lights: vec![relit] }, sun]);
    for written in written(&world, &of(&file), false) {
        let again = read(&written);
        assert!(paths(&written).contains(&"/Floor/Planks/Lamp/Spot".to_owned()), "it keeps its place below others");
        assert!(paths(&written).contains(&"/Sun".to_owned()));
        for light in &world.scene.lights {
            let other = again.lights.iter().find(|other| other.name == light.name).expect("it is there");
            assert!((other.strength() - light.strength()).length() < 1e-6, "{light:?} {other:?}");
            if let (
                LightKind::Spot { position: a, direction: b, .. },
                LightKind::Spot { position: c, direction: d, .. },
            ) = (&light.kind, &other.kind)
            {
                assert!(a.distance(*c) < 1e-5 && b.distance(*d) < 1e-5, "{light:?} {other:?}");
            }
        }
    }
    let dark =
        edited(&first, &[Edit::RemoveLight { light: "Lamp".into() }, Edit::RemoveLight { light: "Spot".into() }]);
    for written in written(&dark, &of(&file), false) {
        assert!(read(&written).lights.is_empty());
        assert!(!paths(&written).contains(&"/Floor/Planks/Lamp/Spot".to_owned()));
    }
}

/// Without its file a scene is written as light knows it.
#[test]
fn a_scene_without_its_file_is_written_flat() {
    let world = world(&house());
    for written in written(&world, &Originals::default(), false) {
        let again = read(&written);
        assert_eq!(again.objects.len(), world.scene.objects.len());
        assert!(paths(&written).iter().all(|path| path.matches('/').count() == 1));
        assert_eq!((again.lights.len(), again.cameras.len()), (world.scene.lights.len(), 1));
        let wood = document(&written).0;
        let factor = &material(&wood, "Wood")["pbrMetallicRoughness"]["baseColorFactor"];
        let albedo = world.scene.objects[0].materials[0].albedo;
        assert_eq!(*factor, numbers(albedo.extend(1.0).to_array()));
    }
}

#[test]
fn light_that_does_not_fit_is_refused() {
    let file = house();
    let (world, originals) = (world(&file), of(&file));
    let export = |layout| {
        let about = LightAbout::default();
        write_lit_glb(&LitExport { world: &world, originals: &originals, layout, unlit: false, about })
    };
    let [values, no_numbers] = [Vec3::ONE, Vec3::NAN].map(|value| vec![value; world.slots()]);
    assert!(export(LightLayout::Vertices(&values)).is_ok());
    assert!(matches!(export(LightLayout::Vertices(&values[1..])), Err(ExportError::Lists(_))));
    assert!(matches!(export(LightLayout::Vertices(&no_numbers)), Err(ExportError::NotFinite(_))));
    assert!(matches!(export(LightLayout::Atlas(world.atlas().unwrap(), &[])), Err(ExportError::Lists(_))));
}
