//! Cut-outs, blended and transmissive surfaces: closed forms, geometry in their place, path tracing and full bakes.

use std::sync::Arc;

use glam::{DMat4, DVec3, Mat2, Vec2, Vec3};
use rebake_core::scene::{
    AlphaMode, AlphaUse, Light, LightKind, Look, Material, Mesh, Object, Scene, Texture, TextureUse, Wrap,
};
use rebake_core::{Budget, Edit, LightMap, Unobserved, World, WorldOptions, bake, update};
use rebake_lab::path::path_trace;

use super::edits::check;
use super::scenes::{crate_at, room_objects, world};
use super::statistics::{Estimate, area_mean, assert_agrees, replicate};

pub(super) fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

/// An object all of one look, seen from both sides.
pub(super) fn of_look(name: &str, mesh: Mesh, look: Look) -> Object {
    let mut object = Object::new(name, mesh, Material::diffuse(look.factor.min(Vec3::splat(0.6))).double_sided());
    object.looks = vec![Some(Arc::new(look))];
    object
}

pub(super) fn blend(alpha: f32) -> Look {
    Look { alpha, alpha_mode: AlphaMode::Blend, ..Look::plain(Vec3::splat(0.5)) }
}

pub(super) fn glass(factor: Vec3, transmission: f32) -> Look {
    Look { transmission, ..Look::plain(factor) }
}

/// Holes in the chequered texels of `n` × `n` whose coordinates have an even sum.
fn chequered(n: u32, use_of: impl Fn(Arc<Texture>) -> TextureUse) -> Look {
    let texel = |i: u32| [255, 255, 255, if (i % n + i / n).is_multiple_of(2) { 100 } else { 200 }];
    let rgba: Vec<u8> = (0..n * n).flat_map(texel).collect();
    let texture = Arc::new(Texture::new(n, n, &rgba, AlphaUse::Cutoff(0.5), 1 << 20));
    Look { alpha_mode: AlphaMode::Mask(0.5), base_color: Some(use_of(texture)), ..Look::plain(Vec3::splat(0.5)) }
}

pub(super) fn plainly(texture: Arc<Texture>) -> TextureUse {
    TextureUse { texture, texcoord: 0, linear: Mat2::IDENTITY, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] }
}

/// A horizontal square of side `size` around the y axis; its texture coordinates go from 0 to 1.
pub(super) fn sheet(y: f32, size: f32) -> Mesh {
    let half = 0.5 * size;
    let mut mesh = Mesh::quad(Vec3::new(-half, y, -half), Vec3::Z * size, Vec3::X * size);
    mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x + half, p.z + half) / size).collect();
    mesh
}

pub(super) fn sun() -> Light {
    let kind = LightKind::Directional { direction: Vec3::NEG_Y, angle: 0.0 };
    Light { name: "sun".into(), kind, color: Vec3::ONE, intensity: std::f32::consts::PI }
}

pub(super) fn lit(objects: Vec<Object>, lights: impl IntoIterator<Item = Light>, spacing: f32) -> World {
    let scene = lights.into_iter().fold(Scene::from_objects(objects), Scene::with_light);
    World::new(scene, &WorldOptions { spacing: Some(spacing), ..WorldOptions::default() }).expect("a test scene")
}

pub(super) fn floor() -> Object {
    Object::new("floor", sheet(0.0, 0.4), Material::diffuse(Vec3::ZERO))
}

pub(super) fn slots_of(world: &World, name: &str) -> std::ops::Range<usize> {
    let object = world.objects().find(|object| object.name == name).expect("an object");
    object.first_element as usize..(object.first_element + object.element_count) as usize
}

