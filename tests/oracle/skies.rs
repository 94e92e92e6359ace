//! Pictures of the sky and suns with a disc against closed forms and full bakes.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use glam::{DVec3, Vec3};
use rebake_core::scene::{ENVIRONMENT, Light, LightKind, Material, Mesh, Object, Scene, SkyPicture};
use rebake_core::{Budget, Edit, LightMap, Relight, Unobserved, World, WorldOptions, bake, update};
use rebake_lab::path::path_trace;

use super::edits::check;
use super::scenes::{crate_at, room_objects};
use super::statistics::{Estimate, area_mean, assert_agrees, replicate};

fn budget(samples: u32) -> Budget {
    Budget { samples_per_element: samples, target_rmse: None }
}

fn sky(picture: SkyPicture, rotation: f32) -> LightKind {
    LightKind::Sky { picture: Arc::new(picture), rotation }
}

/// A picture whose texels have a radiance by row and column.
fn picture(width: usize, height: usize, radiance: impl Fn(usize, usize) -> [f32; 3]) -> SkyPicture {
    let texels = (0..width * height).flat_map(|i| radiance(i / width, i % width));
    SkyPicture::new(width, height, &texels.collect::<Vec<f32>>()).expect("a picture")
}

/// Grey, brighter towards the top, with a sun of a few texels some 50° high that has most of the light.
fn noon() -> SkyPicture {
    picture(64, 32, |row, column| match (row, column) {
        (13..=14, 40..=41) => [400.0, 360.0, 300.0],
        _ => [0.5 + 0.02 * (32.0 - row as f32), 0.6, 0.8],
    })
}

fn world(objects: Vec<Object>, kind: LightKind, intensity: f32, spacing: f32) -> World {
    let sky = Light { name: ENVIRONMENT.to_owned(), kind, color: Vec3::ONE, intensity };
    let options = WorldOptions { spacing: Some(spacing), ..WorldOptions::default() };
    World::new(Scene::from_objects(objects).with_light(sky), &options).expect("a test scene")
}

fn plane(name: &str, u: Vec3, v: Vec3) -> Object {
    Object::new(name, Mesh::quad(-0.5 * (u + v), u, v), Material::diffuse(Vec3::splat(0.5)))
}

/// What arrives at a plane, mean over it, from a bake and from path tracing.
fn found(world: &World, n: Vec3) -> [Estimate; 2] {
    let faces = |slot: usize| world.normals()[slot].dot(n) > 0.9;
    let baked = replicate(8, |seed| {
        let map = bake(world, &budget(64), seed, &Unobserved).expect("nobody cancels");
        area_mean(world, faces, |slot| map.light.direct[slot].as_dvec3())
    });
    let traced = replicate(8, |seed| {
        let slots: Vec<u32> = (0..world.slots() as u32).filter(|&slot| faces(slot as usize)).collect();
        let (values, _) = path_trace(world, &slots, 64, seed, &Unobserved).expect("nobody cancels");
        area_mean(world, faces, |slot| {
            let at = slots.binary_search(&(slot as u32)).expect("a traced slot");
            values[at].direct.as_dvec3()
        })
    });
    [baked, traced]
}

/// irradiance / π of an upward plane: the part between two polar angles counts by the difference of their sin².
#[test]
fn a_gradient_lights_a_plane_by_its_rows() {
    let radiance = |row: usize| 0.2 + (row as f32 * 0.7).sin().abs() * 3.0;
    let truth: f64 = (0..8)
        .map(|row| {
            let angle = |row: usize| FRAC_PI_2 * row as f64 / 8.0;
            f64::from(radiance(row)) * (angle(row + 1).sin().powi(2) - angle(row).sin().powi(2))
        })
        .sum();
    let picture = picture(32, 16, |row, _| [radiance(row); 3]);
    let world = world(vec![plane("floor", Vec3::Z, Vec3::X)], sky(picture, 0.3), 2.0, 0.3);
    for found in found(&world, Vec3::Y) {
        assert_agrees("a gradient", found, 2.0 * truth, 0.0);
    }
}

