//! The score interval of a difference between paired shares (Tango 1998, Statistics in Medicine 17, 891-908).
//!
//! A difference lies within it unless a score test refuses it at 5 %, with the chance of `only_b` that makes the
//! counts most likely at that difference. It stays within -1 to 1, and has a width where no pair differs.

use super::bootstrap::Z_975;

/// The 95 % interval of the share of `a` less that of `b`, from pairs of which only a, only b succeeded, among `n`;
/// none without pairs.
pub(super) fn interval(only_a: u64, only_b: u64, n: u64) -> Option<[f64; 2]> {
    if n == 0 || only_a + only_b > n {
        return None;
    }
    Some([-upper(only_b, only_a, n), upper(only_a, only_b, n)])
}

/// The upper end: from the estimate on the score falls.
fn upper(only_a: u64, only_b: u64, n: u64) -> f64 {
    let (a, b, n) = (only_a as f64, only_b as f64, n as f64);
    let (mut low, mut high) = ((a - b) / n, 1.0);
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if score(a, b, n, middle) > -Z_975 {
            low = middle;
        } else {
            high = middle;
        }
    }
    f64::midpoint(low, high)
}

/// How many standard errors the counts are above what `difference` lets expect.
fn score(only_a: f64, only_b: f64, n: f64, difference: f64) -> f64 {
    let square = 2.0 * n;
    let linear = -only_a - only_b + (2.0 * n - only_a + only_b) * difference;
    let constant = -only_b * difference * (1.0 - difference);
    let share_b = ((linear * linear - 4.0 * square * constant).max(0.0).sqrt() - linear) / (2.0 * square);
    let variance = n * (2.0 * share_b + difference * (1.0 - difference));
    let excess = only_a - only_b - n * difference;
    if excess == 0.0 { 0.0 } else { excess / variance.max(0.0).sqrt() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_ends_are_where_a_search_for_the_likeliest_shares_puts_them() {
        // Maximised numerically over the multinomial likelihood and solved by brentq, scipy 1.17.1; the second is
        // z^2 / (n + z^2) in closed form.
        for (only_a, only_b, n, low, high) in [
            (12, 1, 44, 0.106_754_952, 0.402_292_149),
            (0, 0, 30, -0.113_513_399, 0.113_513_399),
            (5, 0, 10, 0.083_700_797, 0.763_406_909),
            (9, 1, 32, 0.068_152_128, 0.432_562_094),
            (3, 3, 20, -0.257_896_236, 0.257_896_236),
            (0, 7, 7, -1.0, -0.291_339_147),
            (43, 0, 54, 0.670_976_933, 0.882_259_459),
        ] {
            let [a, b] = interval(only_a, only_b, n).unwrap();
            assert!((a - low).abs() < 1e-7 && (b - high).abs() < 1e-7, "{only_a}, {only_b} of {n}: [{a}, {b}]");
        }
        assert_eq!(interval(0, 0, 0), None);
    }

    proptest! {
        #[test]
        fn it_holds_the_estimate_and_turns_with_the_sides(a in 0u64..40, b in 0u64..40, same in 0u64..40) {
            let n = (a + b + same).max(1);
            let [low, high] = interval(a, b, n).unwrap();
            let estimate = (a as f64 - b as f64) / n as f64;
            prop_assert!(-1.0 <= low && low <= estimate && estimate <= high && high <= 1.0, "[{low}, {high}]");
            prop_assert_eq!(interval(b, a, n).unwrap(), [-high, -low]);
        }
    }
}
