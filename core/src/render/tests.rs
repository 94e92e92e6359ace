use std::f32::consts::{FRAC_1_PI, PI};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, Mat2, Vec2, Vec3};

use super::*;
use crate::job::Unobserved;
use crate::scene::{AlphaUse, Light, LightKind, Look, Material, Mesh, Object, Scene, Texture, TextureUse, Wrap};
use crate::{Edit, WorldOptions};

const ALBEDO: Vec3 = Vec3::new(0.6, 0.4, 0.2);

/// A floor of 4 × 4 m around the world's zero whose front looks up.
fn floor_at(height: f32) -> Object {
    let floor = Mesh::quad(Vec3::new(-2.0, height, -2.0), Vec3::Z * 4.0, Vec3::X * 4.0);
    Object::new("floor", floor, Material::diffuse(ALBEDO))
}

fn world(objects: Vec<Object>, lights: Vec<Light>) -> World {
    let mut scene = Scene::from_objects(objects);
    scene.lights.extend(lights);
    World::new(scene, &WorldOptions { spacing: Some(0.25), ..WorldOptions::default() }).unwrap()
}

fn light(kind: LightKind, intensity: f32) -> Light {
    Light { name: "light".to_owned(), kind, color: Vec3::new(1.0, 0.5, 0.25), intensity }
}

/// Straight down from 3 m above the floor, x to the right and −z upward in the picture.
fn from_above() -> Viewpoint {
    Viewpoint::new(DVec3::new(0.0, 3.0, 0.0), DVec3::ZERO, DVec3::NEG_Z, 0.8).unwrap()
}

fn options(width: usize, height: usize, samples: u32) -> RenderOptions {
    RenderOptions { width, height, samples, seed: 7 }
}

/// Where the centre of a pixel of [`from_above`] meets the floor.
fn floor_point(x: usize, y: usize, options: &RenderOptions) -> Vec3 {
    let half = 3.0 * (0.8f32 / 2.0).tan();
    let u = ((x as f32 + 0.5) / options.width as f32 * 2.0 - 1.0) * half * options.width as f32 / options.height as f32;
    let v = ((y as f32 + 0.5) / options.height as f32 * 2.0 - 1.0) * half;
    Vec3::new(u, 0.0, v)
}

fn shot(world: &World, map: &LightMap, view: View, options: &RenderOptions) -> Picture {
    render(world, map, &from_above(), view, options, &Unobserved).unwrap()
}

#[track_caller]
fn assert_close(found: Vec3, expected: Vec3, tolerance: f32) {
    assert!(
        (found - expected).abs().max_element() <= tolerance * expected.max_element().max(1e-3),
        "{found} {expected}"
    );
}

#[test]
fn a_plane_under_a_point_light_has_the_radiance_of_the_formula() {
    let position = DVec3::new(0.5, 2.0, 0.25);
    let lamp = light(LightKind::Point { position, range: None }, 20.0);
    let strength = lamp.strength();
    let world = world(vec![floor_at(0.0)], vec![lamp]);
    let (map, options) = (LightMap::black(world.slots()), options(25, 17, 1));
    for view in [View::Full, View::Direct] {
        let picture = shot(&world, &map, view, &options);
        for (i, pixel) in picture.pixels.iter().enumerate() {
            let to_light = position.as_vec3() - floor_point(i % 25, i / 25, &options);
            let distance2 = to_light.length_squared();
            let irradiance = strength * (to_light.y / distance2.sqrt() / distance2);
            assert_close(*pixel, ALBEDO * FRAC_1_PI * irradiance, 1e-3);
        }
    }
}

