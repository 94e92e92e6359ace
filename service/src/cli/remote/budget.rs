//! When a job stops: the same options wherever one is made.

use serde_json::{Value, json};

use super::super::values::positive;
use super::operation::set;

/// When the work stops: at the first bound that is reached.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(super) struct BudgetArgs {
    /// Budget: samples per element
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) samples: Option<u32>,
    /// Budget: time from when it is asked for, waiting included
    #[arg(long, global = true, value_name = "SECONDS", value_parser = positive)]
    pub(super) max_seconds: Option<f64>,
    /// Budget: stop at this stated error (RMSE of radiance / albedo)
    #[arg(long, global = true, value_name = "RMSE", value_parser = positive)]
    pub(super) target_rmse: Option<f64>,
}

impl BudgetArgs {
    /// The `budget` of an edit; none where nothing is asked for.
    fn json(&self) -> Option<Value> {
        let mut budget = json!({});
        set(&mut budget, "samples_per_element", self.samples.map(|x| json!(x)));
        set(&mut budget, "max_seconds", self.max_seconds.map(|x| json!(x)));
        set(&mut budget, "target_rmse", self.target_rmse.map(|x| json!(x)));
        budget.as_object().is_some_and(|fields| !fields.is_empty()).then_some(budget)
    }

    /// Adds the budget to an edit or a list of edits.
    pub(super) fn add_to(&self, mut edit: Value) -> Value {
        set(&mut edit, "budget", self.json());
        edit
    }
}
