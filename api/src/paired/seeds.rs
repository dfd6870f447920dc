//! How many more seeds would decide.

use super::bootstrap::Z_975;

/// The estimated number of further seeds per cell until the 95 % interval of the difference excludes 0, if difference
/// and spread stay what they are: by the normal approximation, in which the interval narrows with the root of the seeds.
///
/// 0 where the interval excludes 0 already; at least 1 where it does not. None where the difference is 0, so that no
/// number would do, or the standard error is not known.
pub(super) fn more(difference: f64, standard_error: Option<f64>, seeds: u64, ci95: Option<[f64; 2]>) -> Option<u64> {
    if difference == 0.0 || seeds == 0 {
        return None;
    }
    if ci95?.iter().all(|end| *end > 0.0) || ci95?.iter().all(|end| *end < 0.0) {
        return Some(0);
    }
    let error = standard_error.filter(|error| *error > 0.0)?;
    let needed = (seeds as f64 * (Z_975 * error / difference).powi(2)).ceil();
    (needed.is_finite()).then(|| (needed as u64).saturating_sub(seeds).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_of_twice_the_difference_needs_four_times_the_seeds() {
        let error = 2.0 * 3.0 / Z_975;
        assert_eq!(more(3.0, Some(error * 0.999_999), 10, Some([-3.0, 9.0])), Some(30));
        assert_eq!(more(-3.0, Some(error * 0.999_999), 10, Some([-9.0, 3.0])), Some(30));
    }

    #[test]
    fn what_is_decided_needs_none_and_what_cannot_be_has_no_number() {
        assert_eq!(more(1.0, Some(0.1), 10, Some([0.8, 1.2])), Some(0));
        assert_eq!(more(-1.0, None, 10, Some([-1.2, -0.8])), Some(0));
        assert_eq!(more(0.0, Some(0.1), 10, Some([-0.2, 0.2])), None);
        assert_eq!(more(1.0, None, 10, Some([-1.0, 3.0])), None);
        assert_eq!(more(1.0, Some(0.5), 10, None), None);
        assert_eq!(more(1e-300, Some(1.0), 10, Some([-1.0, 1.0])), None);
    }

    #[test]
    fn one_more_where_only_the_approximation_says_enough() {
        assert_eq!(more(2.0, Some(1.0), 3, Some([-2.3, 6.3])), Some(1));
    }
}
