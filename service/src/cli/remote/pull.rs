//! `rebake pull`: save a light map.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::super::ui;
use super::{ServerArgs, interruptible};
use clap::ValueEnum;
use rebake::Filter;
use rebake::client::Client;

const AFTER_HELP: &str = "\
The ending of the file chooses the format:
  .glb   the subdivided mesh, the light map as float COLOR_0
  .exr   the values alone, 32-bit float
  .rbkd  the delta format, from version 0
With --atlas the directory gets atlas.json, which says where every object lies, and page-0.exr and so on.
A file is replaced only when the new one is complete.";

/// Times that an atlas is fetched anew since the light map changed meanwhile.
const TRIES: usize = 5;

/// Arguments of `rebake pull`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP)]
pub(in super::super) struct PullArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    /// File to write
    #[arg(
        short,
        long,
        value_name = "OUT.{glb,exr,rbkd}",
        value_parser = output_file,
        required_unless_present = "atlas",
        conflicts_with = "atlas"
    )]
    output: Option<PathBuf>,
    /// Directory for the pages of the scene's atlas, as half-float .exr, and atlas.json
    #[arg(long, value_name = "DIR")]
    atlas: Option<PathBuf>,
    /// One part of the light (`direct`, `indirect`), one layer by its name, or `all` layers in one .exr
    #[arg(long)]
    layer: Option<String>,
    /// Which part of all light or of the layer: full, direct, indirect, or error, the standard error of each element;
    /// or ao, ambient occlusion, or directional, from where light comes
    #[arg(long)]
    part: Option<String>,
    /// Whether noise is averaged away where it may be [default: as the API says: in .glb and atlases, not in .exr and .rbkd]
    #[arg(long, value_enum)]
    filter: Option<Filter>,
}

impl PullArgs {
    /// The query of the API's calls for light.
    fn query(&self) -> Vec<(&'static str, String)> {
        let filter = self.filter.and_then(|filter| Some(filter.to_possible_value()?.get_name().to_owned()));
        let given = [("layer", self.layer.clone()), ("part", self.part.clone()), ("filter", filter)];
        given.into_iter().filter_map(|(name, value)| Some((name, value?))).collect()
    }
}

/// The API's format for a file's ending.
fn format_of(path: &Path) -> Option<&'static str> {
    match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
        "glb" => Some("glb"),
        "exr" => Some("exr"),
        "rbkd" => Some("raw"),
        _ => None,
    }
}

fn output_file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match format_of(&path) {
        Some(_) => Ok(path),
        None => Err("the file has to end in .glb, .exr or .rbkd".to_owned()),
    }
}

/// Saves the light map.
pub(in super::super) async fn pull(args: PullArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    if let Some(directory) = &args.atlas {
        return interruptible(pull_atlas(&client, &args, directory), "").await;
    }
    let output = args.output.as_deref().context("there is no file to write")?;
    let format = format_of(output).context("the file has to end in .glb, .exr or .rbkd")?;
    let work = async {
        let query = [vec![("format", format.to_owned())], args.query()].concat();
        let mut response = client.lightmap(&args.scene, &query).await?;
        let etag = response.headers().get("etag").and_then(|tag| tag.to_str().ok()).unwrap_or("?");
        let version = etag.trim_start_matches("W/").trim_matches('"').to_owned();
        let spinner = ui::spinner("pull");
        let mut out = Replacement::begin(output)?;
        while let Some(chunk) = response.chunk().await.context("the connection was lost")? {
            out.write(&chunk)?;
            spinner.set_message(ui::bytes(out.bytes));
        }
        spinner.finish_and_clear();
        let bytes = out.finish()?;
        ui::note(&format!("{}: version {version}, {}", output.display(), ui::bytes(bytes)));
        Ok(())
    };
    interruptible(work, "").await
}

