//! `rebake`: the service, its demo, and the command line that talks to it.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    rebake::keep_freed_memory();
    cli::run()
}
