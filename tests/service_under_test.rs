//! The service in a process of its own, for tests that kill it or weigh it. It tells on standard error where it listens
//! and serves until it is killed.
//!
//! `service-under-test [NAME=VALUE]…`, the names being those of [`set`].

use std::error::Error;
use std::path::PathBuf;
use std::time::Duration;

use rebake::Config;

fn main() -> Result<(), Box<dyn Error>> {
    let mut config = Config { threads: 1, ..Config::default() };
    // However busy the machine is: uploads are answered with their scenes.
    config.timeouts.upload_answer = Duration::from_secs(600);
    for argument in std::env::args().skip(1) {
        let (name, value) = argument.split_once('=').ok_or_else(|| format!("{argument}: there is no ="))?;
        set(&mut config, name, value).map_err(|error| format!("{argument}: {error}"))?;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
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
        _ => return Err("there is no such setting".into()),
    }
    Ok(())
}
