//! The one task that changes the database: group commit.
//!
//! Whatever waits in the queue when a transaction begins goes into it together, so that the cost of a durable
//! commit is shared; an answer leaves only after the commit. The commands of a batch are put in an order that
//! favours those who did their work: admissions, hellos, results, renewals, then expiry, submissions and claims. If a batch
//! cannot be written, each of its commands is tried alone: one that the database refuses spoils no other.
//! What changes many jobs at once is an errand, done in steps between the batches.

mod errands;
mod heard;
mod outage;

use std::sync::Arc;
use std::time::Duration;

use furrow_schema::id::{SweepId, WorkerId};
use furrow_schema::protocol::{LEASE_MS, RENEW_EVERY_MS, Recorded, Refusal, Reply, Welcome};
use sqlx::SqliteConnection;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

use crate::batch::{Answers, Batch, Command};
use crate::config::{Config, Verify};
use crate::error::StoreError;
use crate::figures::Figures;
use crate::rate::Rates;
use crate::store::claim::Terms;
use crate::store::expiry::Ending;
use crate::store::result::Aftermath;
use crate::store::tally::Tally;
use crate::store::{Store, admission, census, claim, expiry, renew, result, submit, verification, worker};
use errands::Errands;
use heard::Heard;
use outage::Outage;

/// At most this many commands share a transaction.
const BATCH_COMMANDS: usize = 256;
/// Leases are looked at this often.
const HOUSEKEEPING_EVERY: Duration = Duration::from_secs(1);

/// The state of the writing task.
pub(crate) struct Writer {
    store: Store,
    config: Config,
    rates: WriterRates,
    figures: Arc<Figures>,
    bells: Bells,
    heard: Heard,
    outage: Outage,
}

/// Results of late, counted where they are recorded.
#[derive(Debug, Clone)]
pub(crate) struct WriterRates {
    /// By the sweep that wants them.
    pub(crate) sweeps: Arc<Rates<SweepId>>,
    /// By the worker that made them.
    pub(crate) workers: Arc<Rates<WorkerId>>,
}

impl WriterRates {
    /// Nothing was counted before `now_ms`.
    pub(crate) fn starting_at(now_ms: i64) -> Self {
        Self { sweeps: Arc::new(Rates::starting_at(now_ms)), workers: Arc::new(Rates::starting_at(now_ms)) }
    }
}

/// Rung after commits.
pub(crate) struct Bells {
    /// A user could see a difference.
    pub(crate) changed: watch::Sender<u64>,
    /// There may be jobs for idle workers.
    pub(crate) work: watch::Sender<u64>,
}

impl Writer {
    pub(crate) fn new(store: Store, config: Config, rates: WriterRates, figures: Arc<Figures>, bells: Bells) -> Self {
        let first_ms = config.clock.now_ms() + config.leases_hold_for.as_millis() as i64;
        let (heard, outage) = (Heard::default(), Outage::keeping_house_from(first_ms));
        Self { store, config, rates, figures, bells, heard, outage }
    }

    /// Serves the queue until nobody can ask any more or `stop`; then empties it and closes the database.
    pub(crate) async fn run(
        self,
        mut queue: mpsc::Receiver<Command>,
        stop: CancellationToken,
        stopped: CancellationToken,
    ) {
        let _say_so_when_done = stopped.drop_guard();
        let mut errands = Errands::begin(&self).await;
        loop {
            let first = tokio::select! {
                biased;
                () = stop.cancelled(), if !queue.is_closed() => {
                    queue.close();
                    continue;
                }
                first = queue.recv() => first,
                () = std::future::ready(()), if errands.wait() => {
                    errands.step(&self).await;
                    self.stop_if_for_good(&stop);
                    continue;
                }
            };
            let Some(first) = first else { break };
            let mut batch = Batch::default();
            batch.push(first);
            while batch.len() < BATCH_COMMANDS
                && let Ok(next) = queue.try_recv()
            {
                batch.push(next);
            }
            errands.take(&mut batch);
            self.serve(batch).await;
            if errands.wait() {
                errands.step(&self).await;
            }
            self.stop_if_for_good(&stop);
        }
        self.store.close().await;
    }

    fn stop_if_for_good(&self, stop: &CancellationToken) {
        if self.outage.is_for_good() {
            stop.cancel();
        }
    }

    async fn serve(&self, batch: Batch) {
        if batch.len() == 0 {
            return;
        }
        let failed = match self.commit(&batch).await {
            Ok(answers) => return self.publish(batch, answers),
            Err(error) => error,
        };
        if batch.len() == 1 || failed.concerns_all() {
            return self.refuse(batch, &failed);
        }
        tracing::warn!(error = %failed, commands = batch.len(), "could not write a batch; trying its commands alone");
        let mut failed_for_all = None;
        for single in batch.split() {
            if let Some(error) = &failed_for_all {
                self.refuse(single, error);
                continue;
            }
            match self.commit(&single).await {
                Ok(answers) => self.publish(single, answers),
                Err(error) => {
                    self.refuse(single, &error);
                    failed_for_all = Some(error).filter(StoreError::concerns_all);
                }
            }
        }
    }

