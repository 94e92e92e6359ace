//! More layers than are carried side by side, in a building with a lamp in every room: against bakes of all light
//! together, and of a lamp alone.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::{LightKind, Material, Mesh, Object, Scene};
use rebake_core::{
    Edit, LightMap, LightPart, Relight, Transition, Unobserved, World, WorldOptions, bake, refine, update,
};

use super::building::{self, each_lamp, lamp};
use super::layers::{Count, baked, budget, check_sum};
use super::statistics::{Estimate, area_mean, assert_agrees, mean_total, replicate};

/// 18 rooms.
const SIZE: building::Rooms = [3, 3, 2];

fn plain() -> World {
    world_of(building::building(SIZE))
}

fn world_of(scene: Scene) -> World {
    let options = WorldOptions { spacing: Some(0.8), ..WorldOptions::default() };
    World::new(scene, &options).expect("a building")
}

fn layered() -> World {
    let plain = plain();
    plain.apply(&each_lamp(&plain.scene)).expect("groups").after
}

/// A world of the same objects and lights as another, without groups.
fn ungrouped(world: &World) -> World {
    let groups = std::collections::BTreeMap::new();
    world_of(Scene { groups, ..Scene::clone(&world.scene) })
}

fn relit<'a>(names: impl IntoIterator<Item = &'a String>, intensity: f32) -> Edit {
    let one = |light: &String| Relight { light: light.clone(), color: None, intensity: Some(intensity) };
    Edit::Relight { lights: names.into_iter().map(one).collect() }
}

fn updated(transition: &Transition, map: &LightMap, seed: u64) -> Arc<LightMap> {
    update(transition, map, &budget(32), None, seed, &Unobserved).expect("nobody cancels")
}

fn chair(x: f64, z: f64) -> Edit {
    let mesh = Mesh::cuboid(Vec3::ZERO, Vec3::new(0.6, 1.0, 0.6));
    let chair = Object::new("chair", mesh, Material::diffuse(Vec3::splat(0.5)));
    let transform = DMat4::from_translation(DVec3::new(x, 0.0, z));
    Edit::Insert { asset: Arc::new(Scene::from_objects(vec![chair])), name: "chair".into(), transform }
}

/// Elements of a room, floor to ceiling.
fn is_in(world: &World, room: building::Rooms) -> impl Fn(usize) -> bool {
    let (low, high) = (building::corner(room), building::corner([room[0] + 1, room[1] + 1, room[2] + 1]));
    let positions: Vec<Vec3> = world.positions().iter().copied().collect();
    move |slot| positions[slot].cmpgt(low).all() && positions[slot].cmplt(high - Vec3::Y * 0.1).all()
}

/// Mean of all light over replicates against bakes without layers; `bias` is a part of it.
fn check_mean(name: &str, world: &World, maps: &[Arc<LightMap>], bias: f64) {
    let plain = ungrouped(world);
    let fresh: Vec<Arc<LightMap>> = (0..6).map(|seed| baked(&plain, 64, 700 + seed)).collect();
    let of = |world: &World, maps: &[Arc<LightMap>]| -> Estimate {
        replicate(maps.len() as u64, |i| mean_total(world, &maps[i as usize]))
    };
    let truth = of(&plain, &fresh);
    assert_agrees(name, of(world, maps), truth.mean, bias * truth.mean + 5.0 * truth.error);
}

/// A hall with a lamp over every metre and a half, all of which light all of it; the first is dim.
fn hall() -> World {
    let walls = Mesh::cuboid(Vec3::ZERO, Vec3::new(9.0, 3.0, 9.0)).inside_out();
    let plain = world_of(Scene::from_objects(vec![Object::new("hall", walls, Material::diffuse(Vec3::splat(0.6)))]));
    let bulb = |k: u32| {
        let position = DVec3::new(0.75 + 1.5 * f64::from(k % 6), 2.4, 0.75 + 1.5 * f64::from(k / 6));
        let (kind, color) = (LightKind::Point { position, range: None }, Vec3::new(1.0, 0.8, 0.6));
        Edit::InsertLight { name: format!("bulb {k}"), kind, color, intensity: if k == 0 { 0.2 } else { 3.0 } }
    };
    let lit = plain.apply(&(0..36).map(bulb).collect::<Vec<_>>()).expect("bulbs").after;
    lit.apply(&each_lamp(&lit.scene)).expect("groups").after
}