/// Saves an atlas, all of it of one version.
async fn pull_atlas(client: &Client, args: &PullArgs, directory: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(directory).with_context(|| format!("cannot make {}", directory.display()))?;
    for _ in 0..TRIES {
        let atlas = client.atlas(&args.scene).await?;
        if let Some(bytes) = pull_pages(client, args, directory, &atlas).await? {
            let version = &atlas["version"];
            ui::note(&format!("{}: version {version}, {}", directory.display(), ui::bytes(bytes)));
            return Ok(());
        }
    }
    anyhow::bail!("the light map changes faster than its atlas can be fetched: wait for the job to end")
}

/// Bytes written; none where a page is of another version.
async fn pull_pages(
    client: &Client,
    args: &PullArgs,
    directory: &Path,
    atlas: &serde_json::Value,
) -> anyhow::Result<Option<u64>> {
    let spinner = ui::spinner("pull");
    let (mut files, mut total) = (Vec::new(), 0);
    let query = args.query();
    for page in 0..atlas["pages"].as_array().map_or(0, Vec::len) {
        let mut response = client.atlas_page(&args.scene, page, &query).await?;
        let version = response.headers().get("x-rebake-version").and_then(|version| version.to_str().ok());
        if version != Some(atlas["version"].to_string().as_str()) {
            return Ok(None);
        }
        let mut out = Replacement::begin(&directory.join(format!("page-{page}.exr")))?;
        while let Some(chunk) = response.chunk().await.context("the connection was lost")? {
            out.write(&chunk)?;
            spinner.set_message(ui::bytes(total + out.bytes));
        }
        total += out.bytes;
        files.push(out);
    }
    let mut out = Replacement::begin(&directory.join("atlas.json"))?;
    out.write(&serde_json::to_vec_pretty(atlas)?)?;
    files.push(out);
    spinner.finish_and_clear();
    files.into_iter().try_for_each(|file| file.finish().map(|_| ()))?;
    Ok(Some(total))
}

/// A file that takes the place of another only when it is complete.
pub(in super::super) struct Replacement {
    target: PathBuf,
    part: PathBuf,
    file: File,
    bytes: u64,
    finished: bool,
}

impl Replacement {
    /// Opens the new file beside the one it will replace.
    pub(in super::super) fn begin(target: &Path) -> anyhow::Result<Replacement> {
        let mut part = target.as_os_str().to_owned();
        part.push(".part");
        let part = PathBuf::from(part);
        let file = File::create(&part).with_context(|| format!("cannot write {}", target.display()))?;
        Ok(Replacement { target: target.to_owned(), part, file, bytes: 0, finished: false })
    }

    /// Appends to the new file.
    pub(in super::super) fn write(&mut self, bytes: &[u8]) -> anyhow::Result<()> {
        self.file.write_all(bytes).with_context(|| format!("cannot write {}", self.part.display()))?;
        self.bytes += bytes.len() as u64;
        Ok(())
    }

    /// Puts the new file in place; answers its size.
    pub(in super::super) fn finish(mut self) -> anyhow::Result<u64> {
        std::fs::rename(&self.part, &self.target).with_context(|| format!("cannot write {}", self.target.display()))?;
        self.finished = true;
        Ok(self.bytes)
    }
}

impl Drop for Replacement {
    fn drop(&mut self) {
        if !self.finished {
            // Half a file is of no use to anyone; if it cannot be removed either, there is nothing left to do.
            let _ = std::fs::remove_file(&self.part);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_or_not_at_all() {
        let dir = std::env::temp_dir().join(format!("rebake-pull-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let target = dir.join("map.exr");
        std::fs::write(&target, "old").unwrap();
        let mut half = Replacement::begin(&target).unwrap();
        half.write(b"ne").unwrap();
        drop(half);
        assert_eq!(std::fs::read(&target).unwrap(), b"old");
        let mut whole = Replacement::begin(&target).unwrap();
        whole.write(b"new").unwrap();
        assert_eq!(whole.finish().unwrap(), 3);
        assert_eq!(std::fs::read(&target).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(&dir).unwrap().count(), 1);
        std::fs::remove_dir_all(&dir).unwrap();
    }
}
