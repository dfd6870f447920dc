//! What the store knows of a sweep: counts per cell, and per metric moments and, when asked for, values.

use std::collections::BTreeMap;

use furrow_coordinator::moments::{METRIC_LIMIT, Moments};
use furrow_coordinator::view::{CellColumns, CellSummary};

use super::metric::{OfSums, ratios_of_sums};
use super::pairs::Pairs;

/// The results of a sweep so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SweepData {
    /// Names of the factors, in the plan's order.
    pub factors: Vec<String>,
    /// The cells, in the plan's order.
    pub cells: Vec<CellData>,
}

/// The results of one cell so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CellData {
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// All its runs.
    pub total: u64,
    /// Runs with a result.
    pub done: u64,
    /// Runs given up on.
    pub failed: u64,
    /// What was measured, by metric.
    pub metrics: BTreeMap<String, Series>,
    /// Numerators and denominators of the ratios of sums, by ratio; none when only the moments were asked for.
    pub ratios: BTreeMap<&'static str, Pairs>,
}

/// One metric over many runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Number, extremes and exact sums.
    pub moments: Moments,
    /// The values, in no particular order; none when only the moments were asked for.
    pub values: Option<Vec<f64>>,
}

impl Series {
    /// The series of these values; those that are no number or beyond the store's limit are left out.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.into_iter().filter(|value| value.abs() <= METRIC_LIMIT).collect();
        let mut moments = Moments::default();
        values.iter().for_each(|value| moments.add(*value));
        Self { moments, values: Some(values) }
    }

    /// The series of these values, of which the store may know the moments: a result never changes, so as many values are
    /// the same values.
    fn with_moments(mut values: Vec<f64>, known: Option<Moments>) -> Self {
        values.retain(|value| value.abs() <= METRIC_LIMIT);
        match known.filter(|known| known.n() == values.len() as u64) {
            Some(moments) => Self { moments, values: Some(values) },
            None => Self::of(values),
        }
    }

    /// Takes in all of `other`; the values are known only where both were.
    pub fn merge(&mut self, other: &Self) {
        let empty = self.moments.n() == 0;
        self.moments.merge(&other.moments);
        match (&mut self.values, &other.values) {
            (Some(values), Some(more)) => values.extend_from_slice(more),
            (values, more) if empty => values.clone_from(more),
            (values, _) if other.moments.n() > 0 => *values = None,
            _ => {}
        }
    }
}

impl SweepData {
    /// The data of a sweep from the store's answers: `summaries` of all cells, and `columns` of all cells or,
    /// when neither medians nor times nor ratios of sums are asked for, of none.
    ///
    /// The two answers may be of different moments while the sweep runs: where a cell's columns are at hand,
    /// they alone are counted.
    #[must_use]
    pub fn new(factors: Vec<String>, summaries: Vec<CellSummary>, columns: Vec<CellColumns>) -> Self {
        let mut by_position: BTreeMap<u64, CellColumns> =
            columns.into_iter().map(|columns| (columns.position, columns)).collect();
        let mut summaries = summaries;
        summaries.sort_by_key(|summary| summary.position);
        let cell = |summary: CellSummary| {
            let columns = by_position.remove(&summary.position);
            CellData::new(summary, columns)
        };
        Self { factors, cells: summaries.into_iter().map(cell).collect() }
    }
}

impl CellData {
    /// Whether its label of `factor` is `label`, or the sweep has no such factor.
    pub(crate) fn allows(&self, factor: &str, label: &str) -> bool {
        self.factors.get(factor).is_none_or(|own| own == label)
    }