/// One texel: E / π = L Δφ (sin² b − sin² a) / 2 π on a floor, and on a wall by where the sky is turned to.
#[test]
fn a_bright_texel_lights_what_faces_it() {
    let (width, height, row, column) = (64, 32, 9, 40);
    let picture = picture(width, height, |r, c| [if (r, c) == (row, column) { 1000.0 } else { 0.0 }; 3]);
    let polar = |row: usize| PI * row as f64 / height as f64;
    let azimuth = |column: usize, rotation: f64| {
        // +x in the middle, +z to its right; a turn about +y takes +x to −z.
        2.0 * PI * (column as f64 / width as f64 - 0.5) - rotation
    };
    let floor = 1000.0 * (polar(row + 1).sin().powi(2) - polar(row).sin().powi(2)) / width as f64;
    // A few thousandths of it are even, and found by chance alone.
    for rotation in [0.0, 1.0] {
        let kind = sky(picture.clone(), rotation as f32);
        let objects = vec![plane("floor", Vec3::Z, Vec3::X)];
        for found in found(&world(objects, kind.clone(), 1.0, 0.5), Vec3::Y) {
            assert_agrees("one texel on a floor", found, floor, 2e-3 * floor);
        }
        // ∫ sin² θ dθ of the texel times ∫ cos(φ − φ of the wall) dφ.
        let heights = |a: f64| 0.5 * a - 0.25 * (2.0 * a).sin();
        let of_rows = heights(polar(row + 1)) - heights(polar(row));
        let of_columns = azimuth(column + 1, rotation).sin() - azimuth(column, rotation).sin();
        let wall = 1000.0 * of_rows * of_columns / PI;
        assert!(wall > 0.0, "the wall faces it");
        let objects = vec![plane("wall", Vec3::Y, Vec3::Z)];
        for found in found(&world(objects, kind, 1.0, 0.5), Vec3::X) {
            assert_agrees("one texel on a wall", found, wall, 2e-3 * wall);
        }
    }
}

/// A sun above a half plane: how much of its disc is seen falls from all to none over the penumbra.
#[test]
fn a_disc_casts_a_penumbra() {
    let angle = 0.2f32;
    let edge_height = 2.0f64;
    let floor = Mesh::quad(Vec3::new(-0.5, 0.0, -0.1), Vec3::Z * 0.2, Vec3::X);
    // It hides the disc where x < 0, seen from below; nothing comes back from it.
    let roof = Mesh::quad(Vec3::new(-1.0, edge_height as f32, -0.5), Vec3::X, Vec3::Z);
    let black = Material::diffuse(Vec3::ZERO);
    let objects =
        vec![Object::new("floor", floor, Material::diffuse(Vec3::splat(0.5))), Object::new("roof", roof, black)];
    let kind = LightKind::Directional { direction: Vec3::NEG_Y, angle };
    let world = world(objects, kind, 3.0, 0.03);
    let maps: Vec<Arc<LightMap>> =
        (0..8).map(|seed| bake(&world, &budget(64), seed, &Unobserved).expect("nobody cancels")).collect();
    let on_floor = |slot: usize| world.positions()[slot].y < 0.1 && world.normals()[slot].y > 0.5;
    // Directions by their projection on the floor: a disc of radius sin(angle / 2), cut where the edge is.
    let radius = f64::from(angle / 2.0).sin();
    let seen = |x: f64| {
        let cut = (-x / edge_height / (1.0 + (x / edge_height).powi(2)).sqrt()).clamp(-radius, radius) / radius;
        (cut.acos() - cut * (1.0 - cut * cut).sqrt()) / PI
    };
    for (low, high) in [(-0.25, -0.15), (-0.15, -0.05), (-0.05, 0.05), (0.05, 0.15), (0.15, 0.25), (0.3, 0.5)] {
        let inside = |slot: usize| {
            let x = f64::from(world.positions()[slot].x);
            on_floor(slot) && low < x && x < high
        };
        let exact = |slot: usize| DVec3::splat(3.0 / PI * seen(f64::from(world.positions()[slot].x)));
        let truth = area_mean(&world, inside, exact);
        let found =
            replicate(8, |seed| area_mean(&world, inside, |slot| maps[seed as usize].light.direct[slot].as_dvec3()));
        if truth < 0.03 {
            assert!(found.mean < 0.05, "{low}: {found:?}");
            continue;
        }
        // The edge is a line in the direction, not quite in the projection: of the second order of the disc.
        assert_agrees(&format!("penumbra from {low} to {high}"), found, truth, 4e-3 * 3.0 / PI);
    }
    // As a whole it gives what it says.
    let lit: Vec<usize> = (0..world.slots()).filter(|&s| on_floor(s) && world.positions()[s].x > 0.3).collect();
    assert!(!lit.is_empty() && lit.iter().all(|&slot| (maps[0].light.direct[slot].x - 3.0 / PI as f32).abs() < 0.02));
}

