//! `rebake compare`: how far two pictures or light maps are apart.

use std::path::{Path, PathBuf};

use anyhow::Context;
use rebake_core::metrics::rmse;
use rebake_core::render::{Loaded, read_picture};
use rebake_lab::compare::{ShownAs, SideBySide};
use rebake_lab::sheet::Crop;
use serde_json::json;

use super::remote::Replacement;
use super::ui;

const AFTER_HELP: &str = "\
Both files are PNG or OpenEXR pictures of the same size, or OpenEXR light maps of the same length. RMSE is over linear \
values; FLIP over what a screen shows, so of EXR pictures after exposure and the tone map AgX, the same for both. \
The difference picture shows A, B, B - A and FLIP side by side, each crop magnified below.
  rebake compare reference.exr picture.exr
  rebake compare before.png after.png -o difference.png --crop 40,60,80,45 --crop 300,200,80,45";

/// Arguments of `rebake compare`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct CompareArgs {
    /// The reference
    #[arg(value_name = "A")]
    reference: PathBuf,
    /// What is held against it
    #[arg(value_name = "B")]
    test: PathBuf,
    /// Difference picture to write
    #[arg(short, long, value_name = "OUT.png")]
    output: Option<PathBuf>,
    /// A part to magnify, pixels; may be repeated
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = crop)]
    crop: Vec<Crop>,
    /// Stops by which EXR pictures are brightened [default: by the mean of A]
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true)]
    exposure: Option<f32>,
    /// What the ends of the difference's colour scale stand for [default: by the pictures]
    #[arg(long, value_name = "VALUE", value_parser = super::values::positive)]
    scale: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// `X,Y,WIDTH,HEIGHT`.
pub(super) fn crop(text: &str) -> Result<Crop, String> {
    let numbers: Option<Vec<usize>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some(&[x, y, width @ 1..=4096, height @ 1..=4096]) => Ok(Crop { x, y, width, height }),
        _ => Err("expected X,Y,WIDTH,HEIGHT in pixels".to_owned()),
    }
}

/// Compares two files.
pub(super) fn compare(args: &CompareArgs) -> anyhow::Result<()> {
    let (a, b) = (load(&args.reference)?, load(&args.test)?);
    anyhow::ensure!(
        a.elements == b.elements && (a.picture.width, a.picture.height) == (b.picture.width, b.picture.height),
        "{} and {} differ in size: {} and {}",
        args.reference.display(),
        args.test.display(),
        size_of(&a),
        size_of(&b)
    );
    let error = rmse(&a.picture.pixels, &b.picture.pixels);
    let mean = a.picture.pixels.iter().map(|p| f64::from(p.element_sum()) / 3.0).sum::<f64>();
    let mean = mean / a.picture.pixels.len().max(1) as f64;
    if a.elements.is_some() {
        anyhow::ensure!(args.output.is_none(), "-o: light maps have no picture; compare renders of them");
        return report(args, error, mean, None);
    }
    // A PNG is what a screen shows already.
    let is_png = |path: &Path| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
    let shown_as = ShownAs {
        is_display: is_png(&args.reference) || is_png(&args.test),
        exposure: args.exposure,
        scale: args.scale.map(|scale| scale as f32),
    };
    let shown = SideBySide::new(&a.picture, &b.picture, shown_as);
    report(args, error, mean, Some(shown.mean_flip()))?;
    match &args.output {
        Some(path) => {
            let mut out = Replacement::begin(path)?;
            out.write(&shown.sheet(&args.crop)?)?;
            out.finish()?;
            ui::note(&format!("{}: A, B, B - A (ends: ±{}), FLIP (0 to 1)", path.display(), shown.scale));
            Ok(())
        }
        None => Ok(()),
    }
}

fn report(args: &CompareArgs, rmse: f64, mean: f64, flip: Option<f64>) -> anyhow::Result<()> {
    if args.json {
        return ui::out(&json!({"rmse": rmse, "mean": mean, "flip": flip}).to_string());
    }
    ui::out(&format!("RMSE {} (mean of A {})", ui::rmse(rmse), ui::rmse(mean)))?;
    flip.map_or(Ok(()), |flip| ui::out(&format!("FLIP {flip:.4} (mean)")))
}

fn load(path: &Path) -> anyhow::Result<Loaded> {
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
    read_picture(&bytes).map_err(|why| anyhow::anyhow!("cannot read {}: {why}", path.display()))
}

fn size_of(loaded: &Loaded) -> String {
    match loaded.elements {
        Some(count) => format!("a light map of {count} elements"),
        None => format!("{} × {} pixels", loaded.picture.width, loaded.picture.height),
    }
}
