//! The one task that changes the database: group commit.
//!
//! Whatever waits in the queue when a transaction begins goes into it together, so that the cost of a durable
//! commit is shared; an answer leaves only after the commit. The commands of a batch are put in an order that
//! favours those who did their work: hellos, results, renewals, then expiry, submissions and claims. If a batch
//! cannot be written, each of its commands is tried alone: one that the database refuses spoils no other.
//! What changes many jobs at once is an errand, done in steps between the batches.

mod errands;

use std::sync::Arc;
use std::time::Duration;

use furrow_schema::protocol::{LEASE_MS, RENEW_EVERY_MS, Recorded, Refusal, Reply, Welcome};
use sqlx::SqliteConnection;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

use crate::batch::{Answers, Batch, Command};
use crate::config::Config;
use crate::error::StoreError;
use crate::rate::Rates;
use crate::store::tally::Tally;
use crate::store::{Store, claim, expiry, renew, result, submit, worker};
use errands::Errands;

/// At most this many commands share a transaction.
const BATCH_COMMANDS: usize = 256;
/// Leases are looked at this often.
const HOUSEKEEPING_EVERY: Duration = Duration::from_secs(1);
/// When housekeeping is so late, nobody could renew meanwhile [ms].
const STANDSTILL_MS: i64 = 5_000;

/// The state of the writing task.
pub(crate) struct Writer {
    store: Store,
    config: Config,
    rates: Arc<Rates>,
    bell: watch::Sender<u64>,
}

impl Writer {
    pub(crate) fn new(store: Store, config: Config, rates: Arc<Rates>, bell: watch::Sender<u64>) -> Self {
        Self { store, config, rates, bell }
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
        }
        self.store.close().await;
    }

    async fn serve(&self, batch: Batch) {
        if batch.len() == 0 {
            return;
        }
        let failed = match self.commit(&batch).await {
            Ok(answers) => return self.publish(batch, answers),
            Err(error) => error,
        };
        if batch.len() == 1 {
            tracing::error!(error = %failed, "could not write");
            return batch.refuse(&failed);
        }
        tracing::warn!(error = %failed, commands = batch.len(), "could not write a batch; trying its commands alone");
        for single in batch.split() {
            match self.commit(&single).await {
                Ok(answers) => self.publish(single, answers),
                Err(error) => {
                    tracing::error!(%error, "could not write");
                    single.refuse(&error);
                }
            }
        }
    }

    async fn commit(&self, batch: &Batch) -> Result<Answers, StoreError> {
        let mut transaction = self.store.writer().begin_with("begin immediate").await?;
        let answers = self.apply(&mut transaction, batch).await?;
        transaction.commit().await?;
        Ok(answers)
    }

    async fn apply(&self, conn: &mut SqliteConnection, batch: &Batch) -> Result<Answers, StoreError> {
        let now_ms = self.config.clock.now_ms();
        let engine_id = crate::store::engine_id(conn, self.config.engine).await?;
        let mut answers = Answers::default();
        for (call, _) in &batch.hellos {
            let welcome = Welcome { lease_ms: LEASE_MS, renew_every_ms: RENEW_EVERY_MS };
            let admitted = worker::hello(conn, call, engine_id, now_ms).await?;
            answers.hellos.push(admitted.map_or_else(Reply::Refused, |()| Reply::Ok(welcome)));
        }
        let known = worker::Known::load(conn, &batch.callers()).await?;
        answers.results = self.record(conn, batch, &known, engine_id, now_ms, &mut answers.tally).await?;
        for (call, _) in &batch.renewals {
            answers.renewals.push(match known.check(call) {
                Ok(worker) => Reply::Ok(renew::renew(conn, worker, &call.body, now_ms).await?),
                Err(refusal) => Reply::Refused(refusal),
            });
        }
        let expired = self.expire(conn, batch, engine_id, now_ms, &mut answers.tally).await?;
        answers.tally.write(conn, now_ms).await?;
        for (sweep, _) in &batch.submissions {
            answers.submissions.push(submit::submit(conn, sweep, engine_id, now_ms).await?);
        }
        for (call, _) in &batch.claims {
            answers.claims.push(match known.check(call) {
                Ok(worker) => {
                    Reply::Ok(claim::claim(conn, worker, &call.request, &call.body, engine_id, now_ms).await?)
                }
                Err(refusal) => Reply::Refused(refusal),
            });
        }
        worker::seen(conn, &batch.seen(&known), now_ms).await?;
        answers.visible = answers.changed_something(expired);
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
    ) -> Result<Vec<Reply<Recorded>>, StoreError> {
        let checked: Vec<_> = batch.results.iter().map(|(call, _)| known.check(call)).collect();
        let reports: Vec<_> = batch
            .results
            .iter()
            .zip(&checked)
            .filter_map(|((call, _), worker)| Some((*worker.as_ref().ok()?, &call.body)))
            .collect();
        let mut recorded = result::record(conn, &reports, engine_id, now_ms, tally).await?.into_iter();
        let reply = |worker: Result<i64, Refusal>| match worker {
            Ok(_) => Reply::Ok(recorded.next().expect("every report of a known worker has an answer")),
            Err(refusal) => Reply::Refused(refusal),
        };
        Ok(checked.into_iter().map(reply).collect())
    }

    async fn expire(
        &self,
        conn: &mut SqliteConnection,
        batch: &Batch,
        engine_id: i64,
        now_ms: i64,
        tally: &mut Tally,
    ) -> Result<bool, StoreError> {
        if batch.housekeeping.is_empty() {
            return Ok(false);
        }
        Ok(expiry::expire(conn, self.config.max_attempts, engine_id, now_ms, tally).await? > 0)
    }

    fn ring(&self) {
        self.bell.send_modify(|generation| *generation += 1);
    }

    fn publish(&self, batch: Batch, answers: Answers) {
        let now_ms = self.config.clock.now_ms();
        for (sweep, results) in answers.tally.recorded() {
            self.rates.count(sweep, results, now_ms);
        }
        if answers.visible {
            self.ring();
        }
        batch.answer(answers);
    }
}

