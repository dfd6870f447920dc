//! What is said of many values: mean, deviation, median, extremes, and an interval of 95 % for the mean.

use furrow_coordinator::moments::Moments;
use furrow_schema::table::Statistics;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::data::Series;
use super::query::Statistic;

/// The 97.5 % quantile of the standard normal distribution.
const Z_975: f64 = 1.959_963_984_540_054;

/// The statistics of a series; `ratio` when each value is 0 or 1.
///
/// All but the median come from exact sums, so the order of the values leaves no trace. What is not defined is
/// none: everything without values, deviation and Student's interval for one value, the median where the values
/// are not at hand. Wilson's interval is defined for one value.
#[must_use]
pub fn summarize(series: &Series, ratio: bool) -> Statistics {
    let moments = &series.moments;
    let (mean, std) = (mean(moments), std(moments));
    let interval =
        |mean| if ratio { wilson_interval(mean, moments.n()) } else { student_interval(mean, std?, moments.n()) };
    Statistics {
        n: moments.n(),
        mean,
        std,
        median: series.values.as_deref().and_then(median),
        min: moments.min(),
        max: moments.max(),
        ci95: mean.and_then(interval),
        ..Statistics::default()
    }
}

/// `statistics` with the sum and the percentiles of the series that were asked for.
#[must_use]
pub fn with_sum_and_percentiles(mut statistics: Statistics, series: &Series, asked: &[Statistic]) -> Statistics {
    let mut values = Vec::new();
    if asked.iter().any(|statistic| statistic.needs_values()) {
        values.extend_from_slice(series.values.as_deref().unwrap_or_default());
    }
    for statistic in asked {
        match statistic {
            Statistic::Sum => statistics.sum = (statistics.n > 0).then(|| series.moments.sum()),
            Statistic::P5 => statistics.p5 = percentile(&mut values, 0.05),
            Statistic::P25 => statistics.p25 = percentile(&mut values, 0.25),
            Statistic::P75 => statistics.p75 = percentile(&mut values, 0.75),
            Statistic::P95 => statistics.p95 = percentile(&mut values, 0.95),
            _ => {}
        }
    }
    statistics
}

/// The value below which the share `at` of the values lies, from 0 to 1: linear between the two that are nearest
/// (Hyndman and Fan 1996, definition 7); none without values, whose order it changes.
fn percentile(values: &mut [f64], at: f64) -> Option<f64> {
    let place = at * values.len().checked_sub(1)? as f64;
    let (_, lower, above) = values.select_nth_unstable_by(place as usize, f64::total_cmp);
    let lower = *lower;
    let upper = above.iter().copied().min_by(f64::total_cmp).unwrap_or(lower);
    Some((lower + (upper - lower) * place.fract()).clamp(lower, upper))
}

/// The mean, within the extremes: the one rounding of sum and quotient must not lead outside.
fn mean(moments: &Moments) -> Option<f64> {
    Some(moments.mean()?.clamp(moments.min()?, moments.max()?))
}

/// The value in the middle, or the mean of the two in the middle; none without values.
pub(crate) fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    if values.is_empty() {
        return None;
    }
    let (below, upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    let upper = *upper;
    let lower = if even { below.iter().copied().max_by(f64::total_cmp)? } else { upper };
    Some(f64::midpoint(lower, upper))
}

/// The sample standard deviation: exactly none of it where all values are the same.
fn std(moments: &Moments) -> Option<f64> {
    let std = moments.std()?;
    Some(if moments.min() == moments.max() { 0.0 } else { std })
}

/// Student's 95 % interval of a mean from `n` values with sample standard deviation `std`; none below two values.
#[must_use]
pub fn student_interval(mean: f64, std: f64, n: u64) -> Option<[f64; 2]> {
    student_interval_at(0.05, mean, std, n)
}

