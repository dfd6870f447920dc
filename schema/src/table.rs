//! A cell of a result table.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// One combination of labels with its statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Cell {
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// Finished runs in this cell.
    pub n: u64,
    /// Runs that the sweep wants here and that have not ended with a result.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub missing: u64,
    /// Statistics by metric.
    pub metrics: BTreeMap<String, Statistics>,
}

fn is_zero(n: &u64) -> bool {
    *n == 0
}

/// Statistics of one metric over the runs of a cell; all in the metric's unit.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Statistics {
    /// Runs in which the metric is defined.
    pub n: u64,
    /// Arithmetic mean.
    pub mean: Option<f64>,
    /// Sample standard deviation (n - 1); null for one value.
    pub std: Option<f64>,
    /// Median.
    pub median: Option<f64>,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// 95 % interval of the mean: Wilson's for ratios, the bootstrap's for ratios of sums, Student's otherwise; null for
    /// one value of a mean.
    pub ci95: Option<[f64; 2]>,
    /// Sum of the values, where it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sum: Option<f64>,
    /// 5th percentile, where it was asked for; between two values by linear interpolation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p5: Option<f64>,
    /// 25th percentile, likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p25: Option<f64>,
    /// 75th percentile, likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p75: Option<f64>,
    /// 95th percentile, likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub p95: Option<f64>,
}
