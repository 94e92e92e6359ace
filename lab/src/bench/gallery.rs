//! Pictures of a case, as the figures of Lu et al. 2025 arrange them: the scene before the edit, every method after it
//! and the reference; FLIP against the reference; the change of the light map; parts of them magnified.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::path::path_trace;
use anyhow::{Context, Result, ensure};
use glam::Vec3;
use rebake_core::metrics::{PIXELS_PER_DEGREE, flip, rmse};
use rebake_core::render::{
    Palette, Picture, RenderOptions, ToneMap, ValuePicture, View, Viewpoint, auto_exposure, change_of, nice_scale,
    render, render_values, srgb_from_linear, visible_slots,
};
use rebake_core::{Edit, LightMap, Stated, Unobserved, World};

use super::report::PictureReport;
use super::{Method, PreparedCase, Timed};
use crate::sheet::{Cell, Crop, Panel, Sheet};

/// Which pictures to draw of every case.
#[derive(Clone, Debug)]
pub struct PictureOptions {
    /// Where files go.
    pub folder: PathBuf,
    /// Index or name of a camera of the scene; the first where absent, an overview where there is none.
    pub camera: Option<String>,
    /// Size and samples per pixel.
    pub render: RenderOptions,
    /// Parts to magnify; where the light changes most where empty.
    pub crops: Vec<Crop>,
}

/// A light map to show, in the world after the edit.
pub(super) struct Shown {
    /// Short, also part of file names.
    pub(super) name: &'static str,
    /// What it cost.
    pub(super) cost: String,
    /// The map.
    pub(super) map: Arc<LightMap>,
}

impl Shown {
    /// A run's map.
    pub(super) fn of(method: Method, run: Timed) -> Shown {
        Shown { name: method.name(), cost: format!("{:.3} s, {} spp", run.seconds, run.samples), map: run.map }
    }
}

/// Edges of magnified parts, as in the published figures.
const COLORS: [[u8; 3]; 4] = [[230, 60, 50], [60, 160, 60], [50, 100, 220], [220, 150, 30]];
/// Parts that are magnified where nobody chose any.
const CROPS: usize = 3;

/// Draws a case and writes its files.
pub(super) fn draw_case(
    case: &PreparedCase,
    base: &LightMap,
    mut shown: Vec<Shown>,
    (mode, reference_samples, seed): (Stated, u32, u64),
    options: &PictureOptions,
) -> Result<Vec<PictureReport>> {
    std::fs::create_dir_all(&options.folder)
        .with_context(|| format!("cannot make the folder {}", options.folder.display()))?;
    let eye = Eye { viewpoint: viewpoint(&case.before, options)?, view: view_of(mode), options: &options.render };
    // An inserted object can be looked through: its light is there, it is not. Figure 6.
    let is_insert = case.edits.iter().any(|edit| matches!(edit, Edit::Insert { .. }));
    let truth = traced(case, &eye, shown.last().map(|s| &*s.map), is_insert, (reference_samples, seed))?;
    shown.push(Shown { name: "reference", cost: format!("{reference_samples} paths"), map: Arc::new(truth) });
    let files = Files { folder: &options.folder, case: slug(&case.name) };
    let gallery = Gallery::new((&case.before, base), &case.after, &shown, mode, &eye, &options.crops)?;
    gallery.save(&files)?;
    files.write("sheet", &gallery.sheet(&case.name, "").draw())?;
    if is_insert {
        let without: Vec<Shown> = shown
            .iter()
            .map(|s| Shown { name: s.name, cost: s.cost.clone(), map: Arc::new(s.map.resized(case.before.slots())) })
            .collect();
        let hidden = Gallery::new((&case.before, base), &case.before, &without, mode, &eye, &options.crops)?;
        files.write("sheet-without-object", &hidden.sheet(&case.name, ", what was inserted is not drawn").draw())?;
    }
    Ok(gallery.report(&files))
}

fn view_of(mode: Stated) -> View {
    match mode {
        Stated::Full => View::Full,
        Stated::Indirect => View::Indirect,
    }
}

/// Where pictures are taken from, and what of.
struct Eye<'a> {
    viewpoint: Viewpoint,
    view: View,
    options: &'a RenderOptions,
}

fn viewpoint(world: &World, options: &PictureOptions) -> Result<Viewpoint> {
    let cameras = &world.scene.cameras;
    let Some(name) = &options.camera else {
        return Ok(cameras.first().map_or_else(|| Viewpoint::overview(world), Viewpoint::of_camera));
    };
    let by_index = || name.parse::<usize>().ok().and_then(|index| cameras.get(index));
    let camera = cameras.iter().find(|camera| camera.name == *name).or_else(by_index);
    camera.map(Viewpoint::of_camera).with_context(|| format!("camera: none of the {} is {name:?}", cameras.len()))
}