/// Of direct light exactly as much is left as what is in the way lets through: baked, path traced, and after edits that
/// bring it and take it away.
#[test]
fn direct_light_is_scaled_by_what_goes_through() {
    let tint = Vec3::new(0.2, 0.5, 1.0);
    let absorption = Vec3::new(1.0, 4.0, 0.0);
    let thick = |factor| Look { absorption, thickness: 0.25, ..glass(factor, 1.0) };
    let mask = |alpha| Look { alpha, alpha_mode: AlphaMode::Mask(0.5), ..Look::plain(Vec3::splat(0.5)) };
    let quad = || sheet(1.0, 1.0);
    let slab = || Mesh::cuboid(Vec3::new(-0.5, 1.0, -0.5), Vec3::new(0.5, 1.25, 0.5));
    let half = Vec3::splat(0.5);
    let cases = [
        ("a veil", quad(), blend(0.3), Vec3::splat(0.7)),
        ("alpha 1", quad(), blend(1.0), Vec3::ZERO),
        ("tinted glass", quad(), glass(tint, 1.0), tint),
        ("milky glass", quad(), glass(tint, 0.5), 0.5 * tint),
        ("a veil of milky glass", quad(), Look { transmission: 0.5, factor: tint, ..blend(0.5) }, half + 0.25 * tint),
        ("no hole", quad(), mask(0.5), Vec3::ZERO),
        ("all hole", quad(), mask(0.49), Vec3::ONE),
        ("a sheet with a volume", quad(), thick(tint), tint * (-absorption * 0.25).exp()),
        ("a slab", slab(), thick(Vec3::ONE), (-absorption * 0.25).exp()),
        ("a slab of two tinted sides", slab(), glass(tint, 1.0), tint * tint),
    ];
    for (name, mesh, look, left) in cases {
        let pane = of_look("pane", mesh, look);
        let asset = Arc::new(Scene::from_objects(vec![pane.clone()]));
        let open = lit(vec![floor()], [sun()], 0.1);
        let world = lit(vec![floor(), pane], [sun()], 0.1);
        let is_left = |map: &LightMap, world: &World, left: Vec3, what: &str| {
            for slot in slots_of(world, "floor") {
                let found = map.light.direct[slot];
                assert!((found - left).abs().max_element() < 1e-5, "{name}, {what}: {found} against {left}");
            }
        };
        let map = bake(&world, &budget(8), 1, &Unobserved).expect("nobody cancels");
        is_left(&map, &world, left, "baked");
        let slots: Vec<u32> = slots_of(&world, "floor").map(|slot| slot as u32).collect();
        for value in path_trace(&world, &slots, 16, 1, &Unobserved).expect("nobody cancels").0 {
            assert!((value.direct - left).abs().max_element() < 1e-5, "{name}, traced: {value:?}");
        }
        let insert = Edit::Insert { asset, name: "pane".into(), transform: DMat4::IDENTITY };
        let old = bake(&open, &budget(8), 1, &Unobserved).expect("nobody cancels");
        let there = open.apply(&[insert]).expect("an insert");
        let map = update(&there, &old, &budget(8), None, 1, &Unobserved).expect("nobody cancels");
        is_left(&map, &there.after, left, "inserted");
        let away = there.after.apply(&[Edit::Remove { objects: vec!["pane".into()] }]).expect("a removal");
        let map = update(&away, &map, &budget(8), None, 1, &Unobserved).expect("nobody cancels");
        is_left(&map, &away.after, Vec3::ONE, "removed");
    }
}

