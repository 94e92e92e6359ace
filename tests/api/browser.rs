//! The page in a real browser: `viewer/test/browser.mjs` drives it, this starts and restarts the service under it.
//!
//! Needs Node, Chromium and the page's packages. `viewer/test/setup.sh` gets what is missing, and the test is skipped,
//! with the reason, where it cannot. `REBAKE_BROWSER=as-is` installs nothing, `REBAKE_BROWSER=required` fails instead
//! of skipping. Screenshots are left in `viewer/screenshots`.

use std::fs::{File, TryLockError};
use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use glam::{DMat3, DMat4, DVec3, Vec3};
use rebake::Config;
use rebake::auth::Tokens;
use rebake_core::export::write_scene_glb;
use rebake_core::scene::{Camera, Material, Mesh, Object, Scene};
use tokio::net::TcpListener;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

use super::access::{ADMIN, token_file};
use super::server::{Server, patiently};

/// Between two lines of the script: longer than it waits itself.
const LINE_PATIENCE: Duration = Duration::from_secs(300);

#[tokio::test]
async fn something_stands_at_the_root() {
    let server = Server::start().await;
    let page = server.get("/").await;
    assert_eq!(page.status, 200);
    assert!(page.header("content-type").starts_with("text/html"));
    assert!(page.header("content-security-policy").contains("default-src 'none'"));
    let text = String::from_utf8(page.body).unwrap();
    let expected = if rebake::viewer::is_embedded() { "viewer.js" } else { "--features viewer" };
    assert!(text.contains(expected), "{text}");
    server.stop().await;
}

#[tokio::test]
async fn the_page_edits_a_room_in_a_browser() {
    let viewer = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../viewer"));
    let wish = Wish::from_env();
    let Ready { chromium, page, lock } = match prepare(viewer, wish) {
        Ok(ready) => ready,
        Err(why) => {
            assert!(wish != Wish::Required, "{why}");
            tell(&format!("skipped: {why}"));
            return;
        }
    };
    let room = std::env::temp_dir().join(format!("rebake-browser-{}.glb", std::process::id()));
    std::fs::write(&room, write_scene_glb(&furnished_room()).unwrap()).unwrap();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let file = token_file();
    let tokens = Tokens::read(file.path()).unwrap();
    let mut service = Some(Service::start(listener, &tokens));
    let mut script = Script::start(viewer, &chromium, &page, address, &room);
    let mut said = Vec::new();
    while let Some(line) = script.line().await {
        match line.as_str() {
            "stop" => {
                service.take().unwrap().stop().await;
                script.answer();
            }
            "start" => {
                service = Some(Service::start(TcpListener::bind(address).await.unwrap(), &tokens));
                script.answer();
            }
            _ => said.push(line),
        }
    }
    let ended = script.child.wait().unwrap();
    // None where the script gave up while it was stopped.
    if let Some(service) = service {
        service.stop().await;
    }
    std::fs::remove_file(&room).unwrap();
    drop(lock);
    assert!(ended.success() && said.last().is_some_and(|line| line == "done"), "{}", said.join("\n"));
}

/// 4 × 3 × 4 m with a cupboard, a lamp under the ceiling, and a camera that looks down on the cupboard.
fn furnished_room() -> Scene {
    let object = |name: &str, mesh: Mesh, albedo: [f32; 3]| Object::new(name, mesh, Material::diffuse(albedo.into()));
    let (low, high) = (Vec3::new(1.0, 0.02, 0.8), Vec3::new(2.0, 1.0, 1.4));
    let lamp = Mesh::quad(Vec3::new(1.5, 2.95, 1.5), Vec3::X, Vec3::Z);
    let mut scene = Scene::from_objects(vec![
        object("room", Mesh::cuboid(Vec3::ZERO, Vec3::new(4.0, 3.0, 4.0)).inside_out(), [0.7, 0.6, 0.5]),
        object("cupboard", Mesh::cuboid(low, high), [0.2, 0.4, 0.6]),
        Object::new("lamp", lamp, Material::emissive(Vec3::new(8.0, 7.0, 6.0))),
    ]);
    let eye = DVec3::new(3.4, 2.2, 3.6);
    let backward = (eye - DVec3::new(1.5, 0.3, 1.2)).normalize();
    let right = DVec3::Y.cross(backward).normalize();
    let rotation = DMat3::from_cols(right, backward.cross(right), backward);
    let world_from_camera = DMat4::from_mat3_translation(rotation, eye);
    scene.cameras.push(Camera { name: "view".to_owned(), world_from_camera, fov_y: 1.0 });
    scene
}

