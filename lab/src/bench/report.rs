//! `REPORT.json`: what was measured. Field names are part of the contract; times are seconds, errors are RMSE of
//! radiance / albedo, area-weighted over the light map.

use rebake_core::Stated;
use serde::{Serialize, Serializer};

use super::Reference;

/// What was measured on, and with what. In JSON its fields are those of the report.
#[derive(Clone, Debug, Serialize)]
pub struct Setup {
    /// File of the scene.
    pub scene: String,
    /// Elements of the scene as it is in the file.
    pub elements: usize,
    /// Threads that all methods, or the service, had.
    pub threads: usize,
    /// Largest distance between neighbouring elements, metres.
    pub spacing: f32,
    /// What errors are measured on.
    #[serde(serialize_with = "name_of_mode")]
    pub mode: Stated,
    /// Runs per method and budget. Figures are medians over them, errors during a drag means.
    pub seeds: u32,
}

/// All cases of a scene.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The scene, threads and so on.
    #[serde(flatten)]
    pub setup: Setup,
    /// In the order of the edit file.
    pub cases: Vec<CaseReport>,
}

/// One edit.
#[derive(Clone, Debug, Serialize)]
pub struct CaseReport {
    /// From the edit file.
    pub name: String,
    /// Elements after the edit.
    pub elements: usize,
    /// Area that was inserted or removed over the area of the scene after the edit.
    pub edited_share: f64,
    /// What errors are measured against.
    pub reference: ReferenceReport,
    /// The light map before the edit.
    pub base: BaseReport,
    /// RMSE of the old light map in the scene after the edit, new elements black. Absent where only the service's runs
    /// were measured, which bakes its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_update_rmse: Option<f64>,
    /// One entry per method and budget.
    pub runs: Vec<RunReport>,
    /// Pictures that were drawn: before the edit, every method at the first budget, the reference.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub pictures: Vec<PictureReport>,
}

/// A picture, held against that of the reference.
#[derive(Clone, Debug, Serialize)]
pub struct PictureReport {
    /// `before`, a method, or `reference`.
    pub of: &'static str,
    /// Its file in the folder of pictures.
    pub file: String,
    /// RMSE of its pixels, linear.
    pub rmse: f64,
    /// Mean FLIP.
    pub flip: f64,
}

/// Path tracing of the scene after the edit.
#[derive(Clone, Debug, Serialize)]
pub struct ReferenceReport {
    /// Paths per element.
    pub samples_per_element: u32,
    /// Its own RMSE, which is taken out of all others.
    pub rmse_noise: f64,
    /// Elements it was traced for, drawn by area.
    pub elements: usize,
    /// Area-weighted mean of what is measured.
    pub mean: f64,
}

/// The light map that updates start from. Its error is theirs, too.
#[derive(Clone, Debug, Serialize)]
pub struct BaseReport {
    /// How it was made.
    pub method: &'static str,
    /// Samples per element.
    pub samples_per_element: u32,
    /// RMSE against path tracing of the scene before the edit; absent where that was not asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rmse: Option<f64>,
}

/// One method at one budget: medians over the seeds.
#[derive(Clone, Debug, Serialize)]
pub struct RunReport {
    /// `path-trace`, `cached`, `paper`, `rebake` or `service`.
    pub method: String,
    /// What the run was given, where that was time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_seconds: Option<f64>,
    /// Seconds it took.
    pub seconds: f64,
    /// Seconds of all processors that it took, where the system tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cpu_seconds: Option<f64>,
    /// Samples per element of the last full pass.
    pub samples_per_element: u32,
    /// Rays traced.
    pub rays: u64,
    /// Mean of the map over that of the reference, on the reference's elements.
    pub mean_ratio: f64,
    /// Standard error of `mean_ratio` from the reference's paths.
    pub mean_error: f64,
    /// RMSE, the reference's own noise taken out; 0 where that hides it.
    pub rmse: f64,
    /// Standard error of `rmse` from the reference's noise and the drawing of elements.
    pub rmse_error: f64,
    /// Root mean square of what independent runs have in common: bias, that of the old map included. Absent for a
    /// single seed.
    pub bias_floor: Option<f64>,
    /// Standard error of `bias_floor`: where that is below twice this, noise hides the bias.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias_error: Option<f64>,
    /// What the method itself says about its error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub estimated_rmse: Option<f64>,
    /// RMSE of path tracing in the same time over this one: path tracing's error falls with the root of time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// RMSE of path tracing in equal time of the processors over this one: what counts where other work shares them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_cpu: Option<f64>,
    /// RMSE of the change alone: against the truth's change added to the same old map, whose own error so drops out.
    /// For updates, where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_rmse: Option<f64>,
    /// Standard error of `change_rmse` from the reference's elements and paths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_rmse_error: Option<f64>,
    /// The part of `change_rmse` that all runs have in common.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_bias: Option<f64>,
    /// Standard error of `change_bias`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_bias_error: Option<f64>,
    /// As `gain`, of `change_rmse`: what the update gains where the old map is right.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change_gain: Option<f64>,
    /// For `paper`: N.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u32>,
    /// For `paper`: M.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub path_length: Option<u32>,
}

impl ReferenceReport {
    /// What a reference is.
    pub fn of(reference: &Reference, mode: Stated) -> ReferenceReport {
        ReferenceReport {
            samples_per_element: reference.samples,
            rmse_noise: reference.noise(mode),
            elements: reference.slots.len(),
            mean: reference.mean(mode),
        }
    }
}

impl RunReport {
    /// Method and its settings, for people.
    pub fn label(&self) -> String {
        match (self.iterations, self.path_length) {
            (Some(n), Some(m)) if (n, m) != (4, 3) => format!("{} N={n} M={m}", self.method),
            _ => self.method.clone(),
        }
    }
}

fn name_of_mode<S: Serializer>(mode: &Stated, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(match mode {
        Stated::Full => "full",
        Stated::Indirect => "indirect",
    })
}
