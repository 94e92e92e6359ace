//! The queue and its scheduler, without threads and clocks. Whole states are compared as text.

use jiff::Timestamp;

use super::queue::{
    Change, Ended, Full, Job, JobKind, JobNumber, JobProgress, JobState, Outcome, Priority, Queue, QueueLimits,
    Requests, RunEnd, SceneNumber, Standing,
};
use super::scheduler::{Decision, Spell, UpToDate, idle, is_idle, make_room, tick};

const NOW: Timestamp = Timestamp::UNIX_EPOCH;

fn queue(queued_per_scene: usize, queued: usize, finished: usize) -> Queue {
    Queue::new(QueueLimits { queued_per_scene, queued, finished })
}

fn push(queue: &mut Queue, scene: SceneNumber, kind: JobKind, priority: Priority) -> Result<JobNumber, Full> {
    let number = queue.promise(scene)?;
    queue.push(Job::new(number, scene, kind, priority, NOW));
    Ok(number)
}

fn edit(queue: &mut Queue, scene: SceneNumber) -> JobNumber {
    push(queue, scene, JobKind::Edit, Priority::Normal).unwrap()
}

/// Ends a job; whether that was its next step.
fn finish(queue: &mut Queue, job: JobNumber, end: impl Into<RunEnd>) -> bool {
    !queue.finish(job, &end.into(), NOW).is_empty()
}

/// Starts what the scheduler says until it waits; answers what it started.
fn start_all(queue: &mut Queue, slots: usize) -> Vec<JobNumber> {
    let mut started = Vec::new();
    while let Decision::Start(job) = tick(queue, slots) {
        assert!(queue.start(job, NOW), "a decision that cannot be carried out");
        started.push(job);
    }
    started
}

#[test]
fn a_life_of_a_queue() {
    let mut queue = queue(10, 10, 10);
    push(&mut queue, 1, JobKind::Bake, Priority::Normal).unwrap();
    edit(&mut queue, 1);
    push(&mut queue, 2, JobKind::Bake, Priority::Normal).unwrap();
    edit(&mut queue, 1);
    assert_eq!(start_all(&mut queue, 2), [2, 3], "an edit goes before the bake");
    queue.report(2, JobProgress { fraction: 0.25, ..JobProgress::default() });
    assert_eq!(queue.cancel(4, NOW), Change::Done);
    assert_eq!(queue.cancel(2, NOW), Change::Requested);
    assert_eq!(
        queue.to_string(),
        "1 scene 1 bake queued\n\
         2 scene 1 edit running (to be canceled) 25 %\n\
         3 scene 2 bake running\n\
         4 scene 1 edit canceled\n"
    );
    assert!(finish(&mut queue, 2, Outcome::Canceled));
    assert!(finish(&mut queue, 3, Outcome::Failed("the engine broke".to_owned())));
    assert_eq!(start_all(&mut queue, 2), [1]);
    assert!(finish(&mut queue, 1, Outcome::Succeeded));
    assert_eq!(
        queue.to_string(),
        "1 scene 1 bake succeeded 100 %\n\
         2 scene 1 edit canceled 25 %\n\
         3 scene 2 bake failed: the engine broke\n\
         4 scene 1 edit canceled\n"
    );
}

#[test]
fn what_works_towards_the_target_goes_on_behind_edits() {
    let mut queue = queue(10, 10, 10);
    let bake = push(&mut queue, 1, JobKind::Bake, Priority::High).unwrap();
    assert_eq!(start_all(&mut queue, 2), [bake]);
    let edits = [edit(&mut queue, 1), edit(&mut queue, 1)];
    assert!(finish(&mut queue, bake, RunEnd::Interrupted));
    for next in edits {
        assert_eq!((queue.current(1), start_all(&mut queue, 2)), (Some(next), vec![next]));
        assert!(finish(&mut queue, next, Outcome::Succeeded));
    }
    assert!(queue.has_target_work(1) && !queue.has_target_work(2));
    assert_eq!(start_all(&mut queue, 2), [bake]);
    assert!(finish(&mut queue, bake, Outcome::Succeeded));
    assert!(!queue.has_target_work(1));
}

