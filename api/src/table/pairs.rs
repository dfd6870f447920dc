//! Two values of each run, and the ratio of their sums.

use furrow_coordinator::moments::METRIC_LIMIT;
use furrow_schema::table::Statistics;

use super::bootstrap::{Contrast, influences, interval};

/// The 97.5 % limit of the expected count where none was counted: -ln 0.025.
const NONE_COUNTED: f64 = 3.688_879_454_113_936;

/// Numerator and denominator of each run, in an order that depends on nothing but the values.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pairs(Vec<[f64; 2]>);

impl Pairs {
    /// The pairs of these runs; those of which a value is no number or beyond the store's limit are left out.
    #[must_use]
    pub fn of(pairs: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let fits = |pair: &[f64; 2]| pair.iter().all(|value| value.abs() <= METRIC_LIMIT);
        let mut pairs = Self(pairs.into_iter().filter(fits).collect());
        pairs.sort();
        pairs
    }

    /// Each value over 1: the ratio of the sums is the mean.
    #[must_use]
    pub fn of_values(values: &[f64]) -> Self {
        Self::of(values.iter().map(|value| [*value, 1.0]))
    }

    /// Takes in all of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.0.extend_from_slice(&other.0);
        self.sort();
    }

    fn sort(&mut self) {
        self.0.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    }

    /// The runs.
    pub(super) fn runs(&self) -> &[[f64; 2]] {
        &self.0
    }

    /// Number of runs.
    #[must_use]
    pub fn n(&self) -> u64 {
        self.0.len() as u64
    }

    /// The sums of numerators and denominators.
    #[must_use]
    pub fn sums(&self) -> [f64; 2] {
        self.0.iter().fold([0.0, 0.0], |sums, pair| [sums[0] + pair[0], sums[1] + pair[1]])
    }

    /// The ratio of the sums; none where the denominators sum up to nothing.
    #[must_use]
    pub fn ratio(&self) -> Option<f64> {
        let [numerator, denominator] = self.sums();
        (denominator != 0.0).then(|| numerator / denominator)
    }

    /// The standard error of the ratio, from the influence of each run on it; none below two runs.
    #[must_use]
    pub fn standard_error(&self) -> Option<f64> {
        let n = self.n() as f64;
        let squares: f64 = influences(Contrast::Alone, &[self])?.iter().map(|influence| influence * influence).sum();
        (n > 1.0).then(|| (squares * n / (n - 1.0)).sqrt())
    }

    /// Number, ratio of the sums and its interval; the other statistics are of single runs, which have no ratio. An
    /// interval with an open end is none.
    #[must_use]
    pub fn summarize(&self) -> Statistics {
        let mean = self.ratio();
        let ci95 = mean.and_then(|_| interval(Contrast::Alone, &[self]));
        let ci95 = ci95.filter(|ends| ends.iter().all(|end| end.is_finite()));
        Statistics { n: self.n(), mean, ci95, ..Statistics::default() }
    }
}

impl Pairs {
    /// The 95 % interval of the ratio of counts below the line. An end may be infinite; where nothing was counted, there
    /// is a lower end yet: so many counts as give none once in 40 times (Poisson) would still have been possible.
    #[must_use]
    pub fn ends(&self) -> Option<[f64; 2]> {
        let [numerator, denominator] = self.sums();
        if denominator == 0.0 {
            return (numerator > 0.0).then_some([numerator / NONE_COUNTED, f64::INFINITY]);
        }
        interval(Contrast::Alone, &[self])
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_ratio_is_that_of_the_sums_and_not_the_mean_of_ratios() {
        let pairs = Pairs::of([[100.0, 1.0], [50.0, 2.0], [210.0, 0.0]]);
        assert_eq!((pairs.n(), pairs.sums(), pairs.ratio()), (3, [360.0, 3.0], Some(120.0)));
        let statistics = pairs.summarize();
        assert_eq!((statistics.mean, statistics.std, statistics.median), (Some(120.0), None, None));
    }

    #[test]
    fn nothing_below_the_line_gives_the_count_alone() {
        let none = Pairs::of([[100.0, 0.0], [50.0, 0.0]]).summarize();
        assert_eq!(none, Statistics { n: 2, ..Statistics::default() });
        assert_eq!(Pairs::default().summarize(), Statistics::default());
    }

    #[test]
    fn a_distance_without_an_intervention_has_a_lower_end() {
        let [low, high] = Pairs::of([[1000.0, 0.0], [2000.0, 0.0]]).ends().unwrap();
        assert!((low - 813.25).abs() < 0.01 && high == f64::INFINITY, "3,000 m / 3.689: {low}");
        assert_eq!(Pairs::of([[0.0, 0.0]]).ends(), None);
    }

    #[test]
    fn one_run_has_a_ratio_and_no_interval() {
        let one = Pairs::of([[100.0, 4.0]]).summarize();
        assert_eq!((one.mean, one.ci95), (Some(25.0), None));
    }

    #[test]
    fn an_interval_that_is_open_above_is_none() {
        let rare = Pairs::of([[100.0, 1.0], [100.0, 0.0], [100.0, 0.0]]);
        assert_eq!(rare.summarize().ci95, None);
        let [low, high] = interval(Contrast::Alone, &[&rare]).unwrap();
        assert!(low.is_finite() && high == f64::INFINITY, "[{low}, {high}]");
    }

    proptest! {
        #[test]
        fn the_order_of_the_runs_leaves_no_trace(
            (runs, shuffled) in proptest::collection::vec((0.0..400.0_f64, 0_u8..5), 0..30)
                .prop_flat_map(|runs| (Just(runs.clone()), Just(runs).prop_shuffle()))
        ) {
            let pairs = |runs: &[(f64, u8)]| Pairs::of(runs.iter().map(|(m, count)| [*m, f64::from(*count)]));
            let mut halves = pairs(&shuffled[..shuffled.len() / 2]);
            halves.merge(&pairs(&shuffled[shuffled.len() / 2..]));
            prop_assert_eq!(pairs(&runs).summarize(), halves.summarize());
        }

        #[test]
        fn the_interval_holds_the_ratio(runs in proptest::collection::vec((1.0..400.0_f64, 1_u8..9), 2..40)) {
            let s = Pairs::of(runs.iter().map(|(m, count)| [*m, f64::from(*count)])).summarize();
            let ([low, high], mean) = (s.ci95.unwrap(), s.mean.unwrap());
            prop_assert!(low <= mean * (1.0 + 1e-12) && mean <= high * (1.0 + 1e-12), "[{}, {}] {}", low, high, mean);
        }
    }
}
