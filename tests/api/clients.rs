//! The clients under `clients/`: their own tests, against a service that asks for tokens.
//!
//! Those of the Python client, and of what of the Blender add-on needs no Blender, run in a virtual environment below
//! `target`; they are skipped, with the reason, where that cannot be made. `REBAKE_PYTHON=required` fails instead.
//! The add-on runs in Blender, too (`clients/blender/test.sh`): a download of 350 MB, once per `target`.
//! `REBAKE_BLENDER=as-is` downloads nothing, `REBAKE_BLENDER=required` fails in place of being skipped.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rebake::auth::Tokens;

use super::access::{ADMIN, token_file};
use super::server::Server;

const CLIENTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../clients");

#[tokio::test]
async fn the_python_client_passes_its_tests() {
    let (python, lock) = match tokio::task::spawn_blocking(environment).await.unwrap() {
        Ok(ready) => ready,
        Err(why) => {
            assert!(!std::env::var("REBAKE_PYTHON").is_ok_and(|wish| wish == "required"), "{why}");
            tell(&format!("Python client test skipped: {why}"));
            return;
        }
    };
    let mut types = Command::new(&python);
    types
        .current_dir(format!("{CLIENTS}/python"))
        .args(["-m", "mypy", "--cache-dir"])
        .arg(python.with_file_name("types"));
    succeeds(tokio::task::spawn_blocking(move || types.output()).await.unwrap().unwrap());
    let mut tests = Command::new(&python);
    tests.args(["-m", "pytest", "-q", "-p", "no:cacheprovider", "python/tests", "blender/tests/test_state.py"]);
    with_a_service(tests).await;
    drop(lock);
}

#[tokio::test]
async fn the_add_on_keeps_a_light_map_up_to_date_in_blender() {
    let mut script = Command::new("bash");
    script.arg("blender/test.sh").env("REBAKE_TOOLS", Path::new(env!("CARGO_TARGET_TMPDIR")).join("blender-tools"));
    let said = with_a_service(script).await;
    said.lines().filter(|line| line.starts_with("Blender test skipped")).for_each(tell);
}

/// Runs a command that talks to the service at `REBAKE_SERVER` with the token `REBAKE_TOKEN`; it has to succeed. What
/// it says.
async fn with_a_service(mut command: Command) -> String {
    let file = token_file();
    let tokens = Tokens::read(file.path()).unwrap();
    let server = Server::with(|config| config.tokens = Some(tokens)).await;
    command.current_dir(CLIENTS).env("REBAKE_SERVER", &server.base).env("REBAKE_TOKEN", ADMIN);
    command.env("PYTHONDONTWRITEBYTECODE", "1");
    let done = tokio::task::spawn_blocking(move || command.output()).await.unwrap();
    server.stop().await;
    succeeds(done.unwrap())
}

/// The interpreter of a virtual environment with the client and what its tests need, and what keeps other processes
/// away from it; else why there is none.
fn environment() -> Result<(PathBuf, File), String> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python-client");
    let cannot = |error: std::io::Error| format!("{} cannot be used: {error}", folder.display());
    std::fs::create_dir_all(&folder).map_err(cannot)?;
    let lock = File::create(folder.join("lock")).map_err(cannot)?;
    lock.lock().map_err(cannot)?;
    let python = folder.join("bin/python");
    let client = format!("{CLIENTS}/python");
    // With the path: what a copy of the folder has installed is the client of somewhere else.
    let wanted = format!("{client}\n{}", std::fs::read_to_string(format!("{client}/pyproject.toml")).unwrap());
    let stamp = folder.join("installed");
    if !std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        tell("Python client test: installing what it needs ...");
        step(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
        // Not for ever, where the registry is slow.
        let mut install = Command::new("timeout");
        install.arg("300").arg(&python).args(["-m", "pip", "install", "--quiet", "--retries", "1", "--timeout", "20"]);
        step(install.arg("--editable").arg(format!("{client}[exr,test]")))?;
        // Written last: what was installed half-way is not taken for whole.
        std::fs::write(&stamp, wanted).map_err(cannot)?;
    }
    Ok((python, lock))
}

/// Runs a command; else why it did not succeed: the last line of what it said, or that `timeout` has ended it.
fn step(command: &mut Command) -> Result<(), String> {
    let program = command.get_program().to_owned();
    let done = command.output().map_err(|error| format!("{} cannot be run: {error}", program.display()))?;
    if done.status.success() {
        return Ok(());
    }
    if done.status.code() == Some(124) {
        return Err("it took too long".to_owned());
    }
    let said = [done.stdout, done.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    Err(said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it said nothing").to_owned())
}

#[track_caller]
fn succeeds(done: Output) -> String {
    let said = String::from_utf8_lossy(&[done.stdout, done.stderr].concat()).into_owned();
    assert!(done.status.success(), "{said}");
    said
}

/// A line that is seen also where the test passes: the harness keeps what is printed otherwise.
fn tell(what: &str) {
    let _ = writeln!(std::io::stderr(), "{what}");
}