#[test]
fn what_is_urgent_runs_beside_full_slots_and_others_are_made_room_for() {
    let mut queue = queue(10, 10, 10);
    let bake = push(&mut queue, 1, JobKind::Bake, Priority::Normal).unwrap();
    let busy = edit(&mut queue, 2);
    assert_eq!(start_all(&mut queue, 2), [bake, busy]);
    assert!(make_room(&queue).is_empty(), "nobody waits");
    push(&mut queue, 3, JobKind::Refine, Priority::Low).unwrap();
    assert!(make_room(&queue).is_empty(), "what waits is less urgent");
    let urgent = push(&mut queue, 4, JobKind::Edit, Priority::High).unwrap();
    let second = push(&mut queue, 5, JobKind::Edit, Priority::High).unwrap();
    push(&mut queue, 6, JobKind::Bake, Priority::High).unwrap();
    assert_eq!(start_all(&mut queue, 2), [urgent], "one, and no bake");
    assert_eq!(make_room(&queue), [bake], "edits run to their end");
    assert!(finish(&mut queue, bake, RunEnd::Interrupted) && finish(&mut queue, urgent, Outcome::Succeeded));
    assert_eq!(start_all(&mut queue, 2).first(), Some(&second));
}

#[test]
fn a_long_queue_of_one_scene_does_not_starve_another() {
    let mut queue = queue(100, 100, 100);
    for scene in [1, 1, 1, 2, 3] {
        edit(&mut queue, scene);
    }
    let mut order = Vec::new();
    while let Decision::Start(job) = tick(&queue, 1) {
        queue.start(job, NOW);
        order.push(queue.get(job).map(|job| job.scene).unwrap());
        finish(&mut queue, job, Outcome::Succeeded);
    }
    assert_eq!(order, [1, 2, 3, 1, 1]);
}

#[test]
fn impossible_steps_are_refused() {
    let mut queue = queue(10, 10, 10);
    let (first, second) = (edit(&mut queue, 1), edit(&mut queue, 1));
    assert!(!finish(&mut queue, first, Outcome::Succeeded), "it does not run");
    assert!(queue.start(first, NOW));
    assert!(!queue.start(first, NOW), "it runs already");
    assert!(!queue.start(second, NOW), "its scene is busy");
    assert!(finish(&mut queue, first, Outcome::Succeeded));
    assert!(!finish(&mut queue, first, Outcome::Failed("late".to_owned())), "it has ended");
    assert_eq!(queue.cancel(first, NOW), Change::Ended);
    assert_eq!(queue.cancel(99, NOW), Change::Unknown);
    queue.report(first, JobProgress::default());
    assert_eq!(queue.get(first).map(|job| job.progress.fraction), Some(1.0), "what has ended does not move");
}

#[test]
fn progress_never_falls() {
    let mut queue = queue(10, 10, 10);
    let job = edit(&mut queue, 1);
    queue.start(job, NOW);
    for (reported, shown) in [(0.3, 0.3), (0.1, 0.3), (-1.0, 0.3), (0.5, 0.5), (7.0, 0.999), (f64::NAN, 0.999)] {
        queue.report(job, JobProgress { fraction: reported, ..JobProgress::default() });
        assert_eq!(queue.get(job).map(|job| job.progress.fraction), Some(shown), "{reported}");
    }
}

/// A small generator: the test needs variety, not quality.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }
}

#[test]
fn whatever_happens_the_rules_hold() {
    for seed in 0..300 {
        let mut dice = Dice(seed);
        let mut queue = queue(3, 8, 5);
        let (mut accepted, mut forgotten) = (0u64, 0u64);
        for _ in 0..200 {
            let any = 1 + dice.roll(accepted + 2);
            match dice.roll(6) {
                0 | 1 => match push(&mut queue, dice.roll(4), JobKind::Edit, Priority::Normal) {
                    Ok(number) => {
                        accepted += 1;
                        assert_eq!(number, accepted);
                    }
                    Err(Full::Scene(count)) => assert_eq!(count, 3),
                    Err(Full::Service(count)) => assert_eq!(count, 8),
                    Err(Full::Closed) => unreachable!("a queue is never closed by itself"),
                },
                2 => {
                    start_all(&mut queue, 2);
                }
                3 => {
                    queue.cancel(any, NOW);
                }
                4 => {
                    finish(&mut queue, any, Outcome::Failed("injected".to_owned()));
                }
                _ => {
                    finish(&mut queue, any, Outcome::Succeeded);
                }
            }
            forgotten += queue.take_forgotten().len() as u64;
            check(&queue);
            assert_eq!(queue.iter().count() as u64, accepted - forgotten);
        }
        // In the end everything ends.
        for _ in 0..100 {
            for job in start_all(&mut queue, 2) {
                finish(&mut queue, job, Outcome::Succeeded);
            }
            for scene in 0..4 {
                queue.running_on(scene).map(|job| finish(&mut queue, job, Outcome::Canceled));
            }
        }
        assert!(queue.iter().all(|job| job.has_ended()), "{queue}");
    }
}

