//! Atlases: rectangles, pages, and what they survive.

use std::io::Cursor;

use exr::prelude::{ReadChannels, ReadLayers, read};
use glam::Vec3;
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{LoadLimits, Scene, load};
use reqwest::Method;
use serde_json::{Value, json};

use super::durable::{insert, start};
use super::glb::room;
use super::server::{Answer, Server, path_of};

/// A page read back: width, height, RGB and validity per texel.
pub(super) struct Page {
    pub(super) width: usize,
    pub(super) values: Vec<Vec3>,
    pub(super) valid: Vec<bool>,
}

impl Page {
    pub(super) fn of(file: &[u8]) -> Page {
        let image = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let layer = image.all_attributes().from_buffered(Cursor::new(file)).unwrap().layer_data;
        let list = &layer.channel_data.list;
        let names: Vec<String> = list.iter().map(|channel| channel.name.to_string()).collect();
        assert_eq!(names, ["B", "G", "R", "valid"]);
        let [b, g, r, valid] = [0, 1, 2, 3].map(|k: usize| list[k].sample_data.values_as_f32().collect::<Vec<f32>>());
        let values = (0..r.len()).map(|k| Vec3::new(r[k], g[k], b[k])).collect();
        Page { width: layer.size.0, values, valid: valid.into_iter().map(|valid| valid == 1.0).collect() }
    }

    /// Bilinear, as an engine does it.
    fn at(&self, [u, v]: [f64; 2]) -> Vec3 {
        let height = self.values.len() / self.width;
        let (x, y) = (u * self.width as f64 - 0.5, v * height as f64 - 0.5);
        let texel = |x: f64, y: f64| self.values[y as usize * self.width + x as usize];
        let (s, t) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
        let row = |y: f64| texel(x.floor(), y).lerp(texel(x.floor() + 1.0, y), s);
        row(y.floor()).lerp(row(y.floor() + 1.0), t)
    }
}

/// The room, lit.
async fn baked(server: &Server, query: &str) -> Value {
    let scene = server.post_glb(&format!("/v1/scenes?{query}"), room().bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    server.get(&path_of(&scene)).await.json(200)
}

async fn atlas(server: &Server, scene: &Value) -> Value {
    server.get(&format!("{}/atlas", path_of(scene))).await.json(200)
}

async fn page(server: &Server, scene: &Value, query: &str) -> Page {
    let answer = server.get(&format!("{}/atlas/0?{query}", path_of(scene))).await;
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    Page::of(&answer.body)
}

/// Page, scale and offset by object.
fn places(atlas: &Value) -> Vec<(String, [Value; 3])> {
    let objects = atlas["objects"].as_array().unwrap().iter();
    let place = |object: &Value| ["page", "scale", "offset"].map(|field| object[field].clone());
    objects.map(|object| (object["object"].as_str().unwrap().to_owned(), place(object))).collect()
}

fn place_of(atlas: &Value, name: &str) -> Option<[Value; 3]> {
    places(atlas).into_iter().find(|(object, _)| object == name).map(|(_, place)| place)
}

/// The scene of `lightmap?format=glb` with its places on pages.
async fn exported(server: &Server, scene: &Value, query: &str) -> (Vec<u8>, Scene) {
    let answer = server.get(&format!("{}/lightmap?format=glb{query}", path_of(scene))).await;
    assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "model/gltf-binary"));
    let scene = load(&answer.body, &LoadLimits::default()).unwrap();
    (answer.body, scene)
}

