//! How far a piece of work is between what the engine tells, and how long it will take: measured on its rounds. Without a
//! clock.

use super::budget::speed;
use crate::engine::Progress;

/// Samples of the shortest round.
const SHORTEST_ROUND: u32 = 4;

/// Part of the first round after which its pace says something.
const MEASURED: f64 = 0.02;

/// Follows the rounds of one piece of work. Times are seconds from any moment on.
#[derive(Debug, Default)]
pub(super) struct Forecast {
    running: Option<Running>,
    /// The last round that ended: its seconds and samples.
    last: Option<(f64, u32)>,
    /// The one before.
    before: Option<(f64, u32)>,
    /// Where the passes of the last round and their loops began: as the engine told, and in parts of its time.
    passes: Vec<(f64, f64)>,
}

/// A round that runs.
#[derive(Debug)]
struct Running {
    began: f64,
    samples: u32,
    /// Where its passes and their loops began: as the engine told, and seconds after it did.
    passes: Vec<(f64, f64)>,
    /// The pass that runs: where it begins and how much it takes, as the engine told.
    pass: (f64, f64),
    /// Its loops so far.
    loops: i32,
    /// Part that is done, as the engine told.
    part: f64,
}

impl Forecast {
    /// A round begins, and the one before it has ended.
    pub(super) fn round(&mut self, now: f64, samples: u32) {
        self.end_round(now);
        self.running = Some(Running { began: now, samples, passes: Vec::new(), pass: (0.0, 0.0), loops: 0, part: 0.0 });
    }

    /// The round that runs has ended.
    fn end_round(&mut self, now: f64) {
        let Some(mut running) = self.running.take() else { return };
        running.end_pass(now);
        let Running { began, samples, passes, .. } = running;
        let secs = (now - began).max(f64::MIN_POSITIVE);
        self.passes = passes.into_iter().map(|(told, at)| (told, at / secs)).collect();
        self.before = self.last.replace((secs, samples));
    }

    /// The engine tells of a pass, or that the round has ended.
    pub(super) fn told(&mut self, now: f64, progress: &Progress) {
        if progress.round_fraction >= 1.0 {
            return self.end_round(now);
        }
        let Some(running) = &mut self.running else { return };
        let begins = f64::from(progress.round_fraction.clamp(0.0, 1.0));
        running.end_pass(now);
        (running.pass, running.loops) = ((begins, f64::from(progress.pass_share.max(0.0))), 0);
        running.reaches(begins, now);
    }

    /// So much of a loop of the pass is done that runs; with 0 one begins. How many there will be is not known: each takes
    /// half of what is left of the pass, until the last round tells how long they take.
    pub(super) fn advance(&mut self, now: f64, part: f32) {
        let Some(running) = &mut self.running else { return };
        running.loops = (running.loops + i32::from(part == 0.0)).max(1);
        if part == 0.0 {
            running.reaches(running.within(0.0), now);
        }
        running.part = running.part.max(running.within(f64::from(part.clamp(0.0, 1.0))));
    }

    /// Part of the round's time that is over, as far as the last round tells.
    pub(super) fn part(&self) -> f64 {
        let Some(running) = &self.running else { return 0.0 };
        let (mut from, mut upto) = ((0.0, 0.0), (1.0, 1.0));
        for pass in &self.passes {
            match pass.0 <= running.part {
                true => from = *pass,
                false => {
                    upto = *pass;
                    break;
                }
            }
        }
        let within = (running.part - from.0) / (upto.0 - from.0).max(f64::MIN_POSITIVE);
        from.1 + (upto.1 - from.1) * within.clamp(0.0, 1.0)
    }

    /// Seconds until so many samples are done, of which `done` are: every round is as long as all before it, and the last
    /// may go beyond. None while nothing is measured.
    pub(super) fn remaining(&self, now: f64, done: u32, wanted: f64, budget: u32) -> Option<f64> {
        let (mut secs, round, mut done) = match (&self.running, self.last) {
            (Some(running), last) => {
                let part = self.part();
                let over = now - running.began;
                let whole = match last {
                    Some(last) => {
                        let (fixed, per_sample) = speed(last, self.before);
                        // The farther it is, the more its own pace counts.
                        over + (1.0 - part) * (fixed + per_sample * f64::from(running.samples))
                    }
                    None if part >= MEASURED => over / part,
                    None => return None,
                };
                ((1.0 - part) * whole, (whole, running.samples), done + running.samples)
            }
            (None, Some(last)) => (0.0, last, done),
            (None, None) => return None,
        };
        let (fixed, per_sample) = speed(round, self.running.as_ref().and(self.last).or(self.before));
        while done < budget && f64::from(done) < wanted {
            let samples = done.max(SHORTEST_ROUND).min(budget - done);
            secs += fixed + per_sample * f64::from(samples);
            done += samples;
        }
        Some(secs.max(0.0))
    }
}

