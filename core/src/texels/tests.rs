use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DMat4, DQuat, DVec3, Vec2};

use super::*;
use crate::atlas::AtlasOptions;
use crate::edit::Edit;
use crate::job::Unobserved;
use crate::random::Pcg32;
use crate::scene::{Material, Mesh, Object, Scene};
use crate::world::WorldOptions;

fn world(objects: Vec<Object>, texels_per_metre: f32) -> World {
    let atlas = AtlasOptions { texels_per_metre: Some(texels_per_metre), ..AtlasOptions::default() };
    let options = WorldOptions { spacing: Some(0.2), atlas: Some(atlas), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects), &options).expect("a world")
}

fn object(name: &str, mesh: Mesh) -> Object {
    Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)))
}

/// A floor, a box that is turned, its mirror image, and a ball.
fn furnished() -> Vec<Object> {
    let turned = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    let cube = Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 0.6, 0.33));
    let place = |name: &str, scale: DVec3, at: DVec3| Object {
        world_from_object: DMat4::from_scale_rotation_translation(scale, turned, at),
        ..object(name, cube.clone())
    };
    vec![
        object("floor", Mesh::quad(Vec3::ZERO, Vec3::Z * 3.1, Vec3::X * 4.3)),
        place("box", DVec3::ONE, DVec3::new(1.0, 1.5, 1.0)),
        place("mirrored", DVec3::new(-1.0, 1.0, 1.0), DVec3::new(3.0, 1.5, 1.0)),
        Object {
            world_from_object: DMat4::from_translation(DVec3::new(3.3, 0.7, 2.5)),
            ..object("ball", Mesh::icosphere(0.4, 3))
        },
    ]
}

/// What a bilinear look-up finds on a page, as an engine does it.
fn look_up(page: &TexelPage, uv: DVec2) -> Vec3 {
    let at = uv * DVec2::new(page.width as f64, page.height as f64) - 0.5;
    let (low, part) = (at.floor(), (at - at.floor()).as_vec2());
    let texel = |dx: f64, dy: f64| {
        let (x, y) = ((low.x + dx) as usize, (low.y + dy) as usize);
        page.values[y * page.width + x]
    };
    texel(0.0, 0.0).lerp(texel(1.0, 0.0), part.x).lerp(texel(0.0, 1.0).lerp(texel(1.0, 1.0), part.x), part.y)
}

/// At random points of all surfaces: what the atlas says, and what the element field says.
fn compare(world: &World, values: &[Vec3], points: usize) -> Vec<(Vec3, Vec3)> {
    let atlas = world.atlas().expect("an atlas");
    let pages: Vec<TexelPage> = (0..atlas.pages().len())
        .map(|page| read_page(world, atlas, page, values, &Unobserved).expect("not canceled"))
        .collect();
    let mut rng = Pcg32::new(11, 1);
    let mut pairs = Vec::new();
    for (index, object) in world.scene.objects.iter().enumerate() {
        let entry = atlas.entry(&object.name).expect("an entry");
        let (scale, offset) = entry.to_page(&entry.front, atlas.pages()[entry.front.page]);
        let texcoords: Vec<[Vec2; 3]> = entry.texcoords().collect();
        let surface = &world.placed[index].surface;
        for _ in 0..points {
            let face = rng.next_u32() as usize % surface.triangles.len();
            let [u, v] = rng.next_2d();
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let source = surface.sources[face];
            let [a, b, c] = texcoords[source.triangle()];
            let [b, c] = if source.turned() { [c, b] } else { [b, c] };
            let uv = (a * (1.0 - u - v) + b * u + c * v).as_dvec2();
            let side = Side { index, entry, rectangle: &entry.front, is_back: false };
            let place = Place { face: face as u32, weights: [u, v] };
            let direct = side.light(world, &place, values).expect("light");
            pairs.push((look_up(&pages[entry.front.page], uv * scale + offset), direct));
        }
    }
    pairs
}