/// Path-traced values where the pictures look; elsewhere, which only backs without elements look at, another map's.
fn traced(
    case: &PreparedCase,
    eye: &Eye,
    elsewhere: Option<&LightMap>,
    without_object: bool,
    (samples, seed): (u32, u64),
) -> Result<LightMap> {
    let world = &case.after;
    let mut slots = visible_slots(world, &eye.viewpoint, eye.options, &Unobserved)?;
    if without_object {
        slots.extend(visible_slots(&case.before, &eye.viewpoint, eye.options, &Unobserved)?);
        slots.sort_unstable();
        slots.dedup();
    }
    slots.retain(|&slot| world.areas()[slot as usize] > 0.0 && world.is_valid(slot as usize));
    let (values, _) = path_trace(world, &slots, samples, seed ^ 0x5eed_0003_0000_0000, &Unobserved)?;
    let mut map = elsewhere.map_or_else(|| LightMap::black(world.slots()), |map| map.resized(world.slots()));
    for (slot, value) in slots.into_iter().zip(values) {
        (map.light.direct[slot as usize], map.light.indirect[slot as usize]) = (value.direct, value.indirect);
    }
    Ok(map)
}

/// What a column of the sheet shows.
struct Column {
    name: &'static str,
    cost: String,
    picture: Panel,
    rmse: f64,
    flip: f64,
    flip_map: Panel,
    /// Of the light map since before the edit; the picture before has none.
    change: Option<Panel>,
}

/// A case's pictures: the one before the edit first, the reference last.
struct Gallery {
    columns: Vec<Column>,
    /// Ends of the colour scale of changes.
    scale: f32,
    crops: Vec<Crop>,
    exposure: f32,
}

impl Gallery {
    fn new(
        (old, base): (&World, &LightMap),
        world: &World,
        shown: &[Shown],
        mode: Stated,
        eye: &Eye,
        crops: &[Crop],
    ) -> Result<Gallery> {
        let draw = |world: &World, map: &LightMap| -> Result<Picture> {
            Ok(render(world, map, &eye.viewpoint, eye.view, eye.options, &Unobserved)?)
        };
        let before = draw(old, base)?;
        let after = shown.iter().map(|s| draw(world, &s.map)).collect::<Result<Vec<Picture>>>()?;
        let truth = after.last().context("there is no reference")?;
        let exposure = auto_exposure(&truth.pixels);
        let displayed = |picture: &Picture| -> Vec<Vec3> {
            let display = |p: &Vec3| ToneMap::AgX.map(*p * exposure.exp2()).map(srgb_from_linear);
            picture.pixels.iter().map(display).collect()
        };
        let goal = displayed(truth);
        let changes = shown
            .iter()
            .map(|s| {
                let change = match mode {
                    Stated::Full => change_of((old, base), (world, &s.map), LightMap::total),
                    Stated::Indirect => change_of((old, base), (world, &s.map), |map, slot| map.light.indirect[slot]),
                };
                Ok(render_values(world, &change, &eye.viewpoint, eye.options, &Unobserved)?)
            })
            .collect::<Result<Vec<ValuePicture>>>()?;
        let changed = &changes.last().context("there is no reference")?.values;
        let scale = nice_scale(changed);
        let crops = choose_crops(changed, truth.width, crops)?;
        let column = |name, cost, picture: &Picture, change: Option<&ValuePicture>| {
            let colors = displayed(picture);
            let errors = flip(&goal, &colors, picture.width, PIXELS_PER_DEGREE);
            let heat: Vec<Vec3> = errors.iter().map(|e| Palette::Heat.color(*e)).collect();
            Column {
                name,
                cost,
                picture: Panel::from_srgb(&colors, picture.width),
                rmse: rmse(&truth.pixels, &picture.pixels),
                flip: errors.iter().map(|e| f64::from(*e)).sum::<f64>() / errors.len().max(1) as f64,
                flip_map: Panel::from_srgb(&heat, picture.width),
                change: change.map(|c| Panel::from_srgb(&c.colors(scale, Palette::Signed), c.width)),
            }
        };
        let first = column("before", "no update".to_owned(), &before, None);
        let rest = shown.iter().zip(&after).zip(&changes);
        let rest = rest.map(|((s, picture), change)| column(s.name, s.cost.clone(), picture, Some(change)));
        let columns = std::iter::once(first).chain(rest).collect();
        Ok(Gallery { columns, scale, crops, exposure })
    }

    fn is_reference(&self, k: usize) -> bool {
        k + 1 == self.columns.len()
    }

