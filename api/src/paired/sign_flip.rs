//! The randomization test of paired ratios of sums: which side is which is thrown anew in each pair (Fisher 1935).
//!
//! If nothing but chance tells a from b, every throw is as likely as what was found. What is compared is
//! N_a D_b - N_b D_a, which has the sign of the difference of the ratios N_a / D_a and N_b / D_b and is defined without
//! anything below a line, too. It is half the sum of u = (n_a - n_b) D - N (d_a - d_b) over the pairs, with N and D over
//! both sides: a throw flips signs in that sum. The p value is exact for up to 16 pairs that differ, from 99,999 throws of
//! a generator with a fixed seed for up to 200, and from the normal distribution beyond.

use statrs::distribution::{ContinuousCDF, Normal};

use super::bootstrap::Row;
use crate::table::Draws;

const EXACT_UP_TO: usize = 16;
const THROWN_UP_TO: usize = 200;
const THROWS: u64 = 99_999;

/// What the test says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SignFlip {
    /// The two-sided p value; 1 where nothing differs.
    pub(super) p: f64,
    /// `sign-flip-exact`, `sign-flip-thrown` or `sign-flip-normal`.
    pub(super) name: &'static str,
}

/// The test on these pairs; none without any.
pub(super) fn sign_flip(rows: &[Row]) -> Option<SignFlip> {
    if rows.is_empty() {
        return None;
    }
    let sum = |of: fn(&Row) -> f64| rows.iter().map(of).sum::<f64>();
    let (above, below) = (sum(|row| row[0] + row[2]), sum(|row| row[1] + row[3]));
    let differences = rows.iter().map(|row| (row[0] - row[2]) * below - above * (row[1] - row[3]));
    let mut rest: Vec<f64> = differences.filter(|difference| *difference != 0.0).collect();
    // Neither the order of the pairs nor which side is a leaves a trace: with signs flipped all throws are the same.
    rest.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    Some(match rest.len() {
        0 => SignFlip { p: 1.0, name: "sign-flip-exact" },
        1..=EXACT_UP_TO => SignFlip { p: exact(&rest), name: "sign-flip-exact" },
        n if n <= THROWN_UP_TO => SignFlip { p: thrown(&rest), name: "sign-flip-thrown" },
        _ => SignFlip { p: normal(&rest), name: "sign-flip-normal" },
    })
}

/// What is found is among what is as large as itself, whatever rounding does.
fn as_large_as(rest: &[f64]) -> f64 {
    rest.iter().sum::<f64>().abs() * (1.0 - 1e-12)
}

fn exact(rest: &[f64]) -> f64 {
    let (found, all) = (as_large_as(rest), 1_u32 << rest.len());
    let sum = |signs: u32| {
        let signed = |(i, u): (usize, &f64)| if signs >> i & 1 == 1 { -u.abs() } else { u.abs() };
        rest.iter().enumerate().map(signed).sum::<f64>()
    };
    let hits = (0..all).filter(|signs| sum(*signs).abs() >= found).count();
    hits as f64 / f64::from(all)
}

fn thrown(rest: &[f64]) -> f64 {
    let found = as_large_as(rest);
    let mut draws = Draws::new();
    let mut throw = || {
        let signed = |chunk: &[f64]| {
            let mut signs = draws.bits();
            let flip = |u: &f64| {
                signs = signs.rotate_right(1);
                if signs >> 63 == 1 { -u.abs() } else { u.abs() }
            };
            chunk.iter().map(flip).sum::<f64>()
        };
        rest.chunks(64).map(signed).sum::<f64>()
    };
    let hits = (0..THROWS).filter(|_| throw().abs() >= found).count() as u64;
    (hits + 1) as f64 / (THROWS + 1) as f64
}

fn normal(rest: &[f64]) -> f64 {
    let deviation = rest.iter().map(|u| u * u).sum::<f64>().sqrt();
    let Ok(normal) = Normal::new(0.0, 1.0) else { return 1.0 };
    2.0 * normal.sf(rest.iter().sum::<f64>().abs() / deviation)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Distances of 100 m on both sides, with these interventions.
    fn rows(interventions: &[[f64; 2]]) -> Vec<Row> {
        interventions.iter().map(|[a, b]| [100.0, *a, 100.0, *b]).collect()
    }

    #[test]
    fn five_pairs_of_one_direction_come_about_once_in_sixteen_times() {
        let found = sign_flip(&rows(&[[1.0, 2.0], [0.0, 3.0], [1.0, 4.0], [0.0, 1.0], [2.0, 5.0]])).unwrap();
        assert_eq!(found, SignFlip { p: 2.0 / 32.0, name: "sign-flip-exact" });
    }

    #[test]
    fn a_side_without_anything_below_the_line_can_be_told_from_the_other() {
        let found = sign_flip(&rows(&[[0.0, 2.0]; 12])).unwrap();
        assert_eq!(found.p, 2.0 / 4096.0);
    }

    #[test]
    fn nothing_that_differs_has_a_p_value_of_one() {
        assert_eq!(sign_flip(&rows(&[[2.0, 2.0]; 5])).unwrap().p, 1.0);
        assert_eq!(sign_flip(&[]), None);
    }

    #[test]
    fn throws_and_the_normal_distribution_agree_with_what_is_counted_out() {
        // Scattered, so that sums seldom tie.
        let mut draws = Draws::new();
        let rest: Vec<f64> = (0..16).map(|_| draws.below(2_000_001) as f64 - 700_000.0).collect();
        let counted = exact(&rest);
        assert!((thrown(&rest) - counted).abs() < 0.006, "{} {counted}", thrown(&rest));
        assert!((normal(&rest) - counted).abs() < 0.03, "{} {counted}", normal(&rest));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]
        #[test]
        fn swapping_the_sides_changes_nothing(pairs in proptest::collection::vec([0_u8..6, 0_u8..6], 1..30)) {
            let of = |pairs: &[[u8; 2]]| rows(&pairs.iter().map(|pair| pair.map(f64::from)).collect::<Vec<_>>());
            let swapped: Vec<[u8; 2]> = pairs.iter().map(|[a, b]| [*b, *a]).collect();
            prop_assert_eq!(sign_flip(&of(&pairs)), sign_flip(&of(&swapped)));
        }
    }
}