    async fn commit(&self, batch: &Batch) -> Result<Answers, StoreError> {
        let begun = Instant::now();
        let mut transaction = self.store.begin().await?;
        let applied = self.apply(&mut transaction, batch).await;
        let answers = self.store.end(transaction, applied).await?;
        self.figures.commits.observe(begun.elapsed());
        Ok(answers)
    }

    fn refuse(&self, batch: Batch, error: &StoreError) {
        self.outage.note(error, self.config.clock.now_ms());
        batch.refuse(error);
    }

    async fn apply(&self, conn: &mut SqliteConnection, batch: &Batch) -> Result<Answers, StoreError> {
        let now_ms = self.config.clock.now_ms();
        let engine_id = crate::store::engine_id(conn, self.config.engine).await?;
        let mut answers = Answers::default();
        for (request, _) in &batch.admissions {
            let answer = admission::answer(conn, request, engine_id, now_ms, &mut answers.tally).await?;
            answers.admissions.push(Ok(answer));
        }
        for ((call, newcomers), _) in &batch.hellos {
            let welcome = Welcome { lease_ms: LEASE_MS, renew_every_ms: RENEW_EVERY_MS };
            let admitted = worker::hello(conn, call, *newcomers, engine_id, now_ms).await?;
            answers.hellos.push(admitted.map_or_else(Reply::Refused, |()| Reply::Ok(welcome)));
        }
        let known = worker::Known::load(conn, &batch.callers(), now_ms).await?;
        let seen = self.note_heard(batch, &answers.hellos, &known, now_ms);
        let aftermath;
        (answers.results, aftermath) = self.record(conn, batch, &known, engine_id, now_ms, &mut answers.tally).await?;
        let known = if aftermath.barred { worker::Known::load(conn, &batch.callers(), now_ms).await? } else { known };
        for (call, _) in &batch.renewals {
            answers.renewals.push(match known.check(call) {
                Ok(worker) => Reply::Ok(renew::renew(conn, worker, &call.body, now_ms).await?),
                Err(refusal) => Reply::Refused(refusal),
            });
        }
        let ended = self.expire(conn, batch, &known, engine_id, now_ms, &mut answers).await?;
        answers.tally.write(conn, now_ms).await?;
        if !batch.beats.is_empty() {
            census::beat(conn, now_ms).await?;
        }
        for (sweep, _) in &batch.submissions {
            answers.submissions.push(submit::submit(conn, sweep, engine_id, now_ms).await?);
        }
        let (verify, workers) = (self.to_verify(conn, batch).await?, self.heard.lately(now_ms));
        let terms = Terms { engine_id, now_ms, verify, workers };
        for (call, _) in &batch.claims {
            answers.claims.push(match known.check(call) {
                Ok(worker) => Reply::Ok(claim::claim(conn, worker, &call.request, &call.body, terms).await?),
                Err(refusal) => Reply::Refused(refusal),
            });
        }
        worker::seen(conn, &seen, now_ms).await?;
        answers.look_back(ended > 0, batch);
        answers.work |= aftermath.to_verify;
        Ok(answers)
    }

    async fn record(
        &self,
        conn: &mut SqliteConnection,
        batch: &Batch,
        known: &worker::Known,
        engine_id: i64,
        now_ms: i64,
        tally: &mut Tally,
    ) -> Result<(Vec<Reply<Recorded>>, Aftermath), StoreError> {
        let checked: Vec<_> = batch.results.iter().map(|(call, _)| known.check(call)).collect();
        let reports: Vec<_> = batch
            .results
            .iter()
            .zip(&checked)
            .filter_map(|((call, _), worker)| Some((*worker.as_ref().ok()?, &call.body)))
            .collect();
        let share = self.config.verify.share;
        let (recorded, aftermath) = result::record(conn, &reports, share, engine_id, now_ms, tally).await?;
        let mut recorded = recorded.into_iter();
        let reply = |worker: Result<i64, Refusal>| match worker {
            Ok(_) => Reply::Ok(recorded.next().expect("every report of a known worker has an answer")),
            Err(refusal) => Reply::Refused(refusal),
        };
        Ok((checked.into_iter().map(reply).collect(), aftermath))
    }