/// Shadows of a cut-out are those of its texels, whatever the texture's place.
#[test]
fn cut_outs_are_exact_to_the_texel() {
    let repeated = |wrap: Wrap| {
        move |texture| TextureUse {
            linear: Mat2::from_diagonal(Vec2::new(2.0, 3.0)),
            offset: Vec2::new(-0.4, 0.15),
            wrap: [wrap; 2],
            ..plainly(texture)
        }
    };
    let placed = |uv: Vec2| uv * Vec2::new(2.0, 3.0) + Vec2::new(-0.4, 0.15);
    let texel = |at: f32| (at * 8.0).floor() as i32;
    let mirrored = |at: f32| if at.floor() as i32 % 2 == 0 { at - at.floor() } else { 1.0 - (at - at.floor()) };
    type Place = Box<dyn Fn(Vec2) -> [i32; 2]>;
    let cases: [(&str, Look, Place); 4] = [
        ("plain", chequered(8, plainly), Box::new(move |uv| [texel(uv.x), texel(uv.y)])),
        ("repeated", chequered(8, repeated(Wrap::Repeat)), {
            Box::new(move |uv| [placed(uv).x, placed(uv).y].map(|at| texel(at - at.floor())))
        }),
        ("clamped", chequered(8, repeated(Wrap::Clamp)), {
            Box::new(move |uv| [placed(uv).x, placed(uv).y].map(|at| texel(at).clamp(0, 7)))
        }),
        ("mirrored", chequered(8, repeated(Wrap::Mirror)), {
            Box::new(move |uv| [placed(uv).x, placed(uv).y].map(|at| texel(mirrored(at))))
        }),
    ];
    for (name, look, place) in cases {
        let floor = Object::new("floor", sheet(0.0, 2.0), Material::diffuse(Vec3::splat(0.5)));
        let world = lit(vec![floor, of_look("leaves", sheet(1.0, 1.0), look)], [sun()], 0.03);
        let map = bake(&world, &budget(4), 1, &Unobserved).expect("nobody cancels");
        let (mut holes, mut shadows) = (0, 0);
        for slot in slots_of(&world, "floor") {
            let p = world.positions()[slot];
            let uv = Vec2::new(p.x, p.z) + 0.5;
            let is_outside = uv.min_element() < 0.0 || uv.max_element() > 1.0;
            // The borders of texels are a matter of rounding.
            let near = [Vec2::splat(2e-3), Vec2::new(2e-3, -2e-3), Vec2::new(-2e-3, 2e-3), Vec2::splat(-2e-3)];
            if is_outside || near.iter().any(|step| place(uv + *step) != place(uv)) {
                continue;
            }
            let [x, y] = place(uv);
            let expected = if (x + y) % 2 == 0 { 1.0 } else { 0.0 };
            assert_eq!(map.light.direct[slot], Vec3::splat(expected), "{name} at {p}");
            if expected > 0.0 { holes += 1 } else { shadows += 1 }
        }
        assert!(holes > 50 && shadows > 50, "{name}: {holes} holes and {shadows} shadows");
    }
}

/// The alpha of vertex colours counts, by place: light through a sheet that fades away.
#[test]
fn vertex_alpha_fades() {
    let mut fading = of_look("pane", sheet(1.0, 1.0), blend(0.8));
    let mesh = Arc::make_mut(&mut fading.mesh);
    mesh.colors = mesh.positions.iter().map(|p| Vec3::ONE.extend(p.x + 0.5)).collect();
    let world = lit(vec![floor(), fading], [sun()], 0.05);
    let map = bake(&world, &budget(4), 1, &Unobserved).expect("nobody cancels");
    for slot in slots_of(&world, "floor") {
        let left = 1.0 - 0.8 * (world.positions()[slot].x + 0.5);
        assert!(
            (map.light.direct[slot] - left).abs().max_element() < 1e-4,
            "{} against {left}",
            map.light.direct[slot]
        );
    }
}

/// A cut-out against the same shape in triangles, under a sky and a sun that shines askew: also what it reflects.
#[test]
fn a_cut_out_is_the_shape_that_it_shows() {
    let n = 4;
    let part = |i: u32| {
        let (x, y) = ((i % n) as f32 / n as f32 - 0.5, (i / n) as f32 / n as f32 - 0.5);
        Mesh::quad(Vec3::new(x, 0.4, y), Vec3::Z / n as f32, Vec3::X / n as f32)
    };
    let mut shape = Mesh::default();
    for quad in (0..n * n).filter(|i| (i % n + i / n) % 2 == 1).map(part) {
        let first = shape.positions.len() as u32;
        shape.positions.extend(&quad.positions);
        shape.normals.extend(&quad.normals);
        shape.triangles.extend(quad.triangles.iter().map(|triangle| triangle.map(|corner| corner + first)));
        shape.triangle_materials.extend(&quad.triangle_materials);
    }
    let floor = || Object::new("floor", sheet(0.0, 1.5), Material::diffuse(Vec3::splat(0.7)));
    let sky = Light { name: "sky".into(), kind: LightKind::Environment, color: Vec3::ONE, intensity: 0.5 };
    let askew = LightKind::Directional { direction: Vec3::new(0.48, -0.8, 0.36), angle: 0.0 };
    let askew = Light { kind: askew, ..sun() };
    let of = |leaves: Object| lit(vec![floor(), leaves], [sky.clone(), askew.clone()], 0.06);
    let cut_out = of(of_look("leaves", sheet(0.4, 1.0), chequered(n, plainly)));
    let shape = of(Object::new("leaves", shape, Material::diffuse(Vec3::splat(0.5)).double_sided()));
    let mean = |world: &World, indirect: bool| {
        let floor = slots_of(world, "floor");
        replicate(8, |seed| {
            let map = bake(world, &budget(128), seed, &Unobserved).expect("nobody cancels");
            let value = |i: usize| if indirect { map.light.indirect[i] } else { map.light.direct[i] };
            area_mean(world, |i| floor.contains(&i), |i| value(i).as_dvec3())
        })
    };
    for (part, indirect, bias) in [("direct", false, 0.003), ("indirect", true, 0.05)] {
        let (a, b) = (mean(&cut_out, indirect), mean(&shape, indirect));
        let both = Estimate { mean: a.mean, error: a.error.hypot(b.error) };
        assert_agrees(&format!("{part} light below leaves"), both, b.mean, bias * b.mean);
    }
}

