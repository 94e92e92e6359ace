//! Runs all methods on all cases and measures them.

use std::sync::Arc;

use anyhow::Result;
use rebake_core::{Budget, LightMap, Stated, Unobserved, bake};

use super::gallery::{Shown, draw_case};
use super::report::{BaseReport, CaseReport, ReferenceReport, Report, RunReport};
use super::{
    Base, Goal, Measured, Method, PictureOptions, PreparedCase, Reference, Service, StudyReport, Subject, Timed,
    run_method,
};

/// What to run, and how long.
#[derive(Clone, Debug)]
pub struct Options {
    /// Largest distance between neighbouring elements, metres; from the scene's size where absent.
    pub spacing: Option<f32>,
    /// What errors are measured on.
    pub mode: Stated,
    /// In the order in which they are run.
    pub methods: Vec<Method>,
    /// Budgets, each run anew.
    pub goals: Vec<Goal>,
    /// Independent runs per method and budget.
    pub seeds: u32,
    /// First seed.
    pub seed: u64,
    /// Paths per element of the reference.
    pub reference_samples: u32,
    /// Elements of the reference.
    pub reference_elements: usize,
    /// Samples per element of the light map before the edit.
    pub base_samples: u32,
    /// Measure that light map, too.
    pub measure_base: bool,
    /// Measure the change of updates alone, too.
    pub measure_change: bool,
    /// Only cases of whose name this is a part.
    pub filter: Option<String>,
    /// Pictures to draw of the runs of the first budget.
    pub pictures: Option<PictureOptions>,
}

/// Is told how far a bench is.
pub trait Watcher {
    /// A step begins.
    fn step(&mut self, _case: &str, _step: &str) {}

    /// A case is done; `report` holds all that are.
    fn case_done(&mut self, _report: &Report) -> Result<()> {
        Ok(())
    }

    /// A case of a study is done; `report` holds all that are.
    fn study_case_done(&mut self, _report: &StudyReport) -> Result<()> {
        Ok(())
    }
}

/// Runs the bench on the current rayon pool; [`Method::Service`] is run by services that `service` lends.
pub fn run(subject: &Subject, options: &Options, service: &dyn Service, watcher: &mut dyn Watcher) -> Result<Report> {
    let setup = subject.setup(options, watcher)?;
    let spacing = setup.spacing;
    let mut report = Report { setup, cases: Vec::new() };
    subject.each_case(
        (options, spacing),
        |_| true,
        watcher,
        |case, watcher| {
            report.cases.push(run_case(case, options, service, watcher)?);
            watcher.case_done(&report)
        },
    )?;
    Ok(report)
}

fn run_case(
    case: &PreparedCase,
    options: &Options,
    service: &dyn Service,
    watcher: &mut dyn Watcher,
) -> Result<CaseReport> {
    let mode = options.mode;
    watcher.step(&case.name, "light map before the edit");
    let budget = Budget { samples_per_element: options.base_samples, target_rmse: None };
    // The service bakes its own.
    let only_service = options.methods.iter().all(|m| *m == Method::Service);
    let base = match only_service {
        true => Arc::new(LightMap::black(case.before.slots())),
        false => bake(&case.before, &budget, options.seed ^ 0xba5e_0000_0000, &Unobserved)?,
    };
    let base_rmse = (options.measure_base && !only_service).then(|| {
        watcher.step(&case.name, "its error");
        let truth = Reference::trace(&case.before, options.reference_elements, options.reference_samples, options.seed);
        truth.mean_square_error(&base, mode).root()
    });
    watcher.step(&case.name, "reference");
    let reference = Reference::trace(&case.after, options.reference_elements, options.reference_samples, options.seed);
    let untouched = case.transition.carry_over(&base);
    let given = (options.measure_change && !only_service).then(|| {
        watcher.step(&case.name, "reference of the change");
        reference.given(&untouched, &case.before, &case.after, options.seed)
    });
    let (mut runs, mut shown) = (Vec::new(), Vec::new());
    for &method in &options.methods {
        for (k, &goal) in options.goals.iter().enumerate() {
            let timed: Vec<Timed> = (0..options.seeds)
                .filter_map(|run| {
                    watcher.step(&case.name, &format!("{}, {}, run {}", method.name(), goal.describe(), run + 1));
                    let base_of_run = Base::of_run(options, run);
                    match method {
                        Method::Service => service.run(case, base_of_run, goal).map(Some),
                        _ => Ok(run_method(method, case, &base, goal, base_of_run.seed)),
                    }
                    .transpose()
                })
                .collect::<Result<_>>()?;
            if !timed.is_empty() {
                let mut run = summarize(method, goal, &timed, &reference, mode);
                if let Some(given) = given.as_ref().filter(|_| method.is_update()) {
                    add_change(&mut run, &timed, given, mode);
                }
                runs.push(run);
            }
            if let (0, Some(_), Some(first)) = (k, &options.pictures, timed.into_iter().next()) {
                shown.push(Shown::of(method, first));
            }
        }
    }
    add_gains(&mut runs);
    let pictures = options.pictures.as_ref().map_or(Ok(Vec::new()), |pictures| {
        watcher.step(&case.name, "pictures");
        draw_case(case, &base, shown, (mode, options.reference_samples, options.seed), pictures)
    })?;
    Ok(CaseReport {
        name: case.name.clone(),
        elements: case.after.element_count(),
        edited_share: case.edited_share(),
        reference: ReferenceReport::of(&reference, mode),
        base: BaseReport { method: "bake", samples_per_element: options.base_samples, rmse: base_rmse },
        no_update_rmse: (!only_service).then(|| reference.mean_square_error(&untouched, mode).root()),
        runs,
        pictures,
    })
}