fn check(queue: &Queue) {
    let count = |state: JobState| queue.iter().filter(|job| job.state() == state).count();
    assert!(count(JobState::Running) <= 2 && count(JobState::Running) == queue.running(), "{queue}");
    assert!(count(JobState::Queued) <= 8, "{queue}");
    assert!(queue.iter().filter(|job| job.has_ended()).count() <= 5, "{queue}");
    for scene in 0..4 {
        let of_scene = |state| queue.iter().filter(|job| job.scene == scene && job.state() == state).count();
        assert!(of_scene(JobState::Running) <= 1 && of_scene(JobState::Queued) <= 3, "{queue}");
        assert_eq!(queue.open_of(scene).len(), of_scene(JobState::Running) + of_scene(JobState::Queued), "{queue}");
    }
    for job in queue.iter() {
        assert!((0.0..=1.0).contains(&job.progress.fraction));
    }
}

#[test]
fn merged_jobs_end_as_the_one_that_does_their_work() {
    let mut queue = queue(10, 10, 10);
    let (first, second) = (edit(&mut queue, 1), edit(&mut queue, 1));
    let other = edit(&mut queue, 2);
    assert!(!queue.merge(first, second), "it does not run");
    assert!(queue.start(second, NOW));
    assert!(queue.merge(first, second) && !queue.merge(first, second) && !queue.merge(other, second));
    assert_eq!(start_all(&mut queue, 9), [other]);
    assert_eq!(queue.to_string(), "1 scene 1 edit queued (in 2)\n2 scene 1 edit running\n3 scene 2 edit running\n");
    // Interrupted: both wait again, in their old order.
    assert_eq!(queue.pause(second), Change::Requested);
    assert_eq!(queue.finish(second, &RunEnd::Interrupted, NOW), [second, first]);
    assert_eq!(queue.to_string(), "1 scene 1 edit queued\n2 scene 1 edit paused\n3 scene 2 edit running\n");
    assert_eq!(queue.resume(second), Change::Done);
    assert_eq!(start_all(&mut queue, 9), [first]);
    assert!(queue.merge(second, first));
    let preview: Vec<_> = queue
        .preview_finish(first, &Outcome::Succeeded.into(), NOW)
        .iter()
        .map(|job| (job.number, job.state()))
        .collect();
    assert_eq!(preview, [(first, JobState::Succeeded), (second, JobState::Succeeded)]);
    assert!(finish(&mut queue, first, Outcome::Succeeded));
    assert_eq!(
        queue.to_string(),
        "1 scene 1 edit succeeded 100 %\n2 scene 1 edit succeeded (in 1) 100 %\n3 scene 2 edit running\n"
    );
}

#[test]
fn paused_jobs_are_out_of_line_and_count_as_waiting() {
    let mut queue = queue(2, 10, 10);
    let first = edit(&mut queue, 1);
    assert_eq!(queue.pause(first), Change::Done);
    let second = edit(&mut queue, 1);
    assert_eq!(queue.promise(1), Err(Full::Scene(2)));
    assert_eq!(start_all(&mut queue, 9), [second]);
    assert_eq!(queue.cancel(first, NOW), Change::Done);
    assert_eq!((queue.pause(first), queue.resume(first)), (Change::Ended, Change::Ended));
    assert_eq!(queue.waiting(), 0);
}

#[test]
fn high_priorities_go_first_but_nothing_waits_for_ever() {
    let mut queue = queue(100, 100, 100);
    let low = push(&mut queue, 1, JobKind::Edit, Priority::Low).unwrap();
    let mut starts = 0;
    loop {
        // There is always something more urgent, of a scene of its own.
        push(&mut queue, 100 + starts, JobKind::Edit, Priority::High).unwrap();
        let Decision::Start(job) = tick(&queue, 1) else { panic!("something waits") };
        queue.start(job, NOW);
        finish(&mut queue, job, Outcome::Succeeded);
        if job == low {
            break;
        }
        starts += 1;
        assert!(starts < 50, "it waits for ever");
    }
    assert!(starts >= 8, "after {starts}");
}

