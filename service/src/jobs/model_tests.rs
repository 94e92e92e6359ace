//! The queue against a model in which a job has the fields of all states side by side, as clients see it: whatever
//! happens, both tell the same, also when the service is started again.

use std::collections::{BTreeMap, HashSet};

use jiff::Timestamp;

use super::JobSpec;
use super::budget::JobBudget;
use super::queue::{
    Change, Job, JobKind, JobNumber, JobState, Outcome, Priority, Queue, QueueLimits, RunEnd, SceneNumber,
};
use super::tests::Dice;
use crate::store::records::JobRecord;

/// A job as its JSON tells of it.
#[derive(Clone, Debug, PartialEq)]
struct Told {
    scene: SceneNumber,
    state: JobState,
    cancel_requested: bool,
    pause_requested: bool,
    merged_into: Option<JobNumber>,
    started_at: Option<Timestamp>,
    finished_at: Option<Timestamp>,
}

impl Told {
    fn of(job: &Job) -> Told {
        Told {
            scene: job.scene,
            state: job.state(),
            cancel_requested: job.requests().cancel,
            pause_requested: job.requests().pause,
            merged_into: job.merged_into(),
            started_at: job.started_at(),
            finished_at: job.ended().map(|ended| ended.finished_at),
        }
    }

    fn end(&mut self, state: JobState, now: Timestamp) {
        (self.state, self.finished_at) = (state, Some(now));
    }

    fn waits(&self) -> bool {
        matches!(self.state, JobState::Queued | JobState::Paused)
    }
}

#[derive(Default)]
struct Model {
    jobs: BTreeMap<JobNumber, Told>,
    preparing: HashSet<SceneNumber>,
}

impl Model {
    fn push(&mut self, number: JobNumber, scene: SceneNumber) {
        let told = Told {
            scene,
            state: JobState::Queued,
            cancel_requested: false,
            pause_requested: false,
            merged_into: None,
            started_at: None,
            finished_at: None,
        };
        self.jobs.insert(number, told);
    }

    fn is_in_line(&self, job: &Told) -> bool {
        job.state == JobState::Queued && job.merged_into.is_none() && !self.preparing.contains(&job.scene)
    }

    fn runs_on(&self, scene: SceneNumber) -> bool {
        self.jobs.values().any(|job| job.scene == scene && job.state == JobState::Running)
    }

    fn start(&mut self, number: JobNumber, now: Timestamp) -> bool {
        let may = self.jobs.get(&number).is_some_and(|job| self.is_in_line(job) && !self.runs_on(job.scene));
        if may && let Some(job) = self.jobs.get_mut(&number) {
            (job.state, job.started_at) = (JobState::Running, Some(now));
        }
        may
    }

    fn merge(&mut self, number: JobNumber, into: JobNumber) -> bool {
        let scene = self.jobs.get(&into).filter(|job| job.state == JobState::Running).map(|job| job.scene);
        let may = self.jobs.get(&number).is_some_and(|job| self.is_in_line(job) && Some(job.scene) == scene);
        if may && let Some(job) = self.jobs.get_mut(&number) {
            job.merged_into = Some(into);
        }
        may
    }

    fn finish(&mut self, number: JobNumber, end: &RunEnd, now: Timestamp) {
        let Some(job) = self.jobs.get_mut(&number).filter(|job| job.state == JobState::Running) else { return };
        match end {
            RunEnd::Ended(Outcome::Succeeded) => job.end(JobState::Succeeded, now),
            RunEnd::Ended(Outcome::Failed(_)) => job.end(JobState::Failed, now),
            RunEnd::Ended(Outcome::Canceled) => job.end(JobState::Canceled, now),
            RunEnd::Interrupted if job.cancel_requested => job.end(JobState::Canceled, now),
            RunEnd::Interrupted if job.pause_requested => job.state = JobState::Paused,
            RunEnd::Interrupted => job.state = JobState::Queued,
        }
        for other in self.jobs.values_mut().filter(|job| job.waits() && job.merged_into == Some(number)) {
            match end {
                RunEnd::Ended(Outcome::Succeeded) => other.end(JobState::Succeeded, now),
                RunEnd::Ended(Outcome::Failed(_)) => other.end(JobState::Failed, now),
                RunEnd::Ended(Outcome::Canceled) | RunEnd::Interrupted => other.merged_into = None,
            }
        }
    }

