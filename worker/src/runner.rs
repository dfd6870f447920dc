//! One run: from a scenario and a seed to the record that is reported.

use std::sync::atomic::{AtomicBool, Ordering};

use furrow_schema::id::Digest;
use furrow_schema::job::RunRecord;
use furrow_sim::{Outcome, Part, Pose, Probe, Scenario, Seed, simulate};

use crate::timing::Stopwatch;
use crate::trajectory::{self, Recorder};

/// What the worker does with a job. [`Simulator`] is the real one.
pub trait Runner: Send + Sync + 'static {
    /// A scenario that was read and checked.
    type Scenario: Send + Sync + 'static;

    /// Reads a scenario's canonical JSON.
    ///
    /// # Errors
    /// Says what is wrong with it. The worker reports the job as panicked with this text.
    fn read(&self, scenario_json: &str) -> Result<Self::Scenario, String>;

    /// Runs it to its end on this thread; nothing if `stop` was raised meanwhile.
    fn run(&self, scenario: &Self::Scenario, order: Order, stop: &AtomicBool) -> Option<RunRecord>;
}

/// How to run a scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// The seed of its random streams.
    pub seed: u64,
    /// Whether the trajectory is wanted.
    pub record: bool,
    /// Whether nothing else runs on the worker meanwhile.
    pub alone: bool,
}

/// Runs jobs by [`simulate`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Simulator;

impl Runner for Simulator {
    type Scenario = Scenario;

    fn read(&self, scenario_json: &str) -> Result<Scenario, String> {
        read_scenario(scenario_json).map_err(|error| error.to_string())
    }

    fn run(&self, scenario: &Scenario, order: Order, stop: &AtomicBool) -> Option<RunRecord> {
        let mut watcher =
            Watcher { stopwatch: Stopwatch::start(), recorder: order.record.then(Recorder::default), stop };
        let result = simulate(scenario, Seed(order.seed), &mut watcher);
        if result.outcome == Outcome::Stopped {
            return None;
        }
        let metrics = result.metrics.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        Some(RunRecord {
            digest: Digest(result.digest),
            outcome: result.outcome.name().to_owned(),
            timings: watcher.stopwatch.finish(&metrics, order.alone),
            metrics,
            trajectory: watcher.recorder.map(|recorder| trajectory::encode(&recorder.path)),
        })
    }
}

/// A scenario's text that is no scenario.
#[derive(Debug, thiserror::Error)]
pub(crate) enum ReadError {
    /// It is not JSON.
    #[error("the scenario is not JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// It is JSON, and no scenario of this engine.
    #[error("the scenario cannot be run: {0}")]
    Scenario(#[from] furrow_sim::ScenarioError),
}

/// Reads a scenario's canonical JSON.
pub(crate) fn read_scenario(scenario_json: &str) -> Result<Scenario, ReadError> {
    Ok(Scenario::from_value(serde_json::from_str(scenario_json)?)?)
}

/// The probe of a job: times the parts, keeps the path if it is wanted, listens for the call to stop.
struct Watcher<'a> {
    stopwatch: Stopwatch,
    recorder: Option<Recorder>,
    stop: &'a AtomicBool,
}

impl Probe for Watcher<'_> {
    fn begin(&mut self, part: Part) {
        self.stopwatch.begin(part);
    }

    fn end(&mut self, part: Part) {
        self.stopwatch.end(part);
    }

    fn pose(&mut self, time_s: f64, world_from_robot: Pose) {
        if let Some(recorder) = &mut self.recorder {
            recorder.pose(time_s, world_from_robot);
        }
    }

    fn stop(&mut self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Ten simulated seconds of the second crop.
    pub(crate) const SHORT_RUN: &str = r#"{
        "field": {"kind": "guyonneau2022", "crop": 2, "seed": "job"}, "robot": {"kind": "two-wheeled"},
        "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
        "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"}, "mission": {"kind": "row-by-row"},
        "observer": {"kind": "inter-rows"}, "limits": {"kind": "simulated-time", "max_time_s": 10}
    }"#;

    fn run(seed: u64, record: bool, stop: bool) -> Option<RunRecord> {
        let scenario = Simulator.read(SHORT_RUN).unwrap();
        Simulator.run(&scenario, Order { seed, record, alone: true }, &AtomicBool::new(stop))
    }

    #[test]
    fn one_job_on_two_threads_gives_one_digest_and_another_seed_another() {
        let other_thread = std::thread::spawn(|| run(1, false, false).unwrap());
        let here = run(1, false, false).unwrap();
        let there = other_thread.join().unwrap();
        assert_eq!((here.digest, &here.metrics, &here.outcome), (there.digest, &there.metrics, &there.outcome));
        assert_ne!(here.digest, run(2, false, false).unwrap().digest);
    }

    #[test]
    fn a_record_carries_times_and_a_trajectory_only_on_request() {
        let record = run(1, true, false).unwrap();
        let path = trajectory::decode(record.trajectory.as_deref().unwrap()).unwrap();
        assert_eq!(path.len(), 201, "20 Hz over 10 s, both ends");
        assert!(record.timings.alone && record.timings.metrics["line_finding_time_ms"] > 0.0);
        assert!(record.timings.parts.iter().any(|part| part.part == "scan" && part.calls > 100));
        assert_eq!(run(1, false, false).unwrap().trajectory, None);
    }

    #[test]
    fn watching_does_not_change_the_run() {
        assert_eq!(run(1, true, false).unwrap().digest, run(1, false, false).unwrap().digest);
    }

    #[test]
    fn a_stopped_run_has_no_record() {
        assert_eq!(run(1, false, true), None);
    }

    #[test]
    fn a_scenario_that_cannot_be_run_is_refused_by_its_key() {
        let broken = SHORT_RUN.replace("fuzzy", "wise");
        assert!(Simulator.read(&broken).unwrap_err().contains("control.kind"));
        assert!(Simulator.read("{").unwrap_err().contains("not JSON"));
    }
}