fn yard() -> Vec<Object> {
    room_objects(0.6).into_iter().filter(|o| !["right", "ceiling", "lamp"].contains(&o.name.as_str())).collect()
}

/// The bake's final gather meets the sky behind near surfaces and in rough cells as well.
#[test]
fn bake_and_path_tracing_agree_under_a_picture() {
    let world = world(yard(), sky(noon(), 0.4), 1.0, 0.15);
    let mean = |value: &dyn Fn(usize) -> Vec3| area_mean(&world, |_| true, |slot| value(slot).as_dvec3());
    let slots: Vec<u32> = (0..world.slots() as u32).collect();
    let traced: Vec<_> =
        (0..6).map(|seed| path_trace(&world, &slots, 64, seed, &Unobserved).expect("nobody cancels").0).collect();
    let baked: Vec<Arc<LightMap>> =
        (0..6).map(|seed| bake(&world, &budget(64), seed, &Unobserved).expect("nobody cancels")).collect();
    let direct = replicate(6, |seed| mean(&|slot| traced[seed as usize][slot].direct));
    let of_bake = replicate(6, |seed| mean(&|slot| baked[seed as usize].light.direct[slot]));
    let both = Estimate { mean: direct.mean, error: direct.error.hypot(of_bake.error) };
    assert_agrees("direct light", both, of_bake.mean, 0.0);
    let indirect = replicate(6, |seed| mean(&|slot| traced[seed as usize][slot].indirect));
    let of_bake = replicate(6, |seed| mean(&|slot| baked[seed as usize].light.indirect[slot]));
    let both = Estimate { mean: indirect.mean, error: indirect.error.hypot(of_bake.error) };
    // Light is looked up between elements: design, section 8.
    assert_agrees("indirect light", both, of_bake.mean, 6e-3 * of_bake.mean);
}

#[test]
fn edits_of_the_sky_and_under_it() {
    let near = Vec3::new(2.2, 0.3, 1.9);
    let under = world(yard(), sky(noon(), 0.4), 1.0, 0.15);
    let turned = Edit::Sky { kind: sky(noon(), 2.0), color: Vec3::ONE, intensity: 0.7 };
    check("another sky", &under, std::slice::from_ref(&turned), near);
    let plain = Edit::Sky { kind: LightKind::Environment, color: Vec3::new(0.4, 0.6, 1.0), intensity: 1.0 };
    check("a plain sky", &under, &[plain], near);
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.4))]));
    let transform = glam::DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9));
    check("a crate under a picture", &under, &[Edit::Insert { asset, name: "crate".into(), transform }], near);
}

/// A light of its own: relit by its weight, without rays, also where the picture has come by an edit.
#[test]
fn a_sky_is_a_layer() {
    let start = world(yard(), LightKind::Environment, 0.3, 0.3);
    let group = Edit::GroupLights { group: Some("sky".into()), lights: vec![ENVIRONMENT.into()] };
    let start = start.apply(&[group]).expect("a group").after;
    let old = bake(&start, &budget(32), 1, &Unobserved).expect("nobody cancels");
    let change = start.apply(&[Edit::Sky { kind: sky(noon(), 0.0), color: Vec3::ONE, intensity: 1.0 }]).expect("a sky");
    let map = update(&change, &old, &budget(32), None, 2, &Unobserved).expect("nobody cancels");
    assert_eq!(map.layer_of(ENVIRONMENT).expect("its layer").name, "sky");
    let color = Some(Vec3::new(0.5, 1.0, 0.0));
    let relight = Relight { light: ENVIRONMENT.into(), color, intensity: Some(3.0) };
    let relit = change.after.apply(&[Edit::Relight { lights: vec![relight] }]).expect("a relight");
    let new = update(&relit, &map, &budget(32), None, 3, &Unobserved).expect("nobody cancels");
    for slot in 0..map.len() {
        let expected = map.total(slot) * Vec3::new(1.5, 3.0, 0.0);
        assert!(new.total(slot).abs_diff_eq(expected, 1e-5 * (1.0 + expected.max_element())), "slot {slot}");
    }
    let other =
        Edit::Sky { kind: LightKind::Point { position: DVec3::ZERO, range: None }, color: Vec3::ONE, intensity: 1.0 };
    assert_eq!(start.apply(&[other]).expect_err("no sky").field, "edits[0].kind");
}
