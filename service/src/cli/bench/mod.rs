//! `rebake bench`: speed against error of all methods, side by side.

mod service;
mod session;
mod study;
mod table;

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::Context;
use indicatif::ProgressBar;
use rebake::Mode;
use rebake_core::render::RenderOptions;
use rebake_core::scene::{LoadLimits, Scene, load_path};
use rebake_lab::bench::{
    self, EditFile, Equation, Goal, Method, Options, PictureOptions, Report, StudyReport, Subject, Watcher,
};
use rebake_lab::sheet::Crop;

use super::demo;
use super::exit::Interrupted;
use super::remote::Replacement;
use super::ui;
use super::values::positive;
use service::Loopback;

const AFTER_HELP: &str = "\
EDITS.json: {\"scene\": \"room.glb\", \"cases\": [{\"name\": \"+ sofa\", \"edit\": \"insert\", \"objects\": [\"Sofa_*\"]}, …]}. \
edit is insert, remove, move or material; objects may hold * and are one edit; insert takes them out of the scene \
first, or puts \"asset\": \"chair.glb\" in at \"transform\" (16 numbers, column-major); material has \"albedo\". Paths \
are relative to the file.

Every method starts from the same scene, elements and trees; updates start from one bake of the scene before the edit. \
Errors are RMSE of radiance / albedo, weighted by area, against path tracing of the scene after the edit; the \
reference's own noise is taken out. The bias floor is what independent runs of a method have in common. Beside the \
report a plot of the same name is written, ending in .svg.

--measure focus and --measure drag ask a service over loopback instead, as a client: the first tells when what \
--focus looks at has a given error, with a focus and without; the second the error while the objects of a move are \
taken to its transform and back, ten moves per second, beside a client that bakes the scene at every move.
  rebake bench -o report.json
  rebake bench room.glb room.edits.json -o report.json
  rebake bench room.glb room.edits.json --methods service --samples 32 -o service.json
  rebake bench room.glb room.edits.json --cases sofa --mode indirect --budget-seconds 0.5,2,8 -o report.json
  rebake bench room.glb room.edits.json --samples 4,16,64,256 -o sweep.json
  rebake bench room.glb room.edits.json --methods paper --iterations 1,2,4,8 --samples 256 -o over-n.json
  rebake bench room.glb room.edits.json --methods paper --path-length 0,1,2,3,4,5 --samples 256 -o over-m.json
  rebake bench --measure focus -o focus.json
  rebake bench room.glb room.edits.json --measure focus --focus '{\"point\":[1,1,1],\"radius\":1}' -o focus.json
  rebake bench --measure drag -o drag.json
  rebake bench room.glb room.edits.json --mode indirect --budget-seconds 2 --seeds 1 --pictures figures -o report.json";

/// Arguments of `rebake bench`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct BenchArgs {
    /// Scene: a binary glTF file [default: the room of `rebake demo`]
    #[arg(value_name = "SCENE.glb", requires = "edits")]
    scene: Option<PathBuf>,
    /// Edit cases
    #[arg(value_name = "EDITS.json")]
    edits: Option<PathBuf>,
    /// Report to write
    #[arg(short, long, value_name = "REPORT.json", value_parser = json_file)]
    output: PathBuf,
    /// What to measure
    #[arg(long, value_enum, default_value_t = What::Edits)]
    measure: What,
    /// For --measure focus: what somebody looks at, as the API takes it [default: the scene's first camera]
    #[arg(long, value_name = "JSON", value_parser = focus_json)]
    focus: Option<serde_json::Value>,
    /// For --measure focus: in which steps, as the API takes it, such as {"mode":"incremental","size":256} [default:
    /// all that is looked at together]
    #[arg(long, value_name = "JSON", value_parser = tiles_json)]
    tiles: Option<serde_json::Value>,
    /// For --measure drag: how many moves
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u32).range(2..))]
    moves: u32,
    /// Seconds that each run has
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "0.5,2,8", value_parser = positive)]
    budget_seconds: Vec<f64>,
    /// Samples per element of each run, instead of seconds; of each edit for --measure focus [default there: 64]
    #[arg(long, value_name = "LIST", value_delimiter = ',', conflicts_with = "budget_seconds",
          value_parser = clap::value_parser!(u32).range(1..))]
    samples: Vec<u32>,
    /// What to run
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        value_enum,
        default_value = "path-trace,cached,paper,rebake"
    )]
    methods: Vec<MethodName>,
    /// For paper, N: applications of the object operator; several are run one after the other
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "4")]
    iterations: Vec<u32>,
    /// For paper, M: longest path in the scene without the object between two of them
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "3")]
    path_length: Vec<u32>,
    /// For paper: equation 3 (all light in one map) or 4 (indirect light, lights sampled)
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(3..=4))]
    paper_equation: u32,
    /// Largest distance between neighbouring elements, metres [default: from the scene's size]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    spacing: Option<f64>,
    /// What errors are measured on: all light, or only what has bounced
    #[arg(long, value_enum, default_value_t = Mode::Full)]
    mode: Mode,
    /// Run only cases whose name has this in it
    #[arg(long, value_name = "PART", allow_hyphen_values = true)]
    cases: Option<String>,
    /// Paths per element of the reference
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(2..))]
    reference_samples: u32,
    /// Elements of the reference, drawn by area
    #[arg(long, value_name = "N", default_value_t = 4096, value_parser = clap::value_parser!(u32).range(16..))]
    reference_elements: u32,
    /// Samples per element of the light map before the edit
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    base_samples: u32,
    /// Measure the light map before the edit, too: its error is in all updates
    #[arg(long)]
    measure_base: bool,
    /// Measure the change that updates make alone, too: their error if the light map before the edit were exact
    #[arg(long)]
    measure_change: bool,
    /// Independent runs per method and budget; figures are medians
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    seeds: u32,
    /// First seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Threads [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
    #[command(flatten)]
    pictures: PictureArgs,
}

