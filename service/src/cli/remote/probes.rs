//! `rebake probes`: save the light around points.

use std::path::PathBuf;

use anyhow::Context;

use super::super::ui;
use super::{Replacement, ServerArgs, interruptible};

const AFTER_HELP: &str = "\
Each probe has nine RGB coefficients of the incoming radiance, in the order and signs of SphericalHarmonics3 of
three.js. With --since 0 the service remembers what it told: --since VERSION of that answer then brings only what has changed.";

/// Arguments of `rebake probes`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(in super::super) struct ProbesArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    /// A grid over the scene: metres between neighbours
    #[arg(long, value_name = "METRES", required_unless_present = "points", conflicts_with = "points")]
    spacing: Option<f64>,
    /// Box of the grid, least and greatest corner: x,y,z,x,y,z
    #[arg(long, allow_hyphen_values = true, requires = "spacing")]
    bounds: Option<String>,
    /// Points instead of a grid: x,y,z;x,y,z
    #[arg(long, allow_hyphen_values = true)]
    points: Option<String>,
    /// Samples per probe
    #[arg(long)]
    samples: Option<u32>,
    /// Only what has changed since this version; 0 to begin
    #[arg(long, value_name = "VERSION")]
    since: Option<u64>,
    /// File to write (JSON); standard output where absent
    #[arg(short, long, value_name = "OUT.json")]
    output: Option<PathBuf>,
}

/// Saves or prints probes.
pub(in super::super) async fn probes(args: ProbesArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let query: Vec<(&str, String)> = [
        ("spacing", args.spacing.map(|spacing| spacing.to_string())),
        ("bounds", args.bounds.clone()),
        ("points", args.points.clone()),
        ("samples", args.samples.map(|samples| samples.to_string())),
        ("since", args.since.map(|since| since.to_string())),
    ]
    .into_iter()
    .filter_map(|(name, value)| Some((name, value?)))
    .collect();
    let told = interruptible(async { Ok(client.probes(&args.scene, &query).await?) }, "").await?;
    let Some(output) = &args.output else { return ui::out(&serde_json::to_string_pretty(&told)?) };
    let mut file = Replacement::begin(output)?;
    file.write(&serde_json::to_vec_pretty(&told)?)?;
    file.finish()?;
    let probes = told["probes"].as_array().context("the service answered without probes")?.len() as u64;
    ui::note(&format!("{}: version {}, {} probes", output.display(), told["version"], ui::count(probes)));
    Ok(())
}
