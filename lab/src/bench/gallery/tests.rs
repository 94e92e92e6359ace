use anyhow::bail;
use rebake_core::Focus;
use rebake_core::scene::{Material, Mesh, Object, Scene};
use serde_json::{Map, Value};

use super::super::{Base, Drag, EditFile, Goal, Options, Seen, Service, Subject, Watcher, run};
use super::*;

#[test]
fn parts_are_chosen_where_light_changes_and_lie_apart() {
    let mut change = vec![0.0f32; 120 * 90];
    for (x, y, value) in [(20, 20, 3.0), (22, 21, 3.0), (100, 70, -2.0), (60, 45, 1.0), (110, 5, 0.1)] {
        change[y * 120 + x] = value;
    }
    let crops = choose_crops(&change, 120, &[]).unwrap();
    assert_eq!(crops.len(), 3);
    for (crop, (x, y)) in crops.iter().zip([(20, 20), (100, 70), (60, 45)]) {
        assert!((crop.x..crop.x + 20).contains(&x) && (crop.y..crop.y + 15).contains(&y), "{crop:?}");
    }
    let wanted = Crop { x: 100, y: 0, width: 20, height: 90 };
    assert_eq!(choose_crops(&change, 120, &[wanted]).unwrap(), [wanted]);
    assert!(choose_crops(&change, 120, &[Crop { x: 101, ..wanted }]).is_err());
    assert!(choose_crops(&[0.0; 120 * 90], 120, &[]).unwrap().is_empty());
}

struct Nobody;

impl Watcher for Nobody {}

/// For benches of methods alone.
struct NoService;

impl Service for NoService {
    fn read_focus(&self, _: &Value, _: &World) -> Result<Focus> {
        bail!("there is no service")
    }

    fn run(&self, _: &PreparedCase, _: Base, _: Goal) -> Result<Timed> {
        bail!("there is no service")
    }

    fn watch(&self, _: &PreparedCase, _: Base, _: Map<String, Value>) -> Result<Vec<Seen>> {
        bail!("there is no service")
    }

    fn drag(&self, _: &World, _: Base, _: &Drag) -> Result<Vec<Seen>> {
        bail!("there is no service")
    }
}

#[test]
fn pictures_of_an_insert_show_that_an_update_comes_nearer_to_the_reference() {
    let object = |name: &str, mesh, material| Object::new(name, mesh, material);
    let walls = Mesh::cuboid(Vec3::ZERO, Vec3::splat(2.0)).inside_out();
    let lamp = Mesh::quad(Vec3::new(0.6, 1.9, 0.6), Vec3::X * 0.8, Vec3::Z * 0.8);
    let scene = Scene::from_objects(vec![
        object("room", walls, Material::diffuse(Vec3::splat(0.7))),
        object("lamp", lamp, Material::emissive(Vec3::splat(9.0))),
        object("box", Mesh::cuboid(Vec3::splat(0.3), Vec3::splat(0.9)), Material::diffuse(Vec3::new(0.7, 0.2, 0.1))),
    ]);
    let file = r#"{"scene": "", "cases": [{"name": "+ box", "edit": "insert", "objects": ["box"]}]}"#;
    let folder = tempfile::tempdir().unwrap();
    let render = RenderOptions { width: 64, height: 48, samples: 2, seed: 0 };
    let pictures = PictureOptions { folder: folder.path().join("new"), camera: None, render, crops: Vec::new() };
    let options = Options {
        spacing: Some(0.2),
        mode: Stated::Indirect,
        methods: vec![Method::PathTrace, Method::Rebake],
        goals: vec![Goal::Samples(16)],
        seeds: 1,
        seed: 1,
        reference_samples: 512,
        reference_elements: 64,
        base_samples: 128,
        measure_base: false,
        measure_change: false,
        filter: None,
        pictures: Some(pictures),
    };
    let file = EditFile::from_json(file).unwrap();
    let subject = Subject { name: "", scene: &scene, file: &file, folder: Path::new(".") };
    let report = run(&subject, &options, &NoService, &mut Nobody).unwrap();
    let found = &report.cases[0].pictures;
    let names: Vec<&str> = found.iter().map(|picture| picture.of).collect();
    assert_eq!(names, ["before", "path-trace", "rebake", "reference"]);
    assert!(found[3].flip == 0.0 && found[3].rmse == 0.0);
    for other in &found[..2] {
        assert!(found[2].rmse < 0.5 * other.rmse && found[2].flip < 0.7 * other.flip, "{found:?}");
    }
    for name in
        ["plus-box-sheet.png", "plus-box-sheet-without-object.png", "plus-box-rebake-change.png", &found[0].file]
    {
        assert!(image_size(&folder.path().join("new").join(name)).0 >= 64, "{name}");
    }
}

fn image_size(path: &Path) -> (usize, usize) {
    let picture = rebake_core::render::read_picture(&std::fs::read(path).unwrap()).unwrap().picture;
    (picture.width, picture.height)
}

#[test]
fn files_are_named_after_cases() {
    assert_eq!(
        [slug("+ Table lamp"), slug("- Sofa/2"), slug("dark sofa")],
        ["plus-table-lamp", "minus-sofa-2", "dark-sofa"]
    );
}