fn summarize(method: Method, goal: Goal, timed: &[Timed], reference: &Reference, mode: Stated) -> RunReport {
    let errors: Vec<_> = timed.iter().map(|t| reference.mean_square_error(&t.map, mode)).collect();
    let maps: Vec<&LightMap> = timed.iter().map(|t| &*t.map).collect();
    let stated: Option<Vec<f64>> = timed.iter().map(|t| t.estimated_rmse.map(f64::from)).collect();
    let bias = reference.mean_square_bias(&maps, mode);
    let published = match method {
        Method::Paper { iterations, path_length, .. } => Some((iterations, path_length)),
        _ => None,
    };
    let cpu: Option<Vec<f64>> = timed.iter().map(|t| t.cpu_seconds).collect();
    let of = |f: &dyn Fn(&Timed) -> f64| median(timed.iter().map(f).collect());
    RunReport {
        method: method.name().to_owned(),
        budget_seconds: goal.seconds(),
        seconds: of(&|t| t.seconds),
        cpu_seconds: cpu.map(median),
        samples_per_element: of(&|t| f64::from(t.samples)) as u32,
        rays: of(&|t| t.rays as f64) as u64,
        mean_ratio: median(timed.iter().map(|t| reference.mean_of(&t.map, mode)).collect()) / reference.mean(mode),
        mean_error: reference.mean_noise(mode) / reference.mean(mode),
        rmse: median(errors.iter().map(|e| e.root()).collect()),
        rmse_error: median(errors.iter().map(|e| e.root_error()).collect()),
        bias_floor: bias.map(|b| b.root()),
        bias_error: bias.map(|b| b.root_error()),
        estimated_rmse: stated.map(median),
        gain: None,
        gain_cpu: None,
        change_rmse: None,
        change_rmse_error: None,
        change_bias: None,
        change_bias_error: None,
        change_gain: None,
        iterations: published.map(|p| p.0),
        path_length: published.map(|p| p.1),
    }
}

/// Errors of the change alone, against a [`Reference::given`].
fn add_change(run: &mut RunReport, timed: &[Timed], given: &Reference, mode: Stated) {
    let errors: Vec<Measured> = timed.iter().map(|t| given.mean_square_error(&t.map, mode)).collect();
    run.change_rmse = Some(median(errors.iter().map(|e| e.root()).collect()));
    run.change_rmse_error = Some(median(errors.iter().map(|e| e.root_error()).collect()));
    let maps: Vec<&LightMap> = timed.iter().map(|t| &*t.map).collect();
    let bias = given.mean_square_bias(&maps, mode);
    (run.change_bias, run.change_bias_error) = (bias.map(|b| b.root()), bias.map(|b| b.root_error()));
}

/// RMSE of path tracing in the same time over that of each run.
fn add_gains(runs: &mut [RunReport]) {
    let of_time = gains(runs, |run| Some(run.seconds), |run| Some(run.rmse));
    let of_cpu = gains(runs, |run| run.cpu_seconds, |run| Some(run.rmse));
    let of_change = gains(runs, |run| Some(run.seconds), |run| run.change_rmse);
    for (((run, gain), cpu), change) in runs.iter_mut().zip(of_time).zip(of_cpu).zip(of_change) {
        (run.gain, run.gain_cpu, run.change_gain) = (gain, cpu, change);
    }
}

/// Path tracing has no bias, so that `rmse · √seconds` is a constant of the case, taken as the median over its runs.
fn gains(
    runs: &[RunReport],
    seconds: impl Fn(&RunReport) -> Option<f64>,
    rmse: impl Fn(&RunReport) -> Option<f64>,
) -> Vec<Option<f64>> {
    let product = |run: &RunReport, rmse: f64| Some(rmse * seconds(run)?.sqrt()).filter(|p| *p > 0.0);
    let traced = runs.iter().filter(|r| r.method == Method::PathTrace.name());
    let constants: Vec<f64> = traced.filter_map(|run| product(run, run.rmse)).collect();
    let constant = (!constants.is_empty()).then(|| median(constants));
    runs.iter().map(|run| Some(constant? / product(run, rmse(run)?)?)).collect()
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { 0.5 * (values[(n - 1) / 2] + values[n / 2]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gains_are_relative_to_path_tracing_at_equal_time() {
        let run = |method: &str, seconds: f64, rmse: f64| RunReport {
            method: method.to_owned(),
            budget_seconds: None,
            seconds,
            cpu_seconds: None,
            samples_per_element: 1,
            rays: 1,
            mean_ratio: 1.0,
            mean_error: 0.0,
            rmse,
            rmse_error: 0.0,
            bias_floor: None,
            bias_error: None,
            estimated_rmse: None,
            gain: None,
            gain_cpu: None,
            change_rmse: None,
            change_rmse_error: None,
            change_bias: None,
            change_bias_error: None,
            change_gain: None,
            iterations: None,
            path_length: None,
        };
        // Path tracing has 0.2 after 1 s and so 0.1 after 4 s.
        let mut runs = [run("path-trace", 1.0, 0.2), run("rebake", 4.0, 0.01), run("paper", 1.0, 0.0)];
        add_gains(&mut runs);
        let gain = runs[1].gain.expect("a gain");
        assert!((gain - 10.0).abs() < 1e-9, "{gain}");
        assert!(runs[2].gain.is_none() && runs[1].gain_cpu.is_none() && runs[1].change_gain.is_none());
        // Of the error of .01 the change has but .002.
        runs[1].change_rmse = Some(0.002);
        add_gains(&mut runs);
        let gain = runs[1].change_gain.expect("a gain");
        assert!((gain - 50.0).abs() < 1e-9, "{gain}");
        assert_eq!([median(vec![3.0, 1.0, 2.0]), median(vec![4.0, 1.0])], [2.0, 2.5]);
    }
}
