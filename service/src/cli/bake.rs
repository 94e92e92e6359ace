//! `rebake bake`: a light map without a service.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use indicatif::ProgressBar;
use rebake::api::atlas::AtlasDocument;
use rebake::{Filter, Mode, Sizing};
use rebake_core::atlas::AtlasOptions;
use rebake_core::export::{
    LightAbout, LightLayout, LitExport, Originals, Precision, lightmap_exr, write_lit_glb, write_page_exr,
};
use rebake_core::resolution::Meter;
use rebake_core::scene::{DEFAULT_MAX_ALBEDO, LoadLimits, Scene, load_path, open_original};
use rebake_core::texels::read_page;
use rebake_core::{Budget, LightMap, Observer, Progress, Snapshot, Unobserved, World, WorldOptions};

use super::exit::{self, Interrupted};
use super::remote::Replacement;
use super::sky::SkyArgs;
use super::ui;
use super::values::{max_albedo, positive};

const AFTER_HELP: &str = "\
The ending of the file chooses the format: .glb is the scene with the light map as float COLOR_0 of subdivided meshes, \
.exr the values alone. The first bound that is reached of --samples, --max-seconds and --target-rmse ends the bake; Ctrl-C ends \
it too and writes what there is by then. Same scene, same options, same seed: same bits, whatever the number of \
threads, unless time ended it.
  rebake bake room.glb -o room.exr --spacing 0.05 --samples 512
  rebake bake room.glb -o room.glb --target-rmse 0.01 --environment 1,1,1.2
  rebake bake room.glb --atlas maps/ --texels-per-metre 30
  rebake bake yard.glb -o yard.exr --sky noon.hdr --sky-rotation 90";

/// Arguments of `rebake bake`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct BakeArgs {
    /// Scene to bake: a .glb file, a .gltf file with its files beside it, or both in a zip archive
    #[arg(value_name = "SCENE.glb")]
    file: PathBuf,
    /// File to write
    #[arg(
        short,
        long,
        value_name = "OUT.{glb,exr}",
        value_parser = output_file,
        required_unless_present = "atlas"
    )]
    output: Option<PathBuf>,
    /// Of a .glb: materials are unlit, so that viewers without lights show the light map
    #[arg(long)]
    unlit: bool,
    /// Directory for the pages of an atlas, as half-float .exr, and atlas.json, which says where every object lies
    #[arg(long, value_name = "DIR")]
    atlas: Option<PathBuf>,
    /// Texels per metre of the atlas [default: one per spacing]
    #[arg(long, value_name = "N", value_parser = positive, requires = "atlas")]
    texels_per_metre: Option<f64>,
    /// Largest distance between neighbouring elements, metres [default: from the scene's size]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    spacing: Option<f64>,
    /// How many elements there are to be, in place of a spacing
    #[arg(long, value_name = "N", conflicts_with = "spacing")]
    elements: Option<NonZeroUsize>,
    /// How they are spread
    #[arg(long, value_enum, value_name = "HOW", default_value_t)]
    sizing: Sizing,
    /// Samples per element
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// What to write: all light, or only what has bounced
    #[arg(long, value_enum, default_value_t = Mode::Full)]
    mode: Mode,
    /// Whether noise is averaged away where it may be [default: statistical for .glb and --atlas, none for .exr]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
    /// Largest albedo that light meets, below 1 [default: 0.95]
    #[arg(long, value_name = "ALBEDO", value_parser = max_albedo)]
    max_albedo: Option<f32>,
    #[command(flatten)]
    sky: SkyArgs,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Stop after this time
    #[arg(long, value_name = "SECONDS", value_parser = positive)]
    max_seconds: Option<f64>,
    /// Stop at this stated error (RMSE of radiance / albedo)
    #[arg(long, value_name = "RMSE", value_parser = positive)]
    target_rmse: Option<f64>,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
}

fn is_glb(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("glb"))
}

