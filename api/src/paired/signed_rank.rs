//! Wilcoxon's signed-rank test of differences around 0 (Wilcoxon 1945).
//!
//! Differences of 0 are dropped. The p value is exact for up to 50 differences without ties, and otherwise from the normal
//! approximation with corrections for ties and continuity.

use statrs::distribution::{ContinuousCDF, Normal};

/// Up to so many differences the distribution is counted out.
const EXACT_UP_TO: usize = 50;

/// What the test says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SignedRank {
    /// The two-sided p value; 1 where nothing differs.
    pub(super) p: f64,
    /// Whether it is exact.
    pub(super) exact: bool,
    /// Differences of 0, which were dropped.
    pub(super) zeros: u64,
    /// Matched-pairs rank-biserial correlation: the share of the ranks for a less that for b, -1 to 1.
    pub(super) rank_biserial: f64,
}

/// The test on these differences, which are finite; none without any.
pub(super) fn signed_rank(differences: &[f64]) -> Option<SignedRank> {
    if differences.is_empty() {
        return None;
    }
    let mut rest: Vec<f64> = differences.iter().copied().filter(|difference| *difference != 0.0).collect();
    let zeros = (differences.len() - rest.len()) as u64;
    if rest.is_empty() {
        return Some(SignedRank { p: 1.0, exact: true, zeros, rank_biserial: 0.0 });
    }
    rest.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    let ranks = Ranks::of(&rest);
    let (n, all) = (rest.len() as f64, ranks.positive + ranks.negative);
    let exact = rest.len() <= EXACT_UP_TO && ranks.ties == 0.0;
    let smaller = ranks.positive.min(ranks.negative);
    let p = if exact { exact_p(rest.len(), smaller) } else { normal_p(n, smaller, ranks.ties) };
    Some(SignedRank { p, exact, zeros, rank_biserial: (ranks.positive - ranks.negative) / all })
}

/// Sums of ranks by sign, and what the ties take from the variance: the sum of t^3 - t over them.
struct Ranks {
    positive: f64,
    negative: f64,
    ties: f64,
}

impl Ranks {
    /// Of differences sorted by magnitude; those of one magnitude share their mean rank.
    fn of(sorted: &[f64]) -> Self {
        let mut ranks = Self { positive: 0.0, negative: 0.0, ties: 0.0 };
        let mut before = 0.0;
        for tied in sorted.chunk_by(|a, b| a.abs() == b.abs()) {
            let count = tied.len() as f64;
            let rank = before + (count + 1.0) / 2.0;
            let positive = tied.iter().filter(|difference| **difference > 0.0).count() as f64;
            ranks.positive += positive * rank;
            ranks.negative += (count - positive) * rank;
            ranks.ties += count.powi(3) - count;
            before += count;
        }
        ranks
    }
}

/// Twice the share of the 2^n signs under which a sum of ranks is at most `smaller`. The counts are whole below 2^53.
fn exact_p(n: usize, smaller: f64) -> f64 {
    let mut ways = vec![0.0; n * (n + 1) / 2 + 1];
    ways[0] = 1.0;
    for rank in 1..=n {
        for sum in (rank..ways.len()).rev() {
            ways[sum] += ways[sum - rank];
        }
    }
    let at_most: f64 = ways[..=smaller as usize].iter().sum();
    (2.0 * at_most / (n as f64).exp2()).min(1.0)
}

fn normal_p(n: f64, smaller: f64, ties: f64) -> f64 {
    let mean = n * (n + 1.0) / 4.0;
    let deviation = (n * (n + 1.0) * (2.0 * n + 1.0) / 24.0 - ties / 48.0).sqrt();
    let z = ((mean - smaller - 0.5) / deviation).max(0.0);
    Normal::new(0.0, 1.0).map_or(1.0, |normal| (2.0 * normal.sf(z)).min(1.0))
}

#[cfg(test)]
pub(super) mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Heights of Darwin's cross-fertilised less self-fertilised maize [1/8 inch] (Fisher 1935, The Design of Experiments).
    pub(in super::super) const DARWIN: [f64; 15] =
        [6.0, 8.0, 14.0, 16.0, 23.0, 24.0, 28.0, 29.0, 41.0, -48.0, 49.0, 56.0, 60.0, -67.0, 75.0];

    fn thirds(n: i32) -> Vec<f64> {
        (1..=n).map(|i| if i % 3 == 0 { -f64::from(i) } else { f64::from(i) }).collect()
    }

    #[track_caller]
    fn assert_p(differences: &[f64], exact: bool, p: f64) {
        let found = signed_rank(differences).unwrap();
        assert!(found.exact == exact && (found.p / p - 1.0).abs() < 1e-9, "{found:?}, expected {p}");
    }

    #[test]
    fn the_p_values_are_those_of_scipy() {
        // wilcoxon(zero_method="wilcox", correction=True), scipy 1.17.1, method "exact" and "approx".
        assert_p(&DARWIN, true, 0.041_259_765_625);
        assert_p(&thirds(30), true, 0.170_598_395_168_781_28);
        assert_p(&thirds(50), true, 0.026_166_968_171_196_46);
        assert_p(&thirds(60), false, 0.036_226_494_178_786_63);
        let ties_and_a_zero = [15.0, -7.0, 5.0, 20.0, 0.0, -9.0, 17.0, -12.0, 5.0, -10.0];
        assert_p(&ties_and_a_zero, false, 0.635_289_318_835_207_2);
        assert_eq!(signed_rank(&ties_and_a_zero).unwrap().zeros, 1);
        assert!((normal_p(15.0, 24.0, 0.0) - 0.043_772_323_763_041_17).abs() < 1e-10);
    }

    #[test]
    fn the_correlation_is_the_balance_of_the_ranks() {
        assert!((signed_rank(&DARWIN).unwrap().rank_biserial - 72.0 / 120.0).abs() < 1e-15);
        assert_eq!(signed_rank(&[1.0, 2.0]).unwrap().rank_biserial, 1.0);
    }

    #[test]
    fn where_nothing_differs_there_is_no_evidence() {
        let none = signed_rank(&[0.0, -0.0]).unwrap();
        assert_eq!((none.p, none.zeros, none.rank_biserial), (1.0, 2, 0.0));
        assert_eq!(signed_rank(&[]), None);
    }

    proptest! {
        #[test]
        fn swapping_the_sides_turns_the_sign_only(values in proptest::collection::vec(-20i32..20, 1..80)) {
            let values: Vec<f64> = values.into_iter().map(f64::from).collect();
            let swapped: Vec<f64> = values.iter().map(|value| -value).collect();
            let (own, other) = (signed_rank(&values).unwrap(), signed_rank(&swapped).unwrap());
            prop_assert_eq!((own.p, own.exact, own.zeros), (other.p, other.exact, other.zeros));
            prop_assert_eq!(own.rank_biserial, -other.rank_biserial);
            prop_assert!((0.0..=1.0).contains(&own.p) && own.rank_biserial.abs() <= 1.0);
        }

        #[test]
        fn the_order_leaves_no_trace((values, shuffled) in proptest::collection::vec(-9i32..9, 1..40)
            .prop_flat_map(|v| (Just(v.clone()), Just(v).prop_shuffle()))) {
            let of = |v: Vec<i32>| signed_rank(&v.into_iter().map(f64::from).collect::<Vec<_>>());
            prop_assert_eq!(of(values), of(shuffled));
        }
    }
}
