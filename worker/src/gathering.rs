//! Lets short runs share a sync of the spool and a commit of the coordinator.

use std::time::Duration;

use tokio::sync::Notify;
use tokio::time::{Instant, timeout_at};

use crate::board::Board;
use crate::pool::Shared;

/// So long after one lot of ended runs the next is taken, unless it is full before or no run goes on.
const EVERY: Duration = Duration::from_millis(250);

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
