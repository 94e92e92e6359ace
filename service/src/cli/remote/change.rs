//! `rebake cancel`, `delete`, `undo`, `redo`, `assets`: what needs no more than a name.

use std::path::PathBuf;

use rebake::client::EditOptions;
use rebake::client::types::JobState;
use serde_json::{Value, json};

use super::super::ui;
use super::budget::BudgetArgs;
use super::look::{print, text};
use super::{ServerArgs, interruptible, note_done, read_packed, wait_for_job};

/// Arguments of `rebake cancel`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct CancelArgs {
    /// Ids of jobs
    #[arg(value_name = "JOB", required = true)]
    jobs: Vec<String>,
    #[command(flatten)]
    server: ServerArgs,
    /// Return when they have ended
    #[arg(long)]
    wait: bool,
}

/// Arguments of `rebake delete`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct DeleteArgs {
    /// Ids of scenes
    #[arg(value_name = "SCENE", required = true)]
    scenes: Vec<String>,
    #[command(flatten)]
    server: ServerArgs,
}

/// Arguments of `rebake undo` and `rebake redo`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct TurnArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    #[command(flatten)]
    budget: BudgetArgs,
    /// Return when the light map is up to date
    #[arg(long)]
    wait: bool,
}

/// Arguments of `rebake assets`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(in super::super) struct AssetsArgs {
    #[command(flatten)]
    list: AssetList,
    #[command(subcommand)]
    command: Option<AssetCommand>,
}

#[derive(Debug, clap::Args)]
struct AssetList {
    #[command(flatten)]
    server: ServerArgs,
    /// Print what the API answers
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum AssetCommand {
    /// Upload assets to insert later, or pictures of the sky; prints their ids
    Add {
        /// Binary glTF files, or .exr and .hdr pictures
        #[arg(value_name = "FILE", required = true)]
        files: Vec<PathBuf>,
        #[command(flatten)]
        server: ServerArgs,
    },
    /// Delete assets that no scene needs
    Delete {
        /// Ids of assets
        #[arg(value_name = "ASSET", required = true)]
        assets: Vec<String>,
        #[command(flatten)]
        server: ServerArgs,
    },
}

/// Cancels jobs: their light maps stay at the last version.
pub(in super::super) async fn cancel(args: CancelArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let work = async {
        for id in &args.jobs {
            client.cancel_job(id).await?;
            let job = match args.wait {
                true => client.wait_for_job(id, |_| ()).await?,
                false => client.job(id).await?,
            };
            let state = match job.state {
                JobState::Canceled => "canceled",
                state if state.has_ended() => "ended before it could be canceled",
                _ => "asked to stop",
            };
            ui::note(&format!("{id}: {state}"));
        }
        Ok(())
    };
    interruptible(work, "").await
}

/// Deletes scenes, with their light maps and their histories.
pub(in super::super) async fn delete(args: DeleteArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let work = async {
        for scene in &args.scenes {
            client.delete_scene(scene).await?;
            ui::note(&format!("{scene}: deleted"));
        }
        Ok(())
    };
    interruptible(work, "").await
}

/// Takes the last edit back, or makes it again: `op` says which.
pub(in super::super) async fn turn(args: TurnArgs, op: &'static str) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let edit = args.budget.add_to(json!({ "op": op }));
    let job = interruptible(async { Ok(client.edit(&args.scene, &edit, &EditOptions::default()).await?) }, "").await?;
    ui::out(&job.id)?;
    if args.wait {
        let wait = wait_for_job(&client, &job);
        note_done(&interruptible(wait, ": the update goes on at the service").await?);
    }
    Ok(())
}

/// Lists, uploads or deletes assets.
pub(in super::super) async fn assets(args: AssetsArgs) -> anyhow::Result<()> {
    match args.command {
        None => {
            let client = args.list.server.client()?;
            let assets = interruptible(async { Ok(client.assets().await?) }, "").await?;
            print(&assets, ["asset", "holds", "file", "memory", "scenes"], row, args.list.json)
        }
        Some(AssetCommand::Add { files, server }) => {
            let client = server.client()?;
            for file in files {
                let bytes = read_packed(&file)?;
                ui::out(&interruptible(async { Ok(client.create_asset(bytes).await?) }, "").await?)?;
            }
            Ok(())
        }
        Some(AssetCommand::Delete { assets, server }) => {
            let client = server.client()?;
            for asset in assets {
                interruptible(async { Ok(client.delete_asset(&asset).await?) }, "").await?;
                ui::note(&format!("{asset}: deleted"));
            }
            Ok(())
        }
    }
}

fn row(asset: &Value) -> [String; 5] {
    let holds = match (asset["picture"][0].as_u64(), asset["picture"][1].as_u64()) {
        (Some(width), Some(height)) => format!("{width} × {height} texels"),
        _ => format!("{} triangles", ui::count(asset["triangles"].as_u64().unwrap_or(0))),
    };
    let bytes = |name: &str| ui::bytes(asset[name].as_u64().unwrap_or(0));
    let scenes: Vec<String> = asset["scenes"].as_array().into_iter().flatten().map(text).collect();
    let scenes = if scenes.is_empty() { "–".to_owned() } else { scenes.join(" ") };
    [text(&asset["asset"]), holds, bytes("bytes"), bytes("memory_bytes"), scenes]
}