#[test]
fn a_square_lamp_lights_the_floor_by_its_form_factor() {
    // A 1 × 1 m lamp 2 m above a point: the form factor of a parallel rectangle over its centre (Howell, B-3), by
    // four quarters.
    let lamp = Mesh::quad(Vec3::new(-0.5, 2.0, -0.5), Vec3::X, Vec3::Z);
    let radiance = Vec3::new(5.0, 4.0, 3.0);
    let world = world(vec![floor_at(0.0), Object::new("lamp", lamp, Material::emissive(radiance))], vec![]);
    let a = 0.25f32;
    let b = a / (1.0 + a * a).sqrt();
    let form_factor = 4.0 * (b * b.atan() * 2.0) / (2.0 * PI);
    let options = RenderOptions { width: 1, height: 1, samples: 4096, seed: 3 };
    // From below the lamp, a field of view of almost nothing: one point.
    let viewpoint = Viewpoint::new(DVec3::new(0.0, 1.0, 0.0), DVec3::ZERO, DVec3::X, 1e-4).unwrap();
    let map = LightMap::black(world.slots());
    let picture = render(&world, &map, &viewpoint, View::Full, &options, &Unobserved).unwrap();
    assert_close(picture.pixels[0], ALBEDO * radiance * form_factor, 5e-3);
    // The lamp itself, seen from the floor.
    let viewpoint = Viewpoint::new(DVec3::new(0.0, 1.0, 0.0), DVec3::new(0.0, 2.0, 0.0), DVec3::X, 0.1).unwrap();
    let picture = render(&world, &map, &viewpoint, View::Direct, &options, &Unobserved).unwrap();
    assert_close(picture.pixels[0], radiance, 1e-4);
}

/// A floor that shines red on the left and blue on the right.
fn two_colors() -> Object {
    let mut floor = floor_at(0.0);
    let mesh = Arc::make_mut(&mut floor.mesh);
    mesh.texcoords[1] = mesh.positions.iter().map(|p| Vec2::new(p.x + 2.0, p.z + 2.0) / 4.0).collect();
    floor.materials[0].emission = Vec3::new(5.0, 4.0, 3.0);
    let texture = Arc::new(Texture::new(2, 1, &[255, 0, 0, 255, 0, 0, 255, 255], AlphaUse::Ignored, 16));
    let linear = Mat2::IDENTITY;
    let emissive = TextureUse { texture, texcoord: 1, linear, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] };
    floor.looks = vec![Some(Arc::new(Look { emissive: Some(emissive), ..Look::plain(ALBEDO) }))];
    floor
}

#[test]
fn emissive_textures_are_seen_by_place() {
    let world = world(vec![two_colors()], vec![]);
    let options = options(24, 16, 1);
    let picture = shot(&world, &LightMap::black(world.slots()), View::Full, &options);
    for (i, pixel) in picture.pixels.iter().enumerate() {
        let is_left = floor_point(i % 24, i / 24, &options).x < 0.0;
        assert_close(*pixel, if is_left { Vec3::X * 5.0 } else { Vec3::Z * 3.0 }, 1e-4);
    }
}

#[test]
fn indirect_light_is_what_the_map_says() {
    let world = world(vec![floor_at(0.0)], vec![]);
    // Linear in the position, so that interpolation between elements is exact; at the vertices, where the renderer
    // looks values up, not at the sample points, which lie a little inside of borders.
    let value = |p: Vec3| Vec3::new(3.0 + p.x, 2.0 + 0.5 * p.z, 1.0);
    let mut map = LightMap::black(world.slots());
    let placed = &world.placed[0];
    map.light.indirect = placed.layout.corners(&placed.surface).into_iter().map(value).collect();
    map.light.direct = vec![Vec3::splat(10.0); map.len()];
    let options = options(24, 16, 1);
    for (view, expected) in [
        (View::Indirect, (&|p| ALBEDO * value(p)) as &dyn Fn(Vec3) -> Vec3),
        // No light is there to be sampled: direct light comes from rays, never from the map.
        (View::Full, &|p| ALBEDO * value(p)),
        (View::LightMap, &|p| value(p) + Vec3::splat(10.0)),
        (View::Direct, &|_| Vec3::ZERO),
    ] {
        for (i, pixel) in shot(&world, &map, view, &options).pixels.iter().enumerate() {
            assert_close(*pixel, expected(floor_point(i % 24, i / 24, &options)), 1e-4);
        }
    }
}

#[test]
fn shadows_are_sharp_under_a_point_light() {
    let position = DVec3::new(0.0, 2.0, 0.0);
    let cube = Object::new(
        "cube",
        Mesh::cuboid(Vec3::new(0.4, 0.9, -0.1), Vec3::new(0.6, 1.0, 0.1)),
        Material::diffuse(ALBEDO),
    );
    let world = world(vec![floor_at(0.0), cube], vec![light(LightKind::Point { position, range: None }, 10.0)]);
    // Between the cube and its shadow on the floor: from x = 0.73 (lower edge 0.4) to x = 1.2 (upper edge 0.6).
    let at = |x: f64| {
        let viewpoint = Viewpoint::new(DVec3::new(x, 0.2, 0.0), DVec3::new(x, 0.0, 0.0), DVec3::X, 0.001).unwrap();
        let map = LightMap::black(world.slots());
        render(&world, &map, &viewpoint, View::Full, &options(1, 1, 4), &Unobserved).unwrap().pixels[0]
    };
    assert_eq!(at(0.9), Vec3::ZERO);
    assert!(at(0.6).min_element() > 0.0 && at(1.4).min_element() > 0.0);
}