/// Asks for housekeeping every second, as long as there is anyone to ask. At first, and after the process stood still
/// (stopped, or its machine asleep), it waits until workers had time to renew.
pub(crate) async fn keep_house(commands: mpsc::WeakSender<Command>, stop: CancellationToken, config: Config) {
    let mut tick = tokio::time::interval_at(Instant::now() + config.leases_hold_for, HOUSEKEEPING_EVERY);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut last_ms = None;
    while stop.run_until_cancelled(tick.tick()).await.is_some() {
        let now_ms = config.clock.now_ms();
        if last_ms.is_some_and(|last_ms| now_ms - last_ms > STANDSTILL_MS) {
            tracing::warn!("this process stood still: no lease runs out before its workers had time to renew");
            last_ms = None;
            tick.reset_after(config.leases_hold_for);
            continue;
        }
        last_ms = Some(now_ms);
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
        let hold = Duration::from_millis(100);
        let first = Instant::now() + hold;
        let config = Config { leases_hold_for: hold, ..Config::new(ENGINE) };
        tokio::spawn(keep_house(commands.downgrade(), CancellationToken::new(), config));
        assert!(matches!(queue.recv().await, Some(Command::KeepHouse(_))));
        assert!(Instant::now() >= first);
    }

    #[tokio::test]
    async fn no_lease_runs_out_right_after_a_standstill() {
        let (commands, mut queue) = mpsc::channel(1);
        let (clock, hand) = crate::Clock::manual(0);
        let hold = Duration::from_millis(1_500);
        let config = Config { leases_hold_for: hold, clock, ..Config::new(ENGINE) };
        tokio::spawn(keep_house(commands.downgrade(), CancellationToken::new(), config));
        let Some(Command::KeepHouse(done)) = queue.recv().await else { panic!("it keeps house") };
        let stopped = Instant::now();
        hand.advance(STANDSTILL_MS + 1);
        done.send(Ok(())).unwrap();
        assert!(matches!(queue.recv().await, Some(Command::KeepHouse(_))));
        assert!(stopped.elapsed() >= hold, "{:?}", stopped.elapsed());
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