/// Root of the mean square, and the largest.
fn errors(pairs: &[(Vec3, Vec3)]) -> (f32, f32) {
    let squares = pairs.iter().map(|(a, b)| (*a - *b).length_squared());
    ((squares.clone().sum::<f32>() / pairs.len() as f32).sqrt(), squares.fold(0.0, f32::max).sqrt())
}

#[test]
fn bilinear_look_ups_find_what_elements_hold() {
    for density in [20.0, 40.0] {
        let world = world(furnished(), density);
        // A slope of 1 per metre: what lies one texel beside is wrong by one texel's size.
        let slope: Vec<Vec3> = world.positions().iter().copied().collect();
        let (rms, most) = errors(&compare(&world, &slope, 2500));
        assert!(rms * density < 0.2 && most * density < 1.5, "{rms} {most} at {density}");
        let same = vec![Vec3::splat(0.7); world.slots()];
        let (_, most) = errors(&compare(&world, &same, 500));
        assert!(most < 1e-6, "{most}");
    }
}

/// Where texels lie on straight edges nothing is lost but what elements do between themselves.
#[test]
fn flat_rectangles_are_read_as_exactly_as_they_are_wide() {
    let floor = vec![object("floor", Mesh::quad(Vec3::ZERO, Vec3::Z * 3.1, Vec3::X * 4.3))];
    let error = |density: f32| {
        let world = world(floor.clone(), density);
        let mut rng = Pcg32::new(4, 1);
        let rough: Vec<Vec3> = (0..world.slots()).map(|_| Vec3::from([rng.next_2d()[0]; 3])).collect();
        errors(&compare(&world, &rough, 4000)).0
    };
    let (coarse, fine) = (error(20.0), error(80.0));
    assert!(coarse < 0.08 && fine < coarse / 4.0, "{coarse} {fine}");
}

/// A ball has seams all over, a box has edges: what is smooth agrees on both sides, what is not stays apart.
#[test]
fn seams_close_and_edges_stay() {
    let ball = vec![object("ball", Mesh::icosphere(1.0, 3))];
    let world = world(ball, 12.0);
    let mut rng = Pcg32::new(9, 1);
    let rough: Vec<Vec3> = (0..world.slots()).map(|_| Vec3::from([rng.next_2d()[0]; 3])).collect();
    let (atlas, surface) = (world.atlas().expect("an atlas"), &world.placed[0].surface);
    let entry = atlas.entry("ball").expect("it");
    let side = Side { index: 0, entry, rectangle: &entry.front, is_back: false };
    let closed = side.read(&world, &Borders::new(&world, 12.0), &rough);
    let points = side.points(&world);
    let light =
        |point: &Point| (point.place.face != NO_FACE).then(|| side.light(&world, &point.place, &rough)).flatten();
    let open: Vec<Vec3> = points.iter().map(|point| light(point).unwrap_or_default()).collect();
    let seams = seams::seams(surface, entry);
    assert!(seams.len() > 50, "{}", seams.len());
    let difference = |values: &[Vec3]| {
        let ends = seams.iter().flat_map(|[a, b]| (0..9).map(move |k| (a, b, (k as f32 + 0.5) / 9.0)));
        let look_up = |at: Vec2| seams::look_up(at, closed.width).into_iter().map(|(k, w)| values[k] * w).sum::<Vec3>();
        let differences = ends.map(|(a, b, t)| look_up(a[0].lerp(a[1], t)) - look_up(b[0].lerp(b[1], t)));
        (differences.map(|d| d.length_squared()).sum::<f32>() / (9.0 * seams.len() as f32)).sqrt()
    };
    let (before, after) = (difference(&open), difference(&closed.values));
    assert!(after < before / 4.0, "{before} {after}");
    let cube = self::world(vec![object("cube", Mesh::cuboid(Vec3::ZERO, Vec3::ONE))], 10.0);
    let entry = cube.atlas().expect("an atlas").entry("cube").expect("it");
    assert!(seams::seams(&cube.placed[0].surface, entry).is_empty(), "hard edges are no seams");
}