#[test]
fn lamps_that_all_light_one_hall_are_relit_right() {
    let world = hall();
    let maps: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&world, 64, seed)).collect();
    for map in &maps {
        let rest = map.rest().expect("more layers than fit side by side");
        let square = |slot: usize| (rest.light.at(slot).0 + rest.light.at(slot).1).as_dvec3().powf(2.0);
        let size = area_mean(&world, |_| true, square).sqrt();
        assert!(size < 0.005 * mean_total(&world, map), "all is some lamp's, but for {size}");
    }
    // The dim one is not told apart where it matters least.
    for (name, to, bias) in
        [("bulb 0", 3.0, 0.004), ("bulb 0", 20.0, 0.03), ("bulb 14", 0.0, 0.001), ("bulb 14", 9.0, 0.003)]
    {
        let transition = world.apply(&[relit([&name.to_owned()], to)]).expect("a relight");
        let count = Count::default();
        let relight = |(map, seed): (&Arc<LightMap>, u64)| {
            update(&transition, map, &budget(64), None, seed, &count).expect("nobody cancels")
        };
        let relit: Vec<Arc<LightMap>> = maps.iter().zip(0..).map(relight).collect();
        assert_eq!(count.rays.load(Ordering::Relaxed), 0);
        relit.iter().for_each(|map| check_sum(&transition.after, map));
        check_mean(&format!("{name} to {to}"), &transition.after, &relit, bias);
        let truth = baked(&ungrouped(&transition.after), 1024, 9);
        let square = |map: &LightMap, slot: usize| (map.total(slot) - truth.total(slot)).as_dvec3().powf(2.0);
        let squares = relit.iter().map(|map| area_mean(&world, |_| true, |slot| square(map, slot)));
        let off = (squares.sum::<f64>() / 8.0).sqrt();
        let stated = relit.iter().map(|map| f64::from(map.estimated_rmse(world.areas()))).sum::<f64>() / 8.0;
        assert!(off < 1.5 * stated && stated < 2.0 * off, "{name} to {to}: off by {off}, stated {stated}");
    }
}

/// Mean of what is left to no lamp.
fn mean_rest(world: &World, map: &LightMap, which: impl Fn(usize) -> bool) -> f64 {
    let rest = map.rest().expect("more layers than fit side by side");
    area_mean(world, which, |slot| (rest.light.at(slot).0 + rest.light.at(slot).1).as_dvec3())
}

#[test]
fn layers_add_up_to_a_bake_and_each_is_its_lamps() {
    let world = layered();
    let maps: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&world, 32, seed)).collect();
    for map in &maps {
        assert_eq!(map.layers.len(), world.scene.lights.len() + 1);
        check_sum(&world, map);
    }
    check_mean("bake", &world, &maps, 0.0);
    // Layers are kept where they matter: nothing of a lamp upstairs.
    let (here, far) = ([1, 1, 0], is_in(&world, [0, 0, 1]));
    let of_lamp = |map: &LightMap| map.layer_of(&lamp(here)).expect("a layer").clone();
    assert!(of_lamp(&maps[0]).light.memory_bytes() < 16 * world.slots());
    assert!((0..world.slots()).filter(|&slot| far(slot)).all(|slot| of_lamp(&maps[0]).light.at(slot).0 == Vec3::ZERO));
    // A lamp alone, in its room and next door: what its layer lacks is in the rest.
    let alone = ungrouped(&world);
    let others = alone.scene.lights.iter().filter(|light| light.name != lamp(here));
    let off: Vec<String> = others.map(|light| light.name.clone()).collect();
    let alone = alone.apply(&[relit(&off, 0.0)]).expect("others off").after;
    let alone = ungrouped(&alone);
    let fresh: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&alone, 128, 800 + seed)).collect();
    let weight = |map: &LightMap| {
        let layer = map.layers.iter().position(|layer| layer.name == lamp(here)).expect("a layer");
        map.layer_weights(&world.scene)[layer]
    };
    for (room, part) in [(here, LightPart::Direct), (here, LightPart::Indirect), ([0, 1, 0], LightPart::Full)] {
        let inside = is_in(&world, room);
        let of = |map: &LightMap| {
            let (values, weight) = (of_lamp(map).light.part(part).into_owned(), weight(map));
            area_mean(&world, &inside, |slot| (values[slot] * weight).as_dvec3())
        };
        let truth = replicate(8, |i| {
            let values = fresh[i as usize].light.part(part);
            area_mean(&alone, &inside, |slot| values[slot].as_dvec3())
        });
        let lacks = maps.iter().map(|map| mean_rest(&world, map, &inside)).fold(0.0, f64::max);
        let estimate = replicate(8, |i| of(&maps[i as usize]));
        assert_agrees(&format!("{room:?} {part:?}"), estimate, truth.mean, lacks + 5.0 * truth.error);
        // What is left to no lamp is little.
        assert!(lacks < 0.02 * maps.iter().map(|map| mean_total(&world, map)).fold(0.0, f64::max), "{lacks}");
    }
}

