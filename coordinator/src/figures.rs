//! Counters in memory for who watches over the service: they begin at 0 with the process.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use furrow_schema::protocol::{Recorded, Reply};

/// Upper ends of the steps in which a commit's time is counted \[s\].
const COMMIT_STEPS_S: &[f64] = &[0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0];

/// What the writer did.
#[derive(Debug)]
pub struct Figures {
    /// How long transactions took, from their begin to the end of their commit.
    pub commits: Histogram,
    recorded: AtomicU64,
}

impl Default for Figures {
    fn default() -> Self {
        Self { commits: Histogram::new(COMMIT_STEPS_S), recorded: AtomicU64::new(0) }
    }
}

impl Figures {
    /// Results that workers were told are on record; one that was sent twice counts twice.
    #[must_use]
    pub fn recorded(&self) -> u64 {
        self.recorded.load(Ordering::Relaxed)
    }

    pub(crate) fn count_recorded(&self, replies: &[Reply<Recorded>]) {
        let recorded = |reply: &Reply<Recorded>| match reply {
            Reply::Ok(recorded) => recorded.recorded.len() as u64,
            Reply::Refused(_) => 0,
        };
        self.recorded.fetch_add(replies.iter().map(recorded).sum(), Ordering::Relaxed);
    }
}

/// Counts durations in fixed steps, without a lock.
#[derive(Debug)]
pub struct Histogram {
    steps_s: &'static [f64],
    /// One more than there are steps.
    counts: Box<[AtomicU64]>,
    sum_us: AtomicU64,
}

/// What a histogram shows at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// How many durations were at most as long as each step \[s\].
    pub up_to_s: Vec<(f64, u64)>,
    /// How many there were.
    pub count: u64,
    /// Their sum \[s\].
    pub sum_s: f64,
}

impl Histogram {
    /// An empty one with these upper ends of steps \[s\], which must ascend.
    #[must_use]
    pub fn new(steps_s: &'static [f64]) -> Self {
        let counts = (0..=steps_s.len()).map(|_| AtomicU64::new(0)).collect();
        Self { steps_s, counts, sum_us: AtomicU64::new(0) }
    }

    /// Counts one duration.
    pub fn observe(&self, duration: Duration) {
        let step = self.steps_s.partition_point(|end| *end < duration.as_secs_f64());
        self.counts[step].fetch_add(1, Ordering::Relaxed);
        let us = u64::try_from(duration.as_micros()).unwrap_or(u64::MAX);
        self.sum_us.fetch_add(us, Ordering::Relaxed);
    }

    /// What was counted so far.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let mut count = 0;
        let mut up_to_s = Vec::with_capacity(self.steps_s.len());
        for (step, counted) in self.counts.iter().enumerate() {
            count += counted.load(Ordering::Relaxed);
            up_to_s.extend(self.steps_s.get(step).map(|end| (*end, count)));
        }
        Snapshot { up_to_s, count, sum_s: self.sum_us.load(Ordering::Relaxed) as f64 / 1e6 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_counts_in_its_step_and_all_longer_ones() {
        let histogram = Histogram::new(&[0.1, 1.0]);
        for ms in [50, 100, 500, 2_000] {
            histogram.observe(Duration::from_millis(ms));
        }
        let expected = Snapshot { up_to_s: vec![(0.1, 2), (1.0, 3)], count: 4, sum_s: 2.65 };
        assert_eq!(histogram.snapshot(), expected);
    }
}