    /// How to verify, if this batch claims and anything is to be verified.
    async fn to_verify(&self, conn: &mut SqliteConnection, batch: &Batch) -> Result<Option<Verify>, StoreError> {
        let verify = Some(self.config.verify).filter(|verify| verify.share > 0.0 && !batch.claims.is_empty());
        Ok(if verify.is_some() && verification::any(conn).await? { verify } else { None })
    }

    /// Notes who was heard of; the rows of those who asked something but a hello.
    fn note_heard(&self, batch: &Batch, hellos: &[Reply<Welcome>], known: &worker::Known, now_ms: i64) -> Vec<i64> {
        let seen = batch.seen(known);
        let welcome = batch.hellos.iter().zip(hellos).filter(|(_, reply)| matches!(reply, Reply::Ok(_)));
        let workers = welcome.map(|(((call, _), _), _)| &call.worker).chain(seen.iter().map(|(_, worker)| *worker));
        self.heard.note(workers, now_ms);
        seen.into_iter().map(|(row, _)| row).collect()
    }

    /// Ends leases that ran out, and those of workers that are gone. Returns how many.
    async fn expire(
        &self,
        conn: &mut SqliteConnection,
        batch: &Batch,
        known: &worker::Known,
        engine_id: i64,
        now_ms: i64,
        answers: &mut Answers,
    ) -> Result<usize, StoreError> {
        let mut ended = 0;
        if !batch.housekeeping.is_empty() {
            self.outage.keeps_house(self.config.leases_hold_for, now_ms);
        }
        let hold = self.outage.leases_hold(now_ms);
        let max_deaths = self.config.max_attempts;
        let mut ending = Ending { engine_id, now_ms, max_deaths, tally: &mut answers.tally };
        if !batch.housekeeping.is_empty() && !hold {
            ended += admission::free_ended(conn, engine_id, now_ms, ending.tally).await?;
            ended += expiry::expire(conn, &mut ending).await?;
        }
        for (call, _) in batch.claims.iter().filter(|(call, _)| call.body.first) {
            if let Ok(worker) = known.check(call) {
                ended += expiry::began_anew(conn, (&call.worker, worker), &call.request, &mut ending).await?;
            }
        }
        for (absence, _) in &batch.absences {
            // While leases hold, whoever is away has time to come back.
            let heard_ms = if hold { Some(now_ms) } else { self.heard.since(absence) };
            if heard_ms.is_none() {
                ended += expiry::fell_silent(conn, &absence.worker, &mut ending).await?;
                self.heard.forget(&absence.worker);
            }
            answers.absences.push(Ok(heard_ms));
        }
        Ok(ended)
    }

    /// A step of an errand was committed.
    fn ring(&self) {
        ring(&self.bells.changed);
        ring(&self.bells.work);
    }

    fn publish(&self, batch: Batch, answers: Answers) {
        let now_ms = self.config.clock.now_ms();
        self.figures.count_recorded(&answers.results);
        for (sweep, results) in answers.tally.recorded() {
            self.rates.sweeps.count(sweep, results, now_ms);
        }
        for (worker, results) in batch.recorded(&answers) {
            self.rates.workers.count(worker, results, now_ms);
        }
        if answers.visible {
            self.outage.over();
            ring(&self.bells.changed);
        }
        if answers.work {
            ring(&self.bells.work);
        }
        batch.answer(answers);
    }
}

fn ring(bell: &watch::Sender<u64>) {
    bell.send_modify(|generation| *generation += 1);
}

