//! Runs that do nothing, or use the processor for a while.

use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use furrow_schema::id::Digest;
use furrow_schema::job::{RunRecord, Timings};
use furrow_worker::{Order, Runner};

use super::process::thread_cpu;

/// Metrics of a run, as many as a real one has.
const METRICS: [&str; 8] = [
    "success",
    "mean_squared_error_mm2",
    "points_processed",
    "rows_completed",
    "simulated_s",
    "crop_damage",
    "distance_m",
    "cross_track_rms_m",
];

/// Takes so much processor time for a run, and makes up its record from scenario and seed.
#[derive(Debug, Clone, Copy)]
pub struct Idle {
    /// Processor time of a run.
    pub run: Duration,
}

impl Runner for Idle {
    type Scenario = String;

    fn read(&self, scenario_json: &str) -> Result<String, String> {
        Ok(scenario_json.to_owned())
    }

    fn run(&self, scenario: &String, order: Order, _stop: &AtomicBool) -> Option<RunRecord> {
        burn(self.run);
        Some(record(scenario, order.seed))
    }
}

/// Such runs one after another on each of `threads` threads, for about `time`, without a queue.
///
/// Returns the share of that time, from 0 to 1, that was not spent on runs: what the machine does beside them.
#[must_use]
pub fn share_lost(runs: Idle, threads: usize, time: Duration) -> f64 {
    let each = (time.as_nanos() / runs.run.as_nanos().max(1)).clamp(1, u128::from(u32::MAX)) as u32;
    let began = Instant::now();
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| (0..each).for_each(|_| burn(runs.run)));
        }
    });
    1.0 - (runs.run * each).as_secs_f64() / began.elapsed().as_secs_f64()
}

/// A record that is a function of scenario and seed.
pub(super) fn record(scenario: &str, seed: u64) -> RunRecord {
    let value = |place: usize| (seed % 1_000) as f64 / (place + 1) as f64 + scenario.len() as f64;
    let metrics = METRICS.iter().enumerate().map(|(place, name)| ((*name).to_owned(), value(place)));
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&seed.to_le_bytes());
    RunRecord {
        digest: Digest(digest),
        outcome: "success".to_owned(),
        metrics: metrics.collect(),
        timings: Timings::default(),
        trajectory: None,
    }
}

/// Uses the processor for `time`, whoever else uses it meanwhile.
fn burn(time: Duration) {
    if time.is_zero() {
        return;
    }
    let end = thread_cpu() + time;
    while thread_cpu() < end {
        std::hint::spin_loop();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_jobs_have_equal_records() {
        assert_eq!(record("{}", 3), record("{}", 3));
        assert_ne!(record("{}", 3).digest, record("{}", 4).digest);
    }

    #[test]
    fn what_runs_lose_is_a_share() {
        let run = Duration::from_millis(1);
        let share = share_lost(Idle { run }, 1, 20 * run);
        assert!((0.0..1.0).contains(&share), "{share}");
    }

    #[test]
    fn a_run_uses_the_time_that_was_asked_for() {
        let before = thread_cpu();
        burn(Duration::from_millis(2));
        let used = thread_cpu() - before;
        assert!((2..10).contains(&used.as_millis()), "{used:?}");
    }
}
