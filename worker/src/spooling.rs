//! Puts ended runs into the spool before they are reported, and takes them out when they are acknowledged.
//!
//! The runs that end while one lot is synced make up the next lot, and reports go on meanwhile: a worker with short
//! jobs pays for few syncs, and waits for none.

use std::sync::{Arc, Mutex, PoisonError};

use furrow_schema::protocol::{MAX_CLAIM, RunReport};

use crate::board::{Board, Lease, MAX_REPORT_BYTES};
use crate::gathering::Gathering;
use crate::pool::Shared;
use crate::spool::{Spool, SpoolError};

/// A spool with the coordinator whose runs go into it.
#[derive(Debug, Clone)]
pub(crate) struct OpenSpool {
    spool: Arc<Mutex<Spool>>,
    coordinator: Arc<str>,
    /// Whether to work on it where it is asked, without another thread.
    at_once: bool,
}

impl OpenSpool {
    pub(crate) fn new(spool: Arc<Mutex<Spool>>, coordinator: &str) -> Self {
        Self { spool, coordinator: coordinator.into(), at_once: false }
    }

    /// The same without threads.
    pub(crate) fn at_once(self) -> Self {
        Self { at_once: true, ..self }
    }

    /// The first runs that wait for an acknowledgement, as many as fit a report. None if they cannot be read.
    pub(crate) async fn waiting(&self) -> Vec<RunReport> {
        let most_bytes = MAX_REPORT_BYTES as u64;
        let waiting = self.with(move |spool, of| spool.waiting_for(of, MAX_CLAIM as usize, most_bytes)).await;
        waiting.unwrap_or_else(|error| {
            tracing::error!(%error, "runs in the spool are not delivered");
            Vec::new()
        })
    }

    /// These runs are acknowledged.
    pub(crate) async fn forget(&self, runs: Vec<Lease>) {
        if let Err(error) = self.with(move |spool, of| spool.acknowledge(of, &runs)).await {
            tracing::warn!(%error, "acknowledged runs stay in the spool");
        }
    }

    /// Keeps these runs; says how many of them, from the first on.
    async fn keep(&self, runs: Arc<Vec<RunReport>>) -> (usize, Result<(), SpoolError>) {
        let kept = self.with(move |spool, of| Ok(spool.keep(of, &runs))).await;
        kept.unwrap_or_else(|error| (0, Err(error)))
    }

    /// Works on the spool where it may block.
    async fn with<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Spool, &str) -> Result<T, SpoolError> + Send + 'static,
    ) -> Result<T, SpoolError> {
        let Self { spool, coordinator, at_once } = self.clone();
        // No step between two changes of the spool can panic, so a poisoned one is as good.
        let work = move || work(&mut spool.lock().unwrap_or_else(PoisonError::into_inner), &coordinator);
        if at_once {
            return work();
        }
        let done = tokio::task::spawn_blocking(work).await;
        done.unwrap_or_else(|error| Err(SpoolError::Disk(std::io::Error::other(error))))
    }
}

/// Spools until no run can end any more and all reports are through.
pub(crate) async fn spool_runs<S>(spool: &OpenSpool, shared: &Shared<S>) {
    let mut trouble = false;
    let mut gathering = Gathering::default();
    loop {
        gathering.more(shared, &shared.spool, Board::gathers_for_spool).await;
        let (round, over) = {
            let mut board = shared.board();
            (board.take_for_spool(), board.is_spooled())
        };
        let Some((runs, acknowledged)) = round else {
            if over {
                return;
            }
            shared.spool.notified().await;
            continue;
        };
        if !acknowledged.is_empty() {
            spool.forget(acknowledged).await;
        }
        if !runs.is_empty() {
            let runs = Arc::new(runs);
            let (kept, outcome) = spool.keep(Arc::clone(&runs)).await;
            shared.board().spooled(Arc::unwrap_or_clone(runs), kept);
            shared.ended.notify_one();
            trouble = tell(outcome, trouble);
        }
    }
}

/// Warns when the spool begins to refuse runs, and says when it takes them again.
fn tell(outcome: Result<(), SpoolError>, was_trouble: bool) -> bool {
    match outcome {
        Err(error) if !was_trouble => tracing::warn!(
            %error,
            "no jobs are claimed until the coordinator has acknowledged the runs that are in memory only"
        ),
        Ok(()) if was_trouble => tracing::info!("the spool takes runs again"),
        _ => return was_trouble,
    }
    !was_trouble
}