/// What is at the coordinates of the exported file is what elements there hold.
#[tokio::test]
async fn pages_hold_the_light_of_the_elements() {
    let server = Server::start().await;
    let scene = baked(&server, "samples_per_element=16&texels_per_metre=20&spacing=0.2").await;
    let told = atlas(&server, &scene).await;
    assert_eq!((&told["version"], &told["texels_per_metre"]), (&scene["version"], &json!(20.0)));
    assert_eq!(scene["texels_per_metre"], 20.0);
    assert_eq!(places(&told).iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>(), ["room", "cupboard"]);
    assert!(told["objects"].as_array().unwrap().iter().all(|object| object["texcoord"] == "made"), "{told}");
    let (half, float) = (page(&server, &scene, "").await, page(&server, &scene, "precision=float").await);
    assert_eq!(half.width as u64, told["pages"][0]["width"].as_u64().unwrap());
    let is_near = |(half, float): (&Vec3, &Vec3)| (*half - *float).abs().cmple(float.abs() / 1000.0 + 1e-6).all();
    assert!(half.values.iter().zip(&float.values).all(is_near) && half.valid == float.valid);
    assert!(half.values.iter().zip(&float.values).any(|(half, float)| half != float));

    let elements = server.get(&format!("{}/elements", path_of(&scene))).await.body;
    let raw = server.get(&format!("{}/lightmap?format=raw", path_of(&scene))).await.body;
    let light = rebake_core::delta::Frame::decode(&raw).unwrap().0.values;
    let float_at = |record: &[u8], k: usize| f32::from_le_bytes(record[4 * k..4 * k + 4].try_into().unwrap());
    let elements: Vec<(Vec3, Vec3, Vec3)> = elements
        .chunks_exact(32)
        .zip(light)
        .map(|(record, light)| {
            let vector = |k: usize| Vec3::new(float_at(record, k), float_at(record, k + 1), float_at(record, k + 2));
            (vector(0), vector(3), light)
        })
        .collect();
    let (_, file) = exported(&server, &scene, "").await;
    let mut errors = Vec::new();
    for object in &file.objects {
        let mesh = &object.mesh;
        for corners in &mesh.triangles {
            let [a, b, c] = corners.map(|corner| mesh.positions[corner as usize]);
            let normal = (b - a).cross(c - a).normalize();
            let uvs = corners.map(|corner| mesh.texcoords[1][corner as usize].as_dvec2());
            // Elements that lie in this triangle.
            for (position, n, light) in elements.iter().filter(|(_, n, _)| n.dot(normal) > 0.99) {
                let parts = [(b, c), (c, a), (a, b)].map(|(p, q)| (p - position).cross(q - position).dot(normal));
                let total: f32 = parts.iter().sum();
                let inside = parts.iter().all(|part| part / total > 0.02) && (position - a).dot(*n).abs() < 1e-3;
                if !inside {
                    continue;
                }
                let uv = (0..3).map(|k| uvs[k] * f64::from(parts[k] / total)).sum::<glam::DVec2>();
                errors.push((float.at(uv.to_array()) - *light).length() / light.length().max(0.05));
            }
        }
    }
    // Four texels between elements: their corners are cut a little, and where a wall stands on a cell its elements are read
    // from one side alone.
    errors.sort_unstable_by(f32::total_cmp);
    let part = |part: usize| errors[errors.len() * part / 100];
    assert!(errors.len() > 1000 && part(50) < 0.05 && part(80) < 0.2, "{} {} {}", errors.len(), part(50), part(80));
    server.stop().await;
}

#[tokio::test]
async fn parts_and_layers_of_pages_add_up() {
    let server = Server::start().await;
    let scene = baked(&server, "layers=each&samples_per_element=4&layout=atlas&spacing=0.2").await;
    let part = async |query: &str| page(&server, &scene, &format!("precision=float&{query}")).await;
    let (full, direct, indirect) = (part("").await, part("part=direct").await, part("part=indirect").await);
    let layer = part("layer=lamp").await;
    let weight = scene["layers"][0]["weight"][0].as_f64().unwrap() as f32;
    let is_near = |a: Vec3, b: Vec3| (a - b).length() <= 1e-4 * b.length() + 1e-5;
    for k in 0..full.values.len() {
        assert!(is_near(direct.values[k] + indirect.values[k], full.values[k]), "{k}");
        assert!(is_near(layer.values[k] * weight, full.values[k]), "{k}");
    }
    assert!(full.values.iter().any(|value| value.x > 0.1));
    let error = part("part=error").await;
    let valid = || error.values.iter().zip(&error.valid).filter(|(_, valid)| **valid).map(|(error, _)| error);
    assert!(valid().count() > 1000 && valid().all(|error| error.is_finite() && error.x == error.z));
    assert!(valid().filter(|error| error.x > 0.0).count() * 10 > valid().count() * 9);
    server.stop().await;
}

