//! `rebake list`, `info`, `jobs`: what a service holds and does.

use serde_json::Value;

use super::super::ui::{self, Table};
use super::{ServerArgs, interruptible};

/// Arguments of `rebake list`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct ListArgs {
    #[command(flatten)]
    server: ServerArgs,
    /// Print what the API answers
    #[arg(long)]
    json: bool,
}

/// Arguments of `rebake info`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct InfoArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    /// Print what the API answers
    #[arg(long)]
    json: bool,
}

/// Arguments of `rebake jobs`.
#[derive(Debug, clap::Args)]
pub(in super::super) struct JobsArgs {
    /// Id of a scene: its jobs only
    scene: Option<String>,
    #[command(flatten)]
    server: ServerArgs,
    /// Jobs in this state only
    #[arg(long, value_parser = ["queued", "running", "paused", "succeeded", "failed", "canceled"])]
    state: Option<String>,
    /// Print what the API answers
    #[arg(long)]
    json: bool,
}

/// Lists the scenes, newest first.
pub(in super::super) async fn list(args: ListArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let scenes = interruptible(async { Ok(client.scenes().await?) }, "").await?;
    let row = |scene: &Value| {
        let elements = scene["elements"].as_u64().map_or_else(none, ui::count);
        [text(&scene["id"]), text(&scene["version"]), elements, text(&scene["current_job"]), text(&scene["name"])]
    };
    print(&scenes, ["scene", "version", "elements", "job", "name"], row, args.json)
}

/// Lists the jobs, newest first.
pub(in super::super) async fn jobs(args: JobsArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let jobs = async { Ok(client.jobs(args.scene.as_deref(), args.state.as_deref()).await?) };
    let jobs = interruptible(jobs, "").await?;
    let row = |job: &Value| {
        let progress = &job["progress"];
        let done = progress["fraction"].as_f64().map_or_else(none, |fraction| format!("{:.0} %", fraction * 100.0));
        let rmse = progress["estimated_rmse"].as_f64().map_or_else(none, ui::rmse);
        [text(&job["id"]), text(&job["state"]), done, rmse, text(&job["kind"]), text(&job["scene"])]
    };
    print(&jobs, ["job", "state", "done", "stated error", "kind", "scene"], row, args.json)
}

/// Tells what is in a scene.
pub(in super::super) async fn info(args: InfoArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let scene = interruptible(async { Ok(client.scene_json(&args.scene).await?) }, "").await?;
    if args.json {
        return ui::out(&serde_json::to_string_pretty(&scene)?);
    }
    for (name, value) in facts(&scene) {
        ui::out(&format!("{name:<12} {value}"))?;
    }
    let objects = list_of(&scene["objects"]);
    let object = |object: &Value| {
        let elements = object["elements"]["count"].as_u64().map_or_else(none, ui::count);
        let hidden = if object["hidden"] == true { "hidden" } else { "" };
        let [noise, resolution] =
            ["noise", "resolution"].map(|kind| object["light_error"][kind].as_f64().map_or_else(none, ui::rmse));
        [text(&object["name"]), elements, noise, resolution, rgb(&object["albedo"]), hidden.to_owned()]
    };
    section(objects, ["object", "elements", "noise", "resolution", "albedo", ""], object)?;
    let light = |light: &Value| {
        let intensity = light["intensity"].as_f64().map_or_else(none, ui::number);
        [text(&light["name"]), text(&light["kind"]), rgb(&light["color"]), intensity]
    };
    section(list_of(&scene["lights"]), ["light", "kind", "colour", "intensity"], light)?;
    for warning in list_of(&scene["warnings"]) {
        ui::note(&format!("warning: {}", text(warning)));
    }
    Ok(())
}

/// One line each, of what there is to say.
fn facts(scene: &Value) -> Vec<(&'static str, String)> {
    let count = |name: &str| scene[name].as_u64().map_or_else(none, ui::count);
    let stated = |kind: &str| scene["light_error"][kind].as_f64().map_or_else(none, ui::rmse);
    let mut facts = vec![
        ("scene", text(&scene["id"])),
        ("name", text(&scene["name"])),
        ("light map", format!("version {}, {} light", text(&scene["version"]), text(&scene["mode"]))),
        ("stated error", format!("noise {}, resolution {}", stated("noise"), stated("resolution"))),
        ("elements", count("elements")),
        ("triangles", count("triangles")),
        ("spacing", scene["spacing"].as_f64().map_or_else(none, |metres| format!("{} m", ui::number(metres)))),
        ("memory", scene["memory_bytes"].as_u64().map_or_else(none, ui::bytes)),
        ("edits", format!("{} accepted, {} not lit yet", count("accepted_edits"), count("unlit_edits"))),
        ("target", target(&scene["target"])),
        ("job", text(&scene["current_job"])),
    ];
    if let Some(error) = scene["error"].as_str() {
        facts.push(("error", error.to_owned()));
    }
    facts
}

fn target(target: &Value) -> String {
    let parts = [
        target["samples_per_element"].as_u64().map(|samples| format!("{} samples per element", ui::count(samples))),
        target["target_rmse"].as_f64().map(|rmse| format!("error {}", ui::rmse(rmse))),
        target["max_seconds"].as_f64().map(ui::seconds),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    if parts.is_empty() { none() } else { parts.join(", ") }
}

/// A table under an empty line; nothing where there are no rows.
fn section<const N: usize>(
    items: &[Value],
    headings: [&str; N],
    row: impl Fn(&Value) -> [String; N],
) -> anyhow::Result<()> {
    if items.is_empty() {
        return Ok(());
    }
    ui::out("")?;
    print(items, headings, row, false)
}

/// A list as a table, or as JSON.
pub(super) fn print<const N: usize>(
    items: &[Value],
    headings: [&str; N],
    row: impl Fn(&Value) -> [String; N],
    json: bool,
) -> anyhow::Result<()> {
    if json {
        return ui::out(&serde_json::to_string_pretty(items)?);
    }
    let rows: Vec<[String; N]> = items.iter().map(row).collect();
    let widest = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..N).map(widest).collect();
    let table = Table::new(&headings, &widths);
    ui::out(&ui::bold(&table.row(&headings)))?;
    rows.iter().try_for_each(|row| ui::out(&table.row(row)))
}

fn list_of(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// A word or a number of an answer, without what would garble a terminal.
pub(super) fn text(value: &Value) -> String {
    match value {
        Value::Null => none(),
        Value::String(text) => text.chars().map(|c| if c.is_control() { '�' } else { c }).collect(),
        other => other.to_string(),
    }
}

fn rgb(value: &Value) -> String {
    let channels = list_of(value).iter().filter_map(Value::as_f64).map(ui::number);
    channels.collect::<Vec<String>>().join(",")
}

fn none() -> String {
    "–".to_owned()
}
