//! What all others talk to: four questions of workers, the user's questions, and a bell for changes.

mod results;

use std::sync::Arc;

use furrow_schema::id::{EngineId, SweepId, WorkerId};
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, Welcome};
use furrow_schema::sweep::{NewSweep, Submitted, Sweep, SweepState};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::AbortHandle;
use tokio_util::sync::CancellationToken;

use crate::batch::{Absence, Admission, Command, Errand};
use crate::config::Config;
use crate::error::StoreError;
use crate::figures::Figures;
use crate::store::admission::{Admitted, Request};
use crate::store::control::Control;
use crate::store::worker::Newcomers;
use crate::store::{Store, census, incident, job, submit, sweep, token, verification, worker};
use crate::token::{Secret, TokenInfo};
use crate::validate;
use crate::view::{
    Census, Incident, JobDetail, JobFilter, JobPage, JobRef, SweepChange, VerificationCounts, WorkerChange, WorkerInfo,
};
use crate::writer;

/// Questions wait in a queue of this length; whoever asks then waits for a place in it.
const QUEUE_LENGTH: usize = 1_024;

/// A running coordinator. Clones are handles on the same one.
#[derive(Debug, Clone)]
pub struct Coordinator {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    store: Store,
    config: Config,
    commands: mpsc::Sender<Command>,
    rates: writer::WriterRates,
    figures: Arc<Figures>,
    changed: watch::Receiver<u64>,
    work: watch::Receiver<u64>,
    stop: CancellationToken,
    stopped: CancellationToken,
    tasks: Vec<AbortHandle>,
}

impl Coordinator {
    /// Starts the writer and the housekeeping on the current tokio runtime.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    #[must_use]
    pub fn start(store: Store, config: Config) -> Self {
        let (commands, queue) = mpsc::channel(QUEUE_LENGTH);
        let ((changes, changed), (hints, work)) = (watch::channel(0), watch::channel(0));
        let bells = writer::Bells { changed: changes, work: hints };
        let rates = writer::WriterRates::starting_at(config.clock.now_ms());
        let figures = Arc::new(Figures::default());
        let (stop, stopped) = (CancellationToken::new(), CancellationToken::new());
        let writer = writer::Writer::new(store.clone(), config.clone(), rates.clone(), figures.clone(), bells);
        let writing = tokio::spawn(writer.run(queue, stop.clone(), stopped.clone()));
        let first_expiry = tokio::time::Instant::now() + config.leases_hold_for;
        let house = tokio::spawn(writer::keep_house(commands.downgrade(), stop.clone(), first_expiry));
        let tasks = vec![writing.abort_handle(), house.abort_handle()];
        Self {
            shared: Arc::new(Shared { store, config, commands, rates, figures, changed, work, stop, stopped, tasks }),
        }
    }

    /// A coordinator that answers what is asked of a store opened to read, beside the one that changes it. All else is
    /// refused with [`StoreError::Closed`].
    ///
    /// # Panics
    /// Outside a tokio runtime.
    #[must_use]
    pub fn reading(store: Store, config: Config) -> Self {
        // Nobody receives what is sent into this queue, or rings these bells.
        let ((commands, _), (_, changed), (_, work)) = (mpsc::channel(1), watch::channel(0), watch::channel(0));
        let rates = writer::WriterRates::starting_at(config.clock.now_ms());
        let figures = Arc::new(Figures::default());
        let (stop, stopped) = (CancellationToken::new(), CancellationToken::new());
        tokio::spawn(close_when_asked(store.clone(), stop.clone(), stopped.clone()));
        let tasks = Vec::new();
        Self {
            shared: Arc::new(Shared { store, config, commands, rates, figures, changed, work, stop, stopped, tasks }),
        }
    }

    /// The name under which workers find this coordinator; it stays with the database.
    #[must_use]
    pub fn id(&self) -> &str {
        self.shared.store.coordinator_id()
    }

    /// The simulation code whose sweeps it takes.
    #[must_use]
    pub fn engine(&self) -> EngineId {
        self.shared.config.engine
    }

    /// A worker presents itself. Its first hello sets its credential.
    pub async fn hello(&self, call: Call<Hello>) -> Reply<Welcome> {
        self.hello_among(call, Newcomers::Welcome).await
    }

