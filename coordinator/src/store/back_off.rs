//! How long a job waits after a panic.

use furrow_schema::id::JobKey;

/// The shortest wait after the first panic \[ms\]; after each further one it is twice as long.
const FIRST_MS: i64 = 1_000;
/// It doubles no more often than this.
const MOST_DOUBLINGS: u32 = 6;

/// The wait \[ms\] of job `key` after its `panics`th panic, which came in handing-out `attempt`: 1 s and up to half as
/// much again after the first, doubled after each further one. What is added follows from key and attempt, so that
/// jobs that panicked together do not all come back together, and the same history gives the same times.
pub(crate) fn back_off_ms(key: &JobKey, attempt: u32, panics: u32) -> i64 {
    let shortest = FIRST_MS << panics.saturating_sub(1).min(MOST_DOUBLINGS);
    let mut hasher = blake3::Hasher::new();
    hasher.update(&key.0).update(&attempt.to_le_bytes());
    let [a, b, c, d, ..] = *hasher.finalize().as_bytes();
    let drawn = i64::from(u32::from_le_bytes([a, b, c, d]));
    shortest + (shortest / 2 * drawn >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(n: u8) -> JobKey {
        JobKey([n; 32])
    }

    #[test]
    fn a_wait_doubles_with_each_panic_up_to_a_minute_and_a_half() {
        for (panics, shortest) in [(1, 1_000), (2, 2_000), (3, 4_000), (7, 64_000), (40, 64_000)] {
            let waits: Vec<_> = (0..100).map(|n| back_off_ms(&key(n), 1, panics)).collect();
            assert!(waits.iter().all(|wait| (shortest..shortest * 3 / 2).contains(wait)), "{panics}: {waits:?}");
        }
    }

    #[test]
    fn the_same_history_gives_the_same_wait_and_another_job_or_attempt_another() {
        assert_eq!(back_off_ms(&key(1), 1, 1), back_off_ms(&key(1), 1, 1));
        let spread: std::collections::BTreeSet<_> = (0..100).map(|n| back_off_ms(&key(n), 1, 1)).collect();
        assert!(spread.len() > 50, "{} different waits of 100", spread.len());
        assert_ne!(back_off_ms(&key(1), 1, 1), back_off_ms(&key(1), 2, 1));
    }
}
