//! The one task that changes the database: group commit.
//!
//! Whatever waits in the queue when a transaction begins goes into it together, so that the cost of a durable
//! commit is shared; an answer leaves only after the commit. The commands of a batch are put in an order that
//! favours those who did their work: hellos, results, renewals, then expiry, submissions and claims. If a batch
//! cannot be written, each of its commands is tried alone: one that the database refuses spoils no other.

use std::sync::Arc;
use std::time::Duration;

use furrow_schema::protocol::{LEASE_MS, RENEW_EVERY_MS, Recorded, Refusal, Reply, Welcome};
use sqlx::SqliteConnection;
use tokio::sync::{mpsc, oneshot, watch};
use tokio::time::MissedTickBehavior;
use tokio_util::sync::CancellationToken;

use crate::batch::{Answers, Batch, Command};
use crate::config::Config;
use crate::error::StoreError;
use crate::rate::Rates;
use crate::store::tally::Tally;
use crate::store::{Store, claim, expiry, renew, result, submit, worker};

/// At most this many commands share a transaction.
const BATCH_COMMANDS: usize = 256;
/// Leases are looked at this often.
const HOUSEKEEPING_EVERY: Duration = Duration::from_secs(1);

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
        loop {
            let first = tokio::select! {
                biased;
                () = stop.cancelled(), if !queue.is_closed() => {
                    queue.close();
                    continue;
                }
                first = queue.recv() => first,
            };
            let Some(first) = first else { break };
            let mut batch = Batch::default();
            batch.push(first);
            while batch.len() < BATCH_COMMANDS
                && let Ok(next) = queue.try_recv()
            {
                batch.push(next);
            }
            self.serve(batch).await;
        }
        self.store.close().await;
    }

    async fn serve(&self, batch: Batch) {
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

    fn publish(&self, batch: Batch, answers: Answers) {
        let now_ms = self.config.clock.now_ms();
        for (sweep, results) in answers.tally.recorded() {
            self.rates.count(sweep, results, now_ms);
        }
        if answers.visible {
            self.bell.send_modify(|generation| *generation += 1);
        }
        batch.answer(answers);
    }
}

/// Asks for housekeeping every second, as long as there is anyone to ask.
pub(crate) async fn keep_house(commands: mpsc::WeakSender<Command>, stop: CancellationToken) {
    let mut tick = tokio::time::interval(HOUSEKEEPING_EVERY);
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