#[test]
fn jobs_of_an_earlier_life_wait_again() {
    let mut queue = queue(10, 10, 10);
    let ended = |outcome| {
        let requests = Requests::default();
        Standing::Ended(Ended { outcome, started_at: Some(NOW), finished_at: NOW, merged_into: Some(1), requests })
    };
    let standings = [
        Standing::Waiting { turn: 9, merged_into: Some(2), started_at: Some(NOW) },
        Standing::Running { started_at: NOW, requests: Requests::default() },
        Standing::Paused { started_at: None },
        ended(Outcome::Succeeded),
        ended(Outcome::Failed("it broke".to_owned())),
        ended(Outcome::Canceled),
        Standing::Running { started_at: NOW, requests: Requests { pause: true, cancel: false } },
    ];
    for (number, standing) in (1..).zip(standings) {
        queue.restore(Job { standing, ..Job::new(number, 1, JobKind::Edit, Priority::Normal, NOW) });
    }
    assert_eq!(
        queue.to_string(),
        "1 scene 1 edit queued\n2 scene 1 edit queued\n3 scene 1 edit paused\n4 scene 1 edit succeeded (in 1)\n\
         5 scene 1 edit failed (in 1): it broke\n6 scene 1 edit canceled (in 1)\n7 scene 1 edit paused\n"
    );
    let started: Vec<_> = queue.iter().filter_map(|job| job.started_at().map(|_| job.number)).collect();
    assert_eq!(started, [1, 4, 5, 6], "what ran then runs no more");
    assert_eq!(queue.promise(1), Ok(8));
    assert_eq!(queue.waiting(), 5);
}

#[test]
fn only_what_runs_or_could_run_keeps_the_service_busy() {
    let mut queue = queue(10, 10, 10);
    assert!(is_idle(&queue));
    let (first, second) = (edit(&mut queue, 1), edit(&mut queue, 2));
    assert!(!is_idle(&queue), "both wait");
    queue.pause(second);
    assert_eq!(start_all(&mut queue, 1), [first]);
    assert!(!is_idle(&queue), "one runs");
    finish(&mut queue, first, Outcome::Succeeded);
    assert!(is_idle(&queue), "a paused one does not count");
    queue.resume(second);
    assert!(!is_idle(&queue));
}

#[test]
fn idle_time_goes_to_the_worst_scene_until_all_are_good_enough() {
    let scene = |scene, stated, mean| UpToDate { scene, stated, mean };
    let spell = |scene, target| Some(Spell { scene, target });
    // The error counts as a part of the light: a dark scene needs a smaller one.
    let scenes = [scene(1, 0.08, 2.0), scene(2, 0.05, 0.5), scene(3, 0.01, 0.5)];
    assert_eq!(idle(&scenes, 0.01), spell(2, 0.025));
    assert_eq!(idle(&scenes, 0.08), spell(2, 0.04), "no further than asked for");
    assert_eq!(idle(&scenes, 0.1), None);
    assert_eq!(idle(&[], 0.1), None);
    assert_eq!(idle(&[scene(2, 0.1, 1.0), scene(1, 0.1, 1.0)], 0.01), spell(1, 0.05), "among equals the oldest");
    // What states no error, is black, or makes no sense is left alone.
    for odd in [(0.0, 1.0), (0.1, 0.0), (f64::NAN, 1.0), (0.1, f64::NAN), (f64::INFINITY, 1.0), (0.1, -1.0)] {
        assert_eq!(idle(&[scene(1, odd.0, odd.1)], 0.01), None, "{odd:?}");
    }
}

#[test]
fn a_round_of_spells_ends() {
    // Each spell brings a scene to its target: how many until all are good enough?
    let mut scenes =
        [(1, 1.0, 1.0), (2, 0.3, 2.0), (3, 5.0, 0.7)].map(|(scene, stated, mean)| UpToDate { scene, stated, mean });
    let mut spells = 0;
    while let Some(spell) = idle(&scenes, 0.01) {
        let worst = scenes.iter_mut().find(|scene| scene.scene == spell.scene).unwrap();
        assert!(spell.target < worst.stated);
        worst.stated = spell.target;
        spells += 1;
    }
    assert_eq!(spells, 7 + 4 + 10);
}