/// Bit for bit, validity as alpha; bands of a part are layers of an array.
#[tokio::test]
async fn ktx2_pages_hold_what_openexr_pages_do() {
    let server = Server::start().await;
    let scene = baked(&server, "layout=atlas&target=%7B%22samples_per_element%22%3A4%7D").await;
    for (precision, bytes) in [("half", 2), ("float", 4)] {
        let expected = page(&server, &scene, &format!("precision={precision}")).await;
        let query = format!("{}/atlas/0?format=ktx2&precision={precision}", path_of(&scene));
        let answer = server.get(&query).await;
        assert_eq!((answer.status.as_u16(), answer.header("content-type")), (200, "image/ktx2"));
        assert!(answer.header("x-rebake-estimated-rmse").parse::<f32>().unwrap() > 0.0);
        let reader = ktx2::Reader::new(&answer.body[..]).unwrap();
        assert_eq!(reader.header().pixel_width as usize, expected.width);
        let version = scene["version"].to_string() + "\0";
        assert!(reader.key_value_data().any(|pair| pair == ("lightMapVersion", version.as_bytes())));
        let texels = reader.levels().next().unwrap().data.chunks(4 * bytes);
        assert_eq!(texels.len(), expected.values.len());
        for (index, texel) in texels.enumerate() {
            let number = |at: usize| match &texel[at * bytes..(at + 1) * bytes] {
                &[a, b] => half::f16::from_le_bytes([a, b]).to_f32(),
                four => f32::from_le_bytes(four.try_into().unwrap()),
            };
            assert_eq!(Vec3::from_array([0, 1, 2].map(number)), expected.values[index], "{index}");
            assert_eq!(number(3) == 1.0, expected.valid[index], "{index}");
        }
    }
    let bands = server.get(&format!("{}/atlas/0?format=ktx2&part=directional", path_of(&scene))).await;
    let reader = ktx2::Reader::new(&bands.body[..]).unwrap();
    let names = reader.key_value_data().find(|(key, _)| *key == "rebake.layers").unwrap().1;
    assert_eq!(names.split(|byte| *byte == b',').count(), reader.header().layer_count as usize);
    assert!(reader.header().layer_count > 1);
    server.stop().await;
}

#[tokio::test]
async fn rectangles_stay_through_edits_and_a_restart() {
    let directory = tempfile::tempdir().unwrap();
    let server = start(directory.path()).await;
    let asset = server.crate_asset().await;
    let scene = server.baked_room("?samples_per_element=1&texels_per_metre=12.5").await;
    let first = atlas(&server, &scene).await;
    let edit = async |server: &Server, edit: Value| {
        server.end_of(&server.edit(&scene, &edit).await).await;
        atlas(server, &scene).await
    };
    let with_a = edit(&server, insert(&asset, "a")).await;
    let with_b = edit(&server, insert(&asset, "b")).await;
    let moved = json!({ "op": "move", "object": "a", "transform": super::glb::translation(1.0, 1.0, 3.0),
        "budget": { "samples_per_element": 1 } });
    let moved = edit(&server, moved).await;
    for name in ["room", "cupboard"] {
        assert!(place_of(&first, name).is_some());
        assert_eq!(place_of(&moved, name), place_of(&first, name));
    }
    assert_eq!(place_of(&moved, "a"), place_of(&with_a, "a"));
    assert_ne!(place_of(&with_b, "a"), place_of(&with_b, "b"));
    let remove = json!({ "op": "remove", "objects": ["a"], "budget": { "samples_per_element": 1 } });
    let removed = edit(&server, remove).await;
    assert_eq!(place_of(&removed, "a"), None);
    let before = server.get(&format!("{}/atlas/0?precision=float", path_of(&scene))).await.body;
    server.stop().await;

    let server = start(directory.path()).await;
    assert_eq!(atlas(&server, &scene).await, removed, "a restart moves nothing");
    assert!(server.get(&format!("{}/atlas/0?precision=float", path_of(&scene))).await.body == before);
    let more = edit(&server, insert(&asset, "c")).await;
    assert_eq!(places(&more)[..3], places(&removed)[..]);
    assert!(place_of(&more, "c").is_some());
    server.stop().await;
}

#[tokio::test]
async fn scenes_without_an_atlas_get_one_when_it_is_asked_for() {
    let server = Server::start().await;
    let asset = server.crate_asset().await;
    let scene = baked(&server, "samples_per_element=1&spacing=0.25").await;
    assert!(scene.get("texels_per_metre").is_none());
    let first = atlas(&server, &scene).await;
    assert_eq!(first["texels_per_metre"], 4.0, "one per spacing");
    server.end_of(&server.edit(&scene, &insert(&asset, "a")).await).await;
    let second = atlas(&server, &scene).await;
    assert_eq!(places(&second)[..2], places(&first)[..]);
    assert!(page(&server, &scene, "").await.valid.iter().any(|valid| *valid));
    server.stop().await;
}

