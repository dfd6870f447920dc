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
