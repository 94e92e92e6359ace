//! Sheets: pictures in a grid, each with a line of words above it, and a bar below where its colours stand for numbers.

use glam::Vec3;
use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};
use rebake_core::export::ExportError;
use rebake_core::render::{Palette, write_png};

/// Between panels and around them, pixels.
const GAP: usize = 10;
const PAPER: [u8; 3] = [255; 3];
const INK: [u8; 3] = [20; 3];

/// 8-bit sRGB, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panel {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `width · height` of them.
    pub pixels: Vec<[u8; 3]>,
}

/// A part of a picture, pixels from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// Left edge.
    pub x: usize,
    /// Upper edge.
    pub y: usize,
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
}

/// A place of the grid.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Words above the picture.
    pub caption: String,
    /// The picture; an empty place without one.
    pub panel: Option<Panel>,
    /// What the colours of the picture stand for, and what the upper end of that scale does: drawn below it.
    pub scale: Option<(Palette, f32)>,
}

impl Cell {
    /// A picture under words.
    pub fn new(caption: impl Into<String>, panel: Panel) -> Cell {
        Cell { caption: caption.into(), panel: Some(panel), scale: None }
    }

    /// An empty place.
    pub fn empty() -> Cell {
        Cell { caption: String::new(), panel: None, scale: None }
    }

    /// This place with a bar of colours.
    pub fn with_scale(self, palette: Palette, scale: f32) -> Cell {
        Cell { scale: Some((palette, scale)), ..self }
    }
}

/// A grid of pictures under a title.
#[derive(Clone, Debug, Default)]
pub struct Sheet {
    /// One line at the top.
    pub title: String,
    /// Rows of cells; a column is as wide as its widest picture.
    pub rows: Vec<Vec<Cell>>,
}

impl Panel {
    /// From sRGB in 0..=1; rows of `width` pixels.
    pub fn from_srgb(colors: &[Vec3], width: usize) -> Panel {
        let pixels: Vec<[u8; 3]> = colors.iter().map(|c| c.to_array().map(|v| (v * 255.0 + 0.5) as u8)).collect();
        Panel { width, height: pixels.len() / width.max(1), pixels }
    }

    /// One colour.
    pub fn blank(width: usize, height: usize, color: [u8; 3]) -> Panel {
        Panel { width, height, pixels: vec![color; width * height] }
    }

    /// A part of the panel, magnified to a width; the crop has to lie within it.
    pub fn magnified(&self, crop: Crop, width: usize) -> Panel {
        let height = (crop.height * width).div_ceil(crop.width.max(1));
        let at = |x: usize, y: usize| {
            let (x, y) = (crop.x + x * crop.width / width, crop.y + (y * crop.width / width).min(crop.height - 1));
            self.pixels[y * self.width + x]
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| at(x, y)).collect();
        Panel { width, height, pixels }
    }

    /// Draws the edge of a part of the panel, two pixels thick.
    pub fn frame(&mut self, crop: Crop, color: [u8; 3]) {
        for y in crop.y..(crop.y + crop.height).min(self.height) {
            for x in crop.x..(crop.x + crop.width).min(self.width) {
                let (right, below) = (crop.x + crop.width - 1 - x, crop.y + crop.height - 1 - y);
                if (x - crop.x).min(y - crop.y).min(right).min(below) < 2 {
                    self.pixels[y * self.width + x] = color;
                }
            }
        }
    }

    /// The whole panel as a crop.
    pub fn whole(&self) -> Crop {
        Crop { x: 0, y: 0, width: self.width, height: self.height }
    }

    /// Two panels of the same height side by side.
    pub fn beside(&self, right: &Panel) -> Panel {
        let mut both = Panel::blank(self.width + right.width, self.height.max(right.height), PAPER);
        both.put(self, 0, 0);
        both.put(right, self.width, 0);
        both
    }

    /// A PNG of it.
    ///
    /// # Errors
    /// [`ExportError`] where it is empty or too large for the format.
    pub fn png(&self) -> Result<Vec<u8>, ExportError> {
        write_png(self.width, self.height, self.pixels.as_flattened())
    }

    fn put(&mut self, panel: &Panel, left: usize, top: usize) {
        for (y, row) in panel.pixels.chunks_exact(panel.width.max(1)).enumerate() {
            self.pixels[(top + y) * self.width + left..][..panel.width].copy_from_slice(row);
        }
    }

