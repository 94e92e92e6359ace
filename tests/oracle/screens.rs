//! Emission by place: screens and signs against closed forms, plain lamps in their place, path tracing and full bakes.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DMat4, DVec3, Mat2, Vec2, Vec3};
use rebake_core::scene::{AlphaUse, LightKind, Look, Material, Mesh, Object, Scene, Texture, TextureUse, Wrap};
use rebake_core::{Budget, Edit, LightMap, Relight, Unobserved, World, bake, update};
use rebake_lab::path::path_trace;

use super::edits::check;
use super::scenes::{room_objects, world};
use super::statistics::{Estimate, area_mean, assert_agrees, replicate};

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// A picture of `width` × `height` texels of these sRGB colours.
fn picture(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 3]) -> TextureUse {
    let rgba: Vec<u8> = (0..width * height)
        .flat_map(|i| {
            let [r, g, b] = texel(i % width, i / width);
            [r, g, b, 255]
        })
        .collect();
    let texture = Arc::new(Texture::new(width, height, &rgba, AlphaUse::Ignored, 1 << 20));
    TextureUse { texture, texcoord: 0, linear: Mat2::IDENTITY, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] }
}

/// Left red, right blue.
fn two_colors() -> TextureUse {
    picture(2, 1, |x, _| if x == 0 { [255, 0, 0] } else { [0, 0, 255] })
}

/// An object that sends out `radiance` times a picture.
fn shining(name: &str, mesh: Mesh, radiance: Vec3, picture: TextureUse) -> Object {
    let mut object = Object::new(name, mesh, Material { emission: radiance, ..Material::diffuse(Vec3::splat(0.5)) });
    object.looks =
        vec![Some(Arc::new(Look { emission: radiance, emissive: Some(picture), ..Look::plain(Vec3::splat(0.5)) }))];
    object
}

/// A square of a metre at `y` that faces down; texture coordinates are x and z, in one of both sets.
fn panel(y: f32, set: usize) -> Mesh {
    let mut mesh = Mesh::quad(Vec3::Y * y, Vec3::X, Vec3::Z);
    mesh.texcoords[set] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.z)).collect();
    mesh
}

/// irradiance / π at the point of an upward plate from a polygon of unit radiance above it (Lambert 1760).
fn of_polygon(point: DVec3, corners: &[DVec3]) -> f64 {
    let rays: Vec<DVec3> = corners.iter().map(|corner| (*corner - point).normalize()).collect();
    let edge = |i: usize| {
        let (a, b) = (rays[i], rays[(i + 1) % rays.len()]);
        a.cross(b).normalize().y * a.dot(b).acos()
    };
    (0..rays.len()).map(edge).sum::<f64>().abs() / (2.0 * PI)
}

fn slots_of(world: &World, name: &str) -> Vec<u32> {
    let object = world.objects().find(|object| object.name == name).expect("an object");
    (object.first_element..object.first_element + object.element_count).collect()
}

/// Direct light of some slots by a bake or by path tracing.
fn direct(world: &World, slots: &[u32], traced: bool, seed: u64) -> Vec<Vec3> {
    if traced {
        let (values, _) = path_trace(world, slots, 128, seed, &Unobserved).expect("nobody cancels");
        return values.into_iter().map(|value| value.direct).collect();
    }
    let map = bake(world, &budget(64), seed, &Unobserved).expect("nobody cancels");
    slots.iter().map(|slot| map.light.direct[*slot as usize]).collect()
}