fn output_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    if is_glb(&path) || path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("exr")) {
        Ok(path)
    } else {
        Err("the file has to end in .glb or .exr".to_owned())
    }
}

/// Bakes a file.
pub(super) async fn bake(args: BakeArgs) -> anyhow::Result<()> {
    let threads = args.threads.map_or(0, NonZeroUsize::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")?;
    let watch = Arc::new(Watch::new(args.samples, args.max_seconds));
    let work = {
        let watch = Arc::clone(&watch);
        tokio::task::spawn_blocking(move || pool.install(|| bake_file(&args, &watch)))
    };
    let signal = Arc::clone(&watch);
    let listener = tokio::spawn(async move {
        if tokio::signal::ctrl_c().await.is_ok() {
            signal.canceled.store(true, Ordering::Relaxed);
            // Loading and writing do not ask whether to go on.
            exit::at_next_interrupt().await;
        }
    });
    let result = work.await.context("the bake broke down")?;
    listener.abort();
    result
}

fn bake_file(args: &BakeArgs, watch: &Watch) -> anyhow::Result<()> {
    let start = Instant::now();
    let scene = load_scene(&args.file, &args.sky, args.max_albedo)?;
    let loaded = scene.warnings.len();
    // Opened now: a place that cannot be written is better known before the bake than after it.
    let out = args.output.as_deref().map(Replacement::begin).transpose()?;
    if let Some(directory) = &args.atlas {
        std::fs::create_dir_all(directory).with_context(|| format!("cannot make {}", directory.display()))?;
    }
    let spinner = ui::spinner("elements");
    let stated = args.mode.stated();
    let spacing = args.spacing.map(|spacing| spacing as f32);
    let texels_per_metre = args.texels_per_metre.map(|density| density as f32);
    let atlas = args.atlas.is_some().then(|| AtlasOptions { texels_per_metre, ..AtlasOptions::default() });
    let options = WorldOptions {
        spacing,
        elements: args.elements.map(NonZeroUsize::get),
        spread: args.sizing.spread(spacing.is_some()),
        stated,
        atlas,
        max_albedo: args.max_albedo.unwrap_or(DEFAULT_MAX_ALBEDO),
        ..WorldOptions::default()
    };
    let world = World::new(scene, &options);
    spinner.finish_and_clear();
    let world = world?;
    world.scene.warnings[loaded..].iter().for_each(|warning| ui::note(&format!("warning: {warning}")));
    let ready = Instant::now();

    watch.begin();
    let budget = Budget { samples_per_element: args.samples, target_rmse: args.target_rmse.map(|rmse| rmse as f32) };
    let baked = rebake_core::bake(&world, &budget, args.seed, watch);
    let seen = watch.finish();
    let interrupted = baked.is_err();
    let map = match baked.ok().or(seen.map) {
        Some(map) => map,
        None => return Err(Interrupted(" before there was a light map; nothing is written").into()),
    };
    // Not of a map that one round has given: its noise is guessed.
    let mut meter = Meter::after_maps(seen.maps.saturating_sub(1));
    // At first few points, which tell what the others cost.
    for _ in 0..2 {
        meter.measure(&world, &map, seen.rays, args.seed, &Unobserved)?;
    }
    let done = Instant::now();

    let values = |default: Filter| -> anyhow::Result<_> {
        let filtered = args.filter.unwrap_or(default).apply(&world, map.clone(), &Unobserved)?;
        let stated = filtered.estimated_rmse(world.areas());
        Ok((world.delivered(&filtered, args.mode.part()), stated))
    };
    let mut stated = map.estimated_rmse(world.areas());
    let mut written = Vec::new();
    if let Some((mut out, path)) = out.zip(args.output.as_deref()) {
        let (values, error) = values(if is_glb(path) { Filter::Statistical } else { Filter::None })?;
        let file = match is_glb(path) {
            true => lit_glb(args, &world, &values, error),
            false => lightmap_exr(&values).map_err(anyhow::Error::from),
        };
        stated = error;
        out.write(&file.with_context(|| format!("cannot write {}", path.display()))?)?;
        written.push((path, out.finish()?));
    }
    if let Some(directory) = &args.atlas {
        let (values, error) = values(Filter::Statistical)?;
        written.push((directory, write_atlas(&world, &values, directory)?));
        stated = error;
    }

    let (scene_time, bake_time) = (ready - start, done - ready);
    let line = |name: &str, text: String| ui::out(&format!("{name:<13} {text}"));
    line("elements", format!("{}, spacing {:.3} m", ui::count(world.element_count() as u64), world.spacing()))?;
    line("samples", format!("{} per element", seen.samples))?;
    line("rays", ui::short(seen.rays as f64))?;
    let times = (scene_time.as_secs_f64(), bake_time.as_secs_f64());
    line("time", format!("{} scene, {} bake", ui::seconds(times.0), ui::seconds(times.1)))?;
    let resolution = meter.error().and_then(|error| error.all.rmse());
    let resolution = resolution.map_or_else(|| "not known".to_owned(), |rmse| ui::rmse(f64::from(rmse)));
    line("stated error", format!("noise {}, resolution {resolution}", ui::rmse(f64::from(stated))))?;
    for (path, bytes) in written {
        line("written", format!("{}, {}", path.display(), ui::bytes(bytes)))?;
    }
    if interrupted { Err(Interrupted("; what there was by then is written").into()) } else { Ok(()) }
}

/// The scene of the file with its light map.
fn lit_glb(args: &BakeArgs, world: &World, values: &[glam::Vec3], error: f32) -> anyhow::Result<Vec<u8>> {
    let scene = Some(open_original(&args.file, &LoadLimits::default())?);
    let originals = Originals { scene, ..Originals::default() };
    let about = LightAbout { version: None, estimated_rmse: Some(error) };
    let layout = LightLayout::Vertices(values);
    Ok(write_lit_glb(&LitExport { world, originals: &originals, layout, unlit: args.unlit, about })?)
}

/// Writes the pages of a world's atlas and where objects lie on them; answers how many bytes that is.
fn write_atlas(world: &World, values: &[glam::Vec3], directory: &Path) -> anyhow::Result<u64> {
    let atlas = world.atlas().context("the scene has no atlas")?;
    let mut total = 0;
    let mut write = |name: String, bytes: Vec<u8>| {
        let mut out = Replacement::begin(&directory.join(name))?;
        out.write(&bytes)?;
        total += out.finish()?;
        anyhow::Ok(())
    };
    for page in 0..atlas.pages().len() {
        let texels = read_page(world, atlas, page, values, &Unobserved)?;
        write(format!("page-{page}.exr"), write_page_exr(&texels, Precision::Half, &[])?)?;
    }
    let document = AtlasDocument::new(world, atlas, 0);
    write("atlas.json".to_owned(), serde_json::to_vec_pretty(&document)?)?;
    Ok(total)
}

/// Loads a file, says what it asked for and does not get, and adds light from outside.
pub(super) fn load_scene(file: &Path, sky: &SkyArgs, max_albedo: Option<f32>) -> anyhow::Result<Scene> {
    let cannot = || format!("cannot load {}", file.display());
    let default = LoadLimits::default();
    let limits = LoadLimits { max_albedo: max_albedo.unwrap_or(default.max_albedo), ..default };
    let mut scene = load_path(file, &limits).with_context(cannot)?;
    sky.add_to(&mut scene)?;
    scene.warnings.iter().for_each(|warning| ui::note(&format!("warning: {warning}")));
    Ok(scene)
}

/// Watches a bake: shows it, keeps the last snapshot, and ends it in time.
struct Watch {
    canceled: AtomicBool,
    samples: u32,
    max_time: Option<Duration>,
    bar: ProgressBar,
    seen: Mutex<Seen>,
}

/// What a bake has told so far.
#[derive(Default)]
struct Seen {
    start: Option<Instant>,
    map: Option<Arc<LightMap>>,
    samples: u32,
    rays: u64,
    /// Maps that stated their error.
    maps: u64,
}

impl Watch {
    fn new(samples: u32, max_seconds: Option<f64>) -> Watch {
        let max_time = max_seconds.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::MAX));
        Watch {
            canceled: AtomicBool::new(false),
            samples,
            max_time,
            bar: ProgressBar::hidden(),
            seen: Mutex::default(),
        }
        .with_bar()
    }

    fn with_bar(mut self) -> Watch {
        self.bar = ui::bar("bake");
        self.bar.disable_steady_tick();
        self
    }

    fn seen(&self) -> std::sync::MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn begin(&self) {
        self.seen().start = Some(Instant::now());
        self.bar.reset_elapsed();
        self.bar.enable_steady_tick(Duration::from_millis(100));
    }

    fn finish(&self) -> Seen {
        self.bar.finish_and_clear();
        std::mem::take(&mut *self.seen())
    }

    fn elapsed(&self) -> Duration {
        self.seen().start.map_or(Duration::ZERO, |start| start.elapsed())
    }
}

