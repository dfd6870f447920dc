//! The metrics of a sweep's cells as columns of numbers: what medians, quantiles and bootstraps over many runs are made of.
//!
//! Runs come in pieces, each one row of the database's answer, and several cells at once: a million results take about a
//! second. Which run is which is not known here; [`values`](super::values) knows.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use furrow_schema::id::{CellId, SweepId};
use futures::{StreamExt, TryStreamExt, stream};
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, Visitor};

use crate::error::StoreError;
use crate::store::{Store, from_json, unsigned};
use crate::view::CellColumns;

const CELLS: &str = "select id, position, factors from cell where sweep_id = ?1 order by position";

/// The metrics of the results in a cell (?1) behind a job (?2), a line each, at most ?3 of them, and the last job.
const PIECE: &str = "select count(*), coalesce(max(job_id), 0), coalesce(group_concat(metrics, x'0a'), '')
    from (select cell_job.job_id, result.metrics
        from cell_job cross join result on result.job_id = cell_job.job_id
        where cell_job.cell_id = ?1 and cell_job.job_id > ?2
        order by cell_job.job_id limit ?3 + 0)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[CELLS, PIECE];

/// Runs of a piece.
const RUNS: i64 = 4_000;

/// Cells that are read at a time: one less than there are readers.
const CELLS_AT_A_TIME: usize = 3;

/// The columns of a sweep by cell, of all metrics or of those named.
pub(crate) async fn by_cell(
    store: &Store,
    sweep: SweepId,
    wanted: Option<&[&str]>,
) -> Result<Vec<CellColumns>, StoreError> {
    let cells: Vec<(i64, i64, String)> = sqlx::query_as(CELLS).bind(sweep.0).fetch_all(store.readers()).await?;
    let wanted: Option<Arc<[String]>> = wanted.map(|names| names.iter().map(|name| (*name).to_owned()).collect());
    let read = |(id, position, factors): (i64, i64, String)| {
        let wanted = wanted.clone();
        async move {
            let position = unsigned("a cell's position", position)?;
            let factors: BTreeMap<String, String> = from_json("a cell's factors", &factors)?;
            let (runs, metrics) = of_cell(store, CellId(id), wanted).await?;
            Ok::<_, StoreError>(CellColumns { position, factors, runs, metrics })
        }
    };
    stream::iter(cells).map(read).buffered(CELLS_AT_A_TIME).try_collect().await
}

async fn of_cell(
    store: &Store,
    cell: CellId,
    wanted: Option<Arc<[String]>>,
) -> Result<(u64, BTreeMap<String, Vec<f64>>), StoreError> {
    let mut columns = Columns::new(wanted);
    let mut after = 0_i64;
    loop {
        let piece = sqlx::query_as(PIECE).bind(cell.0).bind(after).bind(RUNS);
        let (runs, last, lines): (i64, i64, String) = piece.fetch_one(store.readers()).await?;
        if runs == 0 {
            return Ok(columns.finish());
        }
        after = last;
        // Thousands of lines take a while: not on a thread that serves others.
        let reading = tokio::task::spawn_blocking(move || columns.read(&lines).map(|()| columns));
        columns =
            reading.await.map_err(|error| StoreError::Damaged(format!("results could not be read: {error}")))??;
    }
}

/// Columns that grow run by run.
struct Columns {
    wanted: Option<Arc<[String]>>,
    /// All metrics so far, by name.
    metrics: Vec<Metric>,
    names: Vec<String>,
    values: Vec<Vec<f64>>,
    runs: usize,
    /// What was read of a run, by column.
    row: Vec<(usize, f64)>,
}

struct Metric {
    name: String,
    /// The name as it stands before its number: `"name":`.
    key: String,
    /// Its column; none where nobody wants it.
    column: Option<usize>,
}

impl Columns {
    fn new(wanted: Option<Arc<[String]>>) -> Self {
        Self { wanted, metrics: Vec::new(), names: Vec::new(), values: Vec::new(), runs: 0, row: Vec::new() }
    }

