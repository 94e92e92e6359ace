//! Determinism: equal inputs and seeds give equal bits on any number of threads; a canceled job gives nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DMat4, DVec3, Vec3};
use rebake_core::scene::Scene;
use rebake_core::{Budget, Canceled, Edit, LightMap, Observer, Unobserved, World, bake, update};

use super::scenes::{crate_at, room_objects, world};

fn bits(map: &LightMap) -> Vec<[u32; 7]> {
    (0..map.len())
        .map(|i| {
            let (d, n) = (map.light.direct[i].to_array(), map.light.indirect[i].to_array());
            [d[0], d[1], d[2], n[0], n[1], n[2], map.light.variance[i]].map(f32::to_bits)
        })
        .collect()
}

fn insertion() -> Edit {
    let asset = Arc::new(Scene::from_objects(vec![crate_at("c", 0.0, 0.0, Vec3::splat(0.5))]));
    Edit::Insert { asset, name: "crate".into(), transform: DMat4::from_translation(DVec3::new(2.2, 0.0, 1.9)) }
}

#[test]
fn results_do_not_depend_on_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let world = world(room_objects(0.8), 0.2);
            let budget = Budget { samples_per_element: 16, target_rmse: None };
            let map = bake(&world, &budget, 3, &Unobserved).expect("nobody cancels");
            let transition = world.apply(&[insertion()]).expect("an insertion");
            let updated = update(&transition, &map, &budget, None, 4, &Unobserved).expect("nobody cancels");
            (bits(&map), bits(&updated))
        })
    };
    let one = run(1);
    assert!(one == run(2), "2 threads");
    assert!(one == run(7), "7 threads");
}

/// Cancels at the n-th question.
struct CancelAt(AtomicU32);

impl Observer for CancelAt {
    fn canceled(&self) -> bool {
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1)).is_err()
    }
}

#[test]
fn a_job_can_be_cancelled_at_any_question() {
    let world: World = world(room_objects(0.8), 0.3);
    let budget = Budget { samples_per_element: 8, target_rmse: None };
    let map = bake(&world, &budget, 3, &Unobserved).expect("nobody cancels");
    let transition = world.apply(&[insertion()]).expect("an insertion");
    let mut at = 0;
    loop {
        let observer = CancelAt(AtomicU32::new(at));
        match update(&transition, &map, &budget, None, 4, &observer) {
            Err(Canceled) => at += 1 + at / 4,
            Ok(_) => break,
        }
    }
    assert!(at > 30, "only {at} chances to cancel");
}

/// Stops by plan and by target.
struct Plan(u32);

impl Observer for Plan {
    fn plan_round(&self, so_far: &rebake_core::Progress, proposed: u32) -> u32 {
        proposed.min(self.0.saturating_sub(so_far.samples_per_element))
    }
}

#[test]
fn budgets_end_the_work() {
    let world = world(room_objects(0.8), 0.3);
    let budget = Budget { samples_per_element: 8, target_rmse: None };
    let map = bake(&world, &budget, 3, &Unobserved).expect("nobody cancels");
    let transition = world.apply(&[insertion()]).expect("an insertion");
    let nothing = update(&transition, &map, &budget, None, 4, &Plan(0)).expect("nobody cancels");
    assert!(bits(&nothing) == bits(&transition.carry_over(&map)), "a plan of nothing leaves the old map");
    let target = 0.05;
    let loose = Budget { samples_per_element: 4096, target_rmse: Some(target) };
    let done = bake(&world, &loose, 3, &Unobserved).expect("nobody cancels");
    assert!(done.estimated_rmse(world.areas()) <= target);
}
