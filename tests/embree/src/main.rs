//! Rays per second against Embree 3 on the rays of core/benches/rays.rs, on one thread, in alternating rounds:
//! `cargo run --release --manifest-path tests/embree/Cargo.toml [-- TRIANGLES]`.

#[cfg(embree)]
mod ffi;
#[cfg(embree)]
#[path = "../../../core/benches/rays.rs"]
#[allow(dead_code, unreachable_pub)]
mod rays;

#[cfg(not(embree))]
fn main() {
    println!("skipped: Embree 3 is not installed (Debian: libembree-dev; elsewhere set EMBREE_PREFIX)");
}

#[cfg(embree)]
fn main() {
    use rebake_core::bvh::{BuildQuality, Bvh};

    let triangles = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(300_000);
    let corners = rays::furnished_room(triangles);
    let ids: Vec<u32> = (0..corners.len() as u32).collect();
    let ours = Bvh::build(&corners, &ids, BuildQuality::Good);
    let (cosine, shadow) = rays::rays(&corners);
    println!("{} triangles, {} closest-hit and {} any-hit rays", corners.len(), cosine.len(), shadow.len());
    for (name, robust) in [("robust", true), ("default", false)] {
        let Some(embree) = ffi::Embree::build(&corners, robust) else {
            println!("skipped: Embree does not start");
            return;
        };
        let differing = cosine
            .iter()
            .filter(|ray| match (ours.closest_hit(ray, None), embree.closest_hit(ray)) {
                (Some(a), Some(b)) => (a.t - b).abs() > 1e-3 * b.abs() + 1e-4,
                (a, b) => a.is_some() != b.is_some(),
            })
            .count();
        let closest = compare(&cosine, |r| ours.closest_hit(r, None).is_some(), |r| embree.closest_hit(r).is_some());
        let any = compare(&shadow, |r| ours.any_hit(r, None), |r| embree.any_hit(r));
        for (what, (mine, theirs)) in [("closest", closest), ("any", any)] {
            println!(
                "Embree {name:<8} {what:<8} ours {mine:6.2} M/s, Embree {theirs:6.2} M/s, ratio {:.2}",
                mine / theirs
            );
        }
        println!("    {differing} of {} closest hits differ", cosine.len());
    }
}

/// Millions of rays per second of both, medians of alternating rounds.
#[cfg(embree)]
fn compare<R>(rays: &[R], ours: impl Fn(&R) -> bool, theirs: impl Fn(&R) -> bool) -> (f64, f64) {
    use std::hint::black_box;
    use std::time::Instant;

    const ROUNDS: usize = 7;
    let timed = |hit: &dyn Fn(&[R]) -> usize| {
        let start = Instant::now();
        black_box(hit(rays));
        start.elapsed().as_secs_f64()
    };
    let mut seconds: Vec<(f64, f64)> = Vec::new();
    for _ in 0..ROUNDS {
        let mine = timed(&|rays| rays.iter().filter(|r| ours(r)).count());
        let other = timed(&|rays| rays.iter().filter(|r| theirs(r)).count());
        seconds.push((mine, other));
    }
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        rays.len() as f64 / values[ROUNDS / 2] / 1e6
    };
    (median(seconds.iter().map(|s| s.0).collect()), median(seconds.iter().map(|s| s.1).collect()))
}
