//! `rebake render`: a picture of a scene of a service, or of a file, which is baked first.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use clap::ValueEnum;
use glam::DVec3;
use rebake::Filter;
use rebake::client::Parts;
use rebake::pictures::{DEFAULT_SAMPLES, PictureSpec, draw};
use rebake_core::render::{RenderOptions, Viewpoint};
use rebake_core::scene::DEFAULT_MAX_ALBEDO;
use rebake_core::{Budget, Unobserved, World, WorldOptions};
use serde::de::DeserializeOwned;

use super::bake::load_scene;
use super::remote::{Replacement, ServerArgs, interruptible};
use super::sky::SkyArgs;
use super::ui;
use super::values::{Point, field_of_view, is_scene_file, max_albedo, positive};

const AFTER_HELP: &str = "\
What ends in .glb, .gltf or .zip is a file: it is baked here, without a service. Anything else is the id of a scene of the service. \
The ending of the picture chooses the format: .png is tone-mapped, .exr holds linear values as computed.
  rebake render $ID -o now.png --size 1280x720 --spp 64
  rebake render $ID -o large.png --size 1920x1080 --spp 64 --progressive
  rebake render $ID -o change.png --view change
  rebake render room.glb -o room.png --camera 0 --exposure 1.5";

/// Arguments of `rebake render`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(super) struct RenderArgs {
    /// Scene: an id, or a file: .glb, .gltf with its files beside it, or both in a .zip
    #[arg(value_name = "SCENE")]
    scene: String,
    /// Picture to write
    #[arg(short, long, value_name = "OUT.{png,exr}", value_parser = picture_file)]
    output: PathBuf,
    #[command(flatten)]
    look: Look,
    #[command(flatten)]
    server: ServerArgs,
    /// Write the picture at once with one sample per pixel, and again with 4, 16 and so on up to --spp
    #[arg(long)]
    progressive: bool,
    /// A version to show the change against (view "change") [default: before the last edit]
    #[arg(long, value_name = "VERSION")]
    since: Option<u64>,
    /// Files: samples per element of the bake
    #[arg(long, value_name = "N", default_value_t = 128, value_parser = clap::value_parser!(u32).range(1..))]
    samples: u32,
    /// Files: largest distance between neighbouring elements, metres [default: from the scene's size]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    spacing: Option<f64>,
    /// Files: largest albedo that light meets, below 1 [default: 0.95]
    #[arg(long, value_name = "ALBEDO", value_parser = max_albedo)]
    max_albedo: Option<f32>,
    #[command(flatten)]
    sky: SkyArgs,
    /// Files: threads [default: one per core]
    #[arg(long, value_name = "N", env = "REBAKE_THREADS")]
    threads: Option<NonZeroUsize>,
}

/// Camera, size and look.
#[derive(Debug, clap::Args)]
struct Look {
    /// What to show
    #[arg(long, default_value = "full", value_parser = ["full", "direct", "indirect", "lightmap", "elements", "change", "error"])]
    view: String,
    /// Index or name of a camera of the file [default: the first]
    #[arg(long, conflicts_with_all = ["eye", "target"])]
    camera: Option<String>,
    /// Where the camera stands
    #[arg(long, value_name = "X,Y,Z", requires = "target", allow_hyphen_values = true)]
    eye: Option<Point>,
    /// What it looks at
    #[arg(long, value_name = "X,Y,Z", requires = "eye", allow_hyphen_values = true)]
    target: Option<Point>,
    /// Upward [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", requires = "eye", allow_hyphen_values = true)]
    up: Option<Point>,
    /// Vertical field of view [default: 60]
    #[arg(long, value_name = "DEGREES", requires = "eye", value_parser = field_of_view)]
    fov_y: Option<f32>,
    /// Pixels across and down
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = size)]
    size: (u32, u32),
    /// Samples per pixel
    #[arg(long, value_name = "N", default_value_t = DEFAULT_SAMPLES,
        value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
    /// Seed of the random numbers
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Stops by which a PNG is brightened [default: by its mean]
    #[arg(long, value_name = "STOPS", allow_hyphen_values = true)]
    exposure: Option<f32>,
    /// Tone map of a PNG
    #[arg(long, default_value = "agx", value_parser = ["agx", "neutral", "linear"])]
    tone: String,
    /// What the ends of the colour scale stand for (views "change" and "error") [default: by the picture]
    #[arg(long, value_name = "VALUE", value_parser = positive)]
    scale: Option<f64>,
    /// Whether the noise of the light map is averaged away where it may be [default: statistical, but for view "change"]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
}

