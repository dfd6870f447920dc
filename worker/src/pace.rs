//! A worker in simulated time: everything that it decides is as always, but time is tokio's clock, which may be moved by
//! hand, and nothing happens on another thread.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use furrow_schema::protocol::{LeasedJob, RunEnd};
use tokio::time::{Instant, sleep};
use tokio_util::sync::CancellationToken;

use crate::backoff::share;
use crate::board::Work;
use crate::pool::{Shared, run};
use crate::runner::Runner;

/// A run looks this often whether it is to stop.
const LOOK_EVERY: Duration = Duration::from_millis(200);

/// Draws which share of a pause to wait, from a half to all of it.
pub(crate) type Shares = Arc<dyn Fn() -> f64 + Send + Sync>;

/// How time goes for a simulated worker.
#[derive(Clone)]
pub struct Pace {
    /// How long a run of this job takes; asked when it begins.
    pub lasts: Arc<dyn Fn(&LeasedJob) -> Duration + Send + Sync>,
    /// Draws which share of a pause between two questions to wait, from 0.5 to 1.
    pub shares: Shares,
}

impl Pace {
    pub(crate) fn drawn_shares() -> Shares {
        Arc::new(share)
    }
}

impl fmt::Debug for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Pace")
    }
}

/// Sets a task to work, as the pool does with its threads, until `gone`.
pub(crate) fn begin<R: Runner>(shared: Arc<Shared<R::Scenario>>, runner: Arc<R>, pace: Pace, gone: CancellationToken) {
    let work = take_all(shared, runner, pace, gone.clone());
    tokio::spawn(async move { gone.run_until_cancelled(work).await });
}

async fn take_all<R: Runner>(shared: Arc<Shared<R::Scenario>>, runner: Arc<R>, pace: Pace, gone: CancellationToken) {
    loop {
        let Some(work) = shared.take() else { return };
        let began = Instant::now();
        let lasts = (pace.lasts)(&work.lease);
        let ended = if is_stopped(&work, lasts).await { RunEnd::HandedBack } else { run(runner.as_ref(), &work) };
        let more = shared.finish(&work.lease, ended, began.elapsed());
        for _ in 0..more {
            begin(Arc::clone(&shared), Arc::clone(&runner), pace.clone(), gone.clone());
        }
    }
}

async fn is_stopped<S>(work: &Work<S>, lasts: Duration) -> bool {
    let ends = Instant::now() + lasts;
    while Instant::now() < ends && !work.stop.load(Ordering::Relaxed) {
        sleep(LOOK_EVERY.min(ends - Instant::now())).await;
    }
    work.stop.load(Ordering::Relaxed)
}
