//! What changes many jobs at once: large submissions, and what users do to sweeps.
//!
//! Each goes on in steps, a transaction each, with a batch of other commands between any two. What users do to sweeps
//! and what is to be removed stands in the database from the first step on and goes on after a crash; a submission that
//! broke off is removed.

use std::collections::{HashMap, VecDeque};

use furrow_schema::id::{SweepId, WorkerId};
use furrow_schema::sweep::{NewSweep, Submitted};
use sqlx::SqliteConnection;

use super::Writer;
use crate::batch::{Batch, Errand, Outcome};
use crate::error::StoreError;
use crate::store::control::{self, Begun, Control, Stepped};
use crate::store::submit::Expansion;
use crate::store::transaction::Transaction;
use crate::store::{Store, removal, submit, worker};

/// A large submission writes so many chunks in one transaction: fewer write the same pages again and again, more let the
/// others wait.
const CHUNKS_A_STEP: usize = 4;

/// All errands, begun or not.
#[derive(Debug, Default)]
pub(super) struct Errands {
    allowances: VecDeque<(WorkerId, Outcome<bool>)>,
    controls: VecDeque<(SweepId, Control, Outcome<bool>)>,
    submissions: VecDeque<(Box<NewSweep>, Outcome<Submitted>)>,
    /// The submission that is under way.
    coming: Option<Coming>,
    /// Who waits until the jobs of a sweep are in line.
    waiting: HashMap<SweepId, Vec<Outcome<bool>>>,
    /// Whether the database may hold something to go on with.
    unfinished: bool,
    /// Whether the database failed: what is under way goes on after the next housekeeping.
    stalled: bool,
}

#[derive(Debug)]
struct Coming {
    sweep: Box<NewSweep>,
    expansion: Expansion,
    outcome: Outcome<Submitted>,
}

impl Errands {
    /// Goes on where the database was left.
    pub(super) async fn begin(writer: &Writer) -> Self {
        if let Err(error) = disown_all(writer).await {
            tracing::error!(%error, "submissions that broke off could not be marked for removal");
        }
        Self { unfinished: true, ..Self::default() }
    }

    /// Takes the errands out of a batch, and new courage from its housekeeping.
    pub(super) fn take(&mut self, batch: &mut Batch) {
        self.stalled &= batch.housekeeping.is_empty();
        for errand in batch.errands.drain(..) {
            match errand {
                Errand::Submit(sweep, outcome) => self.submissions.push_back((sweep, outcome)),
                Errand::Allow(worker, outcome) => self.allowances.push_back((worker, outcome)),
                Errand::Control(sweep, control, outcome) => self.controls.push_back((sweep, control, outcome)),
            }
        }
    }

    /// Whether there is anything to do now.
    pub(super) fn wait(&self) -> bool {
        let under_way = self.coming.is_some() || self.unfinished;
        !self.allowances.is_empty()
            || !self.controls.is_empty()
            || !self.submissions.is_empty()
            || (under_way && !self.stalled)
    }

    /// Does the next step: what users do to sweeps goes before submissions, and both before removals.
    pub(super) async fn step(&mut self, writer: &Writer) {
        if let Some((worker, outcome)) = self.allowances.pop_front() {
            let _ = outcome.send(allow(writer, &worker).await.map_err(|error| not_written(writer, error)));
            return;
        }
        if let Some((sweep, control, outcome)) = self.controls.pop_front() {
            return self.begin_control(writer, sweep, control, outcome).await;
        }
        if self.unfinished && !self.stalled && self.settle(writer).await {
            return;
        }
        if let Some(coming) = self.coming.take() {
            self.expand(writer, coming).await;
        } else if let Some((sweep, outcome)) = self.submissions.pop_front() {
            self.begin_submission(writer, sweep, outcome).await;
        } else if self.unfinished && !self.stalled {
            self.remove(writer).await;
        }
    }

    async fn begin_control(&mut self, writer: &Writer, sweep: SweepId, control: Control, outcome: Outcome<bool>) {
        let begun = match begin_control(writer, sweep, control).await {
            Ok(begun) => begun,
            Err(error) => Err(not_written(writer, error)),
        };
        writer.ring();
        if control == Control::Remove && begun.is_ok() {
            self.answer(sweep);
        }
        match begun {
            Ok(Begun::GoesOn) if control != Control::Remove => {
                self.unfinished = true;
                self.waiting.entry(sweep).or_default().push(outcome);
            }
            Ok(Begun::GoesOn) => {
                self.unfinished = true;
                let _ = outcome.send(Ok(true));
            }
            Ok(begun) => {
                self.answer(sweep);
                let _ = outcome.send(Ok(begun != Begun::Unknown));
            }
            Err(error) => _ = outcome.send(Err(error)),
        }
    }

    /// Brings more jobs in line with their sweeps; false if there are none.
    async fn settle(&mut self, writer: &Writer) -> bool {
        match settle(writer).await {
            Ok(Stepped::Nothing) => return false,
            Ok(Stepped::GoesOn) => {}
            Ok(Stepped::Ended(sweep)) => self.answer(sweep),
            Err(error) => self.stall(writer, &error),
        }
        writer.ring();
        true
    }

    /// All that was asked about a sweep is done.
    fn answer(&mut self, sweep: SweepId) {
        for outcome in self.waiting.remove(&sweep).into_iter().flatten() {
            let _ = outcome.send(Ok(true));
        }
    }

