//! The worker's life: hello, work until told to stop, hand back, leave.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use furrow_schema::id::{EngineId, WorkerId};
use furrow_schema::protocol::{Hello, Recorded, Refusal, RunEnd, RunReport};
use tokio_util::sync::CancellationToken;

use crate::claims::claim_jobs;
use crate::conversation::{AskError, Conversation};
use crate::link::Link;
use crate::pace::Pace;
use crate::pool::{Pool, Shared};
use crate::renewals::renew_leases;
use crate::reports::{deliver_spooled, report_runs};
use crate::runner::{Runner, Simulator};
use crate::spool::{Identity, Spool};
use crate::spooling::{OpenSpool, spool_runs};

/// A worker that was told to stop has this long to stop its runs, and as long again to say so.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// What a worker is and how much it may use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Config {
    /// A name for people, such as the host's.
    pub name: String,
    /// Runs at a time, at least 1.
    pub threads: usize,
    /// The simulation code it runs.
    pub engine: EngineId,
}

impl Config {
    /// This host, all its cores, the engine that is compiled in.
    #[must_use]
    pub fn of_this_host() -> Self {
        let name = hostname::get().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self { name, threads, engine: EngineId(furrow_sim::engine::id()) }
    }

    /// How such a worker presents itself.
    #[must_use]
    pub fn hello(&self) -> Hello {
        let threads = u32::try_from(self.threads.max(1)).unwrap_or(u32::MAX);
        Hello { name: self.name.clone(), engine: self.engine, threads }
    }
}

/// What a worker did in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Summary {
    /// Runs with a result that is on record.
    pub done: u64,
    /// Runs that panicked or could not be read.
    pub panicked: u64,
    /// Jobs handed back.
    pub handed_back: u64,
    /// Reports that came too late and changed nothing.
    pub ignored: u64,
}

impl Summary {
    pub(crate) fn count(&mut self, runs: &[RunReport], recorded: &Recorded) {
        self.ignored += recorded.ignored.len() as u64;
        for run in runs.iter().filter(|run| !recorded.ignored.contains(&run.job)) {
            match run.ended {
                RunEnd::Done(_) => self.done += 1,
                RunEnd::Panicked { .. } => self.panicked += 1,
                RunEnd::HandedBack => self.handed_back += 1,
            }
        }
    }
}

impl std::ops::AddAssign for Summary {
    fn add_assign(&mut self, more: Self) {
        self.done += more.done;
        self.panicked += more.panicked;
        self.handed_back += more.handed_back;
        self.ignored += more.ignored;
    }
}

/// Why a worker ended before it was told to.
#[derive(Debug, thiserror::Error)]
pub enum WorkerError {
    /// The coordinator will not have this worker. The caller shows the reason and leaves.
    #[error("the coordinator refused this worker: {0}")]
    Refused(Refusal),
    /// The link is closed for good. The caller leaves, or connects anew.
    #[error("the link to the coordinator is closed")]
    LinkClosed,
    /// Another coordinator is in its place. What this one handed out is not for that one; finished runs stay in the
    /// spool. The caller connects anew, and begins another life.
    #[error("another coordinator, {0}, is in its place")]
    OtherCoordinator(String),
    /// The operating system gives no threads. The caller asks for fewer.
    #[error("no threads to run on: {0}")]
    NoThreads(String),
}

/// Pulls jobs from a coordinator and runs them.
pub struct Worker<R: Runner = Simulator> {
    link: Arc<dyn Link>,
    config: Config,
    identity: Identity,
    spool: Option<OpenSpool>,
    runner: Arc<R>,
    pace: Option<Pace>,
}

impl Worker {
    /// A worker that simulates.
    #[must_use]
    pub fn new(link: Arc<dyn Link>, config: Config) -> Self {
        Self::with_runner(link, config, Simulator)
    }
}

impl<R: Runner> Worker<R> {
    /// A worker that does with a job what `runner` does.
    #[must_use]
    pub fn with_runner(link: Arc<dyn Link>, config: Config, runner: R) -> Self {
        Self { link, config, identity: Identity::random(), spool: None, runner: Arc::new(runner), pace: None }
    }

    /// Finished runs are kept in `spool` until `coordinator`, to which the link leads, has acknowledged them; the worker
    /// is the one of that folder. Without it they are lost with the process.
    #[must_use]
    pub fn spooling(mut self, spool: Arc<Mutex<Spool>>, coordinator: &str) -> Self {
        self.identity = spool.lock().unwrap_or_else(PoisonError::into_inner).identity_at(coordinator);
        self.spool = Some(OpenSpool::new(spool, coordinator));
        self
    }

    /// Time is tokio's alone, which a test may move by hand: runs last as long as `pace` says, and no thread takes part.
    #[must_use]
    pub fn paced(mut self, pace: Pace) -> Self {
        self.spool = self.spool.map(OpenSpool::at_once);
        self.pace = Some(pace);
        self
    }

