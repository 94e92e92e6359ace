//! Many clients that follow many scenes while all of them are edited: nothing is lost, memory stays flat, small
//! requests are answered.
//!
//! `REBAKE_LOAD_SECONDS=600 cargo test -p rebake-tests load -- --nocapture` is the long run, with 10 scenes and 100
//! clients; below a minute there are 3 and 12.

use std::time::{Duration, Instant};

use futures_util::future::join_all;
use glam::Vec3;
use rebake::client::DeltaFollower;
use serde_json::{Value, json};
use tokio::sync::watch;
use tokio::time::MissedTickBehavior;

use super::glb::{crate_asset, room, translation};
use super::process::Service;
use super::server::{PATIENCE, Server, path_of};

struct Load {
    seconds: u64,
    scenes: usize,
    clients: usize,
    spacing: f64,
}

impl Load {
    fn chosen() -> Load {
        let seconds = std::env::var("REBAKE_LOAD_SECONDS").ok().map_or(3, |text| text.parse().unwrap());
        let is_long = seconds >= 60;
        let (scenes, clients, spacing) = if is_long { (10, 100, 0.25) } else { (3, 12, 0.5) };
        Load { seconds, scenes, clients, spacing }
    }
}

/// How a client takes its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Habit {
    Steady,
    /// Takes nothing in now and then, on an open connection.
    Stalls,
    /// Goes away now and then and comes back with its last version.
    Reconnects,
}

#[derive(Clone, Copy, Debug, Default)]
struct Taken {
    snapshots: u64,
    bytes: u64,
    pauses: u64,
}

/// What clients are told of the edits of a scene.
struct Told {
    /// How many there were.
    edits: watch::Sender<u64>,
    /// The last version, once there are no more.
    end: watch::Sender<u64>,
}

impl Told {
    fn new() -> Told {
        Told { edits: watch::Sender::new(0), end: watch::Sender::new(0) }
    }

    /// Waits until there were some more edits, or there are no more.
    async fn pause(&self) {
        const EDITS: u64 = 6;
        let (mut edits, mut end) = (self.edits.subscribe(), self.end.subscribe());
        let enough = *edits.borrow() + EDITS;
        tokio::select! {
            _ = edits.wait_for(|edits| *edits >= enough) => {}
            _ = end.wait_for(|version| *version > 0) => {}
        }
    }
}

/// Follows a scene until it is told the version that it has to reach; answers the map.
async fn follow(server: &Server, scene: &str, habit: Habit, told: &Told) -> (Vec<Vec3>, u64, Taken) {
    const EVERY: u64 = 5;
    let mut end = told.end.subscribe();
    let mut follower = server.client.follow(scene);
    let mut taken = Taken::default();
    loop {
        let last = *end.borrow_and_update();
        if last > 0 && follower.version() >= last {
            let (map, version) = follower.into_map();
            return (map, version, taken);
        }
        let update = tokio::select! {
            update = follower.next() => update.unwrap(),
            _ = end.changed() => continue,
        };
        taken.snapshots += 1;
        taken.bytes += update.bytes as u64;
        if last > 0 || taken.snapshots % EVERY != 0 || habit == Habit::Steady {
            continue;
        }
        taken.pauses += 1;
        if habit == Habit::Reconnects {
            let (map, version) = follower.into_map();
            told.pause().await;
            follower = DeltaFollower::resume(server.client.clone(), scene, map, version);
        } else {
            told.pause().await;
        }
    }
}

/// Edits a scene until the time is over, in bursts that the queue may merge; answers how many edits.
async fn edit(server: &Server, scene: &Value, asset: &str, told: &Told, until: Instant) -> u64 {
    for round in 0u32.. {
        let x = 1.0 + 0.1 * f64::from(round % 20);
        let at = |x: f64| translation(x, 0.01, 2.0);
        let burst = [
            json!({ "op": "insert", "asset": asset, "name": "crate", "transform": at(x) }),
            json!({ "op": "move", "object": "crate", "transform": at(x + 0.1) }),
            json!({ "op": "move", "object": "crate", "transform": at(x + 0.2) }),
            json!({ "op": "relight", "lights": [{ "light": "lamp", "intensity": 10 + round % 7 }] }),
            json!({ "op": "material", "object": "cupboard", "albedo": [0.1, 0.2, 0.1 + 0.1 * f64::from(round % 6)] }),
            json!({ "op": "remove", "objects": ["crate"] }),
        ];
        for part in burst.chunks(3) {
            let mut last = String::new();
            for edit in part {
                let mut edit = edit.clone();
                edit["budget"] = json!({ "samples_per_element": 4 });
                last = server.edit(scene, &edit).await;
                told.edits.send_modify(|edits| *edits += 1);
            }
            let job = server.end_of(&last).await;
            assert_eq!(job["state"], "succeeded", "{job}");
        }
        if Instant::now() >= until {
            break;
        }
    }
    *told.edits.borrow()
}

