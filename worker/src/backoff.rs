//! Pauses between repetitions of a question that nobody answered.

use std::time::Duration;

/// The first pause.
const FIRST: Duration = Duration::from_millis(100);
/// No pause is longer than this.
const LONGEST: Duration = Duration::from_secs(5);

/// Pauses that double from 0.1 s to 5 s, each drawn between half and all of its length so that many workers do
/// not come back at one moment.
#[derive(Debug)]
pub(crate) struct Backoff {
    next: Duration,
}

impl Backoff {
    /// Starts at the shortest pause.
    pub(crate) fn new() -> Self {
        Self { next: FIRST }
    }

    /// How long to wait this time, with `share` drawn by [`share`].
    pub(crate) fn pause(&mut self, share: f64) -> Duration {
        let longest_now = self.next;
        self.next = (longest_now * 2).min(LONGEST);
        longest_now.mul_f64(share)
    }
}

/// Which share of a pause to wait: half to all of it.
pub(crate) fn share() -> f64 {
    rand::random_range(0.5..=1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_from_a_tenth_of_a_second_and_stay_under_five() {
        let mut backoff = Backoff::new();
        let pauses: Vec<Duration> = (0..20).map(|_| backoff.pause(share())).collect();
        assert!(pauses[0] >= FIRST / 2 && pauses[0] <= FIRST);
        assert!(pauses.iter().all(|pause| *pause <= LONGEST));
        assert!(pauses[10..].iter().all(|pause| *pause >= LONGEST / 2));
    }
}
