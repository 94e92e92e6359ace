//! Several machines for one bake: workers in processes of their own, killed and lying ones among them, and a broker that
//! goes away. Whatever happens, the light is that of one process, bit for bit.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream::{self, AckKind, consumer::pull};
use futures_util::StreamExt;
use rebake::cluster::ClusterConfig;
use reqwest::Method;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::glb::{Glb, room};
use super::process::Service;
use super::server::{PATIENCE, Server, path_of};

/// A NATS server with JetStream; killed when it is dropped.
pub(super) struct Broker {
    program: PathBuf,
    child: Child,
    folder: TempDir,
    port: String,
}

impl Broker {
    /// None, with the reason on the terminal, where there is no such server and none can be installed.
    pub(super) fn start() -> Option<Broker> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("broker.sh");
        let done = Command::new("bash").arg(script).stdin(Stdio::null()).output().unwrap();
        if !done.status.success() {
            // What a test prints is not seen where it passes.
            let reason = String::from_utf8_lossy(&done.stderr).trim().to_owned();
            let _ = writeln!(std::io::stderr(), "tests with workers are left out: {reason}");
            return None;
        }
        let program = PathBuf::from(String::from_utf8(done.stdout).unwrap().trim());
        let folder = tempfile::tempdir().unwrap();
        let child = run(&program, folder.path(), "-1");
        let file = folder.path().join(format!("nats-server_{}.ports", child.id()));
        let begun = Instant::now();
        let ports: Value = loop {
            match fs::read(&file).ok().and_then(|text| serde_json::from_slice(&text).ok()) {
                Some(ports) => break ports,
                None => assert!(begun.elapsed() < PATIENCE, "the broker tells no port"),
            }
            std::thread::yield_now();
        };
        let port = ports["nats"][0].as_str().unwrap().rsplit(':').next().unwrap().to_owned();
        Some(Broker { program, child, folder, port })
    }

    fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }

    /// Brings it back where it was, with what it had kept.
    fn come_back(&mut self) {
        self.child = run(&self.program, self.folder.path(), &self.port);
    }

    pub(super) fn objects(&self) -> PathBuf {
        self.folder.path().join("objects")
    }

    pub(super) fn config(&self, delegates: bool) -> ClusterConfig {
        ClusterConfig { queue: self.url(), objects: self.objects().display().to_string(), delegates }
    }

    fn worker(&self) -> Service {
        let settings = [format!("queue={}", self.url()), format!("objects={}", self.objects().display())];
        Service::start(&[&settings[0], &settings[1], "worker=true"])
    }

    pub(super) async fn serve(&self, delegates: bool) -> Server {
        Server::with(|config| config.cluster = Some(self.config(delegates))).await
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn run(program: &Path, folder: &Path, port: &str) -> Child {
    let mut broker = Command::new(program);
    broker.args(["-js", "-a", "127.0.0.1", "-p", port]).arg("-sd").arg(folder.join("jetstream"));
    broker.arg("--ports_file_dir").arg(folder).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Uploads a scene, moves and repaints things, and answers its light: that after the bake and that after the edits.
async fn light_of(server: &Server, scene: &Glb) -> [Vec<u8>; 2] {
    light_with(server, scene, "layers=shared").await
}

/// Light as [`light_of`] has it, of a scene that is uploaded with `layers`, a part of the query.
async fn light_with(server: &Server, scene: &Glb, layers: &str) -> [Vec<u8>; 2] {
    let query = format!("/v1/scenes?spacing=0.3&samples_per_element=96&{layers}");
    let scene = server.post_glb(&query, scene.bytes()).await.json(201);
    server.end_of(scene["current_job"].as_str().unwrap()).await;
    let path = path_of(&scene);
    let baked = raw(server, &path).await;
    let repaint = json!({ "op": "material", "object": "cupboard", "albedo": [0.2, 0.6, 0.3] });
    let job = server.edit(&scene, &repaint).await;
    server.end_of(&job).await;
    // The light goes on to a target of its own behind the edit.
    let target = json!({ "target": { "samples_per_element": 160 } });
    let changed = server.request(Method::PATCH, &path).json(&target).send().await.unwrap();
    assert_eq!(changed.status(), 200);
    let page = server.get(&format!("/v1/jobs?scene={}", scene["id"].as_str().unwrap())).await.json(200);
    server.end_of(page["items"][0]["id"].as_str().unwrap()).await;
    [baked, raw(server, &path).await]
}

pub(super) async fn raw(server: &Server, path: &str) -> Vec<u8> {
    let answer = server.get(&format!("{path}/lightmap?format=raw")).await;
    assert_eq!(answer.status, 200);
    answer.body
}

/// Parts that were done at such a place.
async fn parts(server: &Server, place: &str) -> u64 {
    let metrics = server.get("/metrics").await;
    let text = String::from_utf8(metrics.body).unwrap();
    let name = format!("rebake_parts_total{{place=\"{place}\"}} ");
    text.lines().find_map(|line| line.strip_prefix(&name)).map_or(0, |count| count.parse().unwrap())
}

/// Workers that the service knows of.
async fn worker_count(server: &Server) -> usize {
    let metrics = server.get("/metrics").await;
    let text = String::from_utf8(metrics.body).unwrap();
    text.lines().find_map(|line| line.strip_prefix("rebake_workers ")).map_or(0, |count| count.parse().unwrap())
}

/// Waits until the service knows of so many workers.
async fn know_workers(server: &Server, count: usize) {
    let begun = Instant::now();
    while worker_count(server).await != count {
        assert!(begun.elapsed() < PATIENCE, "no {count} workers");
        tokio::task::yield_now().await;
    }
}

/// The room with a lamp more.
fn two_lamps() -> Glb {
    let mut scene = room();
    scene.point_light("bulb", [2.0, 1.5, 2.0], 20.0);
    scene
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_worker_two_or_none_give_the_bits_of_one_process() {
    let Some(broker) = Broker::start() else { return };
    let alone = light_of(&Server::start().await, &two_lamps()).await;

    let server = broker.serve(false).await;
    assert!(light_of(&server, &two_lamps()).await == alone, "no worker");
    assert!(parts(&server, "here").await > 0 && parts(&server, "elsewhere").await == 0);

    let first = broker.worker();
    let server = broker.serve(true).await;
    know_workers(&server, 1).await;
    assert!(light_of(&server, &two_lamps()).await == alone, "one worker");
    assert!(parts(&server, "elsewhere").await > 0);

    let second = broker.worker();
    let server = broker.serve(true).await;
    know_workers(&server, 2).await;
    assert!(light_of(&server, &two_lamps()).await == alone, "two workers");
    assert!(parts(&server, "elsewhere").await > 0 && parts(&server, "refused").await == 0);
    first.kill();
    second.kill();
    // Nothing is left of results.
    let left = || fs::read_dir(broker.objects().join("parts")).map_or(0, Iterator::count);
    let begun = Instant::now();
    while left() > 0 {
        assert!(begun.elapsed() < PATIENCE, "{} offers are left", left());
        tokio::task::yield_now().await;
    }
}

/// More layers than lie side by side: a part of a round has those that matter at each element.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn bakes_of_many_layers_are_shared_out_too() {
    let Some(broker) = Broker::start() else { return };
    let mut scene = room();
    for k in 0..18 {
        let (x, z) = (0.4 + 0.8 * (k % 5) as f32, 0.4 + 0.8 * (k / 5) as f32);
        scene.point_light(&format!("bulb {k}"), [x, 0.3, z], 2.0);
    }
    let alone = light_with(&Server::start().await, &scene, "layers=each").await;
    let worker = broker.worker();
    let server = broker.serve(true).await;
    know_workers(&server, 1).await;
    assert!(light_with(&server, &scene, "layers=each").await == alone);
    assert!(parts(&server, "elsewhere").await > 0 && parts(&server, "refused").await == 0);
    worker.kill();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn workers_and_the_broker_may_die_at_any_moment() {
    let Some(mut broker) = Broker::start() else { return };
    let alone = light_of(&Server::start().await, &room()).await;
    let (server, scene) = (broker.serve(false).await, room());
    let mut workers = vec![broker.worker(), broker.worker()];
    let mut light = std::pin::pin!(light_of(&server, &scene));
    let mut rolls = 7_u32;
    let light = loop {
        // Not synchronisation: the moments of trouble.
        match tokio::time::timeout(Duration::from_millis(40), &mut light).await {
            Ok(light) => break light,
            Err(_) => {
                rolls = rolls.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                match rolls >> 29 {
                    0 => {
                        broker.kill();
                        broker.come_back();
                    }
                    1 => workers.push(broker.worker()),
                    2 | 3 => drop(workers.pop()),
                    _ => {}
                }
            }
        }
    };
    assert!(light == alone);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_queue_that_is_not_there_stops_nothing() {
    let alone = light_of(&Server::start().await, &room()).await;
    let folder = tempfile::tempdir().unwrap();
    // Nobody listens at port 1.
    let queue = "nats://127.0.0.1:1".to_owned();
    let cluster = ClusterConfig { queue, objects: folder.path().display().to_string(), delegates: false };
    let server = Server::with(|config| config.cluster = Some(cluster)).await;
    assert!(light_of(&server, &room()).await == alone);
}

/// What is given for a task: bytes, and what they are said to hash to.
type Lie<'a> = dyn Fn(&Value) -> (Vec<u8>, String) + 'a;

/// Takes parts as a worker would, and gives `nonsense` for each.
async fn lie(broker: &Broker, nonsense: impl Fn(&Value) -> (Vec<u8>, String)) {
    let client = async_nats::connect(broker.url()).await.unwrap();
    let context = jetstream::new(client.clone());
    let stream = loop {
        match context.get_stream("rebake-parts").await {
            Ok(stream) => break stream,
            Err(_) => tokio::task::yield_now().await,
        }
    };
    let config = pull::Config { durable_name: Some("rebake-workers".to_owned()), ..Default::default() };
    let consumer = stream.get_or_create_consumer("rebake-workers", config).await.unwrap();
    let mut tasks = consumer.messages().await.unwrap();
    while let Some(Ok(message)) = tasks.next().await {
        let task: Value = serde_json::from_slice(&message.payload).unwrap();
        let (bytes, hash) = nonsense(&task);
        let (offer, part) = (task["offer"].as_str().unwrap(), &task["part"]);
        let folder = broker.objects().join("parts").join(offer);
        let written = fs::create_dir_all(&folder).and_then(|()| fs::write(folder.join(format!("{part}-liar")), bytes));
        // The service clears the folders of offers that are over away.
        if written.is_err_and(|error| error.kind() == ErrorKind::NotFound) {
            message.ack_with(AckKind::Ack).await.unwrap();
            continue;
        }
        for what in [json!("working"), json!({ "done": { "hash": hash, "ms": 1 } })] {
            let news = json!({ "worker": "liar", "round": task["round"], "part": part, "what": what });
            client.publish(format!("rebake.news.{offer}"), news.to_string().into()).await.unwrap();
        }
        client.flush().await.unwrap();
        message.ack_with(AckKind::Ack).await.unwrap();
    }
}

/// An estimate of a part whose every number has these bits.
fn estimate_of(task: &Value, slots: usize, bits: u32) -> Vec<u8> {
    let number = |name: &str| task[name].as_u64().unwrap() as u32;
    let mut bytes = b"RBKEST03".to_vec();
    for number in [number("round"), number("part"), number("samples"), 1] {
        bytes.extend(number.to_le_bytes());
    }
    bytes.extend((slots as u64).to_le_bytes());
    (0..slots * 6).for_each(|_| bytes.extend(bits.to_le_bytes()));
    bytes
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nonsense_is_told_apart_and_done_again() {
    let Some(broker) = Broker::start() else { return };
    let alone = light_of(&Server::start().await, &room()).await;
    let slots = alone[0].len() / 12;
    let hash = |bytes: &[u8]| blake3::hash(bytes).to_hex().to_string();
    let nonsense: [&Lie<'_>; 3] = [
        &|_| (b"light".to_vec(), hash(b"light")),
        &|task| (estimate_of(task, slots, 0x3f80_0000), hash(b"something else")),
        &|task| {
            let bytes = estimate_of(task, slots, f32::NAN.to_bits());
            let hash = hash(&bytes);
            (bytes, hash)
        },
    ];
    let current = AtomicUsize::new(0);
    let tell_apart = async {
        for (place, _) in nonsense.iter().enumerate() {
            current.store(place, Ordering::Relaxed);
            let server = broker.serve(true).await;
            let client = async_nats::connect(broker.url()).await.unwrap();
            while worker_count(&server).await != 1 {
                client.publish("rebake.workers", "liar".into()).await.unwrap();
                client.flush().await.unwrap();
            }
            assert!(light_of(&server, &room()).await == alone);
            assert!(parts(&server, "refused").await > 0, "lie {place}");
        }
    };
    // One liar for all: what is sent to one that has just gone is nobody's for as long as the queue waits for its answer.
    tokio::select! {
        () = tell_apart => {}
        () = lie(&broker, |task| nonsense[current.load(Ordering::Relaxed)](task)) => unreachable!("it goes on lying"),
    }
}
