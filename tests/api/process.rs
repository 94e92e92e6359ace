//! A service in a process of its own: this test binary, which runs one of its ignored tests.

use std::ffi::OsStr;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use rebake::Config;

use super::server::Server;

/// What the ignored test does: serves until it is killed, and tells where.
pub(crate) fn serve_until_killed(config: Config) {
    tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap().block_on(async {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        eprintln!("listening on http://{}", listener.local_addr().unwrap());
        rebake::run(listener, config, std::future::pending()).await.unwrap();
    });
}

/// A child process with the service; killed when it is dropped.
pub(crate) struct Service {
    child: Child,
    pub(crate) server: Server,
}

impl Service {
    /// Runs the ignored test of this name with this variable set.
    pub(crate) fn start(test: &str, variable: (&str, &OsStr)) -> Service {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", test, "--ignored", "--nocapture"])
            .env(variable.0, variable.1)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let base = lines.into_iter().find_map(|line| line.strip_prefix("listening on ").map(str::to_owned));
        match base {
            Some(base) => Service { child, server: Server::elsewhere(&base) },
            None => panic!("the service did not start: {}", child.wait().unwrap()),
        }
    }

    /// Memory of the process in MiB, where the system tells.
    pub(crate) fn resident_mib(&self) -> Option<f64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0)
    }

    pub(crate) fn kill(self) {}
}

impl Drop for Service {
    fn drop(&mut self) {
        // SIGKILL: nothing of the process runs any more. Also where a check failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
