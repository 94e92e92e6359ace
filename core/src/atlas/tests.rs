use glam::{DMat4, DVec3, Vec3};

use super::*;
use crate::random::Pcg32;
use crate::scene::{Material, Mesh};

fn object(name: &str, mesh: Mesh) -> Object {
    Object::new(name, mesh, Material::diffuse(Vec3::ONE))
}

fn at(object: &Object, world_from_object: DMat4) -> Object {
    Object { world_from_object, ..object.clone() }
}

fn empty(texels_per_metre: f32) -> Atlas {
    let options = AtlasOptions { texels_per_metre: Some(texels_per_metre), ..AtlasOptions::default() };
    Atlas::new(options, 1.0).expect("an atlas")
}

fn next(atlas: &Atlas, objects: &[Object]) -> Result<Atlas, AtlasError> {
    atlas.next(objects.iter().map(|object| Item { object, with_back: false }))
}

fn of(objects: &[Object], texels_per_metre: f32) -> Atlas {
    next(&empty(texels_per_metre), objects).expect("an atlas")
}

/// Texel centres that two triangles of an object cover, and triangles without an area in its rectangle.
fn faults(entry: &Entry) -> (usize, usize) {
    let size = entry.front.size;
    let (mut owners, mut twice, mut flat) = (vec![false; (size[0] * size[1]) as usize], 0, 0);
    for places in &entry.unwrap.places {
        let [a, b, c] = places.map(Vec2::as_dvec2);
        flat += usize::from((b - a).perp_dot(c - a) == 0.0);
        for_rows(*places, 0.0, size, |x, y| {
            if charts::is_inside(*places, x, y) {
                twice += usize::from(std::mem::replace(&mut owners[(y * size[0] + x) as usize], true));
            }
        });
        let margin = f64::from(unwrap::MARGIN) - 1e-3;
        let inside = |at: DVec2| at.min_element() > margin && (0..2).all(|k| at[k] < f64::from(size[k]) - margin);
        assert!([a, b, c].into_iter().all(inside), "{places:?} of {size:?}");
    }
    (twice, flat)
}

/// Texels per metre along the edges of all triangles, least and most.
fn densities(object: &Object, entry: &Entry) -> (f32, f32) {
    let mut range = (f32::INFINITY, 0.0_f32);
    for (corners, places) in object.mesh.triangles.iter().zip(&entry.unwrap.places) {
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            let [p, q] = [i, j].map(|k: usize| object.mesh.positions[corners[k] as usize]);
            let density = (places[i] - places[j]).length() / (p - q).length();
            range = (range.0.min(density), range.1.max(density));
        }
    }
    range
}

#[test]
fn boxes_and_balls_are_laid_flat_at_the_density_that_is_asked_for() {
    let cube = object("cube", Mesh::cuboid(Vec3::ZERO, Vec3::new(1.0, 2.0, 0.5)));
    let ball = object("ball", Mesh::icosphere(1.0, 4));
    let atlas = of(&[cube.clone(), ball.clone()], 20.0);
    let [cube_entry, ball_entry] = ["cube", "ball"].map(|name| atlas.entry(name).expect("an entry"));
    assert_eq!((faults(cube_entry), faults(ball_entry)), ((0, 0), (0, 0)));
    let (least, most) = densities(&cube, cube_entry);
    assert!((least - 20.0).abs() < 1e-3 && (most - 20.0).abs() < 1e-3, "{least} {most}");
    // Six boxes of sides that are whole texels.
    let texels: u32 = [(20, 40), (20, 10), (40, 10)].iter().map(|(w, h)| 2 * (w + 9) * (h + 9)).sum();
    assert!(cube_entry.texels() < u64::from(texels) * 6 / 5, "{} {texels}", cube_entry.texels());
    let (least, most) = densities(&ball, ball_entry);
    assert!(least > 10.0 && most < 40.0, "{least} {most}");
    assert!(ball_entry.texels() < 4 * 5027, "{}", ball_entry.texels());
}