/// Squares of a picture over a plate, texel by texel: near, where triangles are sampled by solid angle, and far; with both
/// sets of texture coordinates, turned, repeated, mirrored and clamped pictures.
#[test]
fn a_plate_is_lit_by_every_texel() {
    let texel = |x: i32, y: i32| [(x * 7 + y * 3) % 5, (x * 3 + y) % 3, (x + y) % 2].map(|c| 60 * c as u8);
    let linear = |code: u8| {
        let value = f64::from(code) / 255.0;
        if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
    };
    let repeat = |i: i32| i.rem_euclid(4);
    let mirror = |i: i32| if i.rem_euclid(8) < 4 { i.rem_euclid(8) } else { 7 - i.rem_euclid(8) };
    let clamp = |i: i32| i.clamp(0, 3);
    type Place = Box<dyn Fn(i32, i32) -> [i32; 2]>;
    // Of each square of an eighth of a metre: its texel.
    let cases: Vec<(&str, f32, usize, Mat2, Vec2, Wrap, Place)> = vec![
        ("far", 1.5, 0, Mat2::IDENTITY, Vec2::ZERO, Wrap::Repeat, Box::new(|i, j| [i / 2, j / 2])),
        ("near", 0.25, 1, Mat2::IDENTITY, Vec2::ZERO, Wrap::Repeat, Box::new(|i, j| [i / 2, j / 2])),
        (
            "turned and repeated",
            0.5,
            0,
            Mat2::from_cols(Vec2::Y * 2.0, Vec2::X),
            Vec2::new(0.25, 0.0),
            Wrap::Repeat,
            Box::new(move |i, j| [repeat(j.div_euclid(2) + 1), repeat(i)]),
        ),
        (
            "mirrored",
            0.5,
            1,
            Mat2::from_diagonal(Vec2::splat(2.0)),
            Vec2::ZERO,
            Wrap::Mirror,
            Box::new(move |i, j| [mirror(i), mirror(j)]),
        ),
        (
            "clamped",
            0.5,
            0,
            Mat2::from_diagonal(Vec2::splat(2.0)),
            Vec2::splat(-0.5),
            Wrap::Clamp,
            Box::new(move |i, j| [clamp(i - 2), clamp(j - 2)]),
        ),
    ];
    let radiance = DVec3::new(4.0, 3.0, 2.0);
    for (name, y, set, matrix, offset, wrap, place) in cases {
        let picture = picture(4, 4, |x, y| texel(x as i32, y as i32));
        let picture = TextureUse { texcoord: set, linear: matrix, offset, wrap: [wrap; 2], ..picture };
        let plate = Mesh::quad(Vec3::new(0.1, 0.0, 0.1), Vec3::Z * 0.5, Vec3::X * 0.8);
        let plate = Object::new("plate", plate, Material::diffuse(Vec3::splat(0.5)));
        let world = world(vec![shining("panel", panel(y, set), radiance.as_vec3(), picture), plate], 0.1);
        let slots = slots_of(&world, "plate");
        let exact = |slot: u32| {
            let point = world.positions()[slot as usize].as_dvec3();
            let square = |i: i32, j: i32| {
                let at = |i: i32, j: i32| DVec3::new(f64::from(i), 0.0, f64::from(j)) / 8.0 + DVec3::Y * f64::from(y);
                let factor = of_polygon(point, &[at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]);
                let [x, y] = place(i, j);
                DVec3::from_array(texel(x, y).map(linear)) * factor
            };
            radiance * (0..64).map(|k| square(k % 8, k / 8)).sum::<DVec3>()
        };
        let exact: Vec<DVec3> = slots.iter().map(|slot| exact(*slot)).collect();
        for traced in [false, true] {
            let found: Vec<Vec<Vec3>> = (0..8).map(|seed| direct(&world, &slots, traced, seed)).collect();
            for channel in 0..3 {
                // A quarter of the plate, so that it matters where light comes from.
                let picked: Vec<usize> = (0..slots.len())
                    .filter(|k| {
                        let p = world.positions()[slots[*k] as usize];
                        p.x < 0.5 && p.z < 0.35
                    })
                    .collect();
                let mean =
                    |value: &dyn Fn(usize) -> f64| picked.iter().map(|k| value(*k)).sum::<f64>() / picked.len() as f64;
                let estimate = replicate(8, |seed| mean(&|k| f64::from(found[seed as usize][k][channel])));
                let truth = mean(&|k| exact[k][channel]);
                let what = format!("{name}, channel {channel}, traced: {traced}");
                assert_agrees(&what, estimate, truth, 2e-4 * truth);
            }
        }
    }
}

