//! Files whose triangles are smaller than light needs: vertices share elements.

use glam::Vec3;
use rebake_core::delta::Frame;
use serde_json::{Value, json};

use super::glb::Glb;
use super::server::{Server, path_of};

/// A room with a lamp and a ball of 1,600 squares, each with vertices of its own: flat shading, as files have it.
fn room_with_ball() -> Vec<u8> {
    let at = |i: u32, k: u32| {
        let (turn, rise) = (f64::from(i) * std::f64::consts::TAU / 40.0, (f64::from(k) / 40.0 - 0.5) * 3.1);
        let (x, y, z) = (rise.cos() * turn.cos(), rise.sin(), rise.cos() * turn.sin());
        [2.0 + 0.15 * x, 1.0 + 0.15 * y, 2.0 + 0.15 * z].map(|x| x as f32)
    };
    let quad = |n: u32| {
        let (i, k) = (n % 40, n / 40);
        [at(i, k), at(i, k + 1), at(i + 1, k + 1), at(i + 1, k)]
    };
    let quads: Vec<[[f32; 3]; 4]> = (0..1600).map(quad).collect();
    let mut glb = Glb::default();
    glb.cuboid("room", [0.0, 0.0, 0.0], [4.0, 3.0, 4.0], 0.7, true).quads("ball", &quads, 0.5, 0.0).point_light(
        "lamp",
        [1.0, 2.5, 2.0],
        20.0,
    );
    glb.bytes()
}

fn object<'s>(scene: &'s Value, name: &str) -> &'s Value {
    scene["objects"].as_array().unwrap().iter().find(|object| object["name"] == name).expect("an object")
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

/// An attribute of the first primitive of an object's mesh, in threes.
fn attribute(file: &[u8], object: &str, name: &str) -> Option<Vec<f32>> {
    let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&file[20..20 + length]).unwrap();
    let bin = &file[20 + length + 8..];
    let node = json["nodes"].as_array().unwrap().iter().find(|node| node["name"] == object).expect("a node");
    let primitive = &json["meshes"][node["mesh"].as_u64().unwrap() as usize]["primitives"][0];
    let accessor = &json["accessors"][primitive["attributes"][name].as_u64()? as usize];
    let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
    let start = (view["byteOffset"].as_u64().unwrap_or(0) + accessor["byteOffset"].as_u64().unwrap_or(0)) as usize;
    Some(floats(&bin[start..start + 12 * accessor["count"].as_u64().unwrap() as usize]))
}

/// The light of elements and the file with it, of one version: a scene gets better while nobody asks for anything.
async fn light_and_file(server: &Server, scene: &Value) -> (Vec<Vec3>, Vec<u8>) {
    loop {
        let light = server.get(&format!("{}/lightmap?format=raw", path_of(scene))).await;
        let file = server.get(&format!("{}/lightmap?format=glb&filter=none", path_of(scene))).await;
        if light.header("x-rebake-version") == file.header("x-rebake-version") {
            let values = Frame::decode(&light.body).unwrap().0.values;
            return (values, file.body);
        }
    }
}

/// What vertices say of the light of their elements, for whoever follows deltas, is what the file has.
async fn check_file(server: &Server, scene: &Value) {
    let scene = server.get(&path_of(scene)).await.json(200);
    let elements = &object(&scene, "ball")["elements"];
    let [first, count] = ["first", "count"].map(|name| elements[name].as_u64().unwrap() as usize);
    assert!((30..640).contains(&count), "{count} elements, a tenth of its vertices");
    let (light, file) = light_and_file(server, &scene).await;
    let [positions, colors, reads, weights] = ["POSITION", "COLOR_0", "_ELEMENTS", "_WEIGHTS"]
        .map(|name| attribute(&file, "ball", name).unwrap_or_else(|| panic!("{name} is there")));
    assert!(positions.len() > 3 * 1600, "all that is round about it is drawn");
    for vertex in 0..positions.len() / 3 {
        let sum: f32 = weights[3 * vertex..3 * vertex + 3].iter().sum();
        assert!((sum - 1.0).abs() < 1e-5);
        for channel in 0..3 {
            let part = |k: usize| {
                let (element, weight) = (reads[3 * vertex + k], weights[3 * vertex + k]);
                weight * light[first + element as usize][channel]
            };
            let mean = part(0) + part(1) + part(2);
            assert!((mean - colors[3 * vertex + channel]).abs() <= 1e-5 * (1.0 + mean.abs()), "vertex {vertex}");
        }
    }
    assert_eq!(attribute(&file, "room", "_ELEMENTS"), None, "where vertices are elements nothing is added");
}

#[tokio::test]
async fn a_ball_of_many_triangles_has_as_few_elements_as_light_needs_through_edits() {
    let server = Server::start().await;
    let path = "/v1/scenes?bake=true&elements=1000&samples_per_element=16";
    let scene = server.post_glb(path, room_with_ball()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    check_file(&server, &scene).await;
    let told = server.get(&path_of(&scene)).await.json(200);
    assert!((800..=1000).contains(&told["live_elements"].as_u64().unwrap()), "{}", told["live_elements"]);
    let turned = json!([0.6, 0.0, -0.8, 0.0, 0.0, 1.0, 0.0, 0.0, 0.8, 0.0, 0.6, 0.0, -1.0, 0.3, 1.0, 1.0]);
    server.end_of(&server.edit(&scene, &json!({ "op": "move", "object": "ball", "transform": turned })).await).await;
    check_file(&server, &scene).await;
    server.end_of(&server.edit(&scene, &json!({ "op": "remove", "objects": ["ball"] })).await).await;
    server.end_of(&server.edit(&scene, &json!({ "op": "undo" })).await).await;
    check_file(&server, &scene).await;
    // The file with its light has the light of its vertices, too.
    let lit = server.get(&format!("{}/lightmap?format=glb&layout=vertices&filter=none", path_of(&scene))).await.body;
    let colors = attribute(&lit, "ball", "COLOR_0").expect("light at vertices");
    assert!(colors.iter().all(|color| color.is_finite()) && colors.iter().any(|color| *color > 0.0));
    server.stop().await;
}
