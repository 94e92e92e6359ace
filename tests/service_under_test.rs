//! The service in a process of its own, for tests that kill it or weigh it. It tells on standard error where it listens
//! and serves until it is killed. With `worker=true` it is a worker, and tells that it listens to its queue.
//!
//! `service-under-test [NAME=VALUE]…`, the names being those of [`set`].

use std::error::Error;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use rebake::Config;
use rebake::cluster::{ClusterConfig, WorkerOptions, work};

fn main() -> Result<(), Box<dyn Error>> {
    let (mut config, mut is_worker) = (Config { threads: 1, ..Config::default() }, false);
    // However busy the machine is: uploads are answered with their scenes.
    config.timeouts.upload_answer = Duration::from_secs(600);
    for argument in std::env::args().skip(1) {
        let (name, value) = argument.split_once('=').ok_or_else(|| format!("{argument}: there is no ="))?;
        is_worker |= name == "worker";
        set(&mut config, name, value).map_err(|error| format!("{argument}: {error}"))?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    if let Some(cluster) = config.cluster.clone().filter(|_| is_worker) {
        // Whoever waits for it expects an address of a service.
        eprintln!("listening on {}", cluster.queue.replace("nats:", "http:"));
        let options = WorkerOptions { cluster, threads: NonZeroUsize::new(config.threads) };
        return Ok(runtime.block_on(work(&options, std::future::pending()))?);
    }
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await?;
        eprintln!("listening on http://{}", listener.local_addr()?);
        Ok(rebake::run(listener, config, std::future::pending()).await?)
    })
}

fn set(config: &mut Config, name: &str, value: &str) -> Result<(), Box<dyn Error>> {
    match name {
        "data-dir" => config.data_dir = Some(PathBuf::from(value)),
        "save-ms" => config.timeouts.save = Duration::from_millis(value.parse()?),
        "finished-jobs" => config.limits.finished_jobs = value.parse()?,
        "events" => config.limits.events = value.parse()?,
        "queue" => cluster_of(config).queue = value.to_owned(),
        "objects" => cluster_of(config).objects = value.to_owned(),
        "worker" => {}
        _ => return Err("there is no such setting".into()),
    }
    Ok(())
}

fn cluster_of(config: &mut Config) -> &mut ClusterConfig {
    let none = ClusterConfig { queue: String::new(), objects: String::new(), delegates: false };
    config.cluster.get_or_insert(none)
}