#[test]
fn rectangles_stay_through_all_edits_and_come_and_go_with_their_objects() {
    let cube = object("a", Mesh::cuboid(Vec3::ZERO, Vec3::ONE));
    let named = |name: &str, from: &Object| Object { name: name.to_owned(), ..from.clone() };
    let ball = object("ball", Mesh::icosphere(0.5, 2));
    let start = vec![cube.clone(), named("b", &cube), ball.clone()];
    let first = of(&start, 30.0);
    let fronts = |atlas: &Atlas| -> Vec<Option<Rectangle>> {
        ["a", "b", "ball", "c"].map(|name| atlas.entry(name).map(|entry| entry.front)).to_vec()
    };
    let [a, b, ball_at, _] = fronts(&first)[..] else { panic!("four") };
    assert!(a != b && a.is_some() && ball_at.is_some());
    // Same mesh, same coordinates: made once.
    assert!(Arc::ptr_eq(&first.entries["a"].unwrap, &first.entries["b"].unwrap));
    let turned = DMat4::from_rotation_translation(glam::DQuat::from_rotation_x(1.0), DVec3::new(5.0, 1.0, -3.0));
    let moved = next(&first, &[at(&cube, turned), start[1].clone(), ball.clone()]).expect("a move");
    assert_eq!(fronts(&moved), fronts(&first));
    let more = next(&moved, &[named("c", &cube), ball.clone(), named("b", &cube), cube.clone()]).expect("an insert");
    assert_eq!(fronts(&more)[..3], fronts(&first)[..3]);
    assert!(Arc::ptr_eq(&more.entries["c"].unwrap, &first.entries["a"].unwrap));
    let fewer = next(&more, &[named("c", &cube), ball.clone()]).expect("a removal");
    assert_eq!(fronts(&fewer), [None, None, ball_at, fronts(&more)[3]]);
    let hidden = Object { is_hidden: true, ..ball.clone() };
    let hidden = next(&fewer, &[named("c", &cube), hidden]).expect("an edit");
    assert_eq!(fronts(&hidden), fronts(&fewer));
    // What is freed is given again.
    let back = next(&hidden, &[named("c", &cube), ball.clone(), named("b", &cube), cube.clone()]).expect("an undo");
    assert_eq!(back.pages(), first.pages());
    // Another size is another rectangle, and nobody else moves.
    let large =
        next(&first, &[at(&cube, DMat4::from_scale(DVec3::splat(3.0))), start[1].clone(), ball]).expect("a move");
    assert_eq!(fronts(&large)[1..], fronts(&first)[1..]);
    assert!(large.entry("a").expect("a").texels() > 5 * first.entry("a").expect("a").texels());
}

#[test]
fn backs_with_light_have_rectangles_of_their_own() {
    let quad = object("quad", Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y));
    let with = |with_back: bool| empty(10.0).next([Item { object: &quad, with_back }].into_iter()).expect("an atlas");
    let (one, two) = (with(false), with(true));
    assert!(one.entry("quad").expect("it").back.is_none());
    let entry = two.entry("quad").expect("it");
    assert!(entry.back.is_some_and(|back| back.size == entry.front.size && back.corner != entry.front.corner));
}

fn with_texcoords(mut mesh: Mesh, texcoords: Vec<Vec2>) -> Object {
    mesh.texcoords[1] = texcoords;
    object("it", mesh)
}

fn coordinates(mesh: Mesh, texcoords: Vec<Vec2>, density: f32) -> Coordinates {
    of(&[with_texcoords(mesh, texcoords)], density).entry("it").expect("an entry").coordinates()
}

/// Two quads beside each other, each with a square of the coordinates.
fn quads() -> (Mesh, Vec<Vec2>) {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
    let other = Mesh::quad(Vec3::X * 2.0, Vec3::X, Vec3::Y);
    mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|corner| corner + mesh.positions.len() as u32)));
    mesh.positions.extend(&other.positions);
    mesh.normals.extend(&other.normals);
    mesh.triangle_materials.extend(&other.triangle_materials);
    let place = |p: &Vec3| if p.x < 1.5 { p.truncate() * 0.4 } else { Vec2::new(p.x - 2.0, p.y) * 0.4 + 0.6 };
    let texcoords = mesh.positions.iter().map(place).collect();
    (mesh, texcoords)
}

#[test]
fn coordinates_of_the_file_are_taken_where_they_can_be_used() {
    let (mesh, good) = quads();
    let change = |f: &dyn Fn(Vec2) -> Vec2| good.iter().map(|uv| f(*uv)).collect::<Vec<_>>();
    assert_eq!(coordinates(mesh.clone(), good.clone(), 20.0), Coordinates::File);
    assert_eq!(
        coordinates(mesh.clone(), change(&|uv| Vec2::new(1.0 - uv.x, uv.y)), 20.0),
        Coordinates::File,
        "mirrored"
    );
    assert_eq!(coordinates(mesh.clone(), change(&|uv| uv * 0.1 + 0.7), 20.0), Coordinates::File, "a corner");
    for (name, density, bad) in [
        ("none", 20.0, Vec::new()),
        ("on top of each other", 20.0, change(&|uv| if uv.x > 0.5 { uv - 0.6 } else { uv })),
        ("outside", 20.0, change(&|uv| uv * 1.5)),
        ("not a number", 20.0, change(&|uv| if uv.x > 0.9 { Vec2::NAN } else { uv })),
        ("in a point", 20.0, change(&|_| Vec2::splat(0.5))),
        ("one of them in a line", 20.0, change(&|uv| if uv.x > 0.5 { Vec2::new(uv.x, 0.9) } else { uv })),
        ("too close", 20.0, change(&|uv| if uv.x > 0.5 { uv - Vec2::X * 0.18 - Vec2::Y * 0.6 } else { uv })),
        ("scattered", 20.0, change(&|uv| if uv.x > 0.5 { uv * 0.1 + 0.9 } else { uv * 0.1 })),
    ] {
        assert_eq!(coordinates(mesh.clone(), bad, density), Coordinates::Made, "{name}");
    }
    // The same margin is enough for more texels.
    let close = change(&|uv| if uv.x > 0.5 { uv - Vec2::X * 0.18 - Vec2::Y * 0.6 } else { uv });
    assert_eq!(coordinates(mesh, close, 400.0), Coordinates::File);
}

