//! When a sweep will be done, and how sure that is.

/// The rate is a count over at most this long \[s\].
const WINDOW_S: f64 = 30.0;
/// Of the standard normal distribution: 95 % lie within as much on either side.
const Z: f64 = 1.96;

/// The 95 % interval of the time until `left` more results have come \[s\], at a rate that was counted since the sweep
/// was submitted `age_s` ago, over 30 s at most. None while nothing is known.
///
/// Results are taken to come by chance at a steady rate: the logarithm of the time left then spreads by the roots of
/// one by the results counted, and one by those to come.
pub(super) fn interval_s(rate_per_s: f64, age_s: f64, left: u64) -> Option<[f64; 2]> {
    if left == 0 {
        return Some([0.0, 0.0]);
    }
    let counted = rate_per_s * age_s.clamp(1.0, WINDOW_S);
    if !counted.is_finite() || counted < 1.0 {
        return None;
    }
    let (expected_s, spread) = (left as f64 / rate_per_s, Z * (1.0 / counted + 1.0 / left as f64).sqrt());
    Some([expected_s * (-spread).exp(), expected_s * spread.exp()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interval_holds_the_expected_time_and_narrows_with_more_results() {
        let width = |rate_per_s: f64, left: u64| {
            let [low, high] = interval_s(rate_per_s, 60.0, left).unwrap();
            let expected = left as f64 / rate_per_s;
            assert!(low < expected && expected < high);
            high / low
        };
        assert!(width(1.0, 1_000) < width(0.1, 1_000));
        assert!(width(1.0, 1_000) < width(1.0, 10));
        assert!((width(1_000.0, 1_000_000) - 1.0).abs() < 0.05);
    }

    #[test]
    fn nothing_left_takes_no_time_and_nothing_counted_says_nothing() {
        assert_eq!(interval_s(0.0, 5.0, 0), Some([0.0, 0.0]));
        assert_eq!(interval_s(0.0, 60.0, 5), None);
        assert_eq!(interval_s(f64::NAN, 60.0, 5), None);
    }
}