    pub(crate) async fn hello_among(&self, call: Call<Hello>, newcomers: Newcomers) -> Reply<Welcome> {
        if let Err(refusal) = self.presentable(&call.body) {
            return Reply::Refused(refusal);
        }
        self.ask(|answer| Command::Hello((call, newcomers), answer)).await
    }

    /// Whether a worker that presents itself so could work here.
    pub(crate) fn presentable(&self, hello: &Hello) -> Result<(), Refusal> {
        validate::hello(hello).and_then(|()| self.same_engine(hello.engine))
    }

    /// A worker asks for jobs. The same request again gets the same jobs, as far as they are still its own.
    pub async fn claim(&self, call: Call<Claim>) -> Reply<Leases> {
        if let Err(refusal) = validate::claim(&call.body).and_then(|()| self.same_engine(call.body.engine)) {
            return Reply::Refused(refusal);
        }
        self.ask(|answer| Command::Claim(call, answer)).await
    }

    /// A worker says what became of jobs. Answered after the commit.
    pub async fn result(&self, call: Call<Report>) -> Reply<Recorded> {
        if let Err(refusal) = validate::report(&call.body).and_then(|()| self.same_engine(call.body.engine)) {
            return Reply::Refused(refusal);
        }
        self.ask(|answer| Command::Result(call, answer)).await
    }

    /// A worker renews its leases and learns which it lost.
    pub async fn renew(&self, call: Call<Renew>) -> Reply<Renewed> {
        if let Err(refusal) = validate::renew(&call.body) {
            return Reply::Refused(refusal);
        }
        self.ask(|answer| Command::Renew(call, answer)).await
    }

