//! Jobs: look, cancel, pause, resume.

use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::Deserialize;
use utoipa::IntoParams;

use super::Shared;
use super::extract::{ApiPath, ApiQuery};
use super::paging::Page;
use super::problem::{ApiResult, Kind, Problem};
use super::types::{Job, JobPage, JobState};
use crate::jobs::queue::{Change, JobNumber};
use crate::state::App;

/// Which jobs.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Of this scene only.
    #[param(example = "s1-k3f9qz")]
    scene: Option<String>,
    /// In this state only.
    #[param(inline)]
    state: Option<JobState>,
    /// Entries per page.
    #[param(example = 50, minimum = 1)]
    limit: Option<usize>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Jobs, newest first. Finished ones are forgotten after a while.
#[utoipa::path(
    get, path = "/v1/jobs", tag = "jobs", operation_id = "list_jobs", params(ListQuery),
    responses((status = 200, body = JobPage, description = "A page of jobs"))
)]
pub(super) async fn list(State(app): Shared, ApiQuery(query): ApiQuery<ListQuery>) -> ApiResult<Json<JobPage>> {
    let page = Page::new(&app.config, query.limit, query.cursor.as_deref())?;
    let jobs = app.jobs.older_than(page.before, page.limit + 1, |job, about| {
        query.scene.as_deref().is_none_or(|wanted| wanted == about.scene)
            && query.state.is_none_or(|wanted| wanted == job.state())
    });
    let (jobs, next_cursor) = page.cut(jobs, |(job, _)| job.number);
    let items = jobs.iter().map(|(job, about)| Job::new(&app.ids, job, about)).collect();
    Ok(Json(JobPage { items, next_cursor }))
}

/// One job.
#[utoipa::path(
    get, path = "/v1/jobs/{job}", tag = "jobs", operation_id = "get_job",
    params(("job" = String, Path, description = "The job's id")),
    responses((status = 200, body = Job, description = "The job"))
)]
pub(super) async fn get(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<Json<Job>> {
    let (_, job) = find(&app, &id)?;
    Ok(Json(job))
}

/// Cancels a job: a queued one at once (200), a running one soon (202; its events tell when). The light map stays at
/// the last consistent version. The edit that the job was to light stays too: the scene's next job lights it.
#[utoipa::path(
    delete, path = "/v1/jobs/{job}", tag = "jobs", operation_id = "cancel_job",
    params(("job" = String, Path, description = "The job's id")),
    responses((status = 200, body = Job, description = "Canceled"), (status = 202, body = Job, description = "Asked to stop"))
)]
pub(super) async fn cancel(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<(StatusCode, Json<Job>)> {
    let (number, job) = find(&app, &id)?;
    let its_app = app.clone();
    let change = app.compute.run(move || its_app.jobs.cancel(number)).await??;
    if change == Change::Done {
        show_what_is_left(&app, &job).await?;
    }
    changed(&app, &id, job, change)
}

/// Pauses a job: a queued one at once (200), a running one soon (202). It makes room for others; what it has published
/// stays. A later job of the scene that runs meanwhile does its work too.
#[utoipa::path(
    post, path = "/v1/jobs/{job}/pause", tag = "jobs", operation_id = "pause_job",
    params(("job" = String, Path, description = "The job's id")),
    responses((status = 200, body = Job, description = "Paused"), (status = 202, body = Job, description = "Asked to make room"))
)]
pub(super) async fn pause(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<(StatusCode, Json<Job>)> {
    let (number, job) = find(&app, &id)?;
    let its_app = app.clone();
    let change = app.compute.run(move || its_app.jobs.pause(number)).await??;
    changed(&app, &id, job, change)
}

/// Puts a paused job in line again. It starts over from the light it started from before, and publishes nothing that
/// is worse than what it had published.
#[utoipa::path(
    post, path = "/v1/jobs/{job}/resume", tag = "jobs", operation_id = "resume_job",
    params(("job" = String, Path, description = "The job's id")),
    responses((status = 200, body = Job, description = "In line"))
)]
pub(super) async fn resume(State(app): Shared, ApiPath(id): ApiPath<String>) -> ApiResult<(StatusCode, Json<Job>)> {
    let (number, job) = find(&app, &id)?;
    let its_app = app.clone();
    let change = app.compute.run(move || its_app.jobs.resume(number)).await??;
    changed(&app, &id, job, change)
}

/// A job after a request to change it: 200 where that is done, 202 where it will be.
fn changed(app: &App, id: &str, before: Job, change: Change) -> ApiResult<(StatusCode, Json<Job>)> {
    let status = match change {
        Change::Done => StatusCode::OK,
        Change::Requested => StatusCode::ACCEPTED,
        Change::Ended | Change::Unknown => {
            let (_, job) = find(app, id)?;
            let text = format!("the job has ended: it is {:?}", job.state).to_lowercase();
            return Err(Problem::new(Kind::JobEnded, text));
        }
    };
    let job = find(app, id).map_or(before, |(_, job)| job);
    Ok((status, Json(job)))
}

/// The edit of a job that never started stays: shows it, with old light, if no other job is going to.
async fn show_what_is_left(app: &std::sync::Arc<App>, job: &Job) -> ApiResult<()> {
    let Some(scene) = app.ids.parse_scene(&job.scene).and_then(|number| app.scenes.get(number)) else { return Ok(()) };
    let accepted = scene.head.lock().await.sequence;
    let its_app = app.clone();
    Ok(app.compute.run(move || its_app.jobs.show_accepted(&scene, accepted)).await?)
}

pub(super) fn find(app: &App, id: &str) -> ApiResult<(JobNumber, Job)> {
    let unknown = || Problem::new(Kind::UnknownJob, format!("there is no job {id:?}"));
    let number = app.ids.parse_job(id).ok_or_else(unknown)?;
    let (job, about) = app.jobs.get(number).ok_or_else(unknown)?;
    Ok((number, Job::new(&app.ids, &job, &about)))
}