#[test]
fn backs_are_looked_through_and_nothing_is_the_environment() {
    let sky = light(LightKind::Environment, 2.0);
    let radiance = sky.strength();
    // A ceiling that looks down, between camera and floor; it hides the sky from the floor nonetheless.
    let ceiling = Mesh::quad(Vec3::new(-50.0, 1.0, -50.0), Vec3::X * 100.0, Vec3::Z * 100.0);
    let ceiling = Object::new("ceiling", ceiling, Material::diffuse(Vec3::ONE));
    let with_ceiling = world(vec![floor_at(0.0), ceiling], vec![sky.clone()]);
    let options = options(16, 16, 16);
    let map = LightMap::black(with_ceiling.slots());
    let under = shot(&with_ceiling, &map, View::Full, &options);
    assert!(under.pixels.iter().all(|p| p.max_element() < 0.05 * radiance.max_element()));
    let mut even = map;
    even.light.indirect.fill(Vec3::ONE);
    assert!(
        shot(&with_ceiling, &even, View::Indirect, &options)
            .pixels
            .iter()
            .all(|p| (*p - ALBEDO).abs().max_element() < 1e-5)
    );
    let open = world(vec![floor_at(0.0)], vec![sky]);
    let lit = shot(&open, &LightMap::black(open.slots()), View::Full, &options);
    assert_close(lit.pixels[8 * 16 + 8], ALBEDO * radiance, 1e-5);
    let up = Viewpoint::new(DVec3::Y, DVec3::Y * 2.0, DVec3::X, 1.0).unwrap();
    let seen = render(&open, &LightMap::black(open.slots()), &up, View::Full, &options, &Unobserved).unwrap();
    assert!(seen.pixels.iter().all(|p| *p == radiance));
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let lamp = Mesh::quad(Vec3::new(-0.5, 2.0, -0.5), Vec3::X, Vec3::Z);
    let lamp = Object::new("lamp", lamp, Material::emissive(Vec3::ONE));
    let world = world(vec![floor_at(0.0), lamp], vec![light(LightKind::Environment, 0.5)]);
    let map = LightMap::black(world.slots());
    let with = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = RenderOptions { seed, ..options(50, 37, 4) };
        pool.install(|| shot(&world, &map, View::Full, &options))
    };
    let one = with(1, 7);
    assert_eq!(one, with(3, 7));
    assert_ne!(one, with(3, 8));
}

#[test]
fn a_canceled_picture_ends() {
    struct Cancel(AtomicBool);
    impl Observer for Cancel {
        fn canceled(&self) -> bool {
            // The first tile runs, the others do not.
            self.0.swap(true, Ordering::Relaxed)
        }
    }
    let world = world(vec![floor_at(0.0)], vec![]);
    let map = LightMap::black(world.slots());
    let cancel = Cancel(AtomicBool::new(false));
    assert_eq!(render(&world, &map, &from_above(), View::Full, &options(64, 64, 1), &cancel), Err(Canceled));
    let values = vec![0.0; world.slots()];
    let cancel = Cancel(AtomicBool::new(true));
    assert_eq!(render_values(&world, &values, &from_above(), &options(64, 64, 1), &cancel), Err(Canceled));
}

