//! How a coordinator behaves, and where it takes the time from.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use furrow_schema::id::EngineId;

/// Settings of a coordinator.
#[derive(Debug, Clone)]
pub struct Config {
    /// The simulation code whose sweeps it takes and whose workers it serves.
    pub engine: EngineId,
    /// After so many workers that died while a job ran there, the job is `failed`. At least 1.
    pub max_attempts: u32,
    /// After its start no lease runs out for so long: its workers had nobody to renew with, and what they still run
    /// shall neither be run again elsewhere nor be charged with a death.
    pub leases_hold_for: Duration,
    /// Which results are computed again.
    pub verify: Verify,
    /// Where the time comes from.
    pub clock: Clock,
}

/// Which results are computed again, and by whom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verify {
    /// How many of the results, from 0 to 1. With 0 nothing is computed again, not even a result in dispute.
    pub share: f64,
    /// When no other worker was heard of for so long, one verifies its own results.
    pub alone_after: Duration,
}

impl Verify {
    /// The share where a coordinator serves many machines.
    pub const DEFAULT_SHARE: f64 = 0.01;
    /// Others have so long to come.
    pub const ALONE_AFTER: Duration = Duration::from_secs(60);
    /// Nothing.
    pub const NOTHING: Self = Self { share: 0.0, alone_after: Self::ALONE_AFTER };

    /// This share of the results.
    #[must_use]
    pub const fn share(share: f64) -> Self {
        Self { share, ..Self::NOTHING }
    }
}

impl Config {
    /// The workers that may die of a job where nothing else is asked.
    pub const DEFAULT_MAX_ATTEMPTS: u32 = 3;
    /// Workers of other processes are back within this time.
    pub const WORKERS_ARE_BACK_WITHIN: Duration = Duration::from_secs(10);

    /// The usual settings for `engine`, whose workers are those of this process. Nothing is verified.
    #[must_use]
    pub fn new(engine: EngineId) -> Self {
        let (max_attempts, leases_hold_for) = (Self::DEFAULT_MAX_ATTEMPTS, Duration::ZERO);
        Self { engine, max_attempts, leases_hold_for, verify: Verify::NOTHING, clock: Clock::system() }
    }
}

/// Tells the time [ms since 1970].
#[derive(Clone)]
pub struct Clock(Arc<dyn Fn() -> i64 + Send + Sync>);

impl Clock {
    /// The machine's clock.
    #[must_use]
    pub fn system() -> Self {
        Self::from_fn(|| {
            let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
            i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
        })
    }

    /// A clock that shows what `now_ms` returns.
    #[must_use]
    pub fn from_fn(now_ms: impl Fn() -> i64 + Send + Sync + 'static) -> Self {
        Self(Arc::new(now_ms))
    }

    /// A clock that stands at `start_ms` until the returned hand is moved.
    #[must_use]
    pub fn manual(start_ms: i64) -> (Self, ClockHand) {
        let hand = ClockHand(Arc::new(AtomicI64::new(start_ms)));
        let shown = hand.clone();
        (Self::from_fn(move || shown.0.load(Ordering::SeqCst)), hand)
    }

    /// The time now [ms since 1970].
    #[must_use]
    pub fn now_ms(&self) -> i64 {
        (self.0)()
    }
}

impl fmt::Debug for Clock {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Clock")
    }
}

/// Moves a clock by hand: tests wait for nothing.
#[derive(Debug, Clone)]
pub struct ClockHand(Arc<AtomicI64>);

impl ClockHand {
    /// Moves the clock on by `by_ms` \[ms\].
    pub fn advance(&self, by_ms: i64) {
        self.0.fetch_add(by_ms, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_moves_only_with_its_hand() {
        let (clock, hand) = Clock::manual(1_000);
        assert_eq!(clock.now_ms(), 1_000);
        hand.advance(250);
        assert_eq!(clock.now_ms(), 1_250);
    }
}