/// What is exported comes back with its own coordinates, mirrored nodes and all.
#[tokio::test]
async fn coordinates_of_the_file_are_used() {
    let server = Server::start().await;
    let mut source = load(&room().bytes(), &LoadLimits::default()).unwrap();
    let cupboard = source.objects.iter_mut().find(|object| object.name == "cupboard").unwrap();
    std::sync::Arc::make_mut(cupboard).world_from_object *= glam::DMat4::from_scale(glam::DVec3::new(-1.0, 1.0, 1.0))
        * glam::DMat4::from_translation(glam::DVec3::new(-2.0, 0.0, 0.0));
    let upload = async |glb: Vec<u8>| server.post_glb("/v1/scenes?texels_per_metre=10&bake=false", glb).await.json(201);
    let scene = upload(write_scene_glb(&source).unwrap()).await;
    let (file, read) = exported(&server, &scene, "&layout=atlas").await;
    assert!(read.objects.iter().all(|object| object.mesh.texcoords[1].len() == object.mesh.positions.len()));
    let again = atlas(&server, &upload(file).await).await;
    assert!(again["objects"].as_array().unwrap().iter().all(|object| object["texcoord"] == "file"), "{again}");
    assert_eq!(again["objects"].as_array().unwrap().len(), 2);
    let (_, vertices) = exported(&server, &scene, "&layout=vertices").await;
    assert!(vertices.objects[0].mesh.texcoords[1].is_empty());
    server.stop().await;
}

#[tokio::test]
async fn what_has_no_answer_is_refused_by_name() {
    let server = Server::start().await;
    let upload = async |query: &str| server.post_glb(&format!("/v1/scenes?bake=false&{query}"), room().bytes()).await;
    for query in [
        "layout=pages",
        "texels_per_metre=0",
        "texels_per_metre=-1",
        "texels_per_metre=nan",
        "layout=vertices&texels_per_metre=5",
    ] {
        let detail = upload(query).await.problem(400, "invalid-query");
        assert!(detail.contains("layout") || detail.contains("texels_per_metre"), "{detail}");
    }
    for density in ["1e5", "1e30"] {
        let answer = upload(&format!("texels_per_metre={density}")).await;
        let detail = answer.problem(413, "scene-too-large");
        assert!(detail.contains("texels"), "{detail}");
    }
    let scene = upload("layout=atlas").await.json(201);
    let path = format!("{}/atlas", path_of(&scene));
    for page in ["1", "-1", "x", "4294967296"] {
        server.get(&format!("{path}/{page}")).await.problem(404, "not-found");
    }
    for query in ["format=dds", "format=png&precision=half", "layer=all", "layer=sun", "part=nothing", "filter=x"] {
        server.get(&format!("{path}/0?{query}")).await.problem(400, "invalid-query");
    }
    server.get(&format!("{}/lightmap?format=exr&layout=atlas", path_of(&scene))).await.problem(400, "invalid-query");
    let png = server.get(&format!("{path}/0?format=png")).await;
    assert_eq!((png.status.as_u16(), png.header("content-type")), (200, "image/png"));
    assert!(image::load_from_memory(&png.body).is_ok());
    for path in [path.clone(), format!("{path}/0")] {
        let tag = server.get(&path).await.header("etag").to_owned();
        assert_eq!(tag, format!("\"{}\"", scene["version"]));
        let request = server.request(Method::GET, &path).header("if-none-match", &tag);
        assert_eq!(Answer::to(request).await.status, 304);
    }
    server.stop().await;
}

#[tokio::test]
async fn an_atlas_that_would_grow_too_large_refuses_the_edit() {
    let server = Server::with(|config| config.limits.atlas_texels = 20_000).await;
    let asset = server.crate_asset().await;
    let scene = server.post_glb("/v1/scenes?bake=false&texels_per_metre=7", room().bytes()).await.json(201);
    let edits = format!("{}/edits", path_of(&scene));
    let mut refused = None;
    for k in 0..40 {
        let answer = server.post_json(&edits, &insert(&asset, &k.to_string())).await;
        if answer.status != 202 {
            refused = Some(answer);
            break;
        }
    }
    let detail = refused.expect("no room").problem(422, "edit-too-large");
    assert!(detail.contains("texels"), "{detail}");
    server.stop().await;
}