    fn pause(&mut self, number: JobNumber) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        match job.state {
            JobState::Queued | JobState::Paused => {
                (job.state, job.merged_into, job.pause_requested) = (JobState::Paused, None, true);
                Change::Done
            }
            JobState::Running => {
                job.pause_requested = true;
                Change::Requested
            }
            _ => Change::Ended,
        }
    }

    fn resume(&mut self, number: JobNumber) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        if job.finished_at.is_some() {
            return Change::Ended;
        }
        job.pause_requested = false;
        if job.state == JobState::Paused {
            job.state = JobState::Queued;
        }
        Change::Done
    }

    fn cancel(&mut self, number: JobNumber, now: Timestamp) -> Change {
        let Some(job) = self.jobs.get_mut(&number) else { return Change::Unknown };
        match job.state {
            JobState::Queued | JobState::Paused => {
                job.merged_into = None;
                job.end(JobState::Canceled, now);
                Change::Done
            }
            JobState::Running => {
                job.cancel_requested = true;
                Change::Requested
            }
            _ => Change::Ended,
        }
    }

    fn fail(&mut self, number: JobNumber, now: Timestamp) -> bool {
        let waiting = self.jobs.get_mut(&number).filter(|job| job.waits());
        waiting.map(|job| job.end(JobState::Failed, now)).is_some()
    }

    fn restart(&mut self, now: Timestamp) {
        self.preparing.clear();
        for job in self.jobs.values_mut().filter(|job| job.finished_at.is_none()) {
            if job.cancel_requested {
                job.end(JobState::Canceled, now);
                continue;
            }
            if job.state == JobState::Running {
                job.started_at = None;
            }
            (job.state, job.merged_into) =
                (if job.pause_requested { JobState::Paused } else { JobState::Queued }, None);
        }
    }
}

const LIMITS: QueueLimits = QueueLimits { queued_per_scene: 6, queued: 12, finished: 1000 };

/// What the next life of the service makes of a queue, by what is stored.
fn restarted(queue: &Queue, now: Timestamp) -> Queue {
    let budget = JobBudget { samples_per_element: 1, max_seconds: None, target_rmse: None, by_error: false };
    let mut next = Queue::new(LIMITS);
    for job in queue.iter() {
        let record = JobRecord { job: job.clone(), spec: JobSpec::new(budget, 1, 0) };
        let text = serde_json::to_string(&record).unwrap();
        let mut record: JobRecord = serde_json::from_str(&text).unwrap();
        assert_eq!(Told::of(&record.job), Told::of(job), "{text}");
        if record.job.requests().cancel {
            record.job.end(Outcome::Canceled, now);
        }
        next.restore(record.job);
    }
    next
}

#[test]
fn whatever_happens_clients_are_told_what_the_model_says() {
    for seed in 0..200 {
        let (mut dice, mut queue, mut model) = (Dice(seed), Queue::new(LIMITS), Model::default());
        let mut log = Vec::new();
        for second in 0..150 {
            let now = Timestamp::from_second(second).unwrap();
            let pushed = model.jobs.len() as u64;
            let (any, other, scene) = (1 + dice.roll(pushed + 2), 1 + dice.roll(pushed + 2), 1 + dice.roll(3));
            let choice = dice.roll(26);
            log.push((choice, any, other, scene));
            match choice {
                0..=4 => {
                    if let Ok(number) = queue.promise(scene) {
                        let kind = if dice.roll(3) == 0 { JobKind::Bake } else { JobKind::Edit };
                        queue.push(Job::new(number, scene, kind, Priority::Normal, now));
                        model.push(number, scene);
                    }
                }
                5..=10 => assert_eq!(queue.start(any, now), model.start(any, now), "{log:?}\n{queue}"),
                11..=13 => assert_eq!(queue.merge(any, other), model.merge(any, other), "{log:?}\n{queue}"),
                14..=17 => {
                    let end = match dice.roll(5) {
                        0 => Outcome::Succeeded.into(),
                        1 => Outcome::Failed("injected".to_owned()).into(),
                        2 => Outcome::Canceled.into(),
                        _ => RunEnd::Interrupted,
                    };
                    let preview = queue.preview_finish(any, &end, now);
                    let changed = queue.finish(any, &end, now);
                    let ended = changed.iter().filter_map(|job| queue.get(*job)).filter(|job| job.has_ended());
                    assert!(ended.eq(&preview), "{log:?}\n{queue}");
                    model.finish(any, &end, now);
                }
                18..=19 => assert_eq!(queue.pause(any), model.pause(any), "{log:?}\n{queue}"),
                20..=21 => assert_eq!(queue.resume(any), model.resume(any), "{log:?}\n{queue}"),
                22 => assert_eq!(queue.cancel(any, now), model.cancel(any, now), "{log:?}\n{queue}"),
                23 => assert_eq!(queue.fail(any, "injected", now), model.fail(any, now), "{log:?}\n{queue}"),
                24 if model.preparing.remove(&scene) => queue.scene_prepared(scene),
                24 if !model.runs_on(scene) => {
                    queue.scene_preparing(scene);
                    model.preparing.insert(scene);
                }
                24 => {}
                _ if dice.roll(4) == 0 => {
                    queue = restarted(&queue, now);
                    model.restart(now);
                }
                _ => {}
            }
            let told: BTreeMap<_, _> = queue.iter().map(|job| (job.number, Told::of(job))).collect();
            assert_eq!(told, model.jobs, "seed {seed}: {log:?}\n{queue}");
            let waiting = model.jobs.values().filter(|job| job.waits()).count();
            assert_eq!(queue.waiting(), waiting, "seed {seed}: {log:?}\n{queue}");
            let running = model.jobs.values().filter(|job| job.state == JobState::Running).count();
            assert_eq!(queue.running(), running, "seed {seed}: {log:?}\n{queue}");
            let in_line = model.jobs.iter().filter(|(_, job)| model.is_in_line(job)).map(|(number, _)| *number);
            assert!(queue.in_line().map(|job| job.number).eq(in_line), "seed {seed}: {log:?}\n{queue}");
        }
    }
}