#[test]
fn change_is_told_where_there_is_something_to_compare() {
    let cube = |x: f32| Mesh::cuboid(Vec3::new(x, 0.2, 0.0), Vec3::new(x + 0.5, 0.7, 0.5));
    let old = world(vec![floor_at(0.0), Object::new("cube", cube(0.0), Material::diffuse(ALBEDO))], vec![]);
    let new = old.apply(&[Edit::Remove { objects: vec!["cube".to_owned()] }]).unwrap().after;
    let asset = std::sync::Arc::new(Scene::from_objects(vec![Object::new("a", cube(0.0), Material::diffuse(ALBEDO))]));
    let transform = glam::DMat4::IDENTITY;
    let new = new.apply(&[Edit::Insert { asset, name: "other".to_owned(), transform }]).unwrap().after;
    let (mut before, mut after) = (LightMap::black(old.slots()), LightMap::black(new.slots()));
    before.light.direct.fill(Vec3::splat(1.0));
    after.light.indirect.fill(Vec3::new(0.0, 1.0, 3.5));
    let change = change_since((&old, &before), (&new, &after));
    let objects = new.object_indices();
    assert_eq!(old.slots(), new.slots(), "the new cube fills the hole of the old one");
    for (slot, value) in change.iter().enumerate() {
        let expected = if objects[slot] == 0 { 0.5 } else { 0.0 };
        assert_eq!(*value, expected, "slot {slot}");
    }
    let picture = render_values(&new, &change, &from_above(), &options(40, 40, 4), &Unobserved).unwrap();
    assert!((picture.values[0] - 0.5).abs() < 1e-5 && picture.values[22 * 40 + 22] == 0.0);
    assert_eq!(picture.auto_scale(), 0.5);
    // Red where it is brighter, at the palette's end.
    let png = image::load_from_memory(&picture.png(0.5, Palette::Signed).unwrap()).unwrap().into_rgb8();
    let [r, g, b] = png.get_pixel(0, 0).0;
    assert!(r > 3 * b && r > 10 * g, "{r} {g} {b}");
}

#[test]
fn wrong_viewpoints_are_named() {
    let new =
        |eye: DVec3, target: DVec3, up: DVec3, fov_y: f32| Viewpoint::new(eye, target, up, fov_y).unwrap_err().field;
    assert_eq!(new(DVec3::NAN, DVec3::X, DVec3::Y, 1.0), "eye");
    assert_eq!(new(DVec3::ZERO, DVec3::ZERO, DVec3::Y, 1.0), "target");
    assert_eq!(new(DVec3::ZERO, DVec3::Y, DVec3::NEG_Y, 1.0), "up");
    assert_eq!(new(DVec3::ZERO, DVec3::X, DVec3::ZERO, 1.0), "up");
    assert_eq!(new(DVec3::ZERO, DVec3::X, DVec3::Y, PI), "fov_y");
}

#[test]
fn tone_maps_keep_order_and_range() {
    for tone in [ToneMap::AgX, ToneMap::Neutral, ToneMap::Linear] {
        let mut last = -1.0;
        for stop in -12..12 {
            let mapped = tone.map(Vec3::splat((stop as f32).exp2()));
            assert!(mapped.x >= last && (0.0..=1.0).contains(&mapped.x), "{tone:?} {stop} {mapped}");
            last = mapped.x;
        }
        assert_eq!(tone.encode(Vec3::splat(f32::NAN)), tone.encode(Vec3::ZERO));
        assert!(tone.encode(Vec3::splat(f32::INFINITY))[0] >= 254, "{tone:?}");
    }
    // The formula's own statement: colours below 0.8 − 0.04 lose 0.04, no more.
    assert_close(ToneMap::Neutral.map(Vec3::new(0.5, 0.3, 0.2)), Vec3::new(0.46, 0.26, 0.16), 1e-6);
    assert_eq!(ToneMap::Linear.encode(Vec3::new(0.0, 0.214_041_14, 1.0)), [0, 128, 255]);
}

#[test]
fn automatic_numbers_are_round() {
    assert_eq!(auto_exposure(&[Vec3::ZERO; 4]), 0.0);
    assert!((auto_exposure(&[Vec3::splat(0.18 / 8.0), Vec3::ZERO, Vec3::splat(0.18 / 2.0)]) - 2.0).abs() < 1e-6);
    assert_eq!(nice_scale(&[0.0; 3]), 1.0);
    assert_eq!(nice_scale(&[0.3, -0.31]), 0.5);
    assert_eq!(nice_scale(&[2e-4; 10]), 2e-4);
    assert_eq!(nice_scale(&[0.0071; 10]).to_string(), "0.01");
}