/// What is drawn of every case.
#[derive(Debug, clap::Args)]
struct PictureArgs {
    /// Folder for pictures of the runs of the first budget: before, every method, reference, FLIP, change, and a sheet
    /// of them all per case
    #[arg(long, value_name = "DIR")]
    pictures: Option<PathBuf>,
    /// Pictures: index or name of a camera of the scene [default: the first]
    #[arg(long, requires = "pictures")]
    camera: Option<String>,
    /// Pictures: pixels across and down
    #[arg(long, value_name = "WxH", default_value = "480x360", value_parser = super::render::size,
        requires = "pictures")]
    picture_size: (u32, u32),
    /// Pictures: samples per pixel
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..),
          requires = "pictures")]
    picture_spp: u32,
    /// Pictures: a part to magnify, pixels; may be repeated [default: where the light changes most]
    #[arg(long, value_name = "X,Y,WIDTH,HEIGHT", value_parser = super::compare::crop, requires = "pictures")]
    crop: Vec<Crop>,
}

impl PictureArgs {
    fn options(&self) -> Option<PictureOptions> {
        let (width, height) = (self.picture_size.0 as usize, self.picture_size.1 as usize);
        self.pictures.as_ref().map(|folder| PictureOptions {
            folder: folder.clone(),
            camera: self.camera.clone(),
            render: RenderOptions { width, height, samples: self.picture_spp, seed: 0 },
            crops: self.crop.clone(),
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum What {
    /// Speed against error of each method
    Edits,
    /// Time to a given error in what somebody looks at
    Focus,
    /// Error while objects are dragged, and afterwards
    Drag,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MethodName {
    /// From scratch, path by path
    PathTrace,
    /// From scratch, by look-ups
    Cached,
    /// Update of the old light map by Lu et al. 2025, as published
    Paper,
    /// Update of the old light map
    Rebake,
    /// Update of the old light map through the service over loopback: bake of the scene before, POST of the edit,
    /// download
    Service,
}

fn json_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let json = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("json"));
    if json { Ok(path) } else { Err("the file has to end in .json".to_owned()) }
}

/// With a wrong field refused here rather than by the service once its scene is baked.
fn tiles_json(text: &str) -> Result<serde_json::Value, String> {
    serde_json::from_str::<rebake::api::edit_types::Tiles>(text).map_err(|error| error.to_string())?;
    focus_json(text)
}

fn focus_json(text: &str) -> Result<serde_json::Value, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

impl BenchArgs {
    fn options(&self) -> Options {
        Options {
            spacing: self.spacing.map(|s| s as f32),
            mode: self.mode.stated(),
            methods: self.methods(),
            goals: match self.samples[..] {
                [] => self.budget_seconds.iter().map(|s| Goal::Seconds(*s)).collect(),
                _ => self.samples.iter().map(|n| Goal::Samples(*n)).collect(),
            },
            seeds: self.seeds,
            seed: self.seed,
            reference_samples: self.reference_samples,
            reference_elements: self.reference_elements as usize,
            base_samples: self.base_samples,
            measure_base: self.measure_base,
            measure_change: self.measure_change,
            filter: self.cases.clone(),
            pictures: self.pictures.options(),
        }
    }

    /// `paper` once for every N and M that is asked for.
    fn methods(&self) -> Vec<Method> {
        let equation = match self.paper_equation {
            3 => Equation::Full,
            _ => Equation::Indirect,
        };
        let published = self.iterations.iter().flat_map(|&iterations| {
            self.path_length.iter().map(move |&path_length| Method::Paper { iterations, path_length, equation })
        });
        let published: Vec<Method> = published.collect();
        let of = |name: &MethodName| match name {
            MethodName::PathTrace => vec![Method::PathTrace],
            MethodName::Cached => vec![Method::Cached],
            MethodName::Paper => published.clone(),
            MethodName::Rebake => vec![Method::Rebake],
            MethodName::Service => vec![Method::Service],
        };
        self.methods.iter().flat_map(of).collect()
    }
}

/// Runs the bench.
pub(super) async fn bench(args: BenchArgs) -> anyhow::Result<()> {
    let threads = args.threads.map_or(0, NonZeroUsize::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")?;
    let work = tokio::task::spawn_blocking(move || pool.install(|| bench_file(&args)));
    tokio::select! {
        done = work => done.context("the bench broke down")?,
        _ = tokio::signal::ctrl_c() => Err(Interrupted("; the report holds the cases that were done").into()),
    }
}

fn bench_file(args: &BenchArgs) -> anyhow::Result<()> {
    let mut options = args.options();
    let (name, scene, file, folder) = match (&args.scene, &args.edits) {
        (Some(scene), Some(edits)) => {
            let folder = edits.parent().unwrap_or(Path::new("."));
            let name = scene.file_name().map_or_else(|| "scene".into(), |n| n.to_string_lossy());
            (name, load_scene(scene)?, EditFile::read(edits)?, folder)
        }
        _ => {
            let (scene, spacing) = demo::bench_scene();
            options.spacing.get_or_insert(spacing);
            let cases = if args.measure == What::Drag { study::DEMO_DRAG } else { DEMO_CASES };
            ("the demo's room".into(), scene, EditFile::from_json(cases)?, Path::new("."))
        }
    };
    // A place that cannot be written is better known before the bench than after it.
    drop(Replacement::begin(&args.output)?);
    let mut screen = Screen { output: args.output.clone(), spinner: ui::spinner("bench") };
    let subject = Subject { name: &name, scene: &scene, file: &file, folder };
    let done = match study::study(args) {
        None => bench::run(&subject, &options, &Loopback, &mut screen).map(drop),
        Some(study) => bench::run_study(&study, &subject, &options, &Loopback, &mut screen).map(drop),
    };
    screen.spinner.finish_and_clear();
    let source = args.edits.as_ref().map_or_else(|| name.to_string(), |edits| edits.display().to_string());
    done.context(source)
}

/// Edits of the demo's room.
const DEMO_CASES: &str = r#"{"scene": "", "cases": [
    {"name": "+ chair", "edit": "insert", "objects": ["chair"]},
    {"name": "- chair", "edit": "remove", "objects": ["chair"]},
    {"name": "- sofa", "edit": "remove", "objects": ["sofa"]},
    {"name": "+ cupboard", "edit": "insert", "objects": ["cupboard"]},
    {"name": "dark sofa", "edit": "material", "objects": ["sofa"], "albedo": [0.05, 0.05, 0.06]}
]}"#;

fn load_scene(path: &Path) -> anyhow::Result<Scene> {
    let cannot = || format!("cannot load {}", path.display());
    let scene = load_path(path, &LoadLimits::default()).with_context(cannot)?;
    scene.warnings.iter().for_each(|warning| ui::note(&format!("warning: {warning}")));
    Ok(scene)
}

/// Shows what runs, prints and saves what is done.
struct Screen {
    output: PathBuf,
    spinner: ProgressBar,
}

impl Watcher for Screen {
    fn step(&mut self, case: &str, step: &str) {
        self.spinner.set_message(if case.is_empty() { step.to_owned() } else { format!("{case}: {step}") });
    }

    fn case_done(&mut self, report: &Report) -> anyhow::Result<()> {
        if let Some(case) = report.cases.last() {
            let print = || -> anyhow::Result<()> {
                if report.cases.len() == 1 {
                    table::print_head(&report.setup, "medians of ")?;
                }
                table::print_case(case)
            };
            self.spinner.suspend(print)?;
        }
        self.save(report, &bench::svg(report))
    }

    fn study_case_done(&mut self, report: &StudyReport) -> anyhow::Result<()> {
        self.spinner.suspend(|| study::print_last(report))?;
        self.save(report, &bench::study_svg(report))
    }
}

impl Screen {
    fn save(&self, report: &impl serde::Serialize, plot: &str) -> anyhow::Result<()> {
        let mut json = serde_json::to_vec_pretty(report)?;
        json.push(b'\n');
        save(&self.output, &json)?;
        save(&self.output.with_extension("svg"), plot.as_bytes())
    }
}

fn save(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = Replacement::begin(path)?;
    out.write(bytes)?;
    out.finish().map(drop)
}
