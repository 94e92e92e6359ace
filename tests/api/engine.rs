//! A stand-in for the engine that goes on only when a test says so. Worlds and edits are the real ones.

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use glam::Vec3;
use rebake::engine::{Budget, Canceled, Engine, LightMap, Observer, Progress, Snapshot, Update, World};
use rebake_core::Pass;

/// What the job that runs does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// One round, and a snapshot.
    Round,
    /// Half of the last pass of a round.
    Half,
    /// The end.
    Finish,
    /// A fault in the engine.
    Panic,
}

/// The engine's side.
#[derive(Debug)]
pub(crate) struct Scripted {
    steps: Mutex<Steps>,
    /// While no job waits.
    idle_steps: Mutex<Steps>,
}

/// The test's side.
#[derive(Debug)]
pub(crate) struct Script {
    steps: Sender<Step>,
    idle_steps: Sender<Step>,
}

impl Scripted {
    /// An engine and its script.
    pub(crate) fn new() -> (Arc<Scripted>, Script) {
        let ((steps, taken), (idle_steps, idle_taken)) = (channel(), channel());
        let steps_of = |receiver| Mutex::new(Steps { receiver, left: None });
        let engine = Scripted { steps: steps_of(taken), idle_steps: steps_of(idle_taken) };
        (Arc::new(engine), Script { steps, idle_steps })
    }

    fn work(
        &self,
        world: &World,
        old: &LightMap,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Arc<LightMap>, Canceled> {
        let mut map = Arc::new(old.clone());
        let mut progress = Progress {
            pass: Pass::Direct,
            samples_per_element: 0,
            round_samples: 4,
            round_fraction: 0.0,
            pass_share: 0.0,
            rays: 0,
            estimated_rmse: None,
            needed: None,
        };
        observer.progress(&progress);
        loop {
            match next_step(&self.steps, observer)? {
                Step::Finish => return Ok(map),
                Step::Panic => panic!("scripted panic"),
                Step::Round => {}
                Step::Half => {
                    observer.plan_round(&progress, 4);
                    observer.progress(&Progress { round_fraction: 0.4, pass_share: 0.6, ..progress });
                    observer.advanced(0.5);
                    continue;
                }
            }
            if observer.plan_round(&progress, 4) == 0 {
                return Ok(map);
            }
            progress.samples_per_element += 4;
            progress.rays += 1000;
            progress.estimated_rmse = Some(1.0 / progress.samples_per_element as f32);
            map = Arc::new(values(world, &map, seed, progress.samples_per_element));
            observer.snapshot(&map, Snapshot::Complete { stated: progress.estimated_rmse }, &progress);
        }
    }
}

/// Steps that a test has sent.
#[derive(Debug)]
struct Steps {
    receiver: Receiver<Step>,
    /// Came just when the work was canceled: the next one's.
    left: Option<Step>,
}

fn next_step(steps: &Mutex<Steps>, observer: &dyn Observer) -> Result<Step, Canceled> {
    loop {
        let mut steps = steps.lock().unwrap();
        let next = match steps.left.take() {
            Some(step) => Ok(step),
            None => steps.receiver.recv_timeout(Duration::from_millis(5)),
        };
        if observer.canceled() {
            steps.left = next.ok();
            return Err(Canceled);
        }
        match next {
            Ok(step) => return Ok(step),
            Err(RecvTimeoutError::Timeout) => {}
            // The test is over.
            Err(RecvTimeoutError::Disconnected) => return Ok(Step::Finish),
        }
    }
}

/// About half of the elements get a new value in every round.
fn values(world: &World, old: &LightMap, seed: u64, samples: u32) -> LightMap {
    let mut map = old.clone();
    for (slot, area) in world.areas().iter().enumerate() {
        let hash = (slot as u64 ^ seed).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(samples) >> 40;
        if *area > 0.0 && hash.is_multiple_of(2) {
            map.light.direct[slot] = Vec3::splat(hash as f32 / 1e6);
            map.light.indirect[slot] = Vec3::new(hash as f32 / 2e6, 0.0, -0.0);
        }
        if *area > 0.0 {
            map.light.variance[slot] = (samples as f32).powi(-2);
        }
    }
    map
}

impl Engine for Scripted {
    fn bake(
        &self,
        world: &World,
        _budget: &Budget,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Arc<LightMap>, Canceled> {
        self.work(world, &LightMap::black(world.slots()), seed, observer)
    }

    fn update(&self, work: &Update<'_>, observer: &dyn Observer) -> Result<Arc<LightMap>, Canceled> {
        let carried = work.transition.carry_over(work.map);
        self.work(&work.transition.after, &carried, work.seed, observer)
    }

    /// Every round halves the stated error.
    fn refine(
        &self,
        world: &World,
        map: &LightMap,
        _budget: &Budget,
        seed: u64,
        observer: &dyn Observer,
    ) -> Result<Arc<LightMap>, Canceled> {
        let mut map = Arc::new(map.clone());
        let mut progress = Progress {
            pass: Pass::Direct,
            samples_per_element: 0,
            round_samples: 4,
            round_fraction: 0.0,
            pass_share: 0.0,
            rays: 0,
            estimated_rmse: None,
            needed: None,
        };
        loop {
            match next_step(&self.idle_steps, observer)? {
                Step::Finish => return Ok(map),
                Step::Panic => panic!("scripted panic"),
                Step::Round => {}
                Step::Half => panic!("refining has no passes here"),
            }
            if observer.plan_round(&progress, 4) == 0 {
                return Ok(map);
            }
            progress.samples_per_element += 4;
            let mut better = values(world, &map, seed, progress.samples_per_element);
            better.light.variance = map.light.variance.iter().map(|variance| variance / 4.0).collect();
            map = Arc::new(better);
            progress.estimated_rmse = Some(map.estimated_rmse(world.areas()));
            observer.snapshot(&map, Snapshot::Complete { stated: progress.estimated_rmse }, &progress);
        }
    }
}

impl Script {
    /// Lets the running job take these steps.
    pub(crate) fn run(&self, steps: &[Step]) {
        for step in steps {
            // A server that has ended needs no more steps.
            let _ = self.steps.send(*step);
        }
    }

    /// Lets refining take these steps, while no job waits.
    pub(crate) fn refine(&self, steps: &[Step]) {
        for step in steps {
            let _ = self.idle_steps.send(*step);
        }
    }
}