/// What is done where something that the test needs is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    /// It is installed; where that cannot be, the test is skipped.
    Install,
    /// The test is skipped.
    AsIs,
    /// It is installed; where that cannot be, the test fails.
    Required,
}

impl Wish {
    fn from_env() -> Wish {
        match std::env::var("REBAKE_BROWSER").as_deref() {
            Err(_) | Ok("" | "install") => Wish::Install,
            Ok("as-is") => Wish::AsIs,
            Ok("required") => Wish::Required,
            Ok(other) => panic!("REBAKE_BROWSER: has to be install, as-is or required, not {other:?}"),
        }
    }
}

/// What the test needs.
struct Ready {
    chromium: PathBuf,
    /// Directory of the built page.
    page: PathBuf,
    /// Keeps another process that runs this test away from packages, page and screenshots.
    lock: File,
}

fn prepare(viewer: &Path, wish: Wish) -> Result<Ready, String> {
    let lock = lock(&viewer.join(".lock"))?;
    let mut setup = Command::new("bash");
    setup.arg(viewer.join("test/setup.sh")).args((wish == Wish::AsIs).then_some("--check"));
    // What it does goes past the harness, which would keep it to itself: it may take a minute.
    let done = setup.stdin(Stdio::null()).stderr(Stdio::inherit()).output();
    let done = done.map_err(|error| format!("viewer/test/setup.sh cannot be run: {error}"))?;
    let said = String::from_utf8_lossy(&done.stdout).trim().to_owned();
    if !done.status.success() {
        return Err(said);
    }
    // A broken page or client is a failure, not a reason to skip.
    for script in ["client", "build"] {
        let ran = Command::new("npm").args(["run", script]).current_dir(viewer).output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stdout));
    }
    Ok(Ready { chromium: PathBuf::from(said), page: viewer.join("dist"), lock })
}

/// Waits until no other process holds the file.
fn lock(path: &Path) -> Result<File, String> {
    let cannot = |error: std::io::Error| format!("{} cannot be locked: {error}", path.display());
    let file = File::create(path).map_err(cannot)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::Error(error)) => Err(cannot(error)),
        Err(TryLockError::WouldBlock) => {
            tell("waits for another process that runs it");
            file.lock().map_err(cannot).map(|()| file)
        }
    }
}

/// A line that is seen also where the test passes: the harness keeps what is printed otherwise.
fn tell(what: &str) {
    let _ = writeln!(std::io::stderr(), "browser test {what}");
}

/// A service that can be started anew at the same address.
struct Service {
    stop: oneshot::Sender<()>,
    ended: JoinHandle<std::io::Result<()>>,
}

impl Service {
    fn start(listener: TcpListener, tokens: &Tokens) -> Service {
        let mut config = Config { threads: 2, tokens: Some(tokens.clone()), ..Config::default() };
        (config.defaults.bake_samples, config.defaults.edit_samples) = (32, 16);
        // Streams of a page that stays open would hold up the end.
        config.timeouts.shutdown = Duration::from_secs(2);
        let (stop, stopped) = oneshot::channel::<()>();
        let shutdown = async move {
            let _ = stopped.await;
        };
        Service { stop, ended: tokio::spawn(rebake::run(listener, config, shutdown)) }
    }

    async fn stop(self) {
        let _ = self.stop.send(());
        patiently(self.ended).await.unwrap().unwrap();
    }
}

/// The running script.
struct Script {
    child: Child,
    lines: mpsc::UnboundedReceiver<String>,
}

impl Script {
    fn start(viewer: &Path, chromium: &Path, page: &Path, address: SocketAddr, room: &Path) -> Script {
        let mut child = Command::new("node")
            .arg("test/browser.mjs")
            .arg(format!("http://{address}"))
            .args([room, Path::new("cupboard"), Path::new("screenshots")])
            .current_dir(viewer)
            .env("CHROMIUM", chromium)
            .env("PAGE_DIR", page)
            .env("CAN_RESTART", "1")
            .env("TOKEN", ADMIN)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let (send, lines) = mpsc::unbounded_channel();
        std::thread::spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| send.send(line)));
        Script { child, lines }
    }

    async fn line(&mut self) -> Option<String> {
        tokio::time::timeout(LINE_PATIENCE, self.lines.recv()).await.expect("the script is silent")
    }

    fn answer(&mut self) {
        self.child.stdin.as_mut().unwrap().write_all(b"done\n").unwrap();
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        // Where the test failed half-way; it has ended by itself otherwise.
        let _ = self.child.kill();
    }
}
