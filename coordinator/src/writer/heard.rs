//! When each worker was last heard of, to the millisecond and in memory only.
//!
//! The database keeps it to within some seconds. This is for telling whether a worker that seems to be gone is, and how
//! many there are to share what is left.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

use furrow_schema::id::WorkerId;

use crate::batch::Absence;

/// Workers renew every second; one that was not heard of for so long \[ms\] does not count.
const LATELY_MS: i64 = 3_000;

#[derive(Debug, Default)]
pub(super) struct Heard(Mutex<HashMap<WorkerId, i64>>);

impl Heard {
    /// Notes that these workers were heard of now.
    pub(super) fn note<'a>(&self, workers: impl Iterator<Item = &'a WorkerId>, now_ms: i64) {
        let mut heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for worker in workers {
            match heard.get_mut(worker) {
                Some(last_ms) => *last_ms = now_ms,
                None => _ = heard.insert(worker.clone(), now_ms),
            }
        }
    }

    /// This worker is gone.
    pub(super) fn forget(&self, worker: &WorkerId) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(worker);
    }

    /// How many workers were heard of lately.
    pub(super) fn lately(&self, now_ms: i64) -> u32 {
        let heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let lately = heard.values().filter(|last_ms| now_ms - **last_ms <= LATELY_MS).count();
        u32::try_from(lately).unwrap_or(u32::MAX)
    }

    /// When the worker was heard of after it is said to have gone, if it was.
    pub(super) fn since(&self, absence: &Absence) -> Option<i64> {
        let heard = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        heard.get(&absence.worker).copied().filter(|last_ms| *last_ms > absence.since_ms)
    }
}