#[test]
fn coordinates_of_the_file_are_told_as_they_are() {
    let (mesh, texcoords) = quads();
    let it = with_texcoords(mesh.clone(), texcoords.clone());
    let atlas = of(&[it], 20.0);
    let entry = atlas.entry("it").expect("an entry");
    let (scale, offset) = entry.to_page(&entry.front, atlas.pages()[0]);
    for ((corners, told), places) in mesh.triangles.iter().zip(entry.texcoords()).zip(&entry.unwrap.places) {
        for k in 0..3 {
            assert!((told[k] - texcoords[corners[k] as usize]).length() < 1e-5);
            let page = told[k].as_dvec2() * scale + offset;
            let texel = page * f64::from(atlas.pages()[0].width);
            let corner = DVec2::from(entry.front.corner.map(f64::from));
            assert!((texel - corner - places[k].as_dvec2()).length() < 1e-3);
        }
    }
}

#[test]
fn what_folds_over_itself_is_cut() {
    // A spiral ramp of many turns: flat enough everywhere, on top of itself when seen from above.
    let mut ramp = Mesh::default();
    const STEPS: u32 = 1200;
    for k in 0..=STEPS {
        let angle = k as f32 * 0.2;
        let direction = Vec3::new(angle.cos(), 0.0, angle.sin());
        ramp.positions.extend([direction + Vec3::Y * angle * 0.05, direction * 3.0 + Vec3::Y * angle * 0.05]);
    }
    for k in 0..STEPS {
        ramp.triangles.extend([[2 * k, 2 * k + 2, 2 * k + 1], [2 * k + 1, 2 * k + 2, 2 * k + 3]]);
    }
    ramp.triangle_materials = vec![0; ramp.triangles.len()];
    let atlas = of(&[object("ramp", ramp)], 8.0);
    assert_eq!(faults(atlas.entry("ramp").expect("an entry")), (0, 0));
}

/// A hundred thousand triangles that share nothing, slivers and copies among them.
#[test]
fn no_mesh_takes_long_and_none_is_laid_on_itself() {
    let (mut soup, mut rng) = (Mesh::default(), Pcg32::new(5, 1));
    for k in 0..100_000u32 {
        let [x, y] = rng.next_2d();
        let middle = Vec3::new(x, y, rng.next_2d()[0]) * 10.0;
        let mut corner = || middle + (Vec3::new(rng.next_2d()[0], rng.next_2d()[0], rng.next_2d()[0]) - 0.5) * 0.1;
        let corners = [corner(), corner(), corner()];
        soup.positions.extend(match k % 4 {
            0 => [corners[0], corners[0].lerp(corners[1], 1e-4), corners[2]],
            1 => [corners[0], corners[0], corners[1]],
            _ => corners,
        });
        soup.triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
    }
    soup.triangle_materials = vec![0; soup.triangles.len()];
    let atlas = of(&[object("soup", soup)], 4.0);
    let (twice, flat) = faults(atlas.entry("soup").expect("an entry"));
    assert_eq!(twice, 0);
    assert!((24_000..27_000).contains(&flat), "{flat}: those without an area, and no others");
}

#[test]
fn what_has_no_room_is_refused_or_coarser() {
    let floor = object("floor", Mesh::quad(Vec3::ZERO, Vec3::Z * 100.0, Vec3::X * 50.0));
    let density = of(std::slice::from_ref(&floor), 100.0).entry("floor").expect("it").texels_per_metre();
    assert!((30.0..41.0).contains(&density), "{density}");
    let small = AtlasOptions { texels_per_metre: Some(10.0), max_texels: 10_000 };
    let small = Atlas::new(small, 1.0).expect("an atlas");
    assert_eq!(next(&small, &[floor]).map(|_| ()), Err(AtlasError::TooLarge { limit: 10_000, texels_per_metre: 10.0 }));
    let nothing = object("nothing", Mesh::default());
    assert!(next(&small, &[nothing]).expect("nothing to lay out").entry("nothing").is_none());
    for density in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let options = AtlasOptions { texels_per_metre: Some(density), max_texels: 10 };
        assert!(matches!(Atlas::new(options, 1.0), Err(AtlasError::Density(_))), "{density}");
    }
    let dense = Atlas::new(AtlasOptions { texels_per_metre: Some(1e30), max_texels: 1 << 20 }, 1.0).expect("an atlas");
    let cubes: Vec<Object> = (0..50).map(|k| object(&k.to_string(), Mesh::cuboid(Vec3::ZERO, Vec3::ONE))).collect();
    assert!(matches!(next(&dense, &cubes), Err(AtlasError::TooLarge { .. })));
}