#[test]
fn texels_past_edges_are_filled_and_say_so() {
    let world = world(furnished(), 20.0);
    let atlas = world.atlas().expect("an atlas");
    let ones = vec![Vec3::ONE; world.slots()];
    let page = read_page(&world, atlas, 0, &ones, &Unobserved).expect("a page");
    let is_filled = |x: i64, y: i64| page.values[y as usize * page.width + x as usize].min_element() > 0.99;
    let (mut valid, mut filled) = (0, 0);
    for (x, y) in (0..page.height as i64).flat_map(|y| (0..page.width as i64).map(move |x| (x, y))) {
        filled += usize::from(is_filled(x, y));
        if page.valid[y as usize * page.width + x as usize] {
            valid += 1;
            let around = (-3..=3).flat_map(|dy| (-3..=3).map(move |dx| (x + dx, y + dy)));
            let within =
                |(x, y): &(i64, i64)| (0..page.width as i64).contains(x) && (0..page.height as i64).contains(y);
            assert!(around.filter(within).all(|(x, y)| is_filled(x, y)), "{x} {y}");
        }
    }
    let area: f32 = world.areas().iter().sum();
    assert!((1.0..2.0).contains(&(valid as f32 / (area * 400.0))), "{valid} {}", area * 400.0);
    assert!(filled > valid);
}

#[test]
fn backs_are_read_on_their_own_side() {
    let quad =
        Object::new("quad", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Z), Material::diffuse(Vec3::ONE).double_sided());
    let other = |y: f32| Mesh::quad(Vec3::new(-1.0, y, -1.0), Vec3::X * 3.0, Vec3::Z * 3.0);
    let (above, below) =
        (object("above", other(1.0)), Mesh::quad(Vec3::new(-1.0, -1.0, -1.0), Vec3::Z * 3.0, Vec3::X * 3.0));
    let world = world(vec![quad, above, object("below", below)], 10.0);
    assert!(world.placed[0].with_back, "both sides are seen");
    let value = |slot: usize| if world.normals()[slot].y > 0.0 { Vec3::X } else { Vec3::Y };
    let values: Vec<Vec3> = (0..world.slots()).map(value).collect();
    let atlas = world.atlas().expect("an atlas");
    let entry = atlas.entry("quad").expect("it");
    let sides = [Some(entry.front), entry.back].map(|side| side.expect("two sides"));
    let normals =
        [0, 1].map(|side| world.normals()[world.placed[0].sides().nth(side).expect("a side").start as usize].y);
    for (rectangle, normal) in sides.iter().zip(normals) {
        let page = read_page(&world, atlas, rectangle.page, &values, &Unobserved).expect("a page");
        let middle = (rectangle.corner[1] + 9) as usize * page.width + (rectangle.corner[0] + 9) as usize;
        assert_eq!(page.values[middle], if normal > 0.0 { Vec3::X } else { Vec3::Y });
    }
}

#[test]
fn pages_are_the_same_on_any_number_of_threads_and_after_edits_that_cancel_out() {
    let world = world(furnished(), 25.0);
    let values: Vec<Vec3> = world.positions().iter().map(|p| p.abs()).collect();
    let page =
        |world: &World| read_page(world, world.atlas().expect("an atlas"), 0, &values, &Unobserved).expect("a page");
    let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
    assert_eq!(pool(1).install(|| page(&world)), pool(3).install(|| page(&world)));
    let asset = Arc::new(Scene::from_objects(vec![object("new", Mesh::icosphere(0.2, 2))]));
    let insert = Edit::Insert { asset, name: "new".into(), transform: DMat4::from_translation(DVec3::Y * 2.0) };
    let with = world.apply(&[insert]).expect("an insert").after;
    assert!(with.atlas().expect("an atlas").entry("new").is_some());
    let without = with.apply(&[Edit::Remove { objects: vec!["new".into()] }]).expect("a removal").after;
    assert!(without.atlas().expect("an atlas").entry("new").is_none());
    let moved = |y: f64| Edit::Move { object: "box".into(), transform: DMat4::from_translation(DVec3::Y * y) };
    let moved = without.apply(&[moved(3.0)]).expect("a move").after;
    let rectangle = |world: &World, name: &str| world.atlas().expect("an atlas").entry(name).expect("it").front;
    for name in ["floor", "box", "mirrored", "ball"] {
        assert_eq!(rectangle(&moved, name), rectangle(&world, name), "{name}");
    }
}

