//! Published tables with ours beside them.
//!
//! Read in this order: `reference` holds what was published, a file per publication, `compare` finds our runs for each
//! published cell, `verdict` says how the two agree, `reason` why in words, `evidence` which runs show it, `layout` sets
//! all that in the paper's rows and columns. `claims` checks what a paper says in words.
//!
//! # Verdicts
//! - `inside`: the published value lies within our 95 % interval, ends included. Where the interval is a single
//!   point, or there is none as for one run, the published value equals our mean.
//! - `same-ranking`: not inside, but the row keeps its place. Among the rows that have both a published
//!   value and one of ours in this column there is at least one other, and for each other one whose published
//!   value differs from this row's, our means differ in the same direction.
//! - `different`: neither.
//! - `not-run`: the sweep has no finished run for this cell (for the mean column: not for all four crops).
//! - of claims: `holds`, `does-not-hold` or `undecided`, by where the 95 % interval lies.
//!
//! Where nothing is published there is no verdict, unless it is `not-run`. An interval's end that is null is open: of a
//! distance per intervention, where runs, or too many of the resamples, have no intervention at all.
//!
//! # Reasons
//! A verdict `different` comes with a reason. It says how ours and the published value compare with what the
//! authors' program gave: two means *agree* if the 95 % interval of their difference holds 0. The program's own
//! interval is Wilson's for ratios; for other values its runs are taken to spread as ours do, or by as much as
//! its mean and median are apart if that is more. Then it says how
//! many runs failed and by which outcome, and cites runs by the first digits of their job keys.

mod claims;
mod compare;
mod error;
mod evidence;
mod layout;
mod reason;
mod reference;
mod verdict;

use std::collections::BTreeMap;

use serde::Serialize;

use crate::table::{Format, Grid, Metric, Pairs, SweepData, metric, render};

pub use claims::{TABLE as CLAIMS, check};
pub use compare::compare;
pub use error::PublicationError;
pub use evidence::{cite, of_sweep};
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
    /// The factors whose labels make up a row.
    #[serde(skip)]
    pub(crate) row_factors: &'static [&'static str],
    /// The factor, or what else it is, whose labels are the columns.
    #[serde(skip)]
    pub(crate) column_factor: &'static str,
    /// Those labels.
    #[serde(skip)]
    pub(crate) columns: Vec<String>,
    /// Whether averages stand with successful runs.
    #[serde(skip)]
    pub(crate) counts_successes: bool,
    /// The cells, by row, then column: algorithm, then field, in most tables. The field `mean` is the published mean
    /// over the fields; `view`, `cause` and `part` say what of the same runs was measured.
    pub cells: Vec<ComparisonCell>,
}

/// A published value with ours beside it.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ComparisonCell {
    /// Label by factor: the table's, and any other factor in which the sweep's runs differ.
    pub factors: BTreeMap<String, String>,
    /// The published value; null where nothing is published.
    pub published: Option<f64>,
    /// Runs behind the published value, where each of them is published.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub published_runs: Option<u64>,
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
    /// The sums whose ratio is compared, of a ratio of sums.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sums: Option<Sums>,
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
    /// What makes up its column.
    #[serde(skip)]
    pub(crate) kind: reference::Kind,
    /// The metric whose mean is compared.
    #[serde(skip)]
    pub(crate) measured: String,
    /// The labels of its runs.
    #[serde(skip)]
    pub(crate) runs: BTreeMap<String, String>,
}

impl ComparisonCell {
    fn label(&self, factor: &str) -> &str {
        self.factors.get(factor).map_or("", String::as_str)
    }

    fn metric(&self) -> Metric {
        metric(&self.measured)
    }
}

/// Two sums whose ratio is compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Sums {
    /// The published ones; null where they are not.
    pub published: Option<[f64; 2]>,
    /// Ours.
    pub ours: [f64; 2],
}

/// What our runs gave.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Ours {
    /// Arithmetic mean; in the column `mean` the mean of the crops' means; of a ratio of sums that ratio, null where
    /// the sum below the line is nothing.
    pub mean: f64,
    /// Median; null in the column `mean`, and of a ratio of sums.
    pub median: Option<f64>,
    /// 95 % interval of the mean; null for one run, unless of a ratio. An end that is null is open.
    pub ci95: Option<[f64; 2]>,
    /// Runs.
    pub n: u64,
}

impl Ours {
    /// The ratio of the sums with its interval; infinite where there is nothing below the line, none where there is
    /// nothing at all.
    fn of_pairs(pairs: &Pairs) -> Option<Self> {
        let ends = pairs.ends();
        let mean = pairs.ratio().or_else(|| ends.map(|_| f64::INFINITY))?;
        Some(Self { mean, median: None, ci95: ends, n: pairs.n() })
    }
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
        if self.table == CLAIMS { layout::of_claims(self) } else { layout::for_people(self) }
    }
}

/// All published tables, as (source, table).
#[must_use]
pub fn all_tables() -> Vec<(&'static str, &'static str)> {
    let of = |source: &&'static str| {
        let source = *source;
        let names = reference::of(source).map(|table| table.name);
        names.chain(claims::exist(source).then_some(CLAIMS)).map(move |table| (source, table))
    };
    sources().iter().flat_map(of).collect()
}

/// The published tables that belong to a sweep of `plan`, as (source, table): tables of times only where the
/// sweep has measured times.
#[must_use]
pub fn tables_of(plan: &str, data: &SweepData) -> Vec<(&'static str, &'static str)> {
    let Some(source) = source_of(plan) else { return Vec::new() };
    let measured = reference::of(source).filter(|table| is_measured(table, data)).map(|table| table.name);
    measured.chain(claims::exist(source).then_some(CLAIMS)).map(|table| (source, table)).collect()
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
    let measured = |metric: &str| data.cells.iter().any(|cell| cell.metrics.contains_key(metric));
    !table.is_timing() || table.columns.iter().any(|column| measured(&column.measured))
}

/// Whether a published table is one of times. Not, if it is unknown.
#[must_use]
pub fn is_of_times(source: &str, table: &str) -> bool {
    reference::of(source).any(|known| known.name == table && known.is_timing())
}
