//! The stored form of a job, which data directories of all builds have: every field of every state, side by side.

use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::jobs::queue::{
    Ended, Job, JobKind, JobNumber, JobProgress, JobState, Outcome, Priority, Requests, SceneNumber, Standing,
};

#[derive(Serialize, Deserialize)]
struct StoredJob {
    number: JobNumber,
    scene: SceneNumber,
    kind: JobKind,
    priority: Priority,
    state: JobState,
    cancel_requested: bool,
    pause_requested: bool,
    merged_into: Option<JobNumber>,
    progress: JobProgress,
    created_at: Timestamp,
    started_at: Option<Timestamp>,
    finished_at: Option<Timestamp>,
    error: Option<String>,
}

pub(super) fn serialize<S: Serializer>(job: &Job, serializer: S) -> Result<S::Ok, S::Error> {
    let (ended, requests) = (job.ended(), job.requests());
    let stored = StoredJob {
        number: job.number,
        scene: job.scene,
        kind: job.kind,
        priority: job.priority,
        state: job.state(),
        cancel_requested: requests.cancel,
        pause_requested: requests.pause,
        merged_into: job.merged_into(),
        progress: job.progress,
        created_at: job.created_at,
        started_at: job.started_at(),
        finished_at: ended.map(|ended| ended.finished_at),
        error: ended.and_then(|ended| ended.outcome.error().map(str::to_owned)),
    };
    stored.serialize(serializer)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Job, D::Error> {
    let stored = StoredJob::deserialize(deserializer)?;
    Ok(Job {
        standing: standing(&stored),
        number: stored.number,
        scene: stored.scene,
        kind: stored.kind,
        priority: stored.priority,
        progress: stored.progress,
        created_at: stored.created_at,
    })
}

fn standing(stored: &StoredJob) -> Standing {
    let StoredJob { merged_into, started_at, .. } = *stored;
    let requests = Requests { pause: stored.pause_requested, cancel: stored.cancel_requested };
    let ended = |outcome: Outcome| {
        let finished_at = stored.finished_at.unwrap_or(stored.created_at);
        Standing::Ended(Ended { outcome, started_at, finished_at, merged_into, requests })
    };
    match (stored.state, started_at) {
        (JobState::Succeeded, _) => ended(Outcome::Succeeded),
        (JobState::Failed, _) => ended(Outcome::Failed(stored.error.clone().unwrap_or_default())),
        (JobState::Canceled, _) => ended(Outcome::Canceled),
        (JobState::Running, Some(started_at)) => Standing::Running { started_at, requests },
        // Earlier builds let one that was asked to stop as it made way wait for its next run.
        (_, Some(started_at)) if requests.cancel => Standing::Running { started_at, requests },
        // Earlier builds kept the pause of one that waited without its state.
        _ if requests.pause => Standing::Paused { started_at },
        _ => Standing::Waiting { turn: 0, merged_into, started_at },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Kept(#[serde(with = "super")] Job);

    /// A record as all builds write it, with what differs between states.
    fn text([state, merged_into, started_at, finished_at, error]: [&str; 5]) -> String {
        let progress =
            r#"{"fraction":0.5,"samples_per_element":3,"elapsed_ms":9,"estimated_rmse":null,"rays":11,"version":4}"#;
        let job =
            format!(r#""number":7,"scene":2,"kind":"edit","priority":"high",{state},"merged_into":{merged_into}"#);
        let began = format!(r#""created_at":"2026-11-23T09:00:00Z","started_at":{started_at}"#);
        format!(r#"{{{job},"progress":{progress},{began},"finished_at":{finished_at},"error":{error}}}"#)
    }

    const NO: &str = r#""cancel_requested":false,"pause_requested":false"#;
    const CANCEL: &str = r#""cancel_requested":true,"pause_requested":false"#;
    const PAUSE: &str = r#""cancel_requested":false,"pause_requested":true"#;
    const STARTED: &str = r#""2026-11-23T09:00:01Z""#;
    const FINISHED: &str = r#""2026-11-23T09:00:02Z""#;

    fn read(text: &str) -> Job {
        let Kept(job) = serde_json::from_str(text).unwrap();
        job
    }

    #[test]
    fn jobs_of_all_states_are_kept_as_they_always_were() {
        let (started_at, finished_at) = (Some(STARTED.trim_matches('"').parse().unwrap()), FINISHED.trim_matches('"'));
        let finished_at = finished_at.parse().unwrap();
        let asked = |pause, cancel| Requests { pause, cancel };
        let running = |requests| Standing::Running { started_at: started_at.unwrap(), requests };
        let ended = |outcome, merged_into, requests| {
            Standing::Ended(Ended { outcome, started_at, finished_at, merged_into, requests })
        };
        let waiting = |merged_into, started_at| Standing::Waiting { turn: 0, merged_into, started_at };
        for (state, asked_for, rest, standing) in [
            ("queued", NO, ["null", "null", "null", "null"], waiting(None, None)),
            ("queued", NO, ["8", STARTED, "null", "null"], waiting(Some(8), started_at)),
            ("running", NO, ["null", STARTED, "null", "null"], running(asked(false, false))),
            ("running", PAUSE, ["null", STARTED, "null", "null"], running(asked(true, false))),
            ("running", CANCEL, ["null", STARTED, "null", "null"], running(asked(false, true))),
            ("paused", PAUSE, ["null", "null", "null", "null"], Standing::Paused { started_at: None }),
            ("paused", PAUSE, ["null", STARTED, "null", "null"], Standing::Paused { started_at }),
            (
                "succeeded",
                NO,
                ["8", STARTED, FINISHED, "null"],
                ended(Outcome::Succeeded, Some(8), asked(false, false)),
            ),
            (
                "canceled",
                CANCEL,
                ["null", STARTED, FINISHED, "null"],
                ended(Outcome::Canceled, None, asked(false, true)),
            ),
            (
                "failed",
                PAUSE,
                ["null", STARTED, FINISHED, r#""it broke""#],
                ended(Outcome::Failed("it broke".to_owned()), None, asked(true, false)),
            ),
        ] {
            let [merged_into, started, finished, error] = rest;
            let text = text([&format!(r#""state":"{state}",{asked_for}"#), merged_into, started, finished, error]);
            let job = read(&text);
            assert_eq!(job.standing, standing, "{text}");
            assert_eq!((job.state().as_str(), job.progress.version), (state, Some(4)));
            assert_eq!(serde_json::to_string(&Kept(job)).unwrap(), text);
        }
    }

    #[test]
    fn combinations_that_cannot_be_are_read_as_what_was_meant() {
        let of = |state: &str, asked_for: &str, started: &str| {
            read(&text([&format!(r#""state":"{state}",{asked_for}"#), "null", started, "null", "null"]))
        };
        // Paused while it waited, by a build that kept the request and not the state.
        assert_eq!(of("queued", PAUSE, "null").standing, Standing::Paused { started_at: None });
        // Asked to stop just as it made way: its cancel is not forgotten.
        assert!(of("queued", CANCEL, STARTED).requests().cancel);
        assert_eq!(of("running", NO, "null").state(), JobState::Queued);
        assert_eq!(of("paused", NO, "null").state(), JobState::Queued);
        let created = of("succeeded", NO, "null");
        assert_eq!(created.ended().map(|ended| ended.finished_at), Some(created.created_at));
    }
}