    /// The name it goes by at the coordinator.
    #[must_use]
    pub fn id(&self) -> &WorkerId {
        &self.identity.worker
    }

    /// Works until `stop` is cancelled; then hands back what waits and what runs, and returns within about 5 s.
    ///
    /// A coordinator that is away is waited for; what was claimed is run meanwhile.
    ///
    /// # Errors
    /// See [`WorkerError`]: the worker ended without being told to.
    pub async fn run(self, stop: CancellationToken) -> Result<Summary, WorkerError> {
        let shared = Arc::new(Shared::new(self.config.threads, self.spool.is_some()));
        let pool = self.pool(&shared)?;
        let shares = self.pace.as_ref().map_or_else(Pace::drawn_shares, |pace| Arc::clone(&pace.shares));
        let conversation =
            Conversation::new(Arc::clone(&self.link), self.identity.clone(), self.config.hello(), shares);
        let welcome = match conversation.say_hello(&stop).await {
            Ok(welcome) => welcome,
            Err(AskError::GivenUp) => return Ok(Summary::default()),
            Err(error) => return Err(error.into()),
        };
        tracing::info!(worker = %self.id(), threads = self.config.threads, "worker started");
        let mut summary = match &self.spool {
            Some(spool) => deliver_spooled(&conversation, self.config.engine, spool, &stop).await?,
            None => Summary::default(),
        };
        let renewals = renew_leases(&conversation, welcome.renew_every_ms, &shared);
        summary += tokio::select! {
            biased;
            ended = self.converse(&conversation, &shared, &pool, &stop) => ended?,
            refusal = renewals => {
                shared.board().close();
                shared.ring_ended();
                return Err(WorkerError::Refused(refusal));
            }
        };
        tracing::info!(worker = %self.id(), done = summary.done, handed_back = summary.handed_back, "worker stopped");
        Ok(summary)
    }

    fn pool(&self, shared: &Arc<Shared<R::Scenario>>) -> Result<Pool<R>, WorkerError> {
        let (shared, runner) = (Arc::clone(shared), Arc::clone(&self.runner));
        match &self.pace {
            Some(pace) => Ok(Pool::paced(shared, runner, pace)),
            None => Pool::new(self.config.threads, shared, runner)
                .map_err(|error| WorkerError::NoThreads(error.to_string())),
        }
    }

    /// Claims and reports until everything is said; the first refusal stops the other side, too.
    async fn converse(
        &self,
        conversation: &Conversation,
        shared: &Shared<R::Scenario>,
        pool: &Pool<R>,
        stop: &CancellationToken,
    ) -> Result<Summary, WorkerError> {
        let (halt, too_late) = (stop.child_token(), CancellationToken::new());
        let engine = self.config.engine;
        let claims = async {
            let _halts_when_dropped = halt.clone().drop_guard();
            let ended = claim_jobs(conversation, engine, shared, pool, &halt).await;
            shared.board().claims_ended();
            shared.ring_ended();
            ended
        };
        let reports = async {
            let _halts_when_dropped = halt.clone().drop_guard();
            let ended = report_runs(conversation, engine, shared, &too_late).await;
            shared.board().reports_ended();
            shared.ring_ended();
            ended
        };
        let spooling = async {
            if let Some(spool) = &self.spool {
                spool_runs(spool, shared).await;
            }
        };
        let all = async { tokio::join!(claims, reports, spooling) };
        let (claimed, reported, ()) = tokio::select! {
            biased;
            ended = all => ended,
            never = wind_down(shared, &halt, &too_late) => match never {},
        };
        shared.board().close();
        claimed?;
        Ok(reported?)
    }
}

/// After the halt: gives work back, waits a little for the runs to stop, then a little for the last report.
async fn wind_down<S>(
    shared: &Shared<S>,
    halt: &CancellationToken,
    too_late: &CancellationToken,
) -> std::convert::Infallible {
    halt.cancelled().await;
    shared.board().close();
    shared.ring_ended();
    tokio::time::sleep(STOP_WITHIN).await;
    shared.board().abandon();
    shared.ring_ended();
    tokio::time::sleep(STOP_WITHIN).await;
    tracing::warn!("leaving without the coordinator's acknowledgement");
    too_late.cancel();
    std::future::pending().await
}

impl From<AskError> for WorkerError {
    fn from(error: AskError) -> Self {
        match error {
            AskError::Refused(refusal) => Self::Refused(refusal),
            AskError::OtherCoordinator(other) => Self::OtherCoordinator(other),
            AskError::Closed | AskError::GivenUp => Self::LinkClosed,
        }
    }
}

#[cfg(test)]
mod tests;