/// An atlas with one bright patch: what it is the colour of shines, and nothing else, fifteen times as bright as the mean of
/// the picture.
#[test]
fn only_what_shows_the_bright_patch_shines() {
    let bright = |x: u32, y: u32| if x / 16 == 3 && y / 16 == 1 { [255, 200, 0] } else { [0; 3] };
    let tiles = |shines: bool| {
        let mut mesh = Mesh::default();
        for k in 0..16u32 {
            let (i, j) = (k % 4, k / 4);
            if shines && k != 6 {
                continue;
            }
            let corner = Vec3::new(i as f32, 4.0, j as f32) * 0.25;
            let quad = Mesh::quad(corner, Vec3::X * 0.25, Vec3::Z * 0.25);
            let first = mesh.positions.len() as u32;
            // Of an atlas tile each shows a part; the seventh shows the patch.
            let at = if k == 6 { Vec2::new(3.0, 1.0) } else { Vec2::new((k % 3) as f32, (k % 4) as f32) };
            let texcoord = |p: &Vec3| (at + (Vec2::new(p.x, p.z) - Vec2::new(corner.x, corner.z)) * 3.9 + 0.01) / 4.0;
            mesh.texcoords[0].extend(quad.positions.iter().map(texcoord));
            mesh.positions.extend(&quad.positions);
            mesh.normals.extend(&quad.normals);
            mesh.triangles.extend(quad.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
            mesh.triangle_materials.extend(&quad.triangle_materials);
        }
        mesh
    };
    let radiance = Vec3::new(5.0, 4.0, 3.0);
    let plate = || {
        let mesh = Mesh::quad(Vec3::ZERO, Vec3::Z, Vec3::X);
        Object::new("plate", mesh, Material::diffuse(Vec3::splat(0.5)))
    };
    let sign = world(vec![shining("sign", tiles(false), radiance, picture(64, 64, bright)), plate()], 0.1);
    let green = ((200.0f32 / 255.0 + 0.055) / 1.055).powf(2.4);
    let emission = radiance * Vec3::new(1.0, green, 0.0);
    let lamp = Material { emission, ..Material::diffuse(Vec3::splat(0.5)) };
    let lamp = world(vec![Object::new("sign", tiles(true), lamp), plate()], 0.1);
    let mean = |world: &World, traced: bool| {
        let slots = slots_of(world, "plate");
        replicate(8, |seed| {
            let values = direct(world, &slots, traced, seed);
            values.iter().map(|value| f64::from(value.x + value.y)).sum::<f64>() / slots.len() as f64
        })
    };
    let truth = mean(&lamp, false);
    for traced in [false, true] {
        let found = mean(&sign, traced);
        let both = Estimate { mean: found.mean, error: found.error.hypot(truth.error) };
        assert_agrees(&format!("an atlas, traced: {traced}"), both, truth.mean, 2e-4 * truth.mean);
    }
}

/// An upright screen of 1.2 × 0.7 m around x = 0 that faces +z.
fn screen(picture: TextureUse) -> Object {
    let mut mesh = Mesh::quad(Vec3::new(-0.6, 0.3, 0.0), Vec3::X * 1.2, Vec3::Y * 0.7);
    mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x / 1.2 + 0.5, (1.0 - p.y) / 0.7)).collect();
    let mut object = shining("screen", mesh, Vec3::splat(12.0), picture);
    object.materials[0].double_sided = true;
    object
}

fn at(x: f64, z: f64) -> DMat4 {
    DMat4::from_translation(DVec3::new(x, 0.0, z))
}

fn room_with_screen() -> World {
    let mut objects = room_objects(0.7);
    objects.retain(|object| object.name != "lamp");
    objects.push(screen(two_colors()).placed(at(1.9, 1.7)));
    world(objects, 0.15)
}

/// Red on the left and blue on the right, direct and after all bounces, as path tracing has it.
#[test]
fn a_screen_lights_a_room_in_its_colors() {
    let world = room_with_screen();
    let slots: Vec<u32> = (0..world.slots() as u32)
        .filter(|&i| world.areas()[i as usize] > 0.0 && world.is_valid(i as usize))
        .step_by(3)
        .collect();
    let traced: Vec<_> =
        (0..8).map(|seed| path_trace(&world, &slots, 128, seed, &Unobserved).expect("nobody cancels").0).collect();
    let baked: Vec<Arc<LightMap>> =
        (0..8).map(|seed| bake(&world, &budget(128), seed, &Unobserved).expect("nobody cancels")).collect();
    let before_it = |slot: u32, left: bool| {
        let p = world.positions()[slot as usize];
        p.z > 1.8 && p.distance(Vec3::new(if left { 1.4 } else { 2.4 }, 0.6, 1.7)) < 0.8
    };
    let mut found = Vec::new();
    for (left, channel) in [(true, 0), (true, 2), (false, 0), (false, 2)] {
        let picked: Vec<usize> = (0..slots.len()).filter(|k| before_it(slots[*k], left)).collect();
        let mean = |value: &dyn Fn(usize) -> Vec3| {
            picked.iter().map(|k| f64::from(value(*k)[channel])).sum::<f64>() / picked.len() as f64
        };
        let of = |light: &dyn Fn(usize, usize) -> Vec3| replicate(8, |seed| mean(&|k| light(seed as usize, k)));
        let pairs = [
            (of(&|seed, k| traced[seed][k].direct), of(&|seed, k| baked[seed].light.direct[slots[k] as usize]), 0.0),
            (
                of(&|seed, k| traced[seed][k].indirect),
                of(&|seed, k| baked[seed].light.indirect[slots[k] as usize]),
                0.015,
            ),
        ];
        for (traced, baked, bias) in pairs {
            let both = Estimate { mean: baked.mean, error: traced.error.hypot(baked.error) };
            let what = format!("left: {left}, channel {channel}, known bias {bias}");
            assert_agrees(&what, both, traced.mean, bias * traced.mean);
        }
        found.push(pairs[0].1.mean);
    }
    let [left_red, left_blue, right_red, right_blue] = found[..] else { panic!("four means") };
    assert!(left_red > 2.0 * left_blue && right_blue > 2.0 * right_red, "{found:?}");
}