/// A screen of two parts: cut-outs on the left, a veil of tinted glass on the right; upright, around x = 0.
fn screen(name: &str) -> Object {
    let mut mesh = Mesh::quad(Vec3::new(-0.7, 0.2, 0.0), Vec3::X * 0.7, Vec3::Y * 1.4);
    let right = Mesh::quad(Vec3::new(0.0, 0.2, 0.0), Vec3::X * 0.7, Vec3::Y * 1.4);
    mesh.positions.extend(&right.positions);
    mesh.normals.extend(&right.normals);
    mesh.triangles.extend(right.triangles.iter().map(|triangle| triangle.map(|corner| corner + 4)));
    mesh.triangle_materials.extend([1, 1]);
    mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
    let mut object = Object::new(name, mesh, Material::diffuse(Vec3::splat(0.5)).double_sided());
    object.materials.push(Material::diffuse(Vec3::new(0.6, 0.3, 0.2)).double_sided());
    let veil = Look { transmission: 0.6, ..blend(0.8) };
    let tinted = Look { factor: Vec3::new(0.6, 0.3, 0.2), ..veil };
    object.looks = vec![Some(Arc::new(chequered(5, plainly))), Some(Arc::new(tinted))];
    object
}

fn at(x: f64, z: f64) -> DMat4 {
    DMat4::from_translation(DVec3::new(x, 0.0, z))
}

fn room_with_screen() -> World {
    let mut objects = room_objects(0.7);
    objects.push(screen("screen").placed(at(1.9, 1.5)));
    world(objects, 0.15)
}

/// All bounces among surfaces that let light through, against path tracing: in all, and behind the screen.
#[test]
fn a_bake_agrees_with_path_tracing() {
    let world = room_with_screen();
    let slots: Vec<u32> = (0..world.slots() as u32)
        .filter(|&i| world.areas()[i as usize] > 0.0 && world.is_valid(i as usize))
        .step_by(3)
        .collect();
    let near = |i: usize| world.positions()[i].distance(Vec3::new(1.9, 0.9, 1.5)) < 1.0;
    let mean = |inside: bool, value: &dyn Fn(usize) -> Vec3| {
        let (mut sum, mut area) = (0.0, 0.0);
        for (k, &slot) in slots.iter().enumerate().filter(|(_, slot)| !inside || near(**slot as usize)) {
            let a = f64::from(world.areas()[slot as usize]);
            (sum, area) = (sum + a * value(k).as_dvec3().element_sum(), area + a);
        }
        sum / area / 3.0
    };
    let traced: Vec<_> =
        (0..8).map(|seed| path_trace(&world, &slots, 128, seed, &Unobserved).expect("nobody cancels").0).collect();
    let baked: Vec<Arc<LightMap>> =
        (0..8).map(|seed| bake(&world, &budget(128), seed, &Unobserved).expect("nobody cancels")).collect();
    for inside in [false, true] {
        let found =
            |light: &dyn Fn(usize, usize) -> Vec3| replicate(8, |seed| mean(inside, &|k| light(seed as usize, k)));
        let direct = found(&|seed, k| traced[seed][k].direct);
        let of_bake = found(&|seed, k| baked[seed].light.direct[slots[k] as usize]);
        let both = Estimate { mean: of_bake.mean, error: direct.error.hypot(of_bake.error) };
        assert_agrees(&format!("direct light, near the screen: {inside}"), both, direct.mean, 0.0);
        let indirect = found(&|seed, k| traced[seed][k].indirect);
        let of_bake = found(&|seed, k| baked[seed].light.indirect[slots[k] as usize]);
        let both = Estimate { mean: of_bake.mean, error: indirect.error.hypot(of_bake.error) };
        assert_agrees(&format!("indirect light, near the screen: {inside}"), both, indirect.mean, 0.01 * indirect.mean);
    }
}

