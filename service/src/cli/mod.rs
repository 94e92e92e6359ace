//! The command line. Results go to standard output, everything else to standard error.

mod bake;
mod bench;
mod compare;
mod demo;
mod door;
mod exit;
mod remote;
mod render;
mod replica;
mod serve;
mod sky;
mod ui;
mod values;
mod worker;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, Subcommand};

const LONG_ABOUT: &str = "\
Keeps the light map of a 3D scene up to date while the scene is edited.

Upload a room as binary glTF, follow its light map as it is baked, insert, move, repaint or remove furniture, \
and get only the values that changed, seconds after the edit instead of minutes.";

const AFTER_HELP: &str = "\
Try it:
  rebake demo                              a furnished room, edited over HTTP and measured
  rebake bake room.glb -o room.exr         a light map without a service

With a service:
  rebake serve &
  ID=$(rebake push room.glb --wait)        upload and bake; prints the scene's id
  rebake watch $ID                         one line per new version of its light map
  rebake edit $ID --wait insert chair.glb --at 1,0,2
  rebake edit $ID --wait remove chair
  rebake render $ID -o room.png            a picture
  rebake pull $ID -o room.glb              the subdivided mesh with the light map as COLOR_0
  rebake undo $ID --wait                   take the last edit back
  rebake list                              what the service holds; info, jobs, assets tell more

Exit status: 0 done, 1 failed, 2 wrong usage, 3 the service refused, 4 the job failed or was canceled, \
130 interrupted.";

/// Keeps the light map of a 3D scene up to date while the scene is edited.
#[derive(Debug, Parser)]
#[command(name = "rebake", version, long_about = LONG_ABOUT, after_help = AFTER_HELP, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Run the service
    Serve(serve::ServeArgs),
    /// Do parts of bakes for services on other machines
    Worker(worker::WorkerArgs),
    /// Serve reads of what a service on another machine publishes
    Replica(replica::ReplicaArgs),
    /// Show what the service does: a furnished room, baked and edited over HTTP, measured
    Demo(demo::DemoArgs),
    /// Bake the light map of a scene file, without a service
    Bake(bake::BakeArgs),
    /// Measure speed against error of updates and of bakes from scratch, side by side
    Bench(Box<bench::BenchArgs>),
    /// Upload a scene and bake it
    Push(remote::PushArgs),
    /// Change a scene: insert, remove, move or repaint objects, change lights
    Edit(Box<remote::EditArgs>),
    /// Follow a scene's light map: one line per new version
    Watch(remote::WatchArgs),
    /// Save a scene's light map to a file
    Pull(remote::PullArgs),
    /// Save the light around points of a scene as spherical harmonics
    Probes(remote::ProbesArgs),
    /// Draw a picture of a scene, or of a file after baking it
    Render(Box<render::RenderArgs>),
    /// Compare two pictures or light maps: RMSE, FLIP, a picture of the difference
    Compare(compare::CompareArgs),
    /// List the scenes of a service
    List(remote::ListArgs),
    /// Tell what is in a scene: objects, lights, light map
    Info(remote::InfoArgs),
    /// List jobs, newest first
    Jobs(remote::JobsArgs),
    /// Cancel jobs; light maps stay at their last version
    Cancel(remote::CancelArgs),
    /// Take the last edit of a scene back
    Undo(remote::TurnArgs),
    /// Make the edit again that was taken back last
    Redo(remote::TurnArgs),
    /// Delete scenes, with their light maps and histories
    Delete(remote::DeleteArgs),
    /// List, upload and delete what can be inserted, and pictures of the sky
    Assets(remote::AssetsArgs),
    /// Ask a service whether it takes work
    Health(remote::HealthArgs),
    /// Print the API description (OpenAPI, JSON)
    Openapi,
}

/// Parses the arguments and checks what clap cannot.
fn parse(arguments: impl IntoIterator<Item = impl Into<OsString> + Clone>) -> Result<Cli, clap::Error> {
    let cli = Cli::try_parse_from(arguments)?;
    match &cli.command {
        Command::Edit(args) if args.is_twofold() => {
            let message = "give either an operation or --json, not both";
            Err(Cli::command().error(ErrorKind::ArgumentConflict, message))
        }
        _ => Ok(cli),
    }
}