    /// A worker seems to be gone: its connection broke, say. If nothing was heard of it since `since_ms` its leases end
    /// at once, as if they had run out; should it be there after all, its results still count. Otherwise tells when it
    /// was last heard of [ms since 1970].
    ///
    /// # Errors
    /// [`StoreError::NotWritten`]: nothing was changed. [`StoreError::Closed`] after a shutdown.
    pub async fn worker_gone(&self, worker: WorkerId, since_ms: i64) -> Result<Option<i64>, StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::Absence(Absence { worker, since_ms }, answer)).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// Takes a sweep in, all of it or nothing: known jobs are shared, those with a result count at once.
    ///
    /// # Errors
    /// [`StoreError::Invalid`], [`StoreError::OtherEngine`] and [`StoreError::Conflict`] refuse the sweep;
    /// after the others it may be submitted again.
    pub async fn submit(&self, sweep: NewSweep) -> Result<Submitted, StoreError> {
        submit::check(&sweep, self.engine())?;
        let (answer, answered) = oneshot::channel();
        let (small, sweep) = (submit::is_small(&sweep), Box::new(sweep));
        let errand = |sweep, answer| Command::Errand(Errand::Submit(sweep, answer));
        self.send(if small { Command::Submit(sweep, answer) } else { errand(sweep, answer) }).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// Changes a sweep's priority, pauses or resumes it; none if there is no such sweep. When this is answered no job
    /// is handed out any more for a paused sweep; those that run may end. One that has ended has nothing to pause.
    ///
    /// # Errors
    /// [`StoreError::Cancelled`] refuses to resume a cancelled sweep; after the others it may be asked again.
    pub async fn change(&self, sweep: SweepId, change: SweepChange) -> Result<Option<Sweep>, StoreError> {
        self.control_and_show(sweep, Control::Change(change)).await
    }

    /// Cancels a sweep unless it is done; none if there is no such sweep. Its jobs that no other live sweep wants are
    /// given up; workers hear of it when they renew. A result that comes all the same is kept.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn cancel(&self, sweep: SweepId) -> Result<Option<Sweep>, StoreError> {
        self.control_and_show(sweep, Control::Cancel).await
    }

    /// Queues a sweep's failed and cancelled jobs again; none if there is no such sweep. Attempts go on counting.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn retry(&self, sweep: SweepId) -> Result<Option<Sweep>, StoreError> {
        self.control_and_show(sweep, Control::Retry).await
    }

    /// Removes a sweep, its cells, and the jobs, results and scenarios that no other sweep lists; false if there is no
    /// such sweep. Nobody sees it any more when this is answered; the rest of a large one goes after that.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn remove(&self, sweep: SweepId) -> Result<bool, StoreError> {
        self.control(sweep, Control::Remove).await
    }

    async fn control_and_show(&self, sweep: SweepId, control: Control) -> Result<Option<Sweep>, StoreError> {
        if self.control(sweep, control).await? { self.sweep(sweep).await } else { Ok(None) }
    }

    async fn control(&self, sweep: SweepId, control: Control) -> Result<bool, StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::Errand(Errand::Control(sweep, control, answer))).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// Sweeps older than `after`, newest first, at most `limit`; without `after` from the newest.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn sweeps(&self, after: Option<SweepId>, limit: u32) -> Result<Vec<Sweep>, StoreError> {
        let mut sweeps = sweep::list(&self.shared.store, after, limit).await?;
        sweeps.iter_mut().for_each(|sweep| self.add_rate(sweep));
        Ok(sweeps)
    }

    /// Where a sweep stands; none if there is no such sweep.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn sweep(&self, id: SweepId) -> Result<Option<Sweep>, StoreError> {
        let mut found = sweep::get(&self.shared.store, id).await?;
        if let Some(sweep) = &mut found {
            self.add_rate(sweep);
        }
        Ok(found)
    }

    /// What was asked for when the sweep was submitted, as JSON; none if there is no such sweep.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn request_of(&self, id: SweepId) -> Result<Option<String>, StoreError> {
        sweep::request(&self.shared.store, id).await
    }

    /// A page of jobs, ordered by cell, then job.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn jobs(&self, filter: &JobFilter) -> Result<JobPage, StoreError> {
        job::list(&self.shared.store, filter).await
    }

    /// A job in full; none if there is no such job.
    ///
    /// # Errors
    /// [`StoreError::Ambiguous`] for the first digits of several keys; [`StoreError::Database`] and
    /// [`StoreError::Damaged`].
    pub async fn job(&self, job: JobRef) -> Result<Option<JobDetail>, StoreError> {
        job::get(&self.shared.store, job).await
    }

    /// Every worker that said hello or enrolled, the latest seen first.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn workers(&self) -> Result<Vec<WorkerInfo>, StoreError> {
        self.list_workers(None).await
    }

    /// One worker; none if there is no such worker.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn worker(&self, worker: &WorkerId) -> Result<Option<WorkerInfo>, StoreError> {
        Ok(self.list_workers(Some(worker)).await?.pop())
    }

    async fn list_workers(&self, worker: Option<&WorkerId>) -> Result<Vec<WorkerInfo>, StoreError> {
        let mut workers = worker::list(&self.shared.store, worker).await?;
        let now_ms = self.now_ms();
        for worker in &mut workers {
            worker.rate_per_s = self.shared.rates.workers.per_s(&worker.id, worker.first_seen_ms, now_ms);
        }
        Ok(workers)
    }

    /// Turns a worker away, or lets it in for a time; none if there is no such worker. What a worker that is turned away
    /// holds is given to others at once; it hears of it with its next question, and ends.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn change_worker(
        &self,
        worker: &WorkerId,
        change: WorkerChange,
    ) -> Result<Option<WorkerInfo>, StoreError> {
        match self.admission(Request::Change(worker.clone(), change)).await? {
            Ok(Admitted::Unknown) => Ok(None),
            _ => self.worker(worker).await,
        }
    }

    pub(crate) async fn admission(&self, request: Request) -> Result<Admission, StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::Admission(request, answer)).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    pub(crate) fn store(&self) -> &Store {
        &self.shared.store
    }

    /// The time now [ms since 1970].
    #[must_use]
    pub fn now_ms(&self) -> i64 {
        self.shared.config.clock.now_ms()
    }

    /// Results that differ from the one on record, newest first, at most `limit`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn incidents(&self, limit: u32) -> Result<Vec<Incident>, StoreError> {
        incident::list(&self.shared.store, limit).await
    }

    /// How many results of its engine were, or are being, verified.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn verifications(&self) -> Result<VerificationCounts, StoreError> {
        verification::count(&self.shared.store, self.engine()).await
    }

    /// Whether it has results computed again.
    #[must_use]
    pub fn verifies(&self) -> bool {
        self.shared.config.verify.share > 0.0
    }

    /// Lets a barred worker have jobs again, once a user knows that it was not at fault or has been mended; false if
    /// there is no such worker. What was found out about its results stays.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn allow(&self, worker: WorkerId) -> Result<bool, StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::Errand(Errand::Allow(worker, answer))).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// The valid token that was sent; none if there is no such token, or it is expired or revoked.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn token(&self, sent: &Secret) -> Result<Option<TokenInfo>, StoreError> {
        let now_ms = self.shared.config.clock.now_ms();
        Ok(token::find(&self.shared.store, &sent.hash()).await?.filter(|token| token.is_valid(now_ms)))
    }

    /// Notes that a token was used, to the minute.
    ///
    /// # Errors
    /// [`StoreError::Database`]: it was not noted, which harms nothing.
    pub async fn note_use(&self, token: &TokenInfo) -> Result<(), StoreError> {
        token::used(&self.shared.store, token, self.shared.config.clock.now_ms()).await
    }

    /// How much there is of everything.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn census(&self) -> Result<Census, StoreError> {
        census::take(&self.shared.store, self.shared.config.clock.now_ms()).await
    }

    /// What the writer did since it was started.
    #[must_use]
    pub fn figures(&self) -> &Figures {
        &self.shared.figures
    }

    /// Has the writer write and commit a mark: proof that it answers and that the disk takes what it writes.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`].
    pub async fn beat(&self) -> Result<(), StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::Beat(answer)).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// A number that grows with every commit that changed something a user can see: wait on it instead of polling.
    #[must_use]
    pub fn changed(&self) -> watch::Receiver<u64> {
        self.shared.changed.clone()
    }

    /// A number that grows when there may be jobs for idle workers.
    #[must_use]
    pub fn work(&self) -> watch::Receiver<u64> {
        self.shared.work.clone()
    }

    /// Expires leases now; a task does so every second anyway.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`]: nothing was changed. [`StoreError::Closed`] after a shutdown.
    pub async fn keep_house(&self) -> Result<(), StoreError> {
        let (answer, answered) = oneshot::channel();
        self.send(Command::KeepHouse(answer)).await?;
        answered.await.map_err(|_| StoreError::Closed)?
    }

    /// Answers what is queued, then closes the database with all of it in one file. Later questions are refused.
    pub async fn shutdown(&self) {
        self.shared.stop.cancel();
        self.ended().await;
    }

    /// Waits until it has ended: after a shutdown, or by itself, because its database turned out to be damaged.
    pub async fn ended(&self) {
        self.shared.stopped.cancelled().await;
    }

    /// Ends it without a word, as a kill of its process does: what is not committed is rolled back, nobody gets an answer,
    /// and the store stays open for another coordinator.
    pub fn kill(&self) {
        self.shared.tasks.iter().for_each(AbortHandle::abort);
    }

    fn same_engine(&self, worker: EngineId) -> Result<(), Refusal> {
        let coordinator = self.engine();
        if worker == coordinator { Ok(()) } else { Err(Refusal::OtherEngine { coordinator, worker }) }
    }

    fn add_rate(&self, sweep: &mut Sweep) {
        let now_ms = self.now_ms();
        let left = sweep.queued + sweep.leased;
        sweep.rate_per_s = self.shared.rates.sweeps.per_s(&sweep.id, sweep.created_ms, now_ms);
        sweep.eta_s = match sweep.rate_per_s {
            _ if left == 0 => Some(0.0),
            _ if sweep.state == SweepState::Paused => None,
            Some(rate) if rate > 0.0 => Some(left as f64 / rate),
            _ => None,
        };
    }

    async fn ask<T>(&self, command: impl FnOnce(oneshot::Sender<Reply<T>>) -> Command) -> Reply<T> {
        let (answer, answered) = oneshot::channel();
        let closed = || Reply::Refused(Refusal::Unavailable { detail: StoreError::Closed.to_string() });
        if self.send(command(answer)).await.is_err() {
            return closed();
        }
        answered.await.unwrap_or_else(|_| closed())
    }

    async fn send(&self, command: Command) -> Result<(), StoreError> {
        self.shared.commands.send(command).await.map_err(|_| StoreError::Closed)
    }
}

async fn close_when_asked(store: Store, stop: CancellationToken, stopped: CancellationToken) {
    let _say_so_when_done = stopped.drop_guard();
    stop.cancelled().await;
    store.close().await;
}