    /// A line of words within `room` pixels; what does not fit is left out. Letters beyond ASCII become `?`.
    fn write(&mut self, text: &str, (left, top): (usize, usize), room: usize, font: (FontWeight, RasterHeight)) {
        let advance = get_raster_width(font.0, font.1);
        for (i, letter) in text.chars().take(room / advance).enumerate() {
            let Some(glyph) = get_raster(letter, font.0, font.1).or_else(|| get_raster('?', font.0, font.1)) else {
                continue;
            };
            for (y, row) in glyph.rows().enumerate() {
                for (x, ink) in row.iter().enumerate() {
                    let pixel = &mut self.pixels[(top + y) * self.width + left + i * advance + x];
                    for (value, dark) in pixel.iter_mut().zip(INK) {
                        let (paper, ink) = (u32::from(*value), u32::from(*ink));
                        *value = ((paper * (255 - ink) + u32::from(dark) * ink) / 255) as u8;
                    }
                }
            }
        }
    }
}

/// The colours of a scale from end to end, and what the ends and the middle stand for below them.
fn bar(palette: Palette, scale: f32, width: usize) -> Panel {
    let text = Sheet::CAPTION.1.val();
    let mut bar = Panel::blank(width, Sheet::BAR, PAPER);
    let line: Vec<Vec3> = (0..width).map(|x| palette.color_along((x as f32 + 0.5) / width as f32)).collect();
    let colors = Panel::from_srgb(&line, width);
    (0..Sheet::BAR - text).for_each(|y| bar.put(&colors, 0, y));
    let ticks = palette.ticks(scale);
    let widths = ticks.each_ref().map(|tick| tick.len() * get_raster_width(Sheet::CAPTION.0, Sheet::CAPTION.1));
    let [low, middle, high] = widths;
    // Both ends or none; the middle where it keeps apart from them.
    let (has_ends, has_middle) = (low + high + GAP <= width, middle + 2 * (low.max(high) + GAP) <= width);
    let lefts = [0, width.saturating_sub(middle) / 2, width.saturating_sub(high)];
    for (k, is_written) in [has_ends, has_ends && has_middle, has_ends].into_iter().enumerate() {
        if is_written {
            bar.write(&ticks[k], (lefts[k], Sheet::BAR - text), widths[k], Sheet::CAPTION);
        }
    }
    bar
}

impl Sheet {
    const TITLE: (FontWeight, RasterHeight) = (FontWeight::Bold, RasterHeight::Size24);
    const CAPTION: (FontWeight, RasterHeight) = (FontWeight::Regular, RasterHeight::Size20);

    /// Height of a bar of colours with its numbers, pixels.
    const BAR: usize = 10 + Self::CAPTION.1.val();