/// Student's interval that misses the mean with a chance of `error`, above 0 and below 1.
#[must_use]
pub fn student_interval_at(error: f64, mean: f64, std: f64, n: u64) -> Option<[f64; 2]> {
    if n < 2 {
        return None;
    }
    let half = t_quantile(1.0 - error / 2.0, n - 1)? * std / (n as f64).sqrt();
    half.is_finite().then_some([mean - half, mean + half])
}

/// The quantile of Student's distribution.
///
/// The library's search for it loses digits as the freedom grows; from 200 on the expansion around the normal
/// quantile is exact to 1e-10 (Abramowitz and Stegun, 26.7.5).
fn t_quantile(share: f64, freedom: u64) -> Option<f64> {
    let v = freedom as f64;
    if freedom < 200 {
        return Some(StudentsT::new(0.0, 1.0, v).ok()?.inverse_cdf(share));
    }
    let z = if share == 0.975 { Z_975 } else { Normal::new(0.0, 1.0).ok()?.inverse_cdf(share) };
    let terms = [
        (z.powi(3) + z) / 4.0,
        (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0,
        (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0,
        (79.0 * z.powi(9) + 776.0 * z.powi(7) + 1482.0 * z.powi(5) - 1920.0 * z.powi(3) - 945.0 * z) / 92160.0,
    ];
    Some(terms.iter().rev().fold(0.0, |sum, term| (sum + term) / v) + z)
}

/// Wilson's 95 % interval of a ratio that was `ratio` in `n` trials; none without trials.
#[must_use]
pub fn wilson_interval(ratio: f64, n: u64) -> Option<[f64; 2]> {
    if n == 0 || !(0.0..=1.0).contains(&ratio) {
        return None;
    }
    let n = n as f64;
    let z2_n = Z_975 * Z_975 / n;
    let centre = (ratio + z2_n / 2.0) / (1.0 + z2_n);
    let half = Z_975 / (1.0 + z2_n) * (ratio * (1.0 - ratio) / n + z2_n / (4.0 * n)).sqrt();
    // At the ends of the scale the formula gives 0 and 1 but for rounding.
    let low = if ratio == 0.0 { 0.0 } else { (centre - half).max(0.0) };
    let high = if ratio == 1.0 { 1.0 } else { (centre + half).min(1.0) };
    Some([low, high])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 5e-5 * b.abs().max(1.0)
    }

    #[track_caller]
    fn assert_interval(found: Option<[f64; 2]>, low: f64, high: f64) {
        let [a, b] = found.unwrap();
        assert!(close(a, low) && close(b, high), "[{a}, {b}] is not [{low}, {high}]");
    }

    #[test]
    fn wilson_gives_the_textbook_intervals() {
        assert_interval(wilson_interval(1.0, 20), 0.83887, 1.0);
        assert_interval(wilson_interval(0.0, 20), 0.0, 0.16113);
        assert_interval(wilson_interval(0.8, 5), 0.37553, 0.96380);
        assert_interval(wilson_interval(0.5, 10), 0.23659, 0.76341);
        assert_interval(wilson_interval(1.0, 1), 0.20655, 1.0);
        assert_eq!(wilson_interval(0.5, 0), None);
    }

    #[test]
    fn students_quantiles_are_those_of_the_tables() {
        for (freedom, t) in [
            (1, 12.706_204_74),
            (2, 4.302_652_73),
            (4, 2.776_445_11),
            (9, 2.262_157_16),
            (19, 2.093_024_05),
            (99, 1.984_216_95),
            (199, 1.971_956_54),
            (200, 1.971_896_22),
            (9_999, 1.960_201_26),
            (999_999, 1.959_966_36),
        ] {
            let n = freedom + 1;
            let [low, high] = student_interval(0.0, (n as f64).sqrt(), n).unwrap();
            assert!((high - t).abs() < 1e-6 && low == -high, "{freedom}: {high} is not {t}");
        }
    }

    #[test]
    fn the_statistics_of_a_few_values() {
        let s = summarize(&Series::of([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]), false);
        assert_eq!((s.n, s.mean, s.median, s.min, s.max), (8, Some(5.0), Some(4.5), Some(2.0), Some(9.0)));
        assert!(close(s.std.unwrap(), 2.13809));
        assert_interval(s.ci95, 3.212_5, 6.787_5);
    }

    #[test]
    fn percentiles_are_those_of_numpy() {
        // numpy.percentile([2, 4, 4, 4, 5, 5, 7, 9], [5, 25, 75, 95]), numpy 2.4.6.
        let series = Series::of([2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]);
        let s = with_sum_and_percentiles(summarize(&series, false), &series, &Statistic::ALL);
        for (found, expected) in [(s.p5, 2.7), (s.p25, 4.0), (s.p75, 5.5), (s.p95, 8.3), (s.sum, 40.0)] {
            assert!(close(found.unwrap(), expected), "{found:?} is not {expected}");
        }
        let none = with_sum_and_percentiles(Statistics::default(), &Series::default(), &Statistic::ALL);
        assert_eq!(none, Statistics::default());
    }

    #[test]
    fn one_value_has_a_mean_but_no_spread() {
        let s = summarize(&Series::of([3.0]), false);
        assert_eq!((s.n, s.mean, s.median, s.std, s.ci95), (1, Some(3.0), Some(3.0), None, None));
        let s = summarize(&Series::of([1.0]), true);
        assert_eq!((s.std, s.ci95.is_some()), (None, true));
    }

    #[test]
    fn no_value_gives_nothing_but_the_count() {
        assert_eq!(summarize(&Series::default(), true), Statistics::default());
        assert_eq!(summarize(&Series::of([]), false), Statistics::default());
    }

    #[test]
    fn without_the_values_only_the_median_is_missing() {
        let all = Series::of([1.0, 2.0, 4.0]);
        let moments = Series { values: None, ..all.clone() };
        assert_eq!(summarize(&moments, false), Statistics { median: None, ..summarize(&all, false) });
    }

    #[test]
    fn equal_values_have_an_interval_of_one_point() {
        let s = summarize(&Series::of([0.1; 3]), false);
        assert_eq!((s.mean, s.std, s.ci95), (Some(0.1), Some(0.0), Some([0.1, 0.1])));
    }

    proptest! {
        #[test]
        fn the_order_of_the_values_leaves_no_trace(
            (values, shuffled) in proptest::collection::vec(-1e6..1e6_f64, 0..40)
                .prop_flat_map(|v| (Just(v.clone()), Just(v).prop_shuffle()))
        ) {
            prop_assert_eq!(summarize(&Series::of(values), false), summarize(&Series::of(shuffled), false));
        }

        #[test]
        fn mean_and_median_lie_within_the_extremes(values in proptest::collection::vec(-1e6..1e6_f64, 1..40)) {
            let s = summarize(&Series::of(values), false);
            let within = |x: f64| s.min.unwrap() <= x && x <= s.max.unwrap();
            prop_assert!(within(s.mean.unwrap()) && within(s.median.unwrap()));
        }

        #[test]
        fn the_median_halves_the_values(values in proptest::collection::vec(-1e3..1e3_f64, 1..40)) {
            let median = median(&values).unwrap();
            let below = values.iter().filter(|value| **value < median).count();
            let above = values.iter().filter(|value| **value > median).count();
            prop_assert!(below * 2 <= values.len() && above * 2 <= values.len());
        }

        #[test]
        fn wilson_lies_on_the_scale_around_the_ratio(hits in 0u64..=50, more in 0u64..50) {
            let n = (hits + more).max(1);
            let ratio = hits as f64 / n as f64;
            let [low, high] = wilson_interval(ratio, n).unwrap();
            prop_assert!(0.0 <= low && low <= ratio && ratio <= high && high <= 1.0 && low < high);
        }
    }
}
