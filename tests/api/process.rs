//! A service in a process of its own.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

use super::server::Server;

/// A child process with the service; killed when it is dropped.
pub(crate) struct Service {
    child: Child,
    pub(crate) server: Server,
}

impl Service {
    /// Starts it with these settings, `name=value` each.
    pub(crate) fn start(settings: &[&str]) -> Service {
        let mut child = Command::new(env!("CARGO_BIN_EXE_service-under-test"))
            .args(settings)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut told = String::new();
        for line in BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok) {
            match line.strip_prefix("listening on ") {
                Some(base) => return Service { child, server: Server::elsewhere(base) },
                None => told = line,
            }
        }
        panic!("the service did not start: {}: {told}", child.wait().unwrap())
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