#[test]
fn a_screen_comes_and_goes() {
    let room = world(room_objects(0.7), 0.15);
    let asset = Arc::new(Scene::from_objects(vec![screen("screen")]));
    let insert = Edit::Insert { asset, name: "screen".into(), transform: at(1.9, 1.5) };
    check("insert a screen", &room, &[insert], Vec3::new(1.9, 0.6, 1.5));
    let remove = Edit::Remove { objects: vec!["screen".into()] };
    check("remove a screen", &room_with_screen(), &[remove], Vec3::new(1.9, 0.6, 1.5));
}

#[test]
fn a_screen_moves_and_is_painted() {
    let before = room_with_screen();
    let turned = Edit::Move { object: "screen".into(), transform: at(1.6, 0.8) * DMat4::from_rotation_y(0.6) };
    check("move a screen", &before, &[turned], Vec3::new(1.6, 0.6, 0.8));
    let scaled = at(1.9, 1.5) * DMat4::from_scale(DVec3::new(0.8, 1.2, 1.0));
    check("scale a screen", &before, &[Edit::Move { object: "screen".into(), transform: scaled }], Vec3::splat(1.5));
    let paint = Edit::Material { object: "screen".into(), albedo: Vec3::new(0.1, 0.6, 0.2) };
    check("paint a screen", &before, &[paint], Vec3::new(1.9, 0.6, 1.5));
}

/// What changes behind a screen is seen through it.
#[test]
fn a_crate_is_put_behind_a_screen() {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::new(0.2, 0.5, 0.7))]));
    let insert = Edit::Insert { asset, name: "crate".into(), transform: at(1.9, 2.2) };
    check("insert behind a screen", &room_with_screen(), &[insert], Vec3::new(1.9, 0.3, 2.2));
}

/// A lamp with holes shines where it has none: half as much where they are half of it, by light sampling and by rays that
/// meet it.
#[test]
fn a_lamp_with_holes_shines_by_half() {
    let lamp = |look: Look| {
        let mut lamp = of_look("lamp", sheet(0.5, 0.5), look);
        lamp.materials[0].emission = Vec3::new(3.0, 2.0, 1.0);
        lit(vec![Object::new("floor", sheet(0.0, 1.0), Material::diffuse(Vec3::splat(0.5))), lamp], [], 0.1)
    };
    let (whole, half) = (lamp(Look::plain(Vec3::ZERO)), lamp(chequered(24, plainly)));
    let mean = |world: &World, value: &dyn Fn(u64) -> Vec<Vec3>| {
        let floor = slots_of(world, "floor");
        let first = floor.start;
        replicate(8, |seed| {
            let values = value(seed);
            area_mean(world, |i| floor.contains(&i), |i| values[i - first].as_dvec3())
        })
    };
    let baked = |world: &World| {
        mean(world, &|seed| {
            let map = bake(world, &budget(64), seed, &Unobserved).expect("nobody cancels");
            map.light.direct[slots_of(world, "floor")].to_vec()
        })
    };
    let slots: Vec<u32> = slots_of(&half, "floor").map(|slot| slot as u32).collect();
    let traced = mean(&half, &|seed| {
        let traced = path_trace(&half, &slots, 64, seed, &Unobserved).expect("nobody cancels").0;
        traced.into_iter().map(|value| value.direct).collect()
    });
    let expected = 0.5 * baked(&whole).mean;
    assert_agrees("a lamp with holes", baked(&half), expected, 2e-3 * expected);
    assert_agrees("a lamp with holes, path traced", traced, expected, 2e-3 * expected);
}
