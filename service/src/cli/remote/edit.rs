//! `rebake edit`: change a scene.

use std::io::Read;
use std::path::Path;

use anyhow::Context;
use rebake::client::EditOptions;
use serde_json::Value;

use super::super::ui;
use super::super::values::Rgb;
use super::budget::BudgetArgs;
use super::operation::Operation;
use super::{ServerArgs, interruptible, note_done, read_file, read_packed, wait_for_job};

const AFTER_HELP: &str = "\
Prints the id of the job on standard output, all else on standard error.
Options stand before the operation or behind it:
  rebake edit $ID --wait insert chair.glb --at 1.5,0,2 --rotate-y 30
  rebake edit $ID --wait --target-rmse 0.01 remove 'chair*'
  rebake edit $ID relight lamp --intensity 2
Several edits as one, applied together or not at all:
  echo '{\"edits\": [{\"op\": \"remove\", \"objects\": [\"sofa\"]},
    {\"op\": \"material\", \"object\": \"floor\", \"albedo\": [0.5, 0.4, 0.3]}]}' |
    rebake edit $ID --wait --json -";

/// Arguments of `rebake edit`.
#[derive(Debug, clap::Args)]
#[command(after_help = AFTER_HELP, subcommand_negates_reqs = true)]
pub(in super::super) struct EditArgs {
    /// Id of the scene
    scene: String,
    #[command(flatten)]
    server: ServerArgs,
    /// The edit, or {"edits": [...]}, as JSON from a file; `-` reads standard input
    #[arg(long, value_name = "FILE", required = true)]
    json: Option<String>,
    /// Return when the light map is up to date
    #[arg(long, global = true)]
    wait: bool,
    #[command(flatten)]
    budget: BudgetArgs,
    /// Take colours of lights with channels above 1 as they are, without asking
    #[arg(long, global = true)]
    yes: bool,
    /// Refuse unless the scene has accepted exactly so many edits (`accepted_edits`, its ETag)
    #[arg(long, value_name = "EDITS", global = true)]
    if_match: Option<u64>,
    /// A word of your choice that makes it safe to send the same edit twice
    #[arg(long, value_name = "KEY", global = true)]
    idempotency_key: Option<String>,
    #[command(subcommand)]
    operation: Option<Operation>,
}

impl EditArgs {
    /// Whether the edit is given both ways: clap lets that through, since an operation lifts the need for `--json`.
    pub(in super::super) fn is_twofold(&self) -> bool {
        self.json.is_some() && self.operation.is_some()
    }
}

/// Posts an edit.
pub(in super::super) async fn edit(args: &EditArgs) -> anyhow::Result<()> {
    let client = args.server.client()?;
    let edit = match (&args.operation, &args.json) {
        (Some(operation), None) => {
            if let Some(color) = operation.bright_color().filter(|_| !args.yes) {
                confirm_color(color)?;
            }
            let uploaded = match operation.asset_file() {
                Some(path) => {
                    let glb = read_packed(&path)?;
                    Some(interruptible(async { Ok(client.create_asset(glb).await?) }, "").await?)
                }
                None => None,
            };
            operation.json(uploaded)
        }
        (None, Some(path)) => read_json(path)?,
        _ => anyhow::bail!("give either an operation or --json"),
    };
    let options = EditOptions { idempotency_key: args.idempotency_key.clone(), if_match: args.if_match };
    let edit = args.budget.add_to(edit);
    let job = interruptible(async { Ok(client.edit(&args.scene, &edit, &options).await?) }, "").await?;
    ui::out(&job.id)?;
    if args.wait {
        let wait = wait_for_job(&client, &job);
        note_done(&interruptible(wait, ": the update goes on at the service").await?);
    }
    Ok(())
}

/// A channel above 1 makes a light brighter than its intensity says: seldom meant, often 8-bit values.
fn confirm_color(color: Rgb) -> anyhow::Result<()> {
    let Rgb([r, g, b]) = color;
    let told = format!(
        "--color {r},{g},{b}: channels are linear factors of the intensity, usually 0 to 1; 8-bit sRGB values are \
         written #rrggbb"
    );
    if !ui::is_interactive() {
        anyhow::bail!("{told}; --yes takes it as it is");
    }
    anyhow::ensure!(ui::confirm(&format!("{told}. Take it as it is?"))?, "nothing was changed");
    Ok(())
}

fn read_json(path: &str) -> anyhow::Result<Value> {
    let (text, place) = if path == "-" {
        let mut text = String::new();
        std::io::stdin().read_to_string(&mut text).context("cannot read standard input")?;
        (text.into_bytes(), "standard input")
    } else {
        (read_file(Path::new(path))?, path)
    };
    let json: Value = serde_json::from_slice(&text).with_context(|| format!("{place} is not JSON"))?;
    anyhow::ensure!(json.is_object(), "{place} has to hold one JSON object, an edit or {{\"edits\": [...]}}");
    Ok(json)
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use serde_json::json;

    use super::*;

    #[derive(Debug, Parser)]
    struct Alone {
        #[command(flatten)]
        edit: EditArgs,
    }

    fn json_of(line: &str) -> Value {
        let args = Alone::try_parse_from(["edit", "s"].into_iter().chain(line.split(' '))).expect(line).edit;
        let operation = args.operation.as_ref().expect("an operation");
        args.budget.add_to(operation.json(operation.asset_file().map(|_| "hash".to_owned())))
    }

    #[test]
    fn operations_become_the_json_of_the_api() {
        let moved = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 1., 0., -2., 1.];
        let cases = [
            (
                "insert a/chair.glb --at 1,0,-2",
                json!({"op": "insert", "asset": "hash", "name": "chair", "transform": moved}),
            ),
            (
                "insert abc --name x --transform 1,0,0,0,0,1,0,0,0,0,1,0,1,0,-2,1",
                json!({"op": "insert", "asset": "abc", "name": "x", "transform": moved}),
            ),
            ("remove a b-*", json!({"op": "remove", "objects": ["a", "b-*"]})),
            ("move sofa --at 1,0,-2", json!({"op": "move", "object": "sofa", "transform": moved})),
            (
                "material sofa --albedo 0.6,0.1,0.1",
                json!({"op": "material", "object": "sofa", "albedo": [0.6, 0.1, 0.1]}),
            ),
            (
                "material --material wood --albedo 1,0,0",
                json!({"op": "material", "material": "wood", "albedo": [1.0, 0.0, 0.0]}),
            ),
            (
                "material sofa --albedo 1,0,0 --multiply",
                json!({"op": "material", "object": "sofa", "albedo": [1.0, 0.0, 0.0], "texture": "multiply"}),
            ),
            ("hide a b-*", json!({"op": "hide", "objects": ["a", "b-*"]})),
            ("show a", json!({"op": "show", "objects": ["a"]})),
            ("undo", json!({"op": "undo"})),
            ("redo", json!({"op": "redo"})),
            (
                "relight lamp --color 1,0.5,0.25",
                json!({"op": "relight", "lights": [{"light": "lamp", "color": [1.0, 0.5, 0.25]}]}),
            ),
            ("relight lamp --intensity 0", json!({"op": "relight", "lights": [{"light": "lamp", "intensity": 0.0}]})),
            (
                "insert-light l --kind point --position 0,2,0 --intensity 40",
                json!({"op": "insert_light", "name": "l",
                    "light": {"kind": "point", "position": [0.0, 2.0, 0.0], "color": [1.0, 1.0, 1.0],
                     "intensity": 40.0}}),
            ),
            (
                "sky a/noon.HDR --rotation -90 --strength 2",
                json!({"op": "sky", "asset": "hash", "rotation": -90.0, "strength": 2.0}),
            ),
            ("sky abc", json!({"op": "sky", "asset": "abc"})),
            ("sky --radiance 1,1,2", json!({"op": "sky", "radiance": [1.0, 1.0, 2.0]})),
            ("remove-light l", json!({"op": "remove_light", "light": "l"})),
            ("move-light l --position -1,2,0", json!({"op": "move_light", "light": "l", "position": [-1.0, 2.0, 0.0]})),
        ];
        for (line, expected) in cases {
            assert_eq!(json_of(line), expected, "{line}");
        }
    }

    #[test]
    fn the_budget_stands_beside_the_operation() {
        assert_eq!(
            json_of("--samples 8 --target-rmse 0.5 remove a"),
            json!({"op": "remove", "objects": ["a"], "budget": {"samples_per_element": 8, "target_rmse": 0.5}})
        );
        assert_eq!(json_of("remove a --samples 8"), json_of("--samples 8 remove a"), "or behind it");
    }

    #[test]
    fn a_colour_above_1_is_told_from_one_that_is_not() {
        let bright = |line: &str| {
            let args = Alone::try_parse_from(["edit", "s"].into_iter().chain(line.split(' '))).expect(line).edit;
            args.operation.as_ref().and_then(Operation::bright_color)
        };
        assert_eq!(bright("relight lamp --color 255,200,150"), Some(Rgb([255.0, 200.0, 150.0])));
        assert_eq!(
            bright("insert-light l --kind environment --color 0,1.5,0 --intensity 1"),
            Some(Rgb([0.0, 1.5, 0.0]))
        );
        for fine in ["relight lamp --color 1,0.5,0", "relight lamp --intensity 9", "sky --radiance 9,9,9", "undo"] {
            assert_eq!(bright(fine), None, "{fine}");
        }
    }

    #[test]
    fn a_turn_is_about_the_vertical() {
        let matrix = &json_of("move a --at 0,0,0 --rotate-y 90 --scale 2")["transform"];
        // The x axis turns to −z.
        assert!((matrix[2].as_f64().unwrap() + 2.0).abs() < 1e-12, "{matrix}");
    }
}