#[test]
fn a_screen_comes_and_goes() {
    let room = world(room_objects(0.7), 0.15);
    let asset = Arc::new(Scene::from_objects(vec![screen(two_colors())]));
    let insert = Edit::Insert { asset, name: "screen".into(), transform: at(1.9, 1.7) };
    check("insert a screen", &room, std::slice::from_ref(&insert), Vec3::new(1.9, 0.6, 1.7));
    let there = room.apply(&[insert]).expect("an insert").after;
    let remove = Edit::Remove { objects: vec!["screen".into()] };
    check("remove a screen", &there, &[remove], Vec3::new(1.9, 0.6, 1.7));
}

#[test]
fn a_screen_moves_and_is_relit() {
    let before = room_with_screen();
    let turned = Edit::Move { object: "screen".into(), transform: at(1.6, 0.9) * DMat4::from_rotation_y(0.6) };
    check("move a screen", &before, &[turned], Vec3::new(1.6, 0.6, 0.9));
    let scaled = at(1.9, 1.7) * DMat4::from_scale(DVec3::new(0.8, 1.2, 1.0));
    check(
        "scale a screen",
        &before,
        &[Edit::Move { object: "screen".into(), transform: scaled }],
        Vec3::new(1.9, 0.6, 2.1),
    );
    let relight = |color, intensity| Relight { light: "screen".into(), color: Some(color), intensity: Some(intensity) };
    let relit = Edit::Relight { lights: vec![relight(Vec3::new(0.3, 1.0, 1.0), 9.0)] };
    check("relight a screen", &before, &[relit], Vec3::new(1.9, 0.6, 1.7));
    // Its albedo is painted, and it shines as before.
    let paint = Edit::Material { object: "screen".into(), albedo: Vec3::new(0.1, 0.6, 0.2) };
    check("paint a screen", &before, &[paint], Vec3::new(1.9, 0.6, 1.7));
}

/// Strength is the factor and the strength of the file: it scales the whole picture, and switches it.
#[test]
fn relighting_scales_the_whole_picture() {
    let world = room_with_screen();
    let kinds: Vec<bool> = world.lights().map(|info| matches!(info.light.kind, LightKind::Emissive { .. })).collect();
    assert_eq!(kinds, [true]);
    assert_eq!(world.lights().next().expect("a light").light.strength(), Vec3::splat(12.0));
    let map = bake(&world, &budget(16), 1, &Unobserved).expect("nobody cancels");
    let relit = |factor: f32| {
        let relight = Relight { light: "screen".into(), color: None, intensity: Some(12.0 * factor) };
        world.apply(&[Edit::Relight { lights: vec![relight] }]).expect("a relight")
    };
    let double = bake(&relit(2.0).after, &budget(16), 1, &Unobserved).expect("nobody cancels");
    for slot in 0..world.slots() {
        let (once, twice) = (map.total(slot) * 2.0, double.total(slot));
        assert!((once - twice).abs().max_element() <= 1e-4 * once.max_element().max(1e-3), "{once} against {twice}");
    }
    let off = update(&relit(0.0), &map, &budget(16), None, 1, &Unobserved).expect("nobody cancels");
    let left = area_mean(&world, |_| true, |slot| off.total(slot).abs().as_dvec3());
    assert!(left < 0.02 * area_mean(&world, |_| true, |slot| map.total(slot).as_dvec3()), "{left}");
}
