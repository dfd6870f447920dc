//! Runs a finished job again for a picture of it: a few at a time, and the latest are kept.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use furrow_schema::id::{Digest, JobId};
use furrow_worker::replay::{ReplayError, Rerun, rerun};
use tokio::sync::Semaphore;

use super::problem::Problem;

/// Runs at a time: they take a core each from whatever else the machine does.
const AT_ONCE: usize = 2;

/// Runs that wait for their turn before further ones are refused.
const WAITING: usize = 32;

/// Finished runs that are kept, one to two megabytes each.
const KEPT: usize = 8;

/// A run that was repeated.
pub(super) type Replay = Rerun;

/// What to repeat.
pub(super) struct Order {
    /// The job.
    pub(super) job: JobId,
    /// Its scenario's canonical JSON.
    pub(super) scenario: Arc<str>,
    /// Its seed.
    pub(super) seed: u64,
    /// What its recorded result hashes to: the repetition must give the same.
    pub(super) digest: Digest,
}

/// Repeats runs.
pub(super) struct Replays {
    turns: Arc<Semaphore>,
    places: Semaphore,
    kept: Mutex<VecDeque<(JobId, Digest, Arc<Replay>)>>,
}

impl Default for Replays {
    fn default() -> Self {
        let places = Semaphore::new(AT_ONCE + WAITING);
        Self { turns: Arc::new(Semaphore::new(AT_ONCE)), places, kept: Mutex::default() }
    }
}

impl Replays {
    /// The run of `order`, kept from before or repeated now.
    ///
    /// # Errors
    /// 503 when too many wait; 409 when this engine cannot repeat it bit by bit; 500 when it panics.
    pub(super) async fn replay(&self, order: Order) -> Result<Arc<Replay>, Problem> {
        if let Some(replay) = self.kept(&order) {
            return Ok(replay);
        }
        let busy = || Problem::unavailable("too many runs are being repeated; ask again in a moment");
        let _place = self.places.try_acquire().map_err(|_| busy())?;
        let turn = Arc::clone(&self.turns).acquire_owned().await.map_err(|_| busy())?;
        if let Some(replay) = self.kept(&order) {
            return Ok(replay);
        }
        let Order { job, scenario, seed, digest } = order;
        let running = tokio::task::spawn_blocking(move || {
            let _turn = turn;
            rerun(&scenario, seed)
        });
        let replay = running.await.map_err(|error| Problem::internal(&error))?.map_err(refused)?;
        if Digest(replay.result.digest) != digest {
            return Err(other_engine("the repeated run has another digest than the recorded one"));
        }
        Ok(self.keep(job, digest, replay))
    }

    fn kept(&self, order: &Order) -> Option<Arc<Replay>> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let same = |(job, digest, _): &&(JobId, Digest, _)| *job == order.job && *digest == order.digest;
        kept.iter().find(same).map(|(_, _, replay)| Arc::clone(replay))
    }

    fn keep(&self, job: JobId, digest: Digest, replay: Replay) -> Arc<Replay> {
        let replay = Arc::new(replay);
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.truncate(KEPT - 1);
        kept.push_front((job, digest, Arc::clone(&replay)));
        replay
    }
}

fn refused(error: ReplayError) -> Problem {
    match error {
        ReplayError::Scenario(reason) => other_engine(&reason),
        ReplayError::Panicked(message) => Problem::internal(&message),
    }
}

fn other_engine(reason: &str) -> Problem {
    let detail = format!("this server's engine ({}) cannot repeat the run: {reason}", crate::engine());
    Problem::new(axum::http::StatusCode::CONFLICT, detail)
}