    async fn begin_submission(&mut self, writer: &Writer, sweep: Box<NewSweep>, outcome: Outcome<Submitted>) {
        match begin_submission(writer, &sweep).await {
            Ok(Ok(expansion)) => self.coming = Some(Coming { sweep, expansion, outcome }),
            Ok(Err(answer)) => _ = outcome.send(answer),
            Err(error) => _ = outcome.send(Err(not_written(writer, error))),
        }
    }

    async fn expand(&mut self, writer: &Writer, mut coming: Coming) {
        let ended = expand(writer, &mut coming).await;
        writer.ring();
        match ended {
            Ok(false) => self.coming = Some(coming),
            Ok(true) => _ = coming.outcome.send(Ok(coming.expansion.submitted)),
            Err(error) => {
                let _ = coming.outcome.send(Err(not_written(writer, error)));
                self.unfinished = true;
                if let Err(error) = disown_all(writer).await {
                    self.stall(writer, &error);
                }
            }
        }
    }

    async fn remove(&mut self, writer: &Writer) {
        match remove(writer).await {
            Ok(any) => self.unfinished = any,
            Err(error) => self.stall(writer, &error),
        }
    }

    fn stall(&mut self, writer: &Writer, error: &StoreError) {
        writer.outage.note(error, writer.config.clock.now_ms());
        self.stalled = true;
    }
}

fn not_written(writer: &Writer, error: StoreError) -> StoreError {
    writer.outage.note(&error, writer.config.clock.now_ms());
    match error {
        StoreError::Full => StoreError::Full,
        other => StoreError::NotWritten(other.to_string()),
    }
}

/// A transaction of its own.
struct Step<'a> {
    store: &'a Store,
    transaction: Transaction,
    engine_id: i64,
    now_ms: i64,
}

impl<'a> Step<'a> {
    async fn begin(writer: &'a Writer) -> Result<Self, StoreError> {
        let store = &writer.store;
        let mut transaction = store.begin().await?;
        let now_ms = writer.config.clock.now_ms();
        match crate::store::engine_id(&mut transaction, writer.config.engine).await {
            Ok(engine_id) => Ok(Self { store, transaction, engine_id, now_ms }),
            Err(error) => store.end(transaction, Err(error)).await,
        }
    }

    /// Commits what was `done` if it went well.
    async fn end<T>(self, done: Result<T, StoreError>) -> Result<T, StoreError> {
        self.store.end(self.transaction, done).await
    }
}

async fn disown_all(writer: &Writer) -> Result<(), StoreError> {
    let mut step = Step::begin(writer).await?;
    let disowned = removal::disown_all(&mut step.transaction, step.now_ms).await;
    step.end(disowned).await
}

async fn allow(writer: &Writer, worker: &WorkerId) -> Result<bool, StoreError> {
    let mut step = Step::begin(writer).await?;
    let known = worker::allow(&mut step.transaction, worker).await;
    step.end(known).await
}

async fn begin_control(
    writer: &Writer,
    sweep: SweepId,
    control: Control,
) -> Result<Result<Begun, StoreError>, StoreError> {
    let mut step = Step::begin(writer).await?;
    let begun = control::begin(&mut step.transaction, sweep, control, step.engine_id, step.now_ms).await;
    step.end(begun).await
}

async fn settle(writer: &Writer) -> Result<Stepped, StoreError> {
    let mut step = Step::begin(writer).await?;
    let stepped = control::step(&mut step.transaction, None, step.engine_id, step.now_ms).await;
    step.end(stepped).await
}

/// What is known of a submission at its begin: how to go on, or the answer.
type Beginning = Result<Expansion, Result<Submitted, StoreError>>;

async fn begin_submission(writer: &Writer, sweep: &NewSweep) -> Result<Beginning, StoreError> {
    let mut step = Step::begin(writer).await?;
    let begun = submit::begin(&mut step.transaction, sweep, step.engine_id, step.now_ms).await;
    step.end(begun).await
}

/// Writes some chunks; true if that was the last, and the sweep can be seen.
async fn expand(writer: &Writer, coming: &mut Coming) -> Result<bool, StoreError> {
    let mut step = Step::begin(writer).await?;
    let expanded = write_chunks(&mut step.transaction, coming).await;
    step.end(expanded).await
}

async fn write_chunks(conn: &mut SqliteConnection, coming: &mut Coming) -> Result<bool, StoreError> {
    let mut ended = false;
    for _ in 0..CHUNKS_A_STEP {
        ended = ended || coming.expansion.step(conn, &coming.sweep).await?;
    }
    if ended {
        coming.expansion.list(conn).await?;
    }
    Ok(ended)
}

/// Removes a part of a sweep that nobody sees; false if there is no such sweep.
async fn remove(writer: &Writer) -> Result<bool, StoreError> {
    let mut step = Step::begin(writer).await?;
    let removed = remove_next(&mut step.transaction, step.engine_id, step.now_ms).await;
    step.end(removed).await
}

async fn remove_next(conn: &mut SqliteConnection, engine_id: i64, now_ms: i64) -> Result<bool, StoreError> {
    let Some(sweep) = removal::next(conn).await? else { return Ok(false) };
    removal::step(conn, sweep, engine_id, now_ms).await?;
    Ok(true)
}

#[cfg(test)]
mod tests;
