//! Runs a finished job again to see its path, when its trajectory was not stored.

use std::panic::{AssertUnwindSafe, catch_unwind};

use furrow_sim::{LocatedNode, Pose, Probe, RunResult, Scenario, Seed, simulate};

use crate::pool::panic_message;
use crate::runner::{ReadError, read_scenario};
use crate::scans::ScanRecorder;
pub use crate::scans::ThinnedScan;

/// Why a job cannot be run again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The scenario is not one that this engine can run. The caller says that another engine made it.
    #[error("{0}")]
    Scenario(String),
    /// The simulation panicked. The caller shows the message; trying again will not help.
    #[error("the run panicked: {0}")]
    Panicked(String),
}

/// A job that was run again.
#[derive(Debug, Clone)]
pub struct Rerun {
    /// What came out.
    pub result: RunResult,
    /// Poses every 0.05 s from 0 s on.
    pub path: Vec<Pose>,
    /// What the LiDARs saw on the way, in order.
    pub scans: Vec<ThinnedScan>,
    /// The graph of poses, of a robot that places itself by one.
    pub nodes: Vec<LocatedNode>,
}

/// Runs `scenario_json` (as stored with the job) with `seed`, and keeps where it went and what it saw.
///
/// The same engine gives the same digest as the stored result. It takes as long as the run did: callers in
/// asynchronous code put it on a blocking thread.
///
/// # Errors
/// See [`ReplayError`].
pub fn rerun(scenario_json: &str, seed: u64) -> Result<Rerun, ReplayError> {
    let scenario = read_scenario(scenario_json).map_err(|error: ReadError| ReplayError::Scenario(error.to_string()))?;
    let mut recorder = ScanRecorder::default();
    let result = watch(&scenario, seed, &mut recorder)?;
    Ok(Rerun { result, path: recorder.path.path, scans: recorder.scans, nodes: recorder.nodes })
}

/// Runs `scenario` with `seed` before `probe`, which is of no use after a panic.
///
/// # Errors
/// [`ReplayError::Panicked`].
pub fn watch(scenario: &Scenario, seed: u64, probe: &mut impl Probe) -> Result<RunResult, ReplayError> {
    catch_unwind(AssertUnwindSafe(|| simulate(scenario, Seed(seed), probe)))
        .map_err(|panic| ReplayError::Panicked(panic_message(panic.as_ref())))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::runner::tests::SHORT_RUN;
    use crate::{Order, Runner, Simulator, trajectory};

    #[test]
    fn a_job_that_is_run_again_has_the_same_digest_and_path() {
        let scenario = Simulator.read(SHORT_RUN).unwrap();
        let order = Order { seed: 3, record: true, alone: false };
        let record = Simulator.run(&scenario, order, &AtomicBool::new(false)).unwrap();
        let Rerun { result, path, .. } = rerun(SHORT_RUN, 3).unwrap();
        assert_eq!(result.digest, record.digest.0);
        let stored = trajectory::decode(&record.trajectory.unwrap()).unwrap();
        assert_eq!(stored.len(), path.len());
        assert!(stored.iter().zip(&path).all(|(stored, pose)| (stored.x_m - pose.x_m).abs() < 5e-5));
    }

    #[test]
    fn scans_come_four_times_a_second_of_each_lidar_and_show_the_rows() {
        let Rerun { path, scans, .. } = rerun(SHORT_RUN, 3).unwrap();
        let simulated_s = 0.05 * (path.len() - 1) as f64;
        let pairs: Vec<&[ThinnedScan]> = scans.chunks(2).collect();
        assert!(pairs.len().abs_diff((simulated_s * 4.0) as usize) <= 1, "{} in {simulated_s} s", pairs.len());
        assert!(pairs.iter().all(|pair| pair[0].time_s == pair[1].time_s));
        assert!(pairs.windows(2).all(|two| (two[1][0].time_s - two[0][0].time_s - 0.25).abs() < 1e-9));
        let first = &scans[0];
        assert!(!first.points_cm.is_empty() && first.points_cm.len() <= 90);
        let across = |sign: i16| first.lines_cm.iter().any(|[_, y, ..]| (20..=120).contains(&(sign * y)));
        assert!(across(1) && across(-1), "a row on each side: {:?}", first.lines_cm);
    }

    #[test]
    fn a_scenario_that_cannot_be_run_is_an_error() {
        assert!(matches!(rerun("{}", 1), Err(ReplayError::Scenario(message)) if message.contains("field")));
    }
}