    fn read(&mut self, lines: &str) -> Result<(), StoreError> {
        lines.lines().try_for_each(|line| {
            if self.read_known(line) {
                return Ok(());
            }
            let mut json = serde_json::Deserializer::from_str(line);
            let read = Run(self).deserialize(&mut json).and_then(|()| json.end());
            read.map_err(|error| StoreError::Damaged(format!("a result's metrics: {error}")))
        })
    }

    /// Reads a run whose metrics are known, sorted by name and without spaces between, as they are stored: several times as
    /// fast as by way of JSON of any kind. Whether it is such a run.
    fn read_known(&mut self, line: &str) -> bool {
        self.row.clear();
        let Some(mut rest) = line.strip_prefix('{') else { return false };
        let mut end_of_line = rest;
        for metric in &self.metrics {
            let Some(behind) = rest.strip_prefix(metric.key.as_str()) else { continue };
            let Some(end) = behind.bytes().position(|byte| matches!(byte, b',' | b'}')) else { return false };
            let (number, next) = behind.split_at(end);
            if !is_number(number) {
                return false;
            }
            if let Some(column) = metric.column {
                match number.parse::<f64>() {
                    Ok(value) if value.is_finite() => self.row.push((column, value)),
                    _ => return false,
                }
            }
            rest = next.strip_prefix(',').unwrap_or(next);
            end_of_line = next;
        }
        if end_of_line != "}" {
            return false;
        }
        for (column, value) in &self.row {
            self.values[*column].push(*value);
        }
        self.end_run();
        true
    }

    fn end_run(&mut self) {
        self.runs += 1;
        self.values.iter_mut().for_each(|column| column.resize(self.runs, f64::NAN));
    }

    /// A metric's column; none where nobody wants it.
    fn column(&mut self, name: &str) -> Option<usize> {
        match self.metrics.binary_search_by(|metric| metric.name.as_str().cmp(name)) {
            Ok(known) => self.metrics[known].column,
            Err(place) => {
                let wanted = self.wanted.as_ref().is_none_or(|wanted| wanted.iter().any(|other| other == name));
                let column = wanted.then_some(self.names.len());
                if wanted {
                    self.names.push(name.to_owned());
                    self.values.push(vec![f64::NAN; self.runs]);
                }
                let key = format!("{}:", serde_json::Value::from(name));
                self.metrics.insert(place, Metric { name: name.to_owned(), key, column });
                column
            }
        }
    }

    fn finish(self) -> (u64, BTreeMap<String, Vec<f64>>) {
        (self.runs as u64, self.names.into_iter().zip(self.values).collect())
    }
}

/// Whether JSON has this number, in its usual forms.
fn is_number(text: &str) -> bool {
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let (mantissa, exponent) = text.split_once('e').unwrap_or((text, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, "0"));
    let whole = whole.strip_prefix('-').unwrap_or(whole);
    digits(whole)
        && (whole.len() == 1 || !whole.starts_with('0'))
        && digits(fraction)
        && digits(exponent.strip_prefix(['-', '+']).unwrap_or(exponent))
}

/// One run's metrics, read into the columns.
struct Run<'a>(&'a mut Columns);

