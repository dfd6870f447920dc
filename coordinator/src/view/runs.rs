//! Runs of a sweep, one by one.

use std::collections::BTreeMap;

use furrow_schema::id::{Digest, JobId, JobKey, ScenarioId};
use furrow_schema::job::JobState;

/// A run with a result, and one of its values.
#[derive(Debug, Clone, PartialEq)]
pub struct RunValue {
    /// Its job's key.
    pub key: JobKey,
    /// Its seed.
    pub seed: u64,
    /// How it ended.
    pub outcome: String,
    /// The value of the metric asked for, in its own unit; none where it is undefined for the run.
    pub value: Option<f64>,
}

/// A run of a sweep without a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnfinishedRun {
    /// Its cell's place in the sweep, from 0.
    pub position: u64,
    /// Its seed.
    pub seed: u64,
    /// Its scenario.
    pub scenario: ScenarioId,
    /// Where its job stands; never done.
    pub state: JobState,
}

/// A place among the runs of a sweep, which are ordered by cell, then job. The default is before the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunCursor {
    /// The place in the sweep of the last run's cell.
    pub position: u64,
    /// The last run's job.
    pub job: JobId,
}

impl Default for RunCursor {
    fn default() -> Self {
        Self { position: 0, job: JobId(0) }
    }
}

/// A run of a sweep with all that was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct RunRow {
    /// Its cell's place in the sweep, from 0.
    pub position: u64,
    /// Its job.
    pub job: JobId,
    /// Its job's key.
    pub key: JobKey,
    /// Its seed.
    pub seed: u64,
    /// Where its job stands.
    pub state: JobState,
    /// How often it was handed out.
    pub attempts: u32,
    /// How it ended, when it has.
    pub outcome: Option<String>,
    /// The digest of its result, when it has one.
    pub digest: Option<Digest>,
    /// Per-run values by metric; times, too, where the sweep measures them and the run was alone.
    pub metrics: BTreeMap<String, f64>,
}
