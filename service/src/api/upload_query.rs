//! How to upload a scene: the query, and what it asks for.

use rebake_core::allowed::{Allowed, check_spacing};
use serde::Deserialize;
use serde_json::Value;
use utoipa::IntoParams;

use super::atlas::{self, LayoutName};
use super::checks::{check_name, check_strength};
use super::edit_beside::to_budget;
use super::edit_types::Budget;
use super::layers::Wanted;
use super::misread::read;
use super::problem::{ApiResult, Kind, Problem};
use super::skies;
use super::types::JobPriority;
use crate::LARGEST_ALBEDO;
use crate::engine::{AtlasOptions, Spread};
use crate::jobs::budget::JobBudget;
use crate::mode::Mode;
use crate::sizing::Sizing;
use crate::state::App;
use crate::store::records::StoredOutside;
use crate::unit::LightUnit;

/// How to upload a scene.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CreateQuery {
    /// Name for people.
    #[param(example = "living room")]
    name: Option<String>,
    /// Largest distance between neighbouring elements, metres; chosen from the scene's size where neither this nor `elements`
    /// is given. On a few objects that are too large for it (a ground of a square kilometre) they lie farther apart, with
    /// a warning.
    #[param(example = 0.1)]
    spacing: Option<f32>,
    /// How many elements the light map is to have, in place of `spacing`: the spacing is chosen so that there are nearly as
    /// many, and no more. Every piece of surface has an element; where that makes more, there is a warning.
    #[param(example = 50_000, minimum = 1)]
    elements: Option<usize>,
    /// How elements are spread. `uniform`, the default: equally far apart. `light`: closer together (down to a fifth) where a
    /// first look says that light changes much, farther apart elsewhere. They are within a tenth as many as with `uniform`
    /// and up to 2.5 times as far apart; where `spacing` is given they are nowhere farther apart than that, and up to
    /// half as many more. Objects that edits insert are uniform.
    #[param(inline)]
    sizing: Option<Sizing>,
    /// What the light map holds; `full` where absent.
    #[param(inline)]
    mode: Option<Mode>,
    /// Constant radiance from outside, `r,g,b`: adds a light named `environment`.
    #[param(example = "1,1,1")]
    pub(super) environment: Option<String>,
    /// A picture of the sky, uploaded as an asset: adds a light named `environment`.
    #[param(example = "d74981efa70a0c880b8d8c1985d075dbcbf679b99a5f9914e5aaf96b831a9e24")]
    pub(super) sky: Option<String>,
    /// By how much that picture is turned about +y, counter-clockwise seen from above, degrees; 0 where absent.
    #[param(example = 90.0)]
    pub(super) sky_rotation: Option<f32>,
    /// Factor on its radiance; 1 where absent.
    #[param(example = 1.0)]
    pub(super) sky_strength: Option<f32>,
    /// Whether a scene that has no light at all gets a plain sky, of radiance 1 from everywhere; `false` where absent.
    pub(super) default_sky: Option<bool>,
    /// Angle that the discs of directional lights of the file take up, degrees, below 180: the sun's is 0.53. 0 where
    /// absent, as glTF has it: hard shadows.
    #[param(example = 0.53)]
    pub(super) sun_angle: Option<f32>,
    /// What the intensities of the file's point and spot lights are: `candela` (glTF's; `candela` where absent), or `watt`,
    /// the power into all directions, as Blender writes in its lighting mode "Raw": 1 / 4π of it per steradian. Emissive
    /// surfaces and directional lights stay as they are.
    #[param(inline)]
    unit: Option<LightUnit>,
    /// Largest albedo that light meets, above 0 and up to 0.999: what is above, of the file, of inserted assets and of
    /// repaints, counts as this. 0.95 where absent.
    #[param(example = 0.99)]
    max_albedo: Option<f32>,
    /// How the light map is delivered. `vertices`, the default: by element, at the corners of a subdivided mesh. `atlas`:
    /// objects also have rectangles on pages of texels, which stay where they are through all edits.
    #[param(inline)]
    layout: Option<LayoutName>,
    /// Texels per metre of surface of the atlas; asks for one. One per spacing where absent.
    #[param(example = 20.0)]
    texels_per_metre: Option<f32>,
    /// Whether the light map is to tell from where light comes, as `part=directional`. That is gathered whenever it is
    /// asked for, of every scene: nothing is computed or kept before, with `true` or without.
    #[serde(rename = "directional")]
    _directional: Option<bool>,
    /// Which lights have layers of their own in the light map, so that relighting them needs no rays: `shared` (none,
    /// the default; lights that are relit get one then), `each` (every light; at most 1022), or a JSON object of layers
    /// with their lights (at most 1022; the other lights share one more).
    #[param(example = "{\"ceiling\": [\"lamp-1\", \"lamp-2\"]}")]
    layers: Option<String>,
    /// Start a bake at once; `true` where absent.
    bake: Option<bool>,
    /// What the scene works towards, as JSON like the `budget` of an edit: the bake ends there, edits interrupt it, and what
    /// they leave behind is refined towards it. In place of the three below.
    #[param(example = "{\"target_rmse\": 0.01, \"max_seconds\": 60}")]
    target: Option<String>,
    /// The target: samples per element; 128 where nothing else is asked for.
    #[param(example = 128)]
    samples_per_element: Option<u32>,
    /// The target: seconds from the upload.
    max_seconds: Option<f64>,
    /// The target: stated error.
    target_rmse: Option<f32>,
    /// Tell what the scene would take, and keep nothing: 200, a ScenePlan; `false` where absent.
    pub(super) dry_run: Option<bool>,
    /// Whose turn comes sooner, of the bake; `normal` where absent.
    #[param(inline)]
    priority: Option<JobPriority>,
}

