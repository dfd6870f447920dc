//! McNemar's exact test and the odds ratio of matched pairs.

use crate::table::{at_most, clopper_pearson_interval};

/// The two-sided p value that `only_a` and `only_b` pairs, of which one side alone is a success, come from even odds:
/// twice the smaller binomial tail, at most 1. Without such pairs it is 1.
pub(super) fn exact(only_a: u64, only_b: u64) -> f64 {
    let (fewer, all) = (only_a.min(only_b), only_a + only_b);
    let tail = if all <= SUMMED_UP_TO { summed(fewer, all) } else { at_most(fewer, all, 0.5) };
    (2.0 * tail).min(1.0)
}

/// Up to so many pairs the tail is a plain sum, of which no term is too small to be written.
const SUMMED_UP_TO: u64 = 1_000;

/// The chance of at most `k` heads in `n` throws of a fair coin.
fn summed(k: u64, n: u64) -> f64 {
    let mut term = (-(n as f64)).exp2();
    let mut sum = term;
    for hits in 1..=k {
        term *= (n - hits + 1) as f64 / hits as f64;
        sum += term;
    }
    sum
}

/// The odds that a alone succeeds rather than b alone; none if b never does.
pub(super) fn odds_ratio(only_a: u64, only_b: u64) -> Option<f64> {
    (only_b > 0).then(|| only_a as f64 / only_b as f64)
}

/// The exact 95 % interval of the odds ratio (Clopper and Pearson 1934); an end that is none is open. None without pairs
/// of which one side alone succeeds.
pub(super) fn odds_ratio_interval(only_a: u64, only_b: u64) -> Option<[Option<f64>; 2]> {
    let all = only_a + only_b;
    if all == 0 {
        return None;
    }
    let [low, high] = clopper_pearson_interval(only_a, all, 0.05);
    let odds = |share: f64| (share < 1.0).then(|| share / (1.0 - share));
    Some([if only_a == 0 { Some(0.0) } else { odds(low) }, if only_b == 0 { None } else { odds(high) }])
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn close(found: f64, expected: f64) -> bool {
        (found - expected).abs() <= 1e-9 * expected.abs().max(1e-9)
    }

    #[test]
    fn the_p_values_are_those_of_statsmodels() {
        // mcnemar(exact=True), statsmodels 0.15.0.
        for (only_a, only_b, p) in [
            (1, 9, 0.021_484_375),
            (0, 5, 0.062_5),
            (3, 3, 1.0),
            (59, 6, 4.964_650_327_128_616e-12),
            (12, 30, 0.007_915_897_334_896_727),
            (150, 190, 0.034_270_046_533_293_9),
        ] {
            assert!(close(exact(only_a, only_b), p), "{only_a}, {only_b}: {}", exact(only_a, only_b));
        }
        assert_eq!(exact(0, 0), 1.0);
        assert!(exact(2, 1_500) < 1e-300);
        assert!(close(summed(450, 1_000), at_most(450, 1_000, 0.5)));
    }

    #[test]
    fn the_odds_intervals_are_those_of_scipy() {
        // binomtest(k, n).proportion_ci(method="exact") as odds, scipy 1.17.1.
        for (only_a, only_b, low, high) in [
            (9, 1, 1.247_109_625_327_664_3, 394.479_113_033_665_5),
            (30, 12, 1.242_963_135_062_152, 5.361_668_483_508_041),
            (1, 7, 0.003_169_739_030_254_097_4, 1.111_975_553_647_155_6),
        ] {
            let [Some(a), Some(b)] = odds_ratio_interval(only_a, only_b).unwrap() else { panic!("both ends") };
            assert!(close(a, low) && close(b, high), "{only_a}, {only_b}: [{a}, {b}]");
        }
        let [low, high] = odds_ratio_interval(5, 0).unwrap();
        assert!(close(low.unwrap(), 0.916_355_857_315_46) && high.is_none());
        assert_eq!(odds_ratio_interval(0, 0), None);
        assert_eq!((odds_ratio(6, 3), odds_ratio(6, 0), odds_ratio(0, 6)), (Some(2.0), None, Some(0.0)));
    }

    proptest! {
        #[test]
        fn swapping_the_sides_changes_no_p_value_and_turns_the_odds_over(a in 0u64..200, b in 0u64..200) {
            prop_assert_eq!(exact(a, b), exact(b, a));
            if let (Some([low, _]), Some([_, high])) = (odds_ratio_interval(a, b), odds_ratio_interval(b, a)) {
                match (low, high) {
                    (Some(low), Some(high)) => prop_assert!((low * high - 1.0).abs() < 1e-9),
                    (low, high) => prop_assert!(low == Some(0.0) && high.is_none()),
                }
            }
        }
    }
}