    fn sheet(&self, case: &str, note: &str) -> Sheet {
        let title = format!("{case}{note} (AgX, {:+.2} stops)", self.exposure);
        let pictures = self.columns.iter().map(|column| {
            let mut panel = column.picture.clone();
            self.crops.iter().zip(COLORS.iter().cycle()).for_each(|(crop, color)| panel.frame(*crop, *color));
            Cell::new(format!("{}: {}", column.name, column.cost), panel)
        });
        let errors = self.columns.iter().enumerate().map(|(k, column)| match self.is_reference(k) {
            true => Cell::empty(),
            false => {
                let caption = format!("FLIP {:.4}, RMSE {:.2e}", column.flip, column.rmse);
                Cell::new(caption, column.flip_map.clone()).with_scale(Palette::Heat, 1.0)
            }
        });
        let change = |panel: &Panel| Cell::new("change", panel.clone()).with_scale(Palette::Signed, self.scale);
        let changes = self.columns.iter().map(|column| column.change.as_ref().map_or_else(Cell::empty, change));
        let mut rows = vec![pictures.collect(), errors.collect(), changes.collect()];
        rows.extend(self.crops.iter().zip(COLORS.iter().cycle()).map(|(crop, color)| self.magnified(*crop, *color)));
        Sheet { title, rows }
    }

    /// A part of every picture; beside it its FLIP, for the reference its change.
    fn magnified(&self, crop: Crop, color: [u8; 3]) -> Vec<Cell> {
        let cell = |(k, column): (usize, &Column)| {
            let width = column.picture.width / 2;
            let mut left = column.picture.magnified(crop, width);
            left.frame(left.whole(), color);
            let beside = if self.is_reference(k) { column.change.as_ref() } else { Some(&column.flip_map) };
            let panel = beside.map_or_else(|| left.clone(), |right| left.beside(&right.magnified(crop, width)));
            Cell::new("", panel)
        };
        self.columns.iter().enumerate().map(cell).collect()
    }

    /// All pictures one by one.
    fn save(&self, files: &Files) -> Result<()> {
        for (k, column) in self.columns.iter().enumerate() {
            files.write(column.name, &column.picture)?;
            if !self.is_reference(k) {
                files.write(&format!("{}-flip", column.name), &column.flip_map)?;
            }
            if let Some(change) = &column.change {
                files.write(&format!("{}-change", column.name), change)?;
            }
        }
        Ok(())
    }

    fn report(&self, files: &Files) -> Vec<PictureReport> {
        let of = |c: &Column| PictureReport { of: c.name, file: files.name(c.name), rmse: c.rmse, flip: c.flip };
        self.columns.iter().map(of).collect()
    }
}

/// Names of a case's files.
struct Files<'a> {
    folder: &'a Path,
    case: String,
}

impl Files<'_> {
    fn name(&self, what: &str) -> String {
        format!("{}-{what}.png", self.case)
    }

    fn write(&self, what: &str, panel: &Panel) -> Result<()> {
        let path = self.folder.join(self.name(what));
        std::fs::write(&path, panel.png()?).with_context(|| format!("cannot write {}", path.display()))
    }
}

/// A case's name as part of a file's.
fn slug(name: &str) -> String {
    let name = name.replacen("+ ", "plus ", 1).replacen("- ", "minus ", 1).to_lowercase();
    let parts: Vec<&str> = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|part| !part.is_empty()).collect();
    parts.join("-")
}

/// The crops that were asked for; without any, those where most light changes: a sixth of the picture wide, apart.
fn choose_crops(change: &[f32], width: usize, wanted: &[Crop]) -> Result<Vec<Crop>> {
    let height = change.len() / width.max(1);
    for crop in wanted {
        let is_inside = crop.x + crop.width <= width && crop.y + crop.height <= height;
        ensure!(is_inside, "crop: {crop:?} is not within {width} × {height} pixels");
    }
    let size = (width / 6, height / 6);
    if !wanted.is_empty() || size.0 < 8 || size.1 < 8 {
        return Ok(wanted.to_vec());
    }
    let sum = |crop: &Crop| -> f64 {
        let row = |y: usize| change[y * width + crop.x..][..crop.width].iter().map(|v| f64::from(v.abs())).sum::<f64>();
        (crop.y..crop.y + crop.height).map(row).sum()
    };
    let steps = |whole: usize, part: usize| (0..=whole - part).step_by((part / 4).max(1));
    let places = steps(height, size.1).flat_map(|y| steps(width, size.0).map(move |x| (x, y)));
    let mut places: Vec<(f64, Crop)> = places
        .map(|(x, y)| Crop { x, y, width: size.0, height: size.1 })
        .map(|crop| (sum(&crop), crop))
        .filter(|(changed, _)| *changed > 0.0)
        .collect();
    places.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut chosen: Vec<Crop> = Vec::new();
    for (_, crop) in places {
        let is_apart = |c: &Crop| c.x.abs_diff(crop.x) >= 3 * size.0 / 2 || c.y.abs_diff(crop.y) >= 3 * size.1 / 2;
        if chosen.len() < CROPS && chosen.iter().all(is_apart) {
            chosen.push(crop);
        }
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests;
