//! The bootstrap over pairs: of a difference of means, or of ratios of sums.
//!
//! Whole pairs are drawn anew with replacement, so that what the two runs of a pair have in common stays in both. All else
//! is as for tables: 2,000 resamples of a generator with a fixed seed, BCa ends with the acceleration from the influence of
//! each pair, the normal interval from 2,000 pairs on.

use crate::table::{Draws, NORMAL_FROM, RESAMPLES, accelerated_ends, acceleration};

pub(super) use crate::table::Z_975;

/// A pair of runs: numerator and denominator of a, then of b.
pub(super) type Row = [f64; 4];

/// A difference of ratios of sums.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Resampled {
    /// Its standard error, from the influence of each pair.
    pub(super) standard_error: f64,
    /// The 95 % interval, of which an end may be infinite.
    pub(super) ci95: [f64; 2],
}

/// The ratio of the sums of a and of b; none where a denominator is nothing.
pub(super) fn ratios(rows: &[Row]) -> [Option<f64>; 2] {
    let [above_a, below_a, above_b, below_b] = sums(rows.iter());
    let ratio = |above: f64, below: f64| (below != 0.0).then(|| above / below);
    [ratio(above_a, below_a), ratio(above_b, below_b)]
}

fn sums<'a>(rows: impl Iterator<Item = &'a Row>) -> Row {
    rows.fold([0.0; 4], |sum, row| [sum[0] + row[0], sum[1] + row[1], sum[2] + row[2], sum[3] + row[3]])
}

/// The interval of the ratio of a less that of b; none with fewer than two pairs, or where there is no such ratio.
/// `rows` is sorted here, so that neither their order nor which side is called a leaves a trace.
pub(super) fn interval(rows: &mut [Row]) -> Option<Resampled> {
    let mut swapped: Vec<Row> = rows.iter().map(|[a, b, c, d]| [*c, *d, *a, *b]).collect();
    rows.sort_by(compare);
    swapped.sort_by(compare);
    let turned = rows.iter().zip(&swapped).map(|(own, other)| compare(own, other)).find(|order| order.is_ne());
    if turned.is_some_and(std::cmp::Ordering::is_gt) {
        let Resampled { standard_error, ci95: [low, high] } = of_sorted(&swapped)?;
        return Some(Resampled { standard_error, ci95: [-high, -low] });
    }
    of_sorted(rows)
}

fn compare(a: &Row, b: &Row) -> std::cmp::Ordering {
    a.iter().zip(b).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(std::cmp::Ordering::Equal)
}

fn of_sorted(rows: &[Row]) -> Option<Resampled> {
    let [Some(a), Some(b)] = ratios(rows) else { return None };
    if rows.len() < 2 {
        return None;
    }
    let [_, below_a, _, below_b] = sums(rows.iter());
    let influence = |row: &Row| (row[0] - a * row[1]) / below_a - (row[2] - b * row[3]) / below_b;
    let influences: Vec<f64> = rows.iter().map(influence).collect();
    let standard_error = influences.iter().map(|influence| influence * influence).sum::<f64>().sqrt();
    let ci95 = if rows.len() >= NORMAL_FROM {
        [a - b - Z_975 * standard_error, a - b + Z_975 * standard_error]
    } else {
        let mut figures = resampled(rows);
        figures.sort_by(f64::total_cmp);
        accelerated_ends(&figures, a - b, a.abs() + b.abs(), acceleration(&influences))?
    };
    Some(Resampled { standard_error, ci95 })
}

/// The difference in each resample that has one.
fn resampled(rows: &[Row]) -> Vec<f64> {
    let mut draws = Draws::new();
    let mut figure = || {
        let [above_a, below_a, above_b, below_b] = sums((0..rows.len()).map(|_| &rows[draws.below(rows.len())]));
        above_a / below_a - above_b / below_b
    };
    (0..RESAMPLES).map(|_| figure()).filter(|figure| !figure.is_nan()).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::signed_rank::tests::DARWIN;
    use super::*;

    fn means(differences: &[f64]) -> Vec<Row> {
        differences.iter().map(|difference| [difference + 100.0, 1.0, 100.0, 1.0]).collect()
    }

    #[test]
    fn two_pairs_give_what_their_four_resamples_give() {
        // Differences 1 and 3: 1, 2, 2 or 3.
        let found = interval(&mut means(&[1.0, 3.0])).unwrap();
        assert_eq!(found.ci95, [1.0, 3.0]);
        // Half the deviation of two values around their mean, with n below the line: sqrt(1/2).
        assert!((found.standard_error - 0.5_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn darwins_maize_has_an_interval_like_that_of_scipy() {
        // scipy 1.17.1, bootstrap(method="BCa", n_resamples=400000); the ends of 2,000 resamples scatter by about 1.
        let [low, high] = interval(&mut means(&DARWIN)).unwrap().ci95;
        assert!((low - SCIPY[0]).abs() < 2.0 && (high - SCIPY[1]).abs() < 2.0, "[{low}, {high}]");
    }

    const SCIPY: [f64; 2] = [-1.666_667, 36.333_333];

    #[test]
    fn what_both_runs_of_a_pair_share_does_not_widen_the_interval() {
        let pairs: Vec<Row> = (0..50).map(|i| [f64::from(i * i) + 1.0, 1.0, f64::from(i * i), 1.0]).collect();
        assert_eq!(interval(&mut pairs.clone()).unwrap().ci95, [1.0, 1.0]);
    }

    #[test]
    fn a_side_with_nothing_below_the_line_has_no_interval_and_rare_counts_an_open_one() {
        assert_eq!(interval(&mut [[100.0, 0.0, 90.0, 2.0]; 3]), None);
        let mut rare = vec![[100.0, 0.0, 100.0, 5.0]; 4];
        rare.push([100.0, 1.0, 100.0, 4.0]);
        let [low, high] = interval(&mut rare).unwrap().ci95;
        assert!(low.is_finite() && high == f64::INFINITY, "[{low}, {high}]");
    }

    #[test]
    fn many_pairs_have_the_normal_interval_and_it_is_where_the_bootstrap_s_is() {
        let row = |i: usize| [200.0 + (i % 7) as f64, (i % 3) as f64, 150.0 + (i % 5) as f64, (i % 4) as f64];
        let of = |n: usize| interval(&mut (0..n).map(row).collect::<Vec<_>>()).unwrap().ci95;
        let (fewer, more) = (of(NORMAL_FROM - 1), of(NORMAL_FROM + 1));
        let width = more[1] - more[0];
        assert!(fewer.iter().zip(&more).all(|(a, b)| (a - b).abs() < 0.15 * width), "{fewer:?} {more:?}");
    }

    fn rows() -> impl Strategy<Value = Vec<Row>> {
        let row = (0u8..9, 0u8..3, 0u8..9, 0u8..3).prop_map(|(a, b, c, d)| [a, b, c, d].map(f64::from));
        proptest::collection::vec(row, 2..25)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        #[test]
        fn swapping_the_sides_turns_the_interval_and_the_order_leaves_no_trace(
            (mut rows, mut shuffled) in rows().prop_flat_map(|rows| (Just(rows.clone()), Just(rows).prop_shuffle()))
        ) {
            let mut swapped: Vec<Row> = rows.iter().map(|[a, b, c, d]| [*c, *d, *a, *b]).collect();
            let own = interval(&mut rows);
            prop_assert_eq!(own, interval(&mut shuffled));
            let turned = own.map(|own| [-own.ci95[1], -own.ci95[0]]);
            prop_assert_eq!(interval(&mut swapped).map(|other| other.ci95), turned);
        }
    }
}