/// How many of the proposed samples fit into the time that is left, going by the time that the others took.
fn affordable(elapsed: Duration, max: Duration, samples_so_far: u32, proposed: u32) -> u32 {
    let left = max.saturating_sub(elapsed).as_secs_f64();
    if samples_so_far == 0 {
        return if left > 0.0 { proposed } else { 0 };
    }
    let per_sample = elapsed.as_secs_f64() / f64::from(samples_so_far);
    let fits = if per_sample > 0.0 { left / per_sample } else { f64::from(u32::MAX) };
    // `as` saturates.
    proposed.min(fits as u32)
}

impl Observer for Watch {
    fn canceled(&self) -> bool {
        self.canceled.load(Ordering::Relaxed)
    }

    fn progress(&self, progress: &Progress) {
        let done = f64::from(progress.samples_per_element);
        let running = f64::from(progress.round_samples) * f64::from(progress.round_fraction);
        let by_samples = (done + running) / f64::from(self.samples);
        let by_time = self.max_time.map_or(0.0, |max| self.elapsed().as_secs_f64() / max.as_secs_f64());
        self.bar.set_position((by_samples.max(by_time).clamp(0.0, 1.0) * 1000.0) as u64);
        let rmse = progress.estimated_rmse.map(|rmse| format!(", error {}", ui::rmse(f64::from(rmse))));
        let pass = progress.pass.as_str().replace('_', " ");
        self.bar.set_message(format!("{pass}{}", rmse.unwrap_or_default()));
        self.seen().rays = progress.rays;
    }

    fn plan_round(&self, so_far: &Progress, proposed: u32) -> u32 {
        match self.max_time {
            Some(max) => affordable(self.elapsed(), max, so_far.samples_per_element, proposed),
            None => proposed,
        }
    }

    fn snapshot(&self, map: &Arc<LightMap>, snapshot: Snapshot, progress: &Progress) {
        let mut seen = self.seen();
        seen.maps += u64::from(matches!(snapshot, Snapshot::Complete { stated: Some(_) }));
        seen.map = Some(Arc::clone(map));
        seen.samples = progress.samples_per_element;
        seen.rays = progress.rays;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_are_cut_to_the_time_left() {
        let s = Duration::from_secs;
        assert_eq!(affordable(s(0), s(10), 0, 16), 16, "the first round always runs");
        assert_eq!(affordable(s(10), s(10), 0, 16), 0, "unless there is no time at all");
        assert_eq!(affordable(s(2), s(10), 16, 16), 16);
        assert_eq!(affordable(s(8), s(10), 64, 64), 16);
        assert_eq!(affordable(s(12), s(10), 64, 64), 0);
        assert_eq!(affordable(s(1), Duration::MAX, 1, u32::MAX), u32::MAX);
    }
}