/// The API's format for a picture's ending.
pub(super) fn format_of(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "png" => Some("png"),
        "exr" => Some("exr"),
        _ => None,
    }
}

fn picture_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    format_of(&path).map(|_| path).ok_or_else(|| "the file has to end in .png or .exr".to_owned())
}

/// `WIDTHxHEIGHT`.
pub(super) fn size(text: &str) -> Result<(u32, u32), String> {
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((width @ 1..=rebake::pictures::MAX_SIDE, height @ 1..=rebake::pictures::MAX_SIDE)) => Ok((width, height)),
        Some(_) => Err(format!("each side has to be 1 to {}", rebake::pictures::MAX_SIDE)),
        None => Err("expected WIDTHxHEIGHT, e.g. 640x360".to_owned()),
    }
}

/// Draws a picture.
pub(super) async fn render(args: RenderArgs) -> anyhow::Result<()> {
    if is_scene_file(Path::new(&args.scene)) {
        interruptible(render_file(args), "").await
    } else {
        interruptible(render_remote(&args), "").await
    }
}

async fn render_remote(args: &RenderArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let start = Instant::now();
    let spinner = ui::spinner("render");
    if args.progressive {
        return render_parts(args, client.render_progressively(&args.scene, &args.query()?).await?).await;
    }
    let response = client.render(&args.scene, &args.query()?).await?;
    let header = |name: &str| response.headers().get(name).and_then(|v| v.to_str().ok()).map(str::to_owned);
    let version = header("x-rebake-version").unwrap_or_default();
    let facts = [("exposure", header("x-rebake-exposure")), ("scale ±", header("x-rebake-scale"))];
    let bytes = rebake::client::read_body(response, usize::MAX).await?;
    spinner.finish_and_clear();
    write(&args.output, &bytes)?;
    let round = |v: String| v.parse().map_or(v, ui::number);
    let facts: String = facts.into_iter().filter_map(|(name, v)| Some(format!(", {name} {}", round(v?)))).collect();
    let time = ui::seconds(start.elapsed().as_secs_f64());
    ui::note(&format!("{}: version {version}{facts}, {time}", args.output.display()));
    Ok(())
}

/// Every part takes the place of the one before it as a whole: whoever looks at the file sees a picture.
async fn render_parts(args: &RenderArgs, mut parts: Parts) -> anyhow::Result<()> {
    let start = Instant::now();
    while let Some(part) = parts.next().await? {
        write(&args.output, &part.bytes)?;
        note_pass(&args.output, part.header("x-rebake-samples").unwrap_or("?"), start);
    }
    Ok(())
}

fn note_pass(output: &Path, samples: &str, start: Instant) {
    let time = ui::seconds(start.elapsed().as_secs_f64());
    ui::note(&format!("{}: {samples} samples per pixel, {time}", output.display()));
}

impl RenderArgs {
    /// The query of the API's render call.
    fn query(&self) -> anyhow::Result<Vec<(&'static str, String)>> {
        let look = &self.look;
        let point = |p: &Point| p.0.map(|x| x.to_string()).join(",");
        let format = format_of(&self.output).context("the file has to end in .png or .exr")?;
        let mut query = vec![
            ("view", look.view.clone()),
            ("format", format.to_owned()),
            ("width", look.size.0.to_string()),
            ("height", look.size.1.to_string()),
            ("spp", look.spp.to_string()),
            ("seed", look.seed.to_string()),
            ("tone", look.tone.clone()),
        ];
        let optional = [
            ("camera", look.camera.clone()),
            ("eye", look.eye.as_ref().map(point)),
            ("target", look.target.as_ref().map(point)),
            ("up", look.up.as_ref().map(point)),
            ("fov_y", look.fov_y.map(|degrees| degrees.to_radians().to_string())),
            ("exposure", look.exposure.map(|x| x.to_string())),
            ("scale", look.scale.map(|x| x.to_string())),
            ("since", self.since.map(|x| x.to_string())),
            ("filter", look.filter.and_then(|filter| Some(filter.to_possible_value()?.get_name().to_owned()))),
        ];
        query.extend(optional.into_iter().filter_map(|(name, value)| Some((name, value?))));
        Ok(query)
    }
}