impl<'de> DeserializeSeed<'de> for Run<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Run<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("numbers by metric")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let columns = self.0;
        while let Some(name) = map.next_key::<Cow<'de, str>>()? {
            match columns.column(&name) {
                Some(column) => {
                    let value = map.next_value()?;
                    // The same metric twice in one run: the last one counts, as for any JSON object.
                    columns.values[column].truncate(columns.runs);
                    columns.values[column].push(value);
                }
                None => drop(map.next_value::<IgnoredAny>()?),
            }
        }
        columns.end_run();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::protocol::RunEnd;
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;
    use crate::testing::{Bench, record, sweep};

    fn columns(lines: &str, wanted: Option<&[&str]>) -> BTreeMap<String, Vec<f64>> {
        let mut columns = Columns::new(wanted.map(|names| names.iter().map(|name| (*name).to_owned()).collect()));
        columns.read(lines).unwrap();
        columns.finish().1
    }

    #[test]
    fn what_a_run_lacks_is_no_number() {
        let found = columns("{\"a\":1,\"b\":2}\n{\"b\":3.5}\n{\"c\":4,\"a\":5}", None);
        assert_eq!(found["b"][..2], [2.0, 3.5]);
        let missing = |name: &str| found[name].iter().map(|value| value.is_nan()).collect::<Vec<_>>();
        assert_eq!((missing("a"), missing("b")), (vec![false, true, false], vec![false, false, true]));
        assert_eq!((missing("c"), found["a"][2]), (vec![true, true, false], 5.0));
        assert_eq!(columns("{\"a\":1,\"b\":2}", Some(&["b"])).keys().collect::<Vec<_>>(), ["b"]);
    }

    #[test]
    fn what_is_no_metric_is_damage() {
        let bad = [
            "[]",
            "{\"a\":\"x\"}",
            "{\"a\":1",
            "{\"a\":1}}",
            "{\"a\":1,}",
            "{\"a\":1e999}",
            "{\"a\":01}",
            "{\"a\":1.}",
            "{\"a\":+1}",
        ];
        for bad in bad {
            assert!(Columns::new(None).read(bad).is_err(), "{bad}");
            assert!(Columns::new(None).read(&format!("{{\"a\":1}}\n{bad}")).is_err(), "{bad} behind another");
        }
    }

    #[test]
    fn runs_like_the_one_before_are_read_as_any_others() {
        let rows = [
            "{\"a\":1.5,\"b\":-0.0,\"c\":1e-7}",
            "{\"a\":0.1,\"b\":12345678.9,\"c\":2.5E+20}",
            "{\"a\":3,\"b\":4,\"c\":5}",
            "{\"a\":3, \"b\":4,\"c\":5}",
            "{\"c\":6,\"a\":7}",
            "{\"a\":8,\"a\":9}",
            "{\"a\":8,\"a\":10}",
            "{}",
            "{\"d\\\"\":11}",
            "{\"d\\\"\":12}",
        ];
        for wanted in [None, Some(&["a", "d\""][..])] {
            let found = columns(&rows.join("\n"), wanted);
            for (i, row) in rows.iter().enumerate() {
                let alone: BTreeMap<String, f64> = serde_json::from_str(row).unwrap();
                for (name, column) in &found {
                    let expected = alone.get(name).copied().unwrap_or(f64::NAN);
                    assert!(
                        column[i].to_bits() == expected.to_bits() || column[i].is_nan() && expected.is_nan(),
                        "{row}"
                    );
                }
            }
            assert!(found.values().all(|column| column.len() == rows.len()));
        }
    }

    proptest! {
        #[test]
        fn any_number_that_is_stored_is_read_to_the_bit(values in prop::collection::vec(prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO, 1..8)) {
            let lines: Vec<String> = values.iter().map(|value| json!({"x": value}).to_string()).collect();
            let found = columns(&lines.join("\n"), None);
            prop_assert!(found["x"].iter().zip(&values).all(|(found, value)| found.to_bits() == value.to_bits()));
        }
    }

    #[tokio::test]
    async fn columns_hold_the_same_values_as_single_runs_do() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop", "rg"], 3)).await.id;
        let worker = bench.worker().await;
        for job in &worker.claim(6).await[1..] {
            let mut record = record(job.seed as f64);
            if job.seed == 2 {
                record.metrics.insert("trajectory_error_mean_m".to_owned(), 0.5);
            }
            worker.ended(job, RunEnd::Done(record)).await;
        }
        let (values, columns) =
            (bench.coordinator.values(id, None).await.unwrap(), bench.coordinator.columns(id, None).await.unwrap());
        for (values, columns) in values.iter().zip(&columns) {
            assert_eq!((values.position, &values.factors), (columns.position, &columns.factors));
            assert_eq!(values.jobs.len() as u64, columns.runs);
            assert!(values.metrics.keys().eq(columns.metrics.keys()));
            for (name, of_runs) in &values.metrics {
                let sorted = |values: Vec<f64>| {
                    let mut values: Vec<f64> = values.into_iter().filter(|value| !value.is_nan()).collect();
                    values.sort_by(f64::total_cmp);
                    values
                };
                let of_runs = sorted(of_runs.iter().flatten().copied().collect());
                assert_eq!(of_runs, sorted(columns.metrics[name].clone()), "{name}");
            }
        }
        assert!(bench.coordinator.columns(SweepId(99), None).await.unwrap().is_empty());
    }
}
