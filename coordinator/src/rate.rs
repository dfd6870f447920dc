//! How fast results come in: counts per second, and by sweep or worker, over the last 30 s, in memory.

use std::collections::{HashMap, VecDeque};
use std::hash::Hash;
use std::sync::{Mutex, PoisonError};

/// The rate is taken over this long \[ms\].
const WINDOW_MS: i64 = 30_000;
/// A rate over less than this would be noise \[ms\].
const SHORTEST_MS: i64 = 1_000;
/// Results are counted in spans of this length \[ms\].
const BUCKET_MS: i64 = 1_000;

/// Recent results by sweep, or by worker.
#[derive(Debug)]
pub struct Rates<K> {
    started_ms: i64,
    recent: Mutex<HashMap<K, VecDeque<(i64, u64)>>>,
}

impl<K: Eq + Hash> Rates<K> {
    /// Counts nothing yet; earlier results are unknown.
    #[must_use]
    pub fn starting_at(now_ms: i64) -> Self {
        Self { started_ms: now_ms, recent: Mutex::default() }
    }

    /// Counts `results` of `key` that were recorded now.
    pub fn count(&self, key: K, results: u64, now_ms: i64) {
        let mut recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        let buckets = recent.entry(key).or_default();
        let bucket = now_ms - now_ms.rem_euclid(BUCKET_MS);
        match buckets.back_mut() {
            Some((last, n)) if *last >= bucket => *n += results,
            _ => buckets.push_back((bucket, results)),
        }
        // The last bucket stays, so that a pause reads as a rate of 0 and not as an unknown one.
        while buckets.len() > 1 && buckets[0].0 <= now_ms - WINDOW_MS - BUCKET_MS {
            buckets.pop_front();
        }
    }

    /// Results per second of `key` over the last 30 s or since it came [1/s]; none while nothing is known.
    #[must_use]
    pub fn per_s(&self, key: &K, created_ms: i64, now_ms: i64) -> Option<f64> {
        let recent = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        let since_ms = (now_ms - WINDOW_MS).max(created_ms).max(self.started_ms);
        let results: u64 =
            recent.get(key)?.iter().filter(|(bucket, _)| bucket + BUCKET_MS > since_ms).map(|(_, n)| n).sum();
        Some(results as f64 * 1_000.0 / (now_ms - since_ms).max(SHORTEST_MS) as f64)
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::id::SweepId;

    use super::*;

    const SWEEP: SweepId = SweepId(1);

    #[test]
    fn nothing_is_known_before_the_first_result() {
        assert_eq!(Rates::starting_at(0).per_s(&SWEEP, 0, 5_000), None);
    }

    #[test]
    fn a_young_sweep_is_not_averaged_over_time_before_it() {
        let rates = Rates::starting_at(0);
        rates.count(SWEEP, 50, 104_000);
        assert_eq!(rates.per_s(&SWEEP, 100_000, 105_000), Some(10.0));
    }

    #[test]
    fn a_stall_brings_the_rate_to_zero() {
        let rates = Rates::starting_at(0);
        rates.count(SWEEP, 300, 1_000);
        assert_eq!(rates.per_s(&SWEEP, 0, 30_000), Some(10.0));
        assert_eq!(rates.per_s(&SWEEP, 0, 90_000), Some(0.0));
    }

    #[test]
    fn sweeps_have_their_own_rates() {
        let rates = Rates::starting_at(0);
        rates.count(SweepId(2), 30, 1_000);
        assert_eq!(rates.per_s(&SWEEP, 0, 2_000), None);
        assert_eq!(rates.per_s(&SweepId(2), 0, 2_000), Some(15.0));
    }
}