#[test]
fn pictures_are_read_back() {
    let pixels: Vec<Vec3> = (0..12).map(|i| Vec3::new(i as f32 * 0.1, 0.5, 2.0)).collect();
    let picture = Picture { width: 4, height: 3, pixels };
    let png = image::load_from_memory(&picture.png(0.0, ToneMap::Linear).unwrap()).unwrap().into_rgb8();
    assert_eq!(png.dimensions(), (4, 3));
    let expected = (srgb_from_linear(0.5) * 255.0 + 0.5) as u8;
    assert_eq!(png.get_pixel(0, 0).0, [0, expected, 255]);
    let loaded = read_picture(&picture.exr(&[("rebakeView", "full")]).unwrap()).unwrap();
    assert_eq!(loaded, Loaded { picture: picture.clone(), elements: None });
    let loaded = read_picture(&picture.png(0.0, ToneMap::Linear).unwrap()).unwrap();
    assert!(
        loaded
            .picture
            .pixels
            .iter()
            .zip(&picture.pixels)
            .all(|(a, b)| (*a - b.min(Vec3::ONE)).abs().max_element() < 5e-3)
    );
    // A light map's padding is no part of it.
    let map = crate::export::write_exr(&[("", &picture.pixels[..7])], 4, &[]).unwrap();
    let loaded = read_picture(&map).unwrap();
    assert_eq!((loaded.elements, &loaded.picture.pixels[..]), (Some(7), &picture.pixels[..7]));
    assert!(read_picture(b"nothing").is_err() && read_picture(&map[..40]).is_err());
    assert!(write_png(2, 2, &[0; 11]).is_err());
}

#[test]
fn pictures_look_up_the_slots_that_are_said_to_be_visible_and_no_others() {
    // A wall below the floor and beyond the picture's edges is out of sight.
    let world = world(
        vec![floor_at(0.0), Object::new("below", Mesh::quad(Vec3::NEG_Y, Vec3::Z, Vec3::X), Material::diffuse(ALBEDO))],
        vec![],
    );
    let mut map = LightMap::black(world.slots());
    map.light.indirect = (0..world.slots()).map(|slot| Vec3::splat(1.0 + slot as f32)).collect();
    let options = options(12, 8, 4);
    let visible = visible_slots(&world, &from_above(), &options, &Unobserved).unwrap();
    assert!(!visible.is_empty() && visible.len() < world.slots() - 20 && visible.is_sorted(), "{}", visible.len());
    let before = [shot(&world, &map, View::Indirect, &options), shot(&world, &map, View::LightMap, &options)];
    for slot in (0..world.slots() as u32).filter(|slot| visible.binary_search(slot).is_err()) {
        map.light.indirect[slot as usize] = Vec3::splat(1e9);
    }
    assert!(before == [shot(&world, &map, View::Indirect, &options), shot(&world, &map, View::LightMap, &options)]);
    let values: Vec<f32> = map.light.indirect.iter().map(|v| v.x).collect();
    let shown = render_values(&world, &values, &from_above(), &options, &Unobserved).unwrap();
    assert!(shown.values.iter().all(|value| *value < 1e8), "a picture of numbers has the same rays");
    // And none is named for nothing.
    map.light.indirect[visible[visible.len() / 2] as usize] = Vec3::splat(1e9);
    assert!(before[0] != shot(&world, &map, View::Indirect, &options));
}

/// A map that is 2 everywhere, seen from straight above: lines are where cells have their edges, and nowhere else.
#[test]
fn lines_lie_between_elements() {
    let world = world(vec![floor_at(0.0)], vec![]);
    let mut map = LightMap::black(world.slots());
    map.light.direct.fill(Vec3::splat(2.0));
    let options = options(140, 100, 1);
    let (plain, drawn) = (shot(&world, &map, View::LightMap, &options), shot(&world, &map, View::Elements, &options));
    let placed = &world.placed[0];
    let edges: Vec<[Vec3; 2]> = placed
        .layout
        .of_cells(&placed.surface, |patch| Some(patch.corners))
        .into_iter()
        .flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]])
        .collect();
    let pixel = 2.0 * 3.0 * (0.8f32 / 2.0).tan() / 100.0;
    let apart = |p: Vec3, [a, b]: [Vec3; 2]| {
        let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t)) / pixel
    };
    let (mut lines, mut clear) = (0, 0);
    for (i, color) in drawn.pixels.iter().enumerate() {
        assert_close(plain.pixels[i], Vec3::splat(2.0), 1e-5);
        let point = floor_point(i % 140, i / 140, &options);
        let nearest = edges.iter().map(|edge| apart(point, *edge)).fold(f32::INFINITY, f32::min);
        if nearest < 0.5 {
            assert!(color.max_element() < 1.9, "{color} at {nearest} pixels");
            lines += 1;
        } else if nearest > 1.0 {
            assert_close(*color, Vec3::splat(2.0), 1e-5);
            clear += 1;
        }
    }
    assert!(lines > 1000 && clear > 1000, "{lines} {clear}");
}
