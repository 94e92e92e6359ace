//! Light from outside that is added to files, and how their own is read.

use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context;
use glam::Vec3;
use rebake::LightUnit;
use rebake_core::scene::{LightKind, LoadLimits, Outside, Scene, load_sky};

use super::ui;
use super::values::{Rgb, not_negative};

/// Light from outside, and of the file.
#[derive(Clone, Debug, Default, clap::Args)]
pub(super) struct SkyArgs {
    /// Constant radiance from outside, linear RGB [default: black]
    #[arg(long, value_name = "R,G,B", conflicts_with = "sky")]
    pub(super) environment: Option<Rgb>,
    /// A picture of the sky: equirectangular, OpenEXR or Radiance
    #[arg(long, value_name = "FILE.{exr,hdr}")]
    pub(super) sky: Option<PathBuf>,
    /// Turn that picture about the vertical, counter-clockwise seen from above
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, requires = "sky")]
    pub(super) sky_rotation: Option<f32>,
    /// Factor on its radiance [default: 1]
    #[arg(long, value_name = "FACTOR", value_parser = not_negative, requires = "sky")]
    pub(super) sky_strength: Option<f64>,
    /// Radiance 1 from everywhere where the scene has no light at all
    #[arg(long)]
    pub(super) default_sky: bool,
    /// Angle that the discs of directional lights take up, below 180: the sun's is 0.53 [default: 0, hard shadows]
    #[arg(long, value_name = "DEGREES", value_parser = disc_angle)]
    pub(super) sun_angle: Option<f32>,
    /// What the intensities of the file's point and spot lights are: glTF's candela, or watts into all directions, as
    /// Blender writes in its lighting mode "Raw" [default: candela]
    #[arg(long, value_enum)]
    pub(super) unit: Option<LightUnit>,
}

fn disc_angle(text: &str) -> Result<f32, String> {
    let angle = text.parse().ok().filter(|angle: &f32| (0.0..180.0).contains(angle));
    angle.ok_or_else(|| "has to be a number of at least 0 and below 180".to_owned())
}

impl SkyArgs {
    /// Adds it to a scene that was just read.
    pub(super) fn add_to(&self, scene: &mut Scene) -> anyhow::Result<()> {
        self.unit.unwrap_or_default().convert(scene);
        let sky = match (&self.sky, self.environment) {
            (Some(file), _) => {
                let cannot = || format!("cannot load {}", file.display());
                let bytes = std::fs::read(file).with_context(cannot)?;
                let loaded = load_sky(&bytes, &LoadLimits::default()).with_context(cannot)?;
                loaded.warnings.iter().for_each(|warning| ui::note(&format!("warning: {warning}")));
                let rotation = self.sky_rotation.unwrap_or(0.0);
                anyhow::ensure!(rotation.is_finite(), "--sky-rotation: has to be finite");
                let rotation = rotation.rem_euclid(360.0).to_radians();
                let kind = LightKind::Sky { picture: Arc::new(loaded.picture), rotation };
                Some((kind, Vec3::ONE, self.sky_strength.unwrap_or(1.0) as f32))
            }
            (None, Some(Rgb(radiance))) => {
                Some((LightKind::Environment, Vec3::from_array(radiance.map(|x| x as f32)), 1.0))
            }
            (None, None) => None,
        };
        let sun_angle = self.sun_angle.unwrap_or(0.0).to_radians();
        let is_added = Outside { sky, default_sky: self.default_sky, sun_angle }.add_to(scene);
        let option = if self.sky.is_some() { "--sky" } else { "--environment" };
        anyhow::ensure!(is_added, "{option}: the scene has a light of the name \"environment\"");
        Ok(())
    }
}
