//! `rebake push`: upload and bake.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use rebake::Sizing;
use rebake::client::types::{NewScene, Scene};

use super::super::sky::SkyArgs;
use super::super::ui;
use super::super::values::{max_albedo, positive};
use super::budget::BudgetArgs;
use super::{ServerArgs, interruptible, note_done, read_file, read_packed, wait_for_job};

const AFTER_HELP: &str = "\
Prints the id of the new scene on standard output, all else on standard error:
  ID=$(rebake push room.glb --spacing 0.1 --wait)
  rebake pull $ID -o room.exr";

/// Arguments of `rebake push`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(in super::super) struct PushArgs {
    /// Scene to upload: a .glb file, a .gltf file with its files beside it, or both in a zip archive
    #[arg(value_name = "SCENE.glb")]
    file: PathBuf,
    #[command(flatten)]
    server: ServerArgs,
    /// Name of the scene [default: the file's]
    #[arg(long)]
    name: Option<String>,
    /// Largest distance between neighbouring elements, metres [default: from the scene's size]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    spacing: Option<f64>,
    /// How many elements there are to be, in place of a spacing
    #[arg(long, value_name = "N", conflicts_with = "spacing")]
    elements: Option<NonZeroUsize>,
    /// How they are spread [default: uniform]
    #[arg(long, value_enum, value_name = "HOW")]
    sizing: Option<Sizing>,
    /// What the light map holds: all light, or only what has bounced
    #[arg(long, value_parser = ["full", "indirect"])]
    mode: Option<String>,
    /// Largest albedo that light meets, below 1 [default: 0.95]
    #[arg(long, value_name = "ALBEDO", value_parser = max_albedo)]
    max_albedo: Option<f32>,
    #[command(flatten)]
    sky: SkyArgs,
    /// Texels per metre of an atlas, which objects have lasting places in [default without it: none]
    #[arg(long, value_name = "N", value_parser = positive)]
    texels_per_metre: Option<f64>,
    /// Lights with layers of their own, which are relit without rays: `shared` (none yet), `each`, or groups as JSON,
    /// e.g. '{"ceiling": ["lamp-1", "lamp-2"]}' [default: shared]
    #[arg(long, value_name = "shared|each|JSON")]
    layers: Option<String>,
    #[command(flatten)]
    budget: BudgetArgs,
    /// Upload only
    #[arg(long, conflicts_with = "wait")]
    no_bake: bool,
    /// Return when the bake is done
    #[arg(long)]
    wait: bool,
}

/// Uploads a scene and starts its bake.
pub(in super::super) async fn push(args: PushArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let glb = read_packed(&args.file)?;
    let sky = match &args.sky.sky {
        Some(file) => {
            let picture = read_file(file)?;
            Some(interruptible(async { Ok(client.create_asset(picture).await?) }, "").await?)
        }
        None => None,
    };
    let new = NewScene {
        name: args.name.or_else(|| NewScene::name_of(&args.file)),
        spacing: args.spacing.map(|spacing| spacing as f32),
        elements: args.elements.map(NonZeroUsize::get),
        sizing: args.sizing,
        mode: args.mode,
        environment: args.sky.environment.map(|rgb| rgb.0.map(|x| x as f32)),
        sky,
        sky_rotation: args.sky.sky_rotation,
        sky_strength: args.sky.sky_strength.map(|strength| strength as f32),
        default_sky: args.sky.default_sky.then_some(true),
        sun_angle: args.sky.sun_angle,
        unit: args.sky.unit,
        max_albedo: args.max_albedo,
        layout: None,
        texels_per_metre: args.texels_per_metre.map(|density| density as f32),
        layers: args.layers,
        samples_per_element: args.budget.samples,
        max_seconds: args.budget.max_seconds,
        target_rmse: args.budget.target_rmse.map(|rmse| rmse as f32),
        bake: args.no_bake.then_some(false),
    };
    let spinner = ui::spinner("upload");
    let created = interruptible(async { Ok(client.create_scene(glb, &new).await?) }, "").await;
    spinner.finish_and_clear();
    let scene = created?;
    note_scene(&scene);
    ui::out(&scene.id)?;
    if let (true, Some(job)) = (args.wait, scene.job_id()) {
        let wait = async {
            let job = client.job(job).await?;
            wait_for_job(&client, &job).await
        };
        note_done(&interruptible(wait, ": the bake goes on at the service").await?);
    }
    Ok(())
}

fn note_scene(scene: &Scene) {
    let name = scene.name.as_deref().unwrap_or(&scene.id);
    if scene.is_preparing() {
        return ui::note(&format!("{name}: its elements are being laid out"));
    }
    ui::note(&format!(
        "{name}: {}, {}, {}, {}",
        ui::counted(scene.objects.len() as u64, "object"),
        ui::counted(scene.lights.len() as u64, "light"),
        ui::counted(scene.elements, "element"),
        ui::bytes(scene.memory_bytes),
    ));
    for warning in &scene.warnings {
        ui::note(&format!("warning: {warning}"));
    }
}