    fn new(summary: CellSummary, columns: Option<CellColumns>) -> Self {
        let CellSummary { factors, total, done, failed, mut metrics, .. } = summary;
        let Some(columns) = columns else {
            let metrics = metrics.into_iter().map(|(name, moments)| (name, Series { moments, values: None })).collect();
            return Self { factors, total, done, failed, metrics, ratios: BTreeMap::new() };
        };
        let pairs = |name: &str, other: &str| {
            let columns = columns.metrics.get(name)?.iter().zip(columns.metrics.get(other)?);
            Some(Pairs::of(columns.map(|(value, other)| [*value, *other])))
        };
        let ratio = |(name, of): (&'static str, OfSums)| Some((name, pairs(of.numerator, of.denominator)?));
        let ratios = ratios_of_sums().filter_map(ratio).collect();
        let series = |(name, column): (String, Vec<f64>)| {
            let known = metrics.remove(&name);
            (name, Series::with_moments(column, known))
        };
        let done = columns.runs;
        Self {
            factors,
            total: total.max(done),
            done,
            failed,
            metrics: columns.metrics.into_iter().map(series).collect(),
            ratios,
        }
    }
}

#[cfg(test)]
mod tests {
    use furrow_coordinator::view::CellValues;

    use super::*;

    fn summary(position: u64, values: &[f64]) -> CellSummary {
        CellSummary {
            id: furrow_schema::id::CellId(1),
            position,
            factors: BTreeMap::from([("field".into(), format!("crop-{position}"))]),
            total: 5,
            done: values.len() as u64,
            failed: 1,
            metrics: BTreeMap::from([("x_m".into(), Series::of(values.iter().copied()).moments)]),
        }
    }

    #[test]
    fn values_come_to_their_cell_by_position_and_bring_the_timings() {
        let values = CellValues {
            position: 2,
            jobs: vec![furrow_schema::id::JobId(1), furrow_schema::id::JobId(2)],
            metrics: BTreeMap::from([("x_m".into(), vec![Some(3.0), None])]),
            timings: BTreeMap::from([("line_finding_time_ms".into(), vec![None, Some(0.5)])]),
            ..CellValues::default()
        };
        let columns = vec![CellColumns::from(values)];
        let data = SweepData::new(vec!["field".into()], vec![summary(2, &[1.0]), summary(1, &[2.0])], columns);
        assert_eq!(data.cells[0].factors["field"], "crop-1");
        assert_eq!(data.cells[0].metrics["x_m"].values, None);
        assert_eq!(data.cells[1].done, 2);
        assert_eq!(data.cells[1].metrics["x_m"].values, Some(vec![3.0]));
        assert_eq!(data.cells[1].metrics["line_finding_time_ms"].moments.mean(), Some(0.5));
    }

    #[test]
    fn a_ratio_of_sums_takes_the_runs_that_have_both() {
        let values = CellValues {
            position: 1,
            jobs: [1, 2, 3].map(furrow_schema::id::JobId).into(),
            metrics: BTreeMap::from([
                ("distance_m".into(), vec![Some(220.0), None, Some(30.0)]),
                ("relevant_interventions".into(), vec![Some(2.0), Some(1.0), Some(0.0)]),
            ]),
            ..CellValues::default()
        };
        let data = SweepData::new(vec!["field".into()], vec![summary(1, &[1.0])], vec![values.into()]);
        let ratios = &data.cells[0].ratios;
        assert_eq!(ratios.keys().collect::<Vec<_>>(), [&"distance_per_intervention_m"]);
        assert_eq!(ratios["distance_per_intervention_m"], Pairs::of([[220.0, 2.0], [30.0, 0.0]]));
    }

    #[test]
    fn values_of_a_part_are_not_taken_for_all_values() {
        let mut known = Series::of([1.0]);
        known.merge(&Series { values: None, ..Series::of([2.0]) });
        assert_eq!((known.moments.n(), known.values), (2, None));

        let mut empty = Series::default();
        empty.merge(&Series::of([2.0]));
        assert_eq!(empty.values, Some(vec![2.0]));
    }

    #[test]
    fn what_is_no_number_is_not_counted() {
        assert_eq!(Series::of([f64::NAN, f64::INFINITY, 1.0]).moments.n(), 1);
    }
}