/// Asks for housekeeping every second from `first` on, as long as there is anyone to ask.
pub(crate) async fn keep_house(commands: mpsc::WeakSender<Command>, stop: CancellationToken, first: Instant) {
    let mut tick = tokio::time::interval_at(first, HOUSEKEEPING_EVERY);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    while stop.run_until_cancelled(tick.tick()).await.is_some() {
        let (answer, answered) = oneshot::channel();
        let Some(commands) = commands.upgrade() else { return };
        if commands.send(Command::KeepHouse(answer)).await.is_err() {
            return;
        }
        drop(commands);
        // What went wrong was logged where it did; the next tick tries again.
        let _ = answered.await;
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::protocol::{LeasedJob, Report, RunReport};
    use futures::future::join_all;

    use super::*;
    use crate::testing::{Bench, ENGINE, Worker, done, sweep};
    use crate::view::JobFilter;

    async fn finish(worker: &Worker, coordinator: &crate::Coordinator, job: LeasedJob) -> Reply<Recorded> {
        let runs = vec![RunReport { job: job.job, attempt: job.attempt, ended: done(job.seed as f64) }];
        coordinator.result(worker.call(Report { engine: ENGINE, runs })).await
    }

    #[tokio::test]
    async fn many_at_once_are_all_answered() {
        let bench = Bench::new().await;
        let submitted = bench.submit(sweep(&["rgop", "rg"], 300)).await;
        let worker = bench.worker().await;
        let claims = (0..12).map(|_| worker.claim(50));
        let jobs: Vec<_> = join_all(claims).await.into_iter().flatten().collect();
        assert_eq!(jobs.len(), 600);
        let answers = join_all(jobs.into_iter().map(|job| finish(&worker, &bench.coordinator, job))).await;
        assert!(answers.into_iter().all(|answer| answer.into_result().unwrap().recorded.len() == 1));
        let sweep = bench.sweep(submitted.id).await;
        assert_eq!((sweep.done, sweep.queued), (600, 0));
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_command_that_the_database_refuses_spoils_no_other() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 3)).await;
        let worker = bench.worker().await;
        let jobs = worker.claim(3).await;
        sqlx::query(
            "create trigger sabotage before insert on result when new.job_id = 2 begin select raise(abort, 'no'); end",
        )
        .execute(bench.store.writer())
        .await
        .unwrap();
        let answers = join_all(jobs.into_iter().map(|job| finish(&worker, &bench.coordinator, job))).await;
        let accepted: Vec<_> = answers.iter().map(|answer| matches!(answer, Reply::Ok(_))).collect();
        assert_eq!(accepted, [true, false, true]);
        assert!(matches!(&answers[1], Reply::Refused(Refusal::Unavailable { .. })));
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn the_bell_rings_for_results_and_not_for_empty_claims() {
        let bench = Bench::new().await;
        let worker = bench.worker().await;
        let mut changed = bench.coordinator.changed();
        changed.mark_unchanged();
        worker.claim(1).await;
        assert!(!changed.has_changed().unwrap());
        bench.submit(sweep(&["rgop"], 1)).await;
        assert!(changed.has_changed().unwrap());
        changed.mark_unchanged();
        let job = worker.claim(1).await.remove(0);
        worker.ended(&job, done(1.0)).await;
        assert!(changed.has_changed().unwrap());
    }

    #[tokio::test]
    async fn a_reopened_file_goes_on_where_it_stood() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let first = Bench::over(Store::open(&path).await.unwrap());
        let submitted = first.submit(sweep(&["rgop"], 3)).await;
        let worker = first.worker().await;
        let call = worker.claim_call(2);
        let leases = first.coordinator.claim(call.clone()).await.into_result().unwrap();
        worker.ended(&leases.jobs[0], done(1.0)).await;
        first.coordinator.shutdown().await;
        assert!(matches!(first.coordinator.keep_house().await, Err(StoreError::Closed)));
        let log = path.with_extension("db-wal");
        assert!(!log.exists(), "all of it is in the one file");

        let second = Bench::over(Store::open(&path).await.unwrap());
        assert_eq!(second.coordinator.id(), first.coordinator.id());
        let again = second.coordinator.claim(call).await.into_result().unwrap();
        assert_eq!(again.jobs, leases.jobs[1..], "a claim repeated over a restart gets the same jobs");
        let sweep = second.sweep(submitted.id).await;
        assert_eq!((sweep.done, sweep.leased, sweep.queued), (1, 1, 1));
        let page = second.coordinator.jobs(&JobFilter::default()).await.unwrap();
        assert_eq!(page.items.len(), 3);
        second.assert_consistent().await;
        second.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn no_lease_runs_out_before_the_workers_had_time_to_come_back() {
        let (commands, mut queue) = mpsc::channel(1);
        let first = Instant::now() + Duration::from_millis(100);
        tokio::spawn(keep_house(commands.downgrade(), CancellationToken::new(), first));
        assert!(matches!(queue.recv().await, Some(Command::KeepHouse(_))));
        assert!(Instant::now() >= first);
    }

    #[tokio::test]
    async fn who_asks_after_a_shutdown_is_refused() {
        let bench = Bench::new().await;
        let worker = bench.worker().await;
        bench.coordinator.shutdown().await;
        let refused = bench.coordinator.claim(worker.claim_call(1)).await.into_result().unwrap_err();
        assert!(matches!(refused, Refusal::Unavailable { .. }));
        assert!(matches!(bench.coordinator.submit(sweep(&["rgop"], 1)).await, Err(StoreError::Closed)));
    }

    #[tokio::test]
    async fn rate_and_time_left_follow_the_clock() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop"], 30)).await.id;
        let worker = bench.worker().await;
        assert_eq!((bench.sweep(id).await.rate_per_s, bench.sweep(id).await.eta_s), (None, None));
        bench.clock.advance(5_000);
        for job in worker.claim(10).await {
            worker.ended(&job, done(1.0)).await;
        }
        let sweep = bench.sweep(id).await;
        assert_eq!((sweep.rate_per_s, sweep.eta_s), (Some(2.0), Some(10.0)));
    }
}