/// More lights than are weighed one by one, against the sum of two halves of them that are.
#[test]
fn many_lights_are_sampled_as_few_are() {
    let scene = building::building([4, 3, 3]);
    let half = |parity: usize| {
        let lights = scene.lights.iter().enumerate().filter(|(k, _)| k % 2 == parity).map(|(_, light)| light.clone());
        world_of(Scene { lights: lights.collect(), ..scene.clone() })
    };
    let (all, halves) = (world_of(scene.clone()), [half(0), half(1)]);
    assert_eq!(all.emitters().len(), 36);
    let maps: Vec<Arc<LightMap>> = (0..8).map(|seed| baked(&all, 16, seed)).collect();
    let of_halves = halves.each_ref().map(|world| (0..6).map(|seed| baked(world, 64, 30 + seed)).collect::<Vec<_>>());
    for (room, part) in
        [([0, 0, 0], LightPart::Direct), ([1, 1, 1], LightPart::Direct), ([2, 1, 2], LightPart::Indirect)]
    {
        let inside = is_in(&all, room);
        let mean = |map: &LightMap| {
            let values = map.light.part(part);
            area_mean(&all, &inside, |slot| values[slot].as_dvec3())
        };
        let truth = of_halves.each_ref().map(|maps| replicate(6, |i| mean(&maps[i as usize])));
        let (truth, error) = (truth[0].mean + truth[1].mean, truth[0].error.hypot(truth[1].error));
        let estimate = replicate(8, |i| mean(&maps[i as usize]));
        assert_agrees(&format!("{room:?} {part:?}"), estimate, truth, 5.0 * error);
    }
}

#[test]
fn any_lamp_is_relit_without_a_ray_and_states_what_is_left() {
    let world = layered();
    let map = baked(&world, 64, 1);
    let name = lamp([2, 0, 1]);
    let transition = world.apply(&[relit([&name], 6.0)]).expect("a relight");
    let count = Count::default();
    let bright = update(&transition, &map, &budget(64), None, 1, &count).expect("nobody cancels");
    assert_eq!(count.rays.load(Ordering::Relaxed), 0);
    check_sum(&transition.after, &bright);
    let truth = baked(&ungrouped(&transition.after), 1024, 2);
    let square = |slot: usize| (bright.total(slot) - truth.total(slot)).as_dvec3().powf(2.0);
    let off = area_mean(&world, |_| true, square).sqrt();
    let stated = f64::from(bright.estimated_rmse(transition.after.areas()));
    assert!(off <= 1.25 * stated && stated <= 4.0 * off, "off by {off}, stated {stated}");
    // Back again, and off.
    let back = transition.after.apply(&[relit([&name], 1.0)]).expect("a relight");
    let again = updated(&back, &bright, 2);
    check_sum(&back.after, &again);
    let dark = world.apply(&[relit([&name], 0.0)]).expect("a relight");
    check_sum(&dark.after, &updated(&dark, &map, 3));
}

