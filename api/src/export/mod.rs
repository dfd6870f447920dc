//! All runs of a sweep as rows: a file per format, fed page by page.
//!
//! A row is a run as a cell lists it: job, key, the cell's labels, seed, state, attempts, outcome, digest, and a column for
//! each metric. What a run does not have is empty or null; failed and waiting jobs are rows, too. The columns are
//! those that are known when the export begins.

mod csv;
mod lines;
mod parquet;

use std::collections::BTreeMap;

use furrow_coordinator::view::{CellSummary, RunRow};
use furrow_schema::sweep::Sweep;

use crate::columnar::File;
use crate::table::{listed, metric, order};

/// What rows are written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// A JSON object a line.
    Lines,
    /// Comma-separated values after RFC 4180.
    Csv,
    /// Apache Parquet, a row group a page.
    Parquet,
}

/// An export that cannot go on: the file is worth nothing.
#[derive(Debug, thiserror::Error)]
#[error("a row cannot be written: {0}")]
pub struct ExportError(String);

impl ExportError {
    fn of(cause: impl std::fmt::Display) -> Self {
        Self(cause.to_string())
    }
}

/// The columns that stand before the metrics, in which factors stand behind the second.
const BEFORE: [&str; 2] = ["job", "key"];
const BEHIND: [&str; 5] = ["seed", "state", "attempts", "outcome", "digest"];

/// What is a column.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Columns {
    /// The factors, in the plan's order.
    factors: Vec<String>,
    /// The metrics, in the order of tables.
    metrics: Vec<String>,
    /// Labels by factor of each cell, by its place in the sweep.
    labels: BTreeMap<u64, BTreeMap<String, String>>,
}

impl Columns {
    /// Of a sweep with these cells.
    #[must_use]
    pub fn of(sweep: &Sweep, cells: &[CellSummary]) -> Self {
        let times = listed().filter(|name| sweep.timing && metric(name).timing).map(str::to_owned);
        let mut metrics: Vec<String> =
            cells.iter().flat_map(|cell| cell.metrics.keys().cloned()).chain(times).collect();
        metrics.sort_by(|a, b| order(a).cmp(&order(b)));
        metrics.dedup();
        let labels = cells.iter().map(|cell| (cell.position, cell.factors.clone())).collect();
        Self { factors: sweep.factors.clone(), metrics, labels }
    }

    /// The headings; a factor or metric that is called like another column goes by `factor.` or `metric.` before its name.
    fn headings(&self) -> Vec<String> {
        let own = |name: &str| BEFORE.contains(&name) || BEHIND.contains(&name);
        let factor = |name: &String| if own(name) { format!("factor.{name}") } else { name.clone() };
        let taken = |name: &str| own(name) || self.factors.iter().any(|factor| factor == name);
        let metric = |name: &String| if taken(name) { format!("metric.{name}") } else { name.clone() };
        let fixed = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let mut headings = fixed(&BEFORE);
        headings.extend(self.factors.iter().map(factor));
        headings.extend(fixed(&BEHIND));
        headings.extend(self.metrics.iter().map(metric));
        headings
    }

    /// The label of `run`, empty where it has none.
    fn label(&self, run: &RunRow, factor: &str) -> &str {
        self.labels.get(&run.position).and_then(|labels| labels.get(factor)).map_or("", String::as_str)
    }
}

/// Rows on their way into a file.
pub struct Export {
    columns: Columns,
    writer: Writer,
}

enum Writer {
    Lines,
    Csv,
    Parquet(Box<File>),
}

impl Export {
    /// An export in `form`, and the first bytes of it.
    ///
    /// # Errors
    /// The columns cannot be described.
    pub fn begin(form: Form, columns: Columns) -> Result<(Self, Vec<u8>), ExportError> {
        let (writer, bytes) = match form {
            Form::Lines => (Writer::Lines, Vec::new()),
            Form::Csv => (Writer::Csv, csv::heading(&columns)?),
            Form::Parquet => {
                let mut file = File::begin(parquet::headings(&columns)).map_err(ExportError::of)?;
                let bytes = file.written();
                (Writer::Parquet(Box::new(file)), bytes)
            }
        };
        Ok((Self { columns, writer }, bytes))
    }

    /// The bytes of some more rows.
    ///
    /// # Errors
    /// The export cannot go on.
    pub fn rows(&mut self, runs: &[RunRow]) -> Result<Vec<u8>, ExportError> {
        match &mut self.writer {
            Writer::Lines => lines::rows(&self.columns, runs),
            Writer::Csv => csv::rows(&self.columns, runs),
            Writer::Parquet(file) => {
                file.group(parquet::columns(&self.columns, runs)).map_err(ExportError::of)?;
                Ok(file.written())
            }
        }
    }

    /// The last bytes.
    ///
    /// # Errors
    /// The export cannot be brought to an end.
    pub fn end(self) -> Result<Vec<u8>, ExportError> {
        match self.writer {
            Writer::Lines | Writer::Csv => Ok(Vec::new()),
            Writer::Parquet(file) => file.end().map_err(ExportError::of),
        }
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::id::{Digest, JobId, JobKey};
    use furrow_schema::job::JobState;

    use super::*;

    pub(super) fn columns() -> Columns {
        let labels = |algorithm: &str, seed: &str| {
            BTreeMap::from([("algorithm".to_owned(), algorithm.to_owned()), ("seed".to_owned(), seed.to_owned())])
        };
        Columns {
            factors: vec!["algorithm".into(), "seed".into()],
            metrics: vec!["success".into(), "distance_m".into()],
            labels: BTreeMap::from([(0, labels("rgop", "a,b")), (1, labels("=1+1", "x"))]),
        }
    }

    pub(super) fn runs() -> Vec<RunRow> {
        let done = RunRow {
            position: 0,
            job: JobId(7),
            key: JobKey([1; 32]),
            seed: 3,
            state: JobState::Done,
            attempts: 1,
            outcome: Some("success".to_owned()),
            digest: Some(Digest([2; 32])),
            metrics: BTreeMap::from([("success".to_owned(), 1.0), ("distance_m".to_owned(), 0.1 + 0.2)]),
        };
        let failed = RunRow {
            position: 1,
            job: JobId(8),
            state: JobState::Failed,
            outcome: None,
            digest: None,
            metrics: BTreeMap::new(),
            ..done.clone()
        };
        vec![done, failed]
    }

    pub(super) fn export(form: Form, pages: &[&[RunRow]]) -> Vec<u8> {
        let (mut export, mut bytes) = Export::begin(form, columns()).unwrap();
        for page in pages {
            bytes.extend(export.rows(page).unwrap());
        }
        bytes.extend(export.end().unwrap());
        bytes
    }

    #[test]
    fn no_two_columns_go_by_one_name() {
        let headings = columns().headings();
        let expected =
            ["job", "key", "algorithm", "factor.seed", "seed", "state", "attempts", "outcome", "digest", "success"];
        assert_eq!(headings[..10], expected);
    }
}
