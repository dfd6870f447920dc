//! Published tables with ours beside them.
//!
//! Read in this order: `reference` holds what was published, `compare` finds our runs for each published
//! cell, `verdict` says how the two agree, `reason` why in words, `evidence` which runs show it, `layout` sets
//! all that in the paper's rows and columns.
//!
//! # Verdicts
//! - `inside`: the published value lies within our 95 % interval, ends included. Where the interval is a single
//!   point, or there is none as for one run, the published value equals our mean.
//! - `same-ranking`: not inside, but the finder keeps its place. Among the finders that have both a published
//!   value and one of ours in this column there is at least one other, and for each other one whose published
//!   value differs from this finder's, our means differ in the same direction.
//! - `different`: neither.
//! - `not-run`: the sweep has no finished run for this cell (for the mean column: not for all four crops).
//!
//! Where nothing is published there is no verdict, unless it is `not-run`.
//!
//! # Reasons
//! A verdict `different` comes with a reason. It says how ours and the published value compare with what the
//! authors' program gave: two means *agree* if the 95 % interval of their difference holds 0. The program's own
//! interval is Wilson's for ratios; for other values its runs are taken to spread as ours do, or by as much as
//! its mean and median are apart if that is more. Then it says how
//! many runs failed and by which outcome, and cites runs by the first digits of their job keys.

mod compare;
mod error;
mod evidence;
mod layout;
mod reason;
mod reference;
mod verdict;

use std::collections::BTreeMap;

use serde::Serialize;

use crate::table::{Format, Grid, Metric, SweepData, metric, render};

pub use compare::compare;
pub use error::PublicationError;
pub use evidence::cite;
pub use reference::{sources, tables};
pub use verdict::Verdict;

/// A published table with ours beside it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Comparison {
    /// The publication, such as `guyonneau2022`.
    pub source: String,
    /// The table, such as `table-2`.
    pub table: String,
    /// The publication for people.
    pub citation: String,
    /// What is compared.
    pub metric: String,
    /// Its unit, `1` where it has none.
    pub unit: String,
    /// What there is to say about the published table as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
    /// How the program's values were made, for people.
    #[serde(skip)]
    pub(crate) program_source: Option<&'static str>,
    /// The cells, by algorithm, then field; the field `mean` is the published mean over the fields.
    pub cells: Vec<ComparisonCell>,
}

/// A published value with ours beside it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ComparisonCell {
    /// Label by factor: `algorithm`, `field`, and any other factor in which the sweep's runs differ.
    pub factors: BTreeMap<String, String>,
    /// The published value; null where nothing is published.
    pub published: Option<f64>,
    /// What the authors' program gave in an equivalent simulator; null where that is not known.
    pub program: Option<f64>,
    /// The median over the runs of the authors' program, where `program` is their mean.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program_median: Option<f64>,
    /// Runs of the authors' program behind `program`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub program_runs: Option<u64>,
    /// Our runs; null where there are none.
    pub ours: Option<Ours>,
    /// How the published value and ours agree; null where nothing is published.
    pub verdict: Option<Verdict>,
    /// What else there is to know, in words; for a verdict `different` its reason, with the job keys of runs.
    pub note: Option<String>,
    /// The reason of a verdict `different`, without the numbers that stand in the table, for people.
    #[serde(skip)]
    pub(crate) reason: Option<String>,
    /// Successful and finished runs, for people.
    #[serde(skip)]
    pub(crate) success: Option<(u64, u64)>,
}

impl ComparisonCell {
    fn label(&self, factor: &str) -> &str {
        self.factors.get(factor).map_or("", String::as_str)
    }
}

/// What our runs gave.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Ours {
    /// Arithmetic mean; in the column `mean` the mean of the crops' means.
    pub mean: f64,
    /// Median; null in the column `mean`.
    pub median: Option<f64>,
    /// 95 % interval of the mean; null for one run, unless of a ratio.
    pub ci95: Option<[f64; 2]>,
    /// Runs.
    pub n: u64,
}

impl Comparison {
    /// The metric whose values make up the table.
    fn measured(&self) -> Metric {
        metric(if self.metric == "success_ratio" { "success" } else { &self.metric })
    }

    /// The comparison as text in `format`: for people in the paper's rows and columns, in CSV one line per cell.
    #[must_use]
    pub fn write(&self, format: Format) -> String {
        match format {
            Format::Json => serde_json::json!(self).to_string(),
            Format::Csv => render(&layout::for_programs(self), format),
            Format::Md | Format::Latex | Format::Text => render(&self.grid(), format),
        }
    }

    /// The comparison in the paper's rows and columns.
    #[must_use]
    pub fn grid(&self) -> Grid {
        layout::for_people(self)
    }
}

/// The published tables that belong to a sweep of `plan`, as (source, table): tables of times only where the
/// sweep has measured times.
#[must_use]
pub fn tables_of(plan: &str, data: &SweepData) -> Vec<(&'static str, &'static str)> {
    let Some(source) = source_of(plan) else { return Vec::new() };
    reference::of(source).filter(|table| is_measured(table, data)).map(|table| (source, table.name)).collect()
}

/// The tables of times of the publication to which `plan` belongs that the sweep has not measured.
#[must_use]
pub fn unmeasured_tables_of(plan: &str, data: &SweepData) -> Vec<&'static str> {
    let Some(source) = source_of(plan) else { return Vec::new() };
    reference::of(source).filter(|table| !is_measured(table, data)).map(|table| table.name).collect()
}

fn source_of(plan: &str) -> Option<&'static str> {
    sources().iter().find(|source| plan.split('/').next() == Some(**source)).copied()
}

fn is_measured(table: &reference::Reference, data: &SweepData) -> bool {
    !table.is_timing() || data.cells.iter().any(|cell| cell.metrics.contains_key(table.measured()))
}

/// Whether a published table is one of times. Not, if it is unknown.
#[must_use]
pub fn is_of_times(source: &str, table: &str) -> bool {
    reference::of(source).any(|known| known.name == table && known.is_timing())
}
