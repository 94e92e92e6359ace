//! Two pictures side by side, and how they differ as people see them.

use anyhow::{Context, Result, ensure};
use glam::Vec3;
use rebake_core::metrics::{PIXELS_PER_DEGREE, flip};
use rebake_core::render::{Palette, Picture, ToneMap, auto_exposure, nice_scale, srgb_from_linear};

use crate::sheet::{Cell, Crop, Panel, Sheet};

/// How pictures are shown.
#[derive(Clone, Copy, Debug, Default)]
pub struct ShownAs {
    /// They are what a screen shows already: neither exposure nor tone map changes them.
    pub is_display: bool,
    /// Stops by which they are brightened; by the mean of the first where absent.
    pub exposure: Option<f32>,
    /// What the ends of the difference's colour scale stand for; by the pictures where absent.
    pub scale: Option<f32>,
}

/// Two pictures as a screen shows them, and their differences.
#[derive(Clone, Debug)]
pub struct SideBySide {
    width: usize,
    height: usize,
    /// A, B, difference, FLIP: sRGB in 0..=1.
    panels: [Vec<Vec3>; 4],
    flip: Vec<f32>,
    /// What the ends of the difference's colour scale stand for.
    pub scale: f32,
}

/// Edges of what is magnified.
const FRAME: [u8; 3] = [230, 60, 50];

impl SideBySide {
    /// Of two pictures of the same size, linear RGB.
    pub fn new(a: &Picture, b: &Picture, shown_as: ShownAs) -> SideBySide {
        let gain = shown_as.exposure.unwrap_or_else(|| auto_exposure(&a.pixels)).exp2();
        let show = |picture: &Picture| -> Vec<Vec3> {
            let display =
                |p: &Vec3| if shown_as.is_display { ToneMap::Linear.map(*p) } else { ToneMap::AgX.map(*p * gain) };
            picture.pixels.iter().map(|p| display(p).map(srgb_from_linear)).collect()
        };
        let (shown_a, shown_b) = (show(a), show(b));
        let flip = flip(&shown_a, &shown_b, a.width, PIXELS_PER_DEGREE);
        let change: Vec<f32> = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*b - *a).element_sum() / 3.0).collect();
        let scale = shown_as.scale.unwrap_or_else(|| nice_scale(&change));
        let colored = change.iter().map(|value| Palette::Signed.color(value / scale)).collect();
        let heat = flip.iter().map(|value| Palette::Heat.color(*value)).collect();
        SideBySide { width: a.width, height: a.height, panels: [shown_a, shown_b, colored, heat], flip, scale }
    }

    /// Mean FLIP over all pixels, 0 to 1.
    pub fn mean_flip(&self) -> f64 {
        self.flip.iter().map(|e| f64::from(*e)).sum::<f64>() / self.flip.len().max(1) as f64
    }

    /// A, B, their difference and FLIP side by side; below, row by row, the crops, each as wide as a panel. A PNG.
    ///
    /// # Errors
    /// A crop that does not lie within the pictures.
    pub fn sheet(&self, crops: &[Crop]) -> Result<Vec<u8>> {
        let panels = self.panels.each_ref().map(|colors| Panel::from_srgb(colors, self.width));
        let flip = format!("FLIP, mean {:.4}", self.mean_flip());
        let captions = ["A", "B", "B - A", &flip];
        let scales = [None, None, Some((Palette::Signed, self.scale)), Some((Palette::Heat, 1.0))];
        let mut first: Vec<Panel> = panels.to_vec();
        let mut rows = Vec::new();
        for crop in crops {
            let inside = crop.x + crop.width <= self.width && crop.y + crop.height <= self.height;
            ensure!(inside, "--crop: {crop:?} is not within {} × {} pixels", self.width, self.height);
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

#[cfg(test)]
mod tests {
    use rebake_core::render::read_picture;

    use super::*;

    #[test]
    fn a_sheet_holds_panels_and_crops() {
        let picture = |value: f32| Picture { width: 20, height: 10, pixels: vec![Vec3::splat(value); 200] };
        let shown = SideBySide::new(&picture(0.2), &picture(0.4), ShownAs::default());
        assert!((shown.scale - 0.2).abs() < 1e-6 && shown.mean_flip() > 0.1);
        let crop = Crop { x: 2, y: 3, width: 5, height: 4 };
        let sheet = read_picture(&shown.sheet(&[crop]).unwrap()).unwrap().picture;
        // Four times 20 and gaps of 10; one row of 10 pixels and one of 4 magnified four times, the first under
        // captions. Bars with numbers below the difference and FLIP.
        assert_eq!((sheet.width, sheet.height), (4 * 30 + 10, 10 + (25 + 10 + 35 + 10) + (16 + 10)));
        let outside = Crop { x: 18, y: 0, width: 5, height: 5 };
        assert!(shown.sheet(&[outside]).is_err());
    }
}
