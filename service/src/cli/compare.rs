//! `rebake compare`: how far two pictures or light maps are apart.

use std::path::{Path, PathBuf};

use anyhow::Context;
use glam::Vec3;
use rebake::sheet::{Cell, Crop, Panel, Sheet};
use rebake_core::metrics::{PIXELS_PER_DEGREE, flip, rmse};
use rebake_core::render::{
    Loaded, Palette, Picture, ToneMap, auto_exposure, nice_scale, read_picture, srgb_from_linear,
};
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
    let shown = Shown::new(args, &a.picture, &b.picture);
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

/// Two pictures as a screen shows them, and their differences.
struct Shown {
    width: usize,
    height: usize,
    /// A, B, difference, FLIP: sRGB in 0..=1.
    panels: [Vec<Vec3>; 4],
    flip: Vec<f32>,
    scale: f32,
}

impl Shown {
    fn new(args: &CompareArgs, a: &Picture, b: &Picture) -> Shown {
        // A PNG is what a screen shows already.
        let is_png = |path: &Path| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
        let is_shown = is_png(&args.reference) || is_png(&args.test);
        let gain = args.exposure.unwrap_or_else(|| auto_exposure(&a.pixels)).exp2();
        let show = |picture: &Picture| -> Vec<Vec3> {
            let display = |p: &Vec3| if is_shown { ToneMap::Linear.map(*p) } else { ToneMap::AgX.map(*p * gain) };
            picture.pixels.iter().map(|p| display(p).map(srgb_from_linear)).collect()
        };
        let (shown_a, shown_b) = (show(a), show(b));
        let flip = flip(&shown_a, &shown_b, a.width, PIXELS_PER_DEGREE);
        let change: Vec<f32> = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*b - *a).element_sum() / 3.0).collect();
        let scale = args.scale.map_or_else(|| nice_scale(&change), |scale| scale as f32);
        let colored = change.iter().map(|value| Palette::Signed.color(value / scale)).collect();
        let heat = flip.iter().map(|value| Palette::Heat.color(*value)).collect();
        Shown { width: a.width, height: a.height, panels: [shown_a, shown_b, colored, heat], flip, scale }
    }

    fn mean_flip(&self) -> f64 {
        self.flip.iter().map(|e| f64::from(*e)).sum::<f64>() / self.flip.len().max(1) as f64
    }

    /// The panels side by side; below, row by row, the crops, each as wide as a panel.
    fn sheet(&self, crops: &[Crop]) -> anyhow::Result<Vec<u8>> {
        let panels = self.panels.each_ref().map(|colors| Panel::from_srgb(colors, self.width));
        let flip = format!("FLIP, mean {:.4}", self.mean_flip());
        let captions = ["A", "B", "B - A", &flip];
        let scales = [None, None, Some((Palette::Signed, self.scale)), Some((Palette::Heat, 1.0))];
        let mut first: Vec<Panel> = panels.to_vec();
        let mut rows = Vec::new();
        for crop in crops {
            let inside = crop.x + crop.width <= self.width && crop.y + crop.height <= self.height;
            anyhow::ensure!(inside, "--crop: {crop:?} is not within {} × {} pixels", self.width, self.height);
            first[..2].iter_mut().for_each(|panel| panel.frame(*crop, FRAME));
            let part = |panel: &Panel| Cell::new("", panel.magnified(*crop, self.width));
            rows.push(panels.iter().map(part).collect());
        }
        let first = captions.into_iter().zip(first).map(|(caption, panel)| Cell::new(caption, panel));
        rows.insert(0, first.zip(scales).map(|(cell, scale)| Cell { scale, ..cell }).collect());
        let sheet = Sheet { title: String::new(), rows };
        sheet.draw().png().context("cannot make the picture")
    }
}

/// Edges of what is magnified.
const FRAME: [u8; 3] = [230, 60, 50];

#[cfg(test)]
mod tests {
    use super::*;

    fn args(line: &[&str]) -> CompareArgs {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: CompareArgs,
        }
        <Line as clap::Parser>::parse_from(std::iter::once(&"compare").chain(line)).args
    }

    #[test]
    fn a_sheet_holds_panels_and_crops() {
        let picture = |value: f32| Picture { width: 20, height: 10, pixels: vec![Vec3::splat(value); 200] };
        let args = args(&["a.exr", "b.exr", "--crop", "2,3,5,4"]);
        let shown = Shown::new(&args, &picture(0.2), &picture(0.4));
        assert!((shown.scale - 0.2).abs() < 1e-6 && shown.mean_flip() > 0.1);
        let sheet = read_picture(&shown.sheet(&args.crop).unwrap()).unwrap().picture;
        // Four times 20 and gaps of 10; one row of 10 pixels and one of 4 magnified four times, the first under
        // captions. Bars with numbers below the difference and FLIP.
        assert_eq!((sheet.width, sheet.height), (4 * 30 + 10, 10 + (25 + 10 + 35 + 10) + (16 + 10)));
        let outside = Crop { x: 18, y: 0, width: 5, height: 5 };
        assert!(shown.sheet(&[outside]).is_err());
    }
}
