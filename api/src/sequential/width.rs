//! How wide the interval of each cell is.

use std::collections::BTreeMap;

use serde::Serialize;

use super::goal::Width;
use crate::table::{CellData, Pairs, Series, SweepData, clopper_pearson_interval, metric, student_interval_at};

/// The interval of one cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CellWidth {
    /// The cell's labels.
    pub factors: BTreeMap<String, String>,
    /// Runs with a value.
    pub n: u64,
    /// The mean, or the ratio.
    pub mean: Option<f64>,
    /// The interval at the error rate of the look; none where it is not defined yet.
    pub interval: Option<[f64; 2]>,
    /// The widest that was asked for, in the metric's unit.
    pub at_most: Option<f64>,
}

impl CellWidth {
    /// Whether the interval is as narrow as asked.
    #[must_use]
    pub fn reached(&self) -> bool {
        self.interval.zip(self.at_most).is_some_and(|([low, high], at_most)| high - low <= at_most)
    }

    /// How many times as wide as asked; infinite where there is no interval yet.
    #[must_use]
    pub fn excess(&self) -> f64 {
        self.interval.zip(self.at_most).map_or(f64::INFINITY, |([low, high], at_most)| (high - low) / at_most)
    }
}

/// The interval of `name` in every cell at the error rate `error`, beside what was asked for.
#[must_use]
pub fn widths(data: &SweepData, name: &str, at_most: Width, error: f64) -> Vec<CellWidth> {
    data.cells.iter().map(|cell| width(cell, name, at_most, error)).collect()
}

fn width(cell: &CellData, name: &str, at_most: Width, error: f64) -> CellWidth {
    let (n, mean, interval) = match (cell.ratios.get(name), cell.metrics.get(name)) {
        (Some(pairs), _) => of_sums(pairs, error),
        (None, Some(series)) if metric(name).ratio => of_ratio(series, error),
        (None, Some(series)) => of_mean(series, error),
        (None, None) => (0, None, None),
    };
    let at_most = match at_most {
        Width::Absolute(width) => Some(width),
        Width::OfMean(share) => mean.map(|mean| share * mean.abs()),
    };
    CellWidth { factors: cell.factors.clone(), n, mean, interval, at_most }
}

type Found = (u64, Option<f64>, Option<[f64; 2]>);

fn of_ratio(series: &Series, error: f64) -> Found {
    let n = series.moments.n();
    let mean = series.moments.mean();
    let interval = mean.map(|mean| clopper_pearson_interval((mean * n as f64).round() as u64, n, error));
    (n, mean, interval)
}

fn of_mean(series: &Series, error: f64) -> Found {
    let (n, mean, std) = (series.moments.n(), series.moments.mean(), series.moments.std());
    (n, mean, mean.zip(std).and_then(|(mean, std)| student_interval_at(error, mean, std, n)))
}

fn of_sums(pairs: &Pairs, error: f64) -> Found {
    let n = pairs.n();
    let interval = pairs
        .ratio()
        .zip(pairs.standard_error())
        .and_then(|(ratio, standard_error)| student_interval_at(error, ratio, standard_error * (n as f64).sqrt(), n));
    (n, pairs.ratio(), interval)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sequential::{error_rate_of, next_seeds};
    use crate::table::Draws;

    fn cell(name: &str, values: &[f64]) -> SweepData {
        let metrics = BTreeMap::from([(name.to_owned(), Series::of(values.iter().copied()))]);
        SweepData { factors: vec![], cells: vec![CellData { metrics, ..CellData::default() }] }
    }

    #[test]
    fn a_width_is_asked_for_in_units_or_as_a_share_of_the_mean() {
        let data = cell("mean_squared_error_mm2", &[90.0, 100.0, 110.0]);
        let wide = &widths(&data, "mean_squared_error_mm2", Width::Absolute(40.0), 0.05)[0];
        // Student's with two degrees of freedom: 4.3027 x 10 / sqrt(3) to each side.
        let [low, high] = wide.interval.unwrap();
        assert!((high - low - 49.683).abs() < 1e-2 && !wide.reached(), "{wide:?}");
        let share = &widths(&data, "mean_squared_error_mm2", Width::OfMean(0.5), 0.05)[0];
        assert!(share.at_most == Some(50.0) && share.reached(), "{share:?}");
        assert!(!widths(&data, "success", Width::Absolute(1.0), 0.05)[0].reached(), "nothing is no narrow interval");
    }

    #[test]
    fn a_ratio_of_sums_has_the_interval_of_its_linear_approximation() {
        let pairs = Pairs::of([[10.0, 1.0], [12.0, 1.0], [11.0, 1.0]]);
        let [a, b] = of_sums(&pairs, 0.05).2.unwrap();
        // With denominators of 1 it is Student's interval of the mean.
        let [low, high] = student_interval_at(0.05, 11.0, 1.0, 3).unwrap();
        assert!((a - low).abs() < 1e-12 && (b - high).abs() < 1e-12, "[{a}, {b}] is not [{low}, {high}]");
    }

    /// Of 2,000 searches for a success ratio, so many end with an interval that misses it.
    fn misses(ratio: f64) -> usize {
        let mut draws = Draws::new();
        let mut hit = || f64::from(u8::from((draws.below(1_000_000) as f64) < ratio * 1e6));
        let search = |hit: &mut dyn FnMut() -> f64| {
            let mut values: Vec<f64> = (0..5).map(|_| hit()).collect();
            for look in 1.. {
                let found = &widths(&cell("success", &values), "success", Width::Absolute(0.5), error_rate_of(look))[0];
                if found.reached() {
                    let [low, high] = found.interval.unwrap();
                    return !(low..=high).contains(&ratio);
                }
                let wanted = next_seeds(values.len() as u64, 1_000);
                while (values.len() as u64) < wanted {
                    values.push(hit());
                }
            }
            unreachable!("an interval of 0.5 is reached with a thousand runs")
        };
        (0..2_000).filter(|_| search(&mut hit)).count()
    }

    #[test]
    fn a_search_that_ends_when_the_interval_is_narrow_misses_less_than_one_time_in_twenty() {
        for ratio in [0.5, 0.8, 0.97] {
            let misses = misses(ratio);
            assert!(misses <= 100, "{misses} of 2,000 at {ratio}");
        }
    }
}