/// A query, checked.
pub(super) struct Options {
    pub(super) name: String,
    pub(super) spacing: Option<f32>,
    pub(super) elements: Option<usize>,
    pub(super) spread: Spread,
    pub(super) mode: Mode,
    pub(super) environment: Option<[f32; 3]>,
    pub(super) outside: StoredOutside,
    pub(super) unit: LightUnit,
    pub(super) max_albedo: Option<f32>,
    pub(super) atlas: Option<AtlasOptions>,
    pub(super) layers: Wanted,
    pub(super) bake: bool,
    pub(super) target: Option<JobBudget>,
    pub(super) priority: JobPriority,
}

impl Options {
    pub(super) fn from_query(query: CreateQuery, app: &App) -> ApiResult<Options> {
        let outside = skies::asked_for(&query)?;
        let atlas = atlas::asked_for(query.layout, query.texels_per_metre, &app.config.limits)?;
        let (bake, has_target) = (query.bake.unwrap_or(true), query.target.is_some());
        let target = read_target(&query, app)?;
        check_elements(&query, app.config.limits.elements)?;
        let name = query.name.unwrap_or_else(|| "scene".to_owned());
        check_name(Allowed::ASKED, &name, "name")?;
        if let Some(Err(reason)) = query.spacing.map(check_spacing) {
            return Err(Problem::field(Kind::InvalidQuery, "spacing", reason));
        }
        if query.max_albedo.is_some_and(|albedo| !(albedo > 0.0 && albedo <= LARGEST_ALBEDO)) {
            let reason = format!("has to be above 0 and at most {LARGEST_ALBEDO}");
            return Err(Problem::field(Kind::InvalidQuery, "max_albedo", reason));
        }
        let environment = query.environment.as_deref().map(parse_environment).transpose()?;
        Ok(Options {
            name,
            spacing: query.spacing,
            elements: query.elements,
            spread: query.sizing.unwrap_or_default().spread(query.spacing.is_some()),
            mode: query.mode.unwrap_or_default(),
            environment,
            outside,
            unit: query.unit.unwrap_or_default(),
            max_albedo: query.max_albedo,
            atlas,
            layers: query.layers.map_or(Ok(Wanted::Shared), |text| Wanted::parse(&text))?,
            bake,
            target: (bake || has_target).then_some(target),
            priority: query.priority.unwrap_or_default(),
        })
    }
}

fn check_elements(query: &CreateQuery, most: usize) -> ApiResult<()> {
    let refused = |reason: String| Err(Problem::field(Kind::InvalidQuery, "elements", reason));
    match query.elements {
        Some(_) if query.spacing.is_some() => refused("comes in place of spacing, not beside it".to_owned()),
        Some(elements) if !(1..=most).contains(&elements) => refused(format!("has to be 1 to {most}, not {elements}")),
        _ => Ok(()),
    }
}

/// What the scene is to work towards, however the query says so.
fn read_target(query: &CreateQuery, app: &App) -> ApiResult<JobBudget> {
    let apart = Budget {
        samples_per_element: query.samples_per_element,
        max_seconds: query.max_seconds,
        target_rmse: query.target_rmse,
    };
    let default_samples = app.config.defaults.bake_samples;
    let Some(text) = &query.target else { return to_budget(Some(apart), "", default_samples, &app.config) };
    if apart.samples_per_element.is_some() || apart.max_seconds.is_some() || apart.target_rmse.is_some() {
        let reason = "comes alone: samples_per_element, max_seconds and target_rmse belong in it";
        return Err(Problem::field(Kind::InvalidQuery, "target", reason));
    }
    let refused = |reason: String| Problem::field(Kind::InvalidQuery, "target", reason);
    let value: Value = serde_json::from_str(text).map_err(|error| refused(format!("has to be JSON: {error}")))?;
    if !value.is_object() {
        return Err(refused("has to be a JSON object".to_owned()));
    }
    let budget = read::<Budget>(value, "target").map_err(in_query)?;
    to_budget(Some(budget), "target", default_samples, &app.config)
}

/// Faults in the query are told as such, whatever checked them.
pub(super) fn in_query(problem: Problem) -> Problem {
    problem.with_kind(Kind::InvalidQuery)
}

fn parse_environment(text: &str) -> ApiResult<[f32; 3]> {
    let numbers: Option<Vec<f32>> =
        text.split(',').map(|number| number.trim().parse().ok().filter(|x: &f32| x.is_finite() && *x >= 0.0)).collect();
    match numbers.as_deref() {
        Some([r, g, b]) => {
            check_strength(Allowed::ASKED, Some(&[*r, *g, *b]), None, "environment").map_err(in_query)?;
            Ok([*r, *g, *b])
        }
        _ => Err(Problem::field(Kind::InvalidQuery, "environment", "has to be r,g,b, each finite and at least 0")),
    }
}