/// What the service was like under load.
struct Watched {
    /// How long small requests took, in milliseconds, sorted.
    took: Vec<f64>,
    /// At the start, at half time and at the end, in MiB, where the system tells.
    memory: [Option<f64>; 3],
}

/// Small requests at a steady pace until the time is over.
async fn ask(service: &Service, scenes: &[Value], until: Instant) -> Watched {
    let mut pace = tokio::time::interval(Duration::from_millis(10));
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut took, start) = (Vec::new(), service.resident_mib());
    let now = Instant::now();
    let (half_time, mut half) = (now + (until - now) / 2, None);
    for n in 0.. {
        pace.tick().await;
        let asked = Instant::now();
        if asked >= until {
            break;
        }
        if half.is_none() && asked >= half_time {
            half = service.resident_mib();
        }
        let path = match n % 4 {
            0 => "/healthz".to_owned(),
            1 => path_of(&scenes[n / 4 % scenes.len()]),
            2 => "/v1/jobs?limit=10".to_owned(),
            _ => "/v1/scenes".to_owned(),
        };
        assert_eq!(service.server.get(&path).await.status, 200, "{path}");
        took.push(asked.elapsed().as_secs_f64() * 1e3);
    }
    took.sort_by(f64::total_cmp);
    Watched { took, memory: [start, half, service.resident_mib()] }
}

fn bits(map: &[Vec3]) -> Vec<[u32; 3]> {
    map.iter().map(|value| value.to_array().map(f32::to_bits)).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn under_load_nothing_is_lost() {
    let load = Load::chosen();
    // Both logs are full within seconds: from then on memory has to be flat.
    let service = Service::start(&["finished-jobs=200", "events=64"]);
    let server = &service.server;
    let asset = server.client.create_asset(crate_asset()).await.unwrap();
    let query = format!("/v1/scenes?samples_per_element=4&spacing={}", load.spacing);
    let mut scenes = Vec::new();
    for _ in 0..load.scenes {
        let scene = server.post_glb(&query, room().bytes()).await.json(201);
        server.end_of(scene["current_job"].as_str().unwrap()).await;
        scenes.push(scene);
    }

    let told: Vec<Told> = scenes.iter().map(|_| Told::new()).collect();
    let clients = (0..load.clients).map(async |n| {
        let habit = [Habit::Steady, Habit::Steady, Habit::Stalls, Habit::Reconnects][n / load.scenes % 4];
        let scene = n % load.scenes;
        (scene, follow(server, scenes[scene]["id"].as_str().unwrap(), habit, &told[scene]).await)
    });
    let until = Instant::now() + Duration::from_secs(load.seconds);
    let work = async {
        let edits = join_all(scenes.iter().zip(&told).map(|(scene, told)| edit(server, scene, &asset, told, until)));
        let (edits, watched) = tokio::join!(edits, ask(&service, &scenes, until));
        for (scene, told) in scenes.iter().zip(&told) {
            told.end.send_replace(server.get(&path_of(scene)).await.json(200)["version"].as_u64().unwrap());
        }
        (edits.iter().sum::<u64>(), watched)
    };
    let all = async { tokio::join!(join_all(clients), work) };
    let (clients, (edits, Watched { took, memory })) =
        tokio::time::timeout(Duration::from_secs(load.seconds) + 3 * PATIENCE, all).await.expect("it ends");

    let mut total = Taken::default();
    for (scene, (map, version, taken)) in &clients {
        let mut fresh = server.client.follow(scenes[*scene]["id"].as_str().unwrap());
        fresh.catch_up().await.unwrap();
        assert_eq!(*version, fresh.version());
        assert!(bits(map) == bits(fresh.map()), "a client's map is not the service's");
        total.snapshots += taken.snapshots;
        total.bytes += taken.bytes;
        total.pauses += taken.pauses;
    }
    let at = |share: f64| took[((took.len() - 1) as f64 * share) as usize];
    eprintln!(
        "{} s, {} scenes, {} clients: {edits} edits, {} snapshots taken in ({:.1} MiB), {} pauses, nothing lost\n\
         {} small requests: median {:.1} ms, p99 {:.1} ms, longest {:.1} ms; memory {memory:.0?} MiB",
        load.seconds,
        load.scenes,
        load.clients,
        total.snapshots,
        total.bytes as f64 / f64::from(1 << 20),
        total.pauses,
        took.len(),
        at(0.5),
        at(0.99),
        at(1.0),
    );
    assert!(total.pauses > 0 && edits > 0);
    if let [Some(start), Some(half), Some(end)] = memory {
        assert!(end < start + 256.0, "from {start} to {end} MiB");
        assert!(end < half * 1.25 + 32.0, "still growing: {half} MiB at half time, {end} at the end");
    }
    service.kill();
}
