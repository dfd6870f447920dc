//! Durations in fixed memory: 32 buckets to a doubling, so that a quantile is within 2 % of the true one.

/// Buckets to a doubling.
const STEPS: usize = 32;
const STEP_BITS: u32 = STEPS.trailing_zeros();
/// Durations of 2^40 ns (18 minutes) and more share the last bucket.
const DOUBLINGS: usize = 40 - STEP_BITS as usize + 1;
const BUCKETS: usize = DOUBLINGS * STEPS;

/// Counts of durations by size, with their exact sum.
#[derive(Debug, Clone)]
pub(super) struct Histogram {
    buckets: Box<[u32; BUCKETS]>,
    count: u64,
    sum_ns: u64,
    min_ns: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { buckets: Box::new([0; BUCKETS]), count: 0, sum_ns: 0, min_ns: u64::MAX, max_ns: 0 }
    }
}

impl Histogram {
    /// Counts one duration.
    pub(super) fn add(&mut self, duration_ns: u64) {
        let bucket = &mut self.buckets[bucket_of(duration_ns)];
        *bucket = bucket.saturating_add(1);
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(duration_ns);
        self.min_ns = self.min_ns.min(duration_ns);
        self.max_ns = self.max_ns.max(duration_ns);
    }

    /// How many durations were counted.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Their sum [ns].
    pub(super) fn sum_ns(&self) -> u64 {
        self.sum_ns
    }

    /// Their mean [ns]; nothing if there are none.
    pub(super) fn mean_ns(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum_ns as f64 / self.count as f64)
    }

    /// The duration that a share of `quantile` (0 to 1) does not exceed [ns], to 2 %; nothing if there are none.
    pub(super) fn quantile_ns(&self, quantile: f64) -> Option<f64> {
        let rank = (quantile * self.count as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        let bucket = self.buckets.iter().position(|n| {
            seen += u64::from(*n);
            seen >= rank
        })?;
        Some(middle_of(bucket).clamp(self.min_ns as f64, self.max_ns as f64))
    }
}

/// Durations under 32 ns have a bucket each; above, the five bits after the leading one choose it.
fn bucket_of(duration_ns: u64) -> usize {
    let doubling = (u64::BITS - duration_ns.leading_zeros()).saturating_sub(STEP_BITS + 1);
    let step = (duration_ns >> doubling) as usize;
    (doubling as usize * STEPS + step).min(BUCKETS - 1)
}

fn middle_of(bucket: usize) -> f64 {
    let doubling = (bucket / STEPS).saturating_sub(1);
    let step = bucket - doubling * STEPS;
    let width = (1_u64 << doubling) as f64;
    step as f64 * width + (width - 1.0) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn without_durations_there_is_no_quantile() {
        assert_eq!((Histogram::default().quantile_ns(0.5), Histogram::default().mean_ns()), (None, None));
    }

    #[test]
    fn quantiles_of_a_thousand_even_steps_are_where_they_should_be() {
        let mut histogram = Histogram::default();
        (1..=1000).for_each(|i| histogram.add(i * 1000));
        let close = |value: f64, expected: f64| (value / expected - 1.0).abs() < 0.02;
        assert!(close(histogram.quantile_ns(0.5).unwrap(), 500_000.0));
        assert!(close(histogram.quantile_ns(0.99).unwrap(), 990_000.0));
        assert_eq!(histogram.mean_ns(), Some(500_500.0));
    }

    #[test]
    fn the_longest_durations_share_the_last_bucket() {
        let mut histogram = Histogram::default();
        histogram.add(u64::MAX);
        histogram.add(u64::MAX);
        assert_eq!(histogram.quantile_ns(0.5), Some(u64::MAX as f64));
    }

    proptest! {
        #[test]
        fn a_bucket_s_middle_is_within_two_percent(duration_ns in 0_u64..1 << 40) {
            let middle = middle_of(bucket_of(duration_ns));
            prop_assert!((middle - duration_ns as f64).abs() <= 0.02 * duration_ns as f64);
        }
    }
}