#[test]
fn what_is_inserted_is_lit_by_all_lamps() {
    let world = layered();
    // Lamps that are dimmed, or lose a colour, meanwhile are no obstacle.
    let green = Relight { light: lamp([2, 2, 1]), color: Some(Vec3::Y), intensity: Some(5.0) };
    let dim = [relit([&lamp([0, 0, 0])], 0.2), Edit::Relight { lights: vec![green] }];
    let dim = world.apply(&dim).expect("relights");
    let transition = dim.after.apply(&[chair(2.4, 2.6)]).expect("a chair");
    let maps: Vec<Arc<LightMap>> = (0..8)
        .map(|seed| {
            let map = updated(&dim, &baked(&world, 32, seed), seed);
            updated(&transition, &map, 100 + seed)
        })
        .collect();
    maps.iter().for_each(|map| check_sum(&transition.after, map));
    check_mean("insert", &transition.after, &maps, 0.005);
    // Refined, they are as good, and state less.
    let fine = refine(&transition.after, &maps[0], &budget(64), 5, &Unobserved).expect("nobody cancels");
    check_sum(&transition.after, &fine);
    assert!(fine.estimated_rmse(transition.after.areas()) < maps[0].estimated_rmse(transition.after.areas()));
}

#[test]
fn a_lamp_leaves_others_and_things_move_in_one_request() {
    let plain = plain();
    let (alone, table) = (lamp([1, 1, 0]), "table 1 1 0".to_owned());
    // Two lamps share a layer.
    let groups: Vec<Edit> = each_lamp(&plain.scene).into_iter().skip(2).collect();
    let world = plain.apply(&groups).expect("groups").after;
    let shared = lamp([0, 0, 0]);
    let to_the_next_room = DMat4::from_translation(DVec3::new(4.0, 0.0, 0.0));
    let away = Edit::Move { object: table, transform: to_the_next_room };
    let edits = [relit([&shared], 3.0), relit([&alone], 0.5), chair(1.8, 2.6), away];
    let transition = world.apply(&edits).expect("edits");
    let maps: Vec<Arc<LightMap>> =
        (0..8).map(|seed| updated(&transition, &baked(&world, 32, seed), 50 + seed)).collect();
    for map in &maps {
        check_sum(&transition.after, map);
        let inside = is_in(&transition.after, [0, 0, 0]);
        let layer = map.layer_of(&shared).expect("a layer of its own").light.part(LightPart::Direct).into_owned();
        let weight = map.layer_weights(&transition.after.scene)
            [map.layers.iter().position(|layer| layer.name == shared).expect("it is there")];
        let own = area_mean(&transition.after, &inside, |slot| (layer[slot] * weight).as_dvec3());
        let all = area_mean(&transition.after, &inside, |slot| map.light.direct[slot].as_dvec3());
        // The rest comes through doors.
        assert!(own > 0.7 * all, "{own} of {all}");
    }
    check_mean("one request", &transition.after, &maps, 0.005);
}

#[test]
fn a_lamp_that_is_moved_often_leaves_nothing_behind() {
    let world = layered();
    let kind = LightKind::Point { position: DVec3::new(1.0, 1.0, 1.2), range: None };
    let bulb = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 30.0 };
    let come = world.apply(&[bulb]).expect("a bulb");
    let mut map = updated(&come, &baked(&world, 16, 1), 2);
    let mut world = come.after;
    let before = mean_rest(&world, &map, |_| true);
    for k in 0..12 {
        let position = Some(DVec3::new(1.0 + 4.0 * f64::from(k % 3), 1.2, 1.0 + 4.0 * f64::from(k / 3 % 3)));
        let step = Edit::MoveLight { light: "bulb".into(), position, direction: None, own_layer: true };
        let moved = world.apply(&[step]).expect("a move");
        (map, world) = (updated(&moved, &map, 10 + k as u64), moved.after);
    }
    let after = mean_rest(&world, &map, |_| true);
    // Of one lamp among nineteen, at another place.
    assert!((after - before).abs() < 0.2 * before, "{before} became {after}");
    check_sum(&world, &map);
}