impl Running {
    /// How far it is at a part of the present loop, as the engine would tell.
    fn within(&self, part: f64) -> f64 {
        let ((begins, share), left) = (self.pass, 0.5_f64.powi(self.loops - 1));
        begins + share * (1.0 - left * (1.0 - 0.5 * part))
    }

    /// The pass has ended with its last loop.
    fn end_pass(&mut self, now: f64) {
        if self.loops > 0 {
            self.reaches(self.within(1.0), now);
        }
    }

    /// It has come so far, as the engine tells.
    fn reaches(&mut self, told: f64, now: f64) {
        // What comes before the first pass belongs to it.
        if told > self.passes.last().map_or(0.0, |(before, _)| *before) {
            self.passes.push((told, now - self.began));
        }
        self.part = self.part.max(told);
    }
}

#[cfg(test)]
mod tests {
    use rebake_core::Pass;

    use super::*;

    fn at(round_fraction: f32, pass_share: f32) -> Progress {
        Progress { round_fraction, pass_share, ..Progress::at_once(Pass::Direct, 0, None) }
    }

    /// Rounds of 4, 4, 8, … up to `budget` samples, at so many seconds per round and per sample, whose passes take
    /// their time as `shares` tell and not as the engine does. Calls `look` with the seconds that are over, the seconds that
    /// all takes, and the forecast.
    fn run(
        budget: u32,
        (fixed, per_sample): (f64, f64),
        shares: [f64; 2],
        mut look: impl FnMut(f64, f64, u32, &Forecast),
    ) {
        let rounds = |mut look: Box<dyn FnMut(f64, u32, u32) + '_>| {
            let (mut now, mut done) = (0.0, 0);
            while done < budget {
                let samples = done.max(4).min(budget - done);
                look(now, samples, done);
                now += fixed + per_sample * f64::from(samples);
                done += samples;
            }
            now
        };
        let all = rounds(Box::new(|_, _, _| ()));
        let mut forecast = Forecast::default();
        rounds(Box::new(|began, samples, done| {
            let secs = fixed + per_sample * f64::from(samples);
            forecast.round(began, samples);
            let mut from = 0.0;
            for (share, (told, size)) in shares.into_iter().zip([(0.0, 0.3), (0.3, 0.7)]) {
                forecast.told(began + secs * from, &at(told, size));
                for step in 0..=10 {
                    let within = f64::from(step) / 10.0;
                    let now = began + secs * (from + share * within);
                    forecast.advance(now, within as f32);
                    look(now, all, done, &forecast);
                }
                from += share;
            }
        }));
    }

    #[test]
    fn after_a_tenth_of_the_time_the_rest_is_told_within_a_factor_of_2() {
        for speed in [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)] {
            for shares in [[0.3, 0.7], [0.9, 0.1], [0.05, 0.95]] {
                let mut looks = 0;
                run(128, speed, shares, |now, all, done, forecast| {
                    let Some(told) = forecast.remaining(now, done, f64::INFINITY, 128) else { return };
                    let ratio = told / (all - now);
                    if now > 0.1 * all && now < 0.97 * all {
                        assert!((0.5..=2.0).contains(&ratio), "{speed:?} {shares:?} {ratio} at {} of {all}", now);
                        looks += 1;
                    }
                });
                assert!(looks > 20, "{looks}");
            }
        }
    }

    #[test]
    fn the_part_of_a_round_rises_evenly_once_a_round_was_measured() {
        let mut last = (0, 0.0);
        run(64, (4.0, 1.0), [0.8, 0.2], |_, _, done, forecast| {
            let now = forecast.part();
            assert!((0.0..=1.0).contains(&now));
            if last.0 == done {
                assert!(now >= last.1, "{now} after {}", last.1);
                assert!(done == 0 || now - last.1 < 0.081, "{now} after {}", last.1);
            }
            last = (done, now);
        });
    }

    #[test]
    fn a_stated_error_that_is_near_ends_the_work_sooner() {
        let mut forecast = Forecast::default();
        forecast.round(0.0, 4);
        assert_eq!(forecast.remaining(1.0, 0, f64::INFINITY, 128), None, "nothing is measured");
        forecast.round(4.0, 4);
        forecast.end_round(8.0);
        assert_eq!(forecast.remaining(8.0, 8, 8.0, 128), Some(0.0));
        assert_eq!(forecast.remaining(8.0, 8, 12.0, 128), Some(8.0));
        assert_eq!(forecast.remaining(8.0, 8, f64::INFINITY, 128), Some(120.0));
    }
}
