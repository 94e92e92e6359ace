//! A case's edit as clients get it, through a service over loopback: upload, bake, POST of the edit, deltas.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use rebake::client::EditOptions;
use rebake_core::{Focus, LightMap, Stated, World};
use rebake_lab::bench::{Base, Drag, Goal, PreparedCase, Seen, Service, Timed, as_map};
use serde_json::{Map, Value, json};

use super::session::{Session, with_session};

/// Services in this process, one after the other.
pub(super) struct Loopback;

impl Service for Loopback {
    fn read_focus(&self, focus: &Value, world: &World) -> Result<Focus> {
        rebake::api::read_focus(focus, world).map_err(anyhow::Error::msg)
    }

    fn run(&self, case: &PreparedCase, base: Base, goal: Goal) -> Result<Timed> {
        with_session(&case.before, base, async |session| run(session, case, goal, base.mode).await)
    }

    fn watch(&self, case: &PreparedCase, base: Base, beside: Map<String, Value>) -> Result<Vec<Seen>> {
        with_session(&case.before, base, async |session| watch(session, case, beside).await)
    }

    fn drag(&self, before: &World, base: Base, drag: &Drag) -> Result<Vec<Seen>> {
        with_session(before, base, async |session| self::drag(session, before, drag).await)
    }
}

async fn run(mut session: Session, case: &PreparedCase, goal: Goal, mode: Stated) -> Result<Timed> {
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
    let map: LightMap = as_map(session.follower.into_map().0, mode);
    Ok(Timed {
        map: Arc::new(map),
        seconds,
        cpu_seconds: None,
        samples: job.progress.samples_per_element.unwrap_or(0) as u32,
        rays: 0,
        estimated_rmse: job.progress.estimated_rmse.map(|rmse| rmse as f32),
    })
}

async fn watch(mut session: Session, case: &PreparedCase, mut body: Map<String, Value>) -> Result<Vec<Seen>> {
    body.insert("edits".to_owned(), session.to_json(&case.edits).await?.into());
    let start = Instant::now();
    let job = session.edit(&body.into()).await?;
    let seen = session.watch(&job.id, start).await?;
    session.check_layout(&case.after).await?;
    Ok(seen)
}

/// Posts all steps and takes in what comes: the map before them first. Every step but the last has time until the next.
async fn drag(mut session: Session, before: &World, drag: &Drag) -> Result<Vec<Seen>> {
    session.check_layout(before).await?;
    let mut shown = vec![session.see(Duration::ZERO)];
    let mut bodies = Vec::new();
    for (k, edits) in drag.steps.iter().enumerate() {
        let mut body = json!({ "edits": session.to_json(edits).await? });
        if k + 1 < drag.steps.len() {
            body["budget"] = json!({ "max_seconds": drag.pause.as_secs_f64() });
        }
        bodies.push(body);
    }
    let (client, scene) = (session.client.clone(), session.scene.clone());
    let start = Instant::now();
    let post = async {
        let mut pace = tokio::time::interval(drag.pause);
        for body in &bodies {
            pace.tick().await;
            client.edit(&scene, body, &EditOptions::default()).await?;
        }
        std::future::pending::<Result<()>>().await
    };
    let take = async {
        loop {
            session.follower.next().await?;
            shown.push(session.see(start.elapsed()));
        }
    };
    let end = tokio::time::sleep_until((start + drag.duration).into());
    let failed: Result<()> = tokio::select! {
        () = end => Ok(()),
        failed = post => failed,
        failed = take => failed,
    };
    failed.map(|()| shown)
}