#[test]
fn lamps_move_come_and_go() {
    let world = layered();
    let position = Some(DVec3::new(1.0, 1.2, 1.0));
    let kind = LightKind::Point { position: DVec3::new(1.0, 1.0, 1.2), range: None };
    let bulb = Edit::InsertLight { name: "bulb".into(), kind, color: Vec3::ONE, intensity: 3.0 };
    let come = world.apply(&[bulb]).expect("a bulb");
    let step = Edit::MoveLight { light: "bulb".into(), position, direction: None, own_layer: true };
    let moved = come.after.apply(&[step]).expect("a move");
    let gone = moved.after.apply(&[Edit::Remove { objects: vec![lamp([1, 0, 0])] }]).expect("a removal");
    let mut found: [Vec<Arc<LightMap>>; 3] = Default::default();
    for seed in 0..6 {
        let mut map = baked(&world, 32, seed);
        for ((transition, found), seed) in [&come, &moved, &gone].into_iter().zip(&mut found).zip(10 * seed..) {
            map = updated(transition, &map, seed);
            check_sum(&transition.after, &map);
            found.push(map.clone());
        }
    }
    // The bulb has one while it is there, and the lamp that goes none.
    let layers = world.scene.lights.len() + 1;
    assert_eq!(found.each_ref().map(|maps| maps[0].layers.len()), [layers + 1, layers + 1, layers]);
    for (name, (transition, maps)) in
        ["come", "moved", "gone"].iter().zip([&come, &moved, &gone].into_iter().zip(&found))
    {
        let rest = maps.iter().map(|map| mean_rest(&transition.after, map, |_| true)).fold(0.0, f64::max);
        check_mean(name, &transition.after, maps, 0.005 + rest / mean_total(&transition.after, &maps[0]));
    }
}

#[test]
fn lamps_that_are_off_are_lit_when_they_are_on() {
    let name = lamp([2, 1, 0]);
    let switch = |world: &World, to: f32| world.apply(&[relit([&name], to)]).expect("a relight");
    let rays = |transition: &Transition, map: &LightMap, seed: u64| {
        let count = Count::default();
        let map = update(transition, map, &budget(32), None, seed, &count).expect("nobody cancels");
        check_sum(&transition.after, &map);
        (map, count.rays.load(Ordering::Relaxed))
    };
    let off = switch(&layered(), 0.0).after;
    let on = switch(&off, 1.0);
    let off_again = switch(&on.after, 0.0);
    let chair = off_again.after.apply(&[chair(9.0, 5.5)]).expect("a chair");
    let last = switch(&chair.after, 1.0);
    let (mut lit, mut beside) = (Vec::new(), Vec::new());
    for seed in 0..6 {
        let map = baked(&off, 32, seed);
        assert!(map.layer_of(&name).is_none(), "off from the first, it has no layer");
        let (map, traced) = rays(&on, &map, seed);
        assert!(traced > 0 && map.layer_of(&name).is_some());
        lit.push(map.clone());
        // From then on it is a switch, whatever happens beside it meanwhile.
        let (map, traced) = rays(&off_again, &map, seed);
        assert_eq!(traced, 0);
        let (map, _) = rays(&chair, &map, seed);
        let (map, traced) = rays(&last, &map, seed);
        assert_eq!(traced, 0);
        beside.push(map);
    }
    check_mean("on", &on.after, &lit, 0.01);
    check_mean("on beside a chair", &last.after, &beside, 0.015);
}

#[test]
fn the_seventeenth_lamp_to_be_relit_makes_a_rest() {
    let mut world = plain();
    let mut map = bake(&world, &budget(32), 1, &Unobserved).expect("nobody cancels");
    let names: Vec<String> = building::rooms(SIZE).map(lamp).collect();
    for (k, name) in names.iter().enumerate() {
        let transition = world.apply(&[relit([name], 1.0 + 0.05 * k as f32)]).expect("a relight");
        (map, world) = (updated(&transition, &map, k as u64), transition.after);
        check_sum(&world, &map);
    }
    assert_eq!(map.layers.len(), names.len() + 1);
    let plain = ungrouped(&world);
    let truth = replicate(6, |seed| mean_total(&plain, &baked(&plain, 64, 40 + seed)));
    let found = mean_total(&world, &map);
    assert!((found / truth.mean - 1.0).abs() < 0.02, "{found} and {truth:?}");
    // Many that leave at once are baked together.
    let all = plain.apply(&each_lamp(&plain.scene)).expect("groups");
    let together = updated(&all, &baked(&plain, 32, 3), 4);
    assert_eq!(together.layers.len(), names.len() + 1);
    check_sum(&all.after, &together);
}

#[test]
fn bits_do_not_depend_on_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let world = layered();
            let map = baked(&world, 8, 1);
            let transition = world.apply(&[chair(2.4, 2.6)]).expect("a chair");
            let lit = update(&transition, &map, &budget(8), None, 2, &Unobserved).expect("nobody cancels");
            (map, lit)
        })
    };
    assert!(run(1) == run(3));
}
