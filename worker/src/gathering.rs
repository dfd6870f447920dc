//! Lets short runs share a sync of the spool and a commit of the coordinator.

use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{Instant, timeout_at};

use crate::board::Board;
use crate::pool::Shared;

/// So long after one lot of ended runs the next is taken, unless it is full before or no run goes on.
const EVERY: Duration = Duration::from_secs(1);

/// When the last lot was taken.
#[derive(Debug, Default)]
pub(crate) struct Gathering {
    last: Option<Instant>,
}

impl Gathering {
    /// Waits for `worth_it` to end, which may change with every ring of `bell`, but not for long.
    pub(crate) async fn more<S>(&mut self, shared: &Shared<S>, bell: &Notify, worth_it: impl Fn(&Board<S>) -> bool) {
        if let Some(last) = self.last {
            let due = last + EVERY;
            while worth_it(&shared.board()) && timeout_at(due, bell.notified()).await.is_ok() {}
        }
        self.last = Some(Instant::now());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn the_first_lot_is_taken_at_once_and_the_next_after_a_while_or_when_there_is_nothing_to_wait_for() {
        let (shared, bell) = (Shared::<()>::new(1, false), Notify::new());
        let (mut gathering, began) = (Gathering::default(), Instant::now());
        gathering.more(&shared, &bell, |_| true).await;
        assert_eq!(began.elapsed(), Duration::ZERO);
        gathering.more(&shared, &bell, |_| true).await;
        assert!(began.elapsed() >= EVERY && began.elapsed() < 2 * EVERY, "{:?}", began.elapsed());
        let second = Instant::now();
        gathering.more(&shared, &bell, |_| false).await;
        assert_eq!(second.elapsed(), Duration::ZERO);
        gathering.more(&shared, &bell, |_| second.elapsed() < EVERY / 2).await;
        assert!(second.elapsed() >= EVERY, "without a ring it does not look again");
    }
}