/// Tiles of a floor, of which one is beside two, and one a little higher; a wall at their end.
#[test]
fn look_ups_agree_where_objects_touch() {
    let tile = |name: &str, x: f32, z: f32, y: f32| object(name, Mesh::quad(Vec3::new(x, y, z), Vec3::Z, Vec3::X));
    let wall = object("wall", Mesh::quad(Vec3::new(0.0, 0.0, 0.0), Vec3::Y, Vec3::Z));
    let objects = vec![
        tile("a", 0.0, 0.0, 0.0),
        tile("b", 1.0, -0.4, 0.0),
        tile("c", 1.0, 0.6, 0.0),
        tile("high", 0.0, 1.0, 0.05),
        wall,
    ];
    let world = world(objects, 20.0);
    let mut rng = Pcg32::new(9, 1);
    let rough: Vec<Vec3> = (0..world.slots()).map(|_| Vec3::from([rng.next_2d()[0]; 3])).collect();
    let atlas = world.atlas().expect("an atlas");
    let side = |index: usize| {
        let entry = atlas.entry(&world.scene.objects[index].name).expect("it");
        Side { index, entry, rectangle: &entry.front, is_back: false }
    };
    let borders = Borders::new(&world, 20.0);
    let met = |object: usize| borders.of(object).iter().map(|border| border.object).collect::<BTreeSet<_>>();
    let expected: [&[usize]; 5] = [&[1, 2], &[0, 2], &[0, 1], &[], &[]];
    assert_eq!([0, 1, 2, 3, 4].map(met), expected.map(|others| others.iter().copied().collect()));
    // Look-ups on both sides of every border, with it closed and as it was read.
    let none = Borders::none(5);
    let difference = |borders: &Borders| {
        let sheets: Vec<Sheet> = (0..3).map(|index| side(index).read(&world, borders, &rough)).collect();
        let find = |object: usize, place: &Place| {
            let at = side(object).on_rectangle(&world, place);
            let parts = seams::look_up(at, sheets[object].width).into_iter();
            parts.map(|(k, w)| sheets[object].values[k] * w).sum::<Vec3>()
        };
        let mut squares = Vec::new();
        let all = Borders::new(&world, 20.0);
        for (object, border) in (0..3).flat_map(|object| all.of(object).iter().map(move |border| (object, border))) {
            for k in 0..20 {
                let t = (k as f32 + 0.3) / 20.0;
                let [here, there] = [&border.here, &border.there].map(|[from, to]| from.towards(to, t));
                squares.push((find(object, &here) - find(border.object, &there)).length_squared());
            }
        }
        (squares.iter().sum::<f32>() / squares.len() as f32).sqrt()
    };
    let (before, after) = (difference(&none), difference(&borders));
    assert!(after < before / 4.0, "{before} {after}");
    // The mean of both is what it was, and what lies apart is left alone.
    let mean = |borders: &Borders| {
        (0..3).flat_map(|index| side(index).read(&world, borders, &rough).values).map(|v| v.x).sum::<f32>()
    };
    assert!((mean(&none) / mean(&borders) - 1.0).abs() < 0.02);
    for index in [3, 4] {
        assert_eq!(side(index).read(&world, &none, &rough).values, side(index).read(&world, &borders, &rough).values);
    }
}
