//! A case's edit as clients get it, through the service over loopback: upload, bake, POST of the edit, download.

use std::sync::Arc;
use std::time::Instant;

use anyhow::Result;
use serde_json::json;

use super::session::{Base, Session, with_session};
use super::study::as_map;
use super::{Goal, Mode, PreparedCase, Timed};

/// Runs a case's edit through a service of its own whose bake takes `base_samples` samples per element. Seconds are
/// from the POST of the edit to the end of its job; the light map is what a client that follows the scene then has, all
/// of it in the part that `mode` measures.
pub fn run_service(case: &PreparedCase, base_samples: u32, goal: Goal, mode: Mode, seed: u64) -> Result<Timed> {
    let base = Base { samples: base_samples, mode, seed };
    with_session(&case.before, base, async |session| through(session, case, goal, mode).await)
}

async fn through(mut session: Session, case: &PreparedCase, goal: Goal, mode: Mode) -> Result<Timed> {
    let mut body = json!({ "edits": session.to_json(&case.edits).await? });
    body["budget"] = match goal {
        Goal::Seconds(seconds) => json!({ "max_seconds": seconds }),
        Goal::Samples(samples) => json!({ "samples_per_element": samples }),
    };
    let start = Instant::now();
    let job = session.edit(&body).await?;
    let job = session.finish(&job.id).await?;
    let seconds = start.elapsed().as_secs_f64();
    session.check_layout(&case.after).await?;
    session.follower.catch_up().await?;
    Ok(Timed {
        map: Arc::new(as_map(session.follower.into_map().0, mode)),
        seconds,
        cpu_seconds: None,
        samples: job.progress.samples_per_element.unwrap_or(0) as u32,
        rays: 0,
        estimated_rmse: job.progress.estimated_rmse.map(|rmse| rmse as f32),
    })
}
