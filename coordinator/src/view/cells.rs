//! The cells of a sweep: counts with moments, the values of runs, and columns of many.

use std::collections::BTreeMap;
use std::sync::Arc;

use furrow_schema::id::{CellId, Digest, JobId, ScenarioId};

use crate::moments::Moments;

/// A cell with its counts and exact moments.
#[derive(Debug, Clone, PartialEq)]
pub struct CellSummary {
    /// The cell.
    pub id: CellId,
    /// Its place in the sweep, from 0.
    pub position: u64,
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// All its jobs.
    pub total: u64,
    /// Jobs with a result.
    pub done: u64,
    /// Jobs given up on.
    pub failed: u64,
    /// Moments by metric, over the jobs with a result in which the metric is defined.
    pub metrics: BTreeMap<String, Moments>,
}

/// The values of the runs of one cell, in an order that depends on nothing but the runs: by seed, then scenario.
/// Element `i` of each column belongs to the run with `seeds[i]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellValues {
    /// The cell's place in the sweep, from 0.
    pub position: u64,
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// The runs' jobs.
    pub jobs: Vec<JobId>,
    /// The runs' seeds.
    pub seeds: Vec<u64>,
    /// The runs' scenarios.
    pub scenarios: Vec<ScenarioId>,
    /// How the runs ended.
    pub outcomes: Vec<Arc<str>>,
    /// The runs' digests.
    pub digests: Vec<Digest>,
    /// A column by metric; none where it is undefined for a run.
    pub metrics: BTreeMap<String, Vec<Option<f64>>>,
    /// A column by timing metric, of the runs that ran alone; none for the others.
    pub timings: BTreeMap<String, Vec<Option<f64>>>,
}

/// The metrics of one cell's results as columns of equal length. Which run is which is not said.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellColumns {
    /// The cell's place in the sweep, from 0.
    pub position: u64,
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// Runs with a result.
    pub runs: u64,
    /// A column by metric; no number (NaN) where it is undefined for a run.
    pub metrics: BTreeMap<String, Vec<f64>>,
}

impl From<CellValues> for CellColumns {
    /// Times are metrics, too.
    fn from(values: CellValues) -> Self {
        let column = |(name, column): (String, Vec<Option<f64>>)| {
            (name, column.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
        };
        let CellValues { position, factors, jobs, metrics, timings, .. } = values;
        Self {
            position,
            factors,
            runs: jobs.len() as u64,
            metrics: metrics.into_iter().chain(timings).map(column).collect(),
        }
    }
}