/// Parses the arguments, does what they ask for, and tells how it went.
pub(crate) fn run() -> ExitCode {
    let cli = parse(std::env::args_os()).unwrap_or_else(|error| error.exit());
    let runtime = match tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return exit::report(&anyhow::Error::new(error).context("cannot start")),
    };
    let result = runtime.block_on(async {
        match cli.command {
            Command::Serve(args) => serve::serve(args).await,
            Command::Worker(args) => worker::worker(args).await,
            Command::Replica(args) => replica::replica(args).await,
            Command::Demo(args) => demo::demo(args).await,
            Command::Bake(args) => bake::bake(args).await,
            Command::Bench(args) => bench::bench(*args).await,
            Command::Push(args) => remote::push(args).await,
            Command::Edit(args) => remote::edit(&args).await,
            Command::Watch(args) => remote::watch(args).await,
            Command::Pull(args) => remote::pull(args).await,
            Command::Probes(args) => remote::probes(args).await,
            Command::Render(args) => render::render(*args).await,
            Command::Compare(args) => compare::compare(&args),
            Command::List(args) => remote::list(args).await,
            Command::Info(args) => remote::info(args).await,
            Command::Jobs(args) => remote::jobs(args).await,
            Command::Cancel(args) => remote::cancel(args).await,
            Command::Undo(args) => remote::turn(args, "undo").await,
            Command::Redo(args) => remote::turn(args, "redo").await,
            Command::Delete(args) => remote::delete(args).await,
            Command::Assets(args) => remote::assets(args).await,
            Command::Health(args) => remote::health(args).await,
            Command::Openapi => ui::out(&serve::openapi_document()?),
        }
    });
    // Whatever still computes in the background has nothing to say any more.
    runtime.shutdown_background();
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => exit::report(&error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_command_explains_itself() {
        for command in Cli::command().get_subcommands_mut() {
            let help = command.render_long_help().to_string();
            assert!(help.contains("Usage:"), "{help}");
            assert!(command.get_about().is_some(), "{}", command.get_name());
        }
    }

    #[test]
    fn lines_of_the_documentation_parse() {
        for line in [
            "rebake serve --listen 127.0.0.1:0 --threads 2",
            "rebake demo --exit",
            "rebake bake room.glb -o room.exr --spacing 0.1 --samples 256 --mode indirect --environment 1,1,1",
            "rebake bench room.glb e.json -o r.json --budget-seconds 0.5,2 --methods path-trace,rebake --cases -sofa",
            "rebake bench -o r.json --methods paper --iterations 1,2,4 --path-length 3 --paper-equation 3",
            "rebake bench room.glb e.json -o r.json --samples 4,16 --mode indirect --seeds 1 --threads 2 --spacing 0.1",
            "rebake bench -o r.json --measure focus --focus {\"camera\":0} --samples 32",
            "rebake bench -o r.json --measure focus --tiles {\"mode\":\"incremental\",\"size\":64}",
            "rebake bench room.glb e.json -o r.json --measure drag --moves 30",
            "rebake push room.glb --server http://h:1 --name room --spacing 0.05 --wait",
            "rebake edit s1 --json -",
            "rebake edit s1 --wait insert chair.glb --at 1,0,2 --rotate-y 90",
            "rebake edit s1 --wait remove sofa chair-*",
            "rebake edit s1 remove sofa --wait --samples 8 --server http://h:1 --token t",
            "rebake edit s1 relight lamp --color 4,1,1 --yes --if-match 3 --wait",
            "rebake edit s1 move sofa --transform 1,0,0,0,0,1,0,0,0,0,1,0,2,0,1,1",
            "rebake edit s1 --samples 64 --max-seconds 2 --target-rmse 0.01 material sofa --albedo 0.6,0.1,0.1",
            "rebake edit s1 relight lamp --color 1,0.9,0.8 --intensity 2.5",
            "rebake edit s1 insert-light lamp-2 --kind point --position 0,2,0 --intensity 40",
            "rebake edit s1 move-light lamp-2 --position 1,2,0",
            "rebake watch s1 --until 7",
            "rebake pull s1 -o room.rbkd --layer indirect",
            "rebake render s1 -o now.png --view change --since 7 --scale 0.5 --size 1280x720 --spp 64",
            "rebake render room.glb -o room.exr --eye 1,2,3 --target 0,1,-1 --fov-y 50 --exposure -1.5 --samples 64",
            "rebake compare a.exr b.exr -o difference.png --crop 1,2,3,4 --crop 5,6,7,8 --json",
            "rebake push room.glb --samples 64 --max-seconds 60 --target-rmse 0.01 --wait",
            "rebake edit s1 --yes relight lamp --color 4,1,1",
            "rebake edit s1 material sofa --albedo #aa3322",
            "rebake list --json",
            "rebake info s1 --server http://h:1",
            "rebake jobs s1 --state running --json",
            "rebake jobs",
            "rebake cancel j1 j2 --wait",
            "rebake undo s1 --wait --samples 16",
            "rebake redo s1 --max-seconds 2",
            "rebake delete s1 s2",
            "rebake assets --json",
            "rebake assets add chair.glb noon.hdr --server http://h:1",
            "rebake assets delete abc",
            "rebake assets --server http://h:1 --token t",
            "rebake health",
            "rebake openapi",
        ] {
            let parsed = parse(line.split(' '));
            assert!(parsed.is_ok(), "{line}: {}", parsed.err().map(|e| e.to_string()).unwrap_or_default());
        }
    }

    #[test]
    fn wrong_arguments_are_refused() {
        for line in [
            "rebake",
            "rebake serve --listen nowhere",
            "rebake serve --threads 0",
            "rebake bake room.glb",
            "rebake bake room.glb -o room.png",
            "rebake bake room.glb -o room.exr --spacing -1",
            "rebake bake room.glb -o room.exr --samples 0",
            "rebake bake room.glb -o room.exr --mode half",
            "rebake bench room.glb -o r.json",
            "rebake bench room.glb e.json -o r.svg",
            "rebake bench room.glb e.json -o r.json --methods magic",
            "rebake bench room.glb e.json -o r.json --budget-seconds 1,0",
            "rebake bench room.glb e.json -o r.json --budget-seconds 1 --samples 4",
            "rebake bench -o r.json --measure focus --focus {",
            "rebake bench -o r.json --measure focus --tiles {\"mode\":\"spiral\"}",
            "rebake push room.glb --environment 1,2",
            "rebake push room.glb --spacing nan",
            "rebake edit s1",
            "rebake edit s1 --json - remove sofa",
            "rebake edit s1 remove",
            "rebake edit s1 move sofa --transform 1,2,3",
            "rebake edit s1 move sofa",
            "rebake edit s1 move-light lamp",
            "rebake edit s1 relight lamp",
            "rebake edit s1 material sofa --albedo 1.5,0,0",
            "rebake edit s1 insert-light l --kind point",
            "rebake pull s1 -o room.obj",
            "rebake render s1",
            "rebake compare a.exr",
            "rebake compare a.exr b.exr --crop 1,2,3",
            "rebake render s1 -o room.jpg",
            "rebake render s1 -o room.png --size 0x3",
            "rebake render s1 -o room.png --eye 1,2,3",
            "rebake render s1 -o room.png --view sideways",
            "rebake render s1 -o room.png --eye 1,2,3 --target 0,0,0 --fov-y 180",
            "rebake push room.glb --samples 0",
            "rebake info",
            "rebake jobs --state done",
            "rebake cancel",
            "rebake delete",
            "rebake undo",
            "rebake undo s1 --target-rmse 0",
            "rebake assets add",
            "rebake assets delete",
        ] {
            assert!(parse(line.split(' ')).is_err(), "{line}");
        }
    }
}