    /// The sheet as one picture.
    pub fn draw(&self) -> Panel {
        let size = |cell: &Cell| cell.panel.as_ref().map_or((0, 0), |panel| (panel.width, panel.height));
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width_of = |k: usize| self.rows.iter().filter_map(|row| row.get(k)).map(|c| size(c).0).max().unwrap_or(0);
        let widths: Vec<usize> = (0..columns).map(width_of).collect();
        let below = |cell: &Cell| cell.scale.map_or(0, |_| GAP / 2 + Self::BAR);
        let height_of = |row: &Vec<Cell>| row.iter().map(|cell| size(cell).1 + below(cell)).max().unwrap_or(0);
        let heights: Vec<usize> = self.rows.iter().map(height_of).collect();
        let line_of = |row: &[Cell]| match row.iter().all(|cell| cell.caption.is_empty()) {
            true => 0,
            false => Self::CAPTION.1.val() + GAP / 2,
        };
        let across = widths.iter().map(|width| width + GAP).sum::<usize>() + GAP;
        let head = if self.title.is_empty() { GAP } else { Self::TITLE.1.val() + 2 * GAP };
        let lines = self.rows.iter().map(|row| line_of(row)).sum::<usize>();
        let down = head + lines + heights.iter().map(|height| height + GAP).sum::<usize>();
        let mut sheet = Panel::blank(across, down, PAPER);
        sheet.write(&self.title, (GAP, GAP), across - 2 * GAP, Self::TITLE);
        let mut top = head;
        for (row, height) in self.rows.iter().zip(heights) {
            let (mut left, line) = (GAP, line_of(row));
            for (cell, width) in row.iter().zip(&widths) {
                sheet.write(&cell.caption, (left, top), *width, Self::CAPTION);
                if let Some(panel) = &cell.panel {
                    sheet.put(panel, left, top + line);
                    if let Some((palette, scale)) = cell.scale {
                        sheet.put(&bar(palette, scale, panel.width), left, top + line + panel.height + GAP / 2);
                    }
                }
                left += width + GAP;
            }
            top += height + line + GAP;
        }
        sheet
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stand_in_their_places_under_their_words() {
        let cell = |caption: &str, color| Cell::new(caption, Panel::blank(40, 20, color));
        let empty = Cell::empty();
        let (red, blue) = ([200, 0, 0], [0, 0, 200]);
        let sheet = Sheet {
            title: "Title".into(),
            rows: vec![vec![cell("a", red), empty], vec![cell("", blue), cell("b", blue)]],
        };
        let drawn = sheet.draw();
        let (line, head) = (20 + GAP / 2, 24 + 2 * GAP);
        assert_eq!((drawn.width, drawn.height), (2 * 40 + 3 * GAP, head + 2 * (20 + line + GAP)));
        let at = |x: usize, y: usize| drawn.pixels[y * drawn.width + x];
        assert_eq!((at(GAP, head + line), at(GAP + 39, head + line + 19)), (red, red));
        assert_eq!(at(2 * GAP + 40, head + 2 * line + 20 + GAP), blue);
        // The empty place and the gaps are paper; where words stand there is ink.
        assert_eq!((at(2 * GAP + 50, head + line + 5), at(GAP - 1, head + line)), (PAPER, PAPER));
        let has_ink = |x: std::ops::Range<usize>, y: usize| {
            x.flat_map(|x| (y..y + 20).map(move |y| (x, y))).any(|(x, y)| at(x, y)[0] < 100)
        };
        assert!(has_ink(GAP..GAP + 12, head) && has_ink(GAP..drawn.width - GAP, GAP));
        assert!(!has_ink(2 * GAP + 40..2 * GAP + 80, head));
    }

    #[test]
    fn a_bar_below_a_picture_says_what_its_colours_stand_for() {
        let of = |width, scale| {
            let cell = Cell::new("", Panel::blank(width, 20, [9; 3])).with_scale(Palette::Signed, scale);
            Sheet { title: String::new(), rows: vec![vec![cell]] }.draw()
        };
        let sheet = of(200, 0.5);
        assert_eq!((sheet.width, sheet.height), (200 + 2 * GAP, 20 + GAP / 2 + Sheet::BAR + 2 * GAP));
        let at = |x: usize, y: usize| sheet.pixels[y * sheet.width + x];
        let row = GAP + 20 + GAP / 2;
        let [low, middle, high] = [at(GAP, row), at(GAP + 100, row), at(GAP + 199, row)];
        assert!(low[2] > low[0] + 100 && high[0] > high[2] + 100 && middle[0].abs_diff(middle[2]) < 4);
        // Numbers below it: at both ends and in the middle, and no ink between them.
        let has_ink = |sheet: &Panel, from: usize, to: usize| {
            let rows = sheet.pixels.chunks_exact(sheet.width).skip(row + 10).take(20);
            rows.flat_map(|row| &row[GAP + from..GAP + to]).any(|pixel| pixel[0] < 100)
        };
        let found = [(0, 44), (44, 90), (90, 110), (110, 160), (160, 200)].map(|(from, to)| has_ink(&sheet, from, to));
        assert_eq!(found, [true, false, true, false, true]);
        // No room for both ends: none is better than half.
        assert!(!has_ink(&of(50, 0.125), 0, 50));
    }

    #[test]
    fn a_magnified_part_has_the_pixels_of_the_part() {
        let pixels = (0..12).map(|i| [i as u8; 3]).collect();
        let panel = Panel { width: 4, height: 3, pixels };
        let part = panel.magnified(Crop { x: 1, y: 1, width: 2, height: 1 }, 4);
        assert_eq!((part.width, part.height), (4, 2));
        let values: Vec<u8> = part.pixels.iter().map(|p| p[0]).collect();
        assert_eq!(values, [5, 5, 6, 6, 5, 5, 6, 6]);
        let mut framed = part;
        framed.frame(framed.whole(), [9; 3]);
        assert!(framed.pixels.iter().all(|p| *p == [9; 3]));
        assert_eq!(panel.beside(&panel).width, 8);
    }
}