async fn render_file(args: RenderArgs) -> anyhow::Result<()> {
    anyhow::ensure!(args.look.view != "change", "--view change: a file has no earlier version; ask a service");
    anyhow::ensure!(args.since.is_none(), "--since: a file has no earlier version; ask a service");
    let threads = args.threads.map_or(0, NonZeroUsize::get);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().context("cannot start the threads")?;
    let work = move || pool.install(|| bake_and_draw(&args));
    tokio::task::spawn_blocking(work).await.context("the rendering broke down")?
}

fn bake_and_draw(args: &RenderArgs) -> anyhow::Result<()> {
    let scene = load_scene(Path::new(&args.scene), &args.sky, args.max_albedo)?;
    let options = WorldOptions {
        spacing: args.spacing.map(|spacing| spacing as f32),
        max_albedo: args.max_albedo.unwrap_or(DEFAULT_MAX_ALBEDO),
        ..WorldOptions::default()
    };
    let start = Instant::now();
    let spinner = ui::spinner("bake");
    let world = World::new(scene, &options)?;
    let spec = args.look.spec(&world, &args.output)?;
    let budget = Budget { samples_per_element: args.samples, target_rmse: None };
    let map = rebake_core::bake(&world, &budget, 1, &Unobserved)?;
    let map = args.look.filter.unwrap_or(Filter::Statistical).apply(&world, map, &Unobserved)?;
    spinner.finish_and_clear();
    let baked = Instant::now();
    let spinner = ui::spinner("render");
    if let (true, [early @ .., _]) = (args.progressive, &spec.passes()[..]) {
        for pass in early {
            write(&args.output, &draw((&world, &map), None, pass, &Unobserved)?.bytes)?;
            note_pass(&args.output, &pass.options.samples.to_string(), baked);
        }
    }
    let drawn = draw((&world, &map), None, &spec, &Unobserved)?;
    spinner.finish_and_clear();
    let times = ((baked - start).as_secs_f64(), baked.elapsed().as_secs_f64());
    write(&args.output, &drawn.bytes)?;
    let facts = [("exposure", drawn.exposure), ("scale ±", drawn.scale)];
    let round = |v: f32| ui::number(f64::from(v));
    let facts: String = facts.into_iter().filter_map(|(name, v)| Some(format!(", {name} {}", round(v?)))).collect();
    let (bake, picture) = (ui::seconds(times.0), ui::seconds(times.1));
    ui::note(&format!("{}: bake {bake}, picture {picture}{facts}", args.output.display()));
    Ok(())
}

impl Look {
    fn spec(&self, world: &World, output: &Path) -> anyhow::Result<PictureSpec> {
        let format = format_of(output).context("the file has to end in .png or .exr")?;
        Ok(PictureSpec {
            view: word(&self.view)?,
            viewpoint: self.viewpoint(world)?,
            options: RenderOptions {
                width: self.size.0 as usize,
                height: self.size.1 as usize,
                samples: self.spp,
                seed: self.seed,
            },
            format: word(format)?,
            exposure: self.exposure,
            tone: word(&self.tone)?,
            scale: self.scale.map(|scale| scale as f32),
        })
    }

    fn viewpoint(&self, world: &World) -> anyhow::Result<Viewpoint> {
        let point = |p: &Point| DVec3::from_array(p.0);
        if let (Some(eye), Some(target)) = (&self.eye, &self.target) {
            let up = self.up.as_ref().map_or(DVec3::Y, point);
            let fov_y = self.fov_y.map_or(std::f32::consts::FRAC_PI_3, f32::to_radians);
            return Viewpoint::new(point(eye), point(target), up, fov_y).map_err(|e| anyhow::anyhow!("--{e}"));
        }
        let cameras = &world.scene.cameras;
        let Some(name) = &self.camera else {
            return Ok(cameras.first().map_or_else(|| Viewpoint::overview(world), Viewpoint::of_camera));
        };
        let by_index = || name.parse::<usize>().ok().and_then(|index| cameras.get(index));
        let camera = cameras.iter().find(|camera| camera.name == *name).or_else(by_index);
        let camera = camera.with_context(|| format!("--camera: none of the {} cameras is {name:?}", cameras.len()))?;
        Ok(Viewpoint::of_camera(camera))
    }
}

/// One of the API's words.
fn word<T: DeserializeOwned>(text: &str) -> anyhow::Result<T> {
    Ok(serde_json::from_value(serde_json::Value::String(text.to_owned()))?)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut out = Replacement::begin(path)?;
    out.write(bytes)?;
    out.finish().map(drop)
}
