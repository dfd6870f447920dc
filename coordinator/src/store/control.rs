//! What users do to sweeps: pause, resume, change the priority, cancel, retry, remove.
//!
//! The sweep's row changes at once, in one transaction with the jobs that run and the first of the others. The rest of
//! a large sweep follows in steps of their own (`settling` keeps how far it is), so that nobody waits for it; after
//! a crash they go on.

use furrow_schema::id::{CellId, JobId, SweepId};
use furrow_schema::sweep::SweepState;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::removal;
use crate::store::settle::{Turns, settle};
use crate::store::sweep::state;
use crate::store::tally::Tally;
use crate::view::SweepChange;

/// So many jobs are brought in line in one transaction.
pub(crate) const STEP: usize = 2_000;

/// The state of a sweep that is seen.
const STATE: &str = "select state from sweep where id = ?1 and id not in (select sweep_id from unlisted)";

/// Changes the priority (?2) and whether a sweep that has not ended is paused (?3), if given.
const CHANGE: &str = "update sweep
    set priority = coalesce(?2, priority),
        state = case when ?3 is null or state not in ('active', 'paused') then state
                     when ?3 then 'paused' else 'active' end
    where id = ?1";

/// Cancels a sweep unless it has ended.
const CANCEL: &str = "update sweep set state = 'cancelled', finished_ms = ?2
    where id = ?1 and state in ('active', 'paused')";

/// Brings a cancelled sweep back.
const REOPEN: &str = "update sweep set state = 'active', finished_ms = null where id = ?1 and state = 'cancelled'";

/// Sets off bringing a sweep's jobs in line from the first on; failed ones anew if ?2, or if that was under way (null).
const BEGIN: &str = "insert into settling (sweep_id, retry, cell_id, job_id, placed)
    select ?1, coalesce(?2, 0), coalesce(min(cell.id), 0), 0, 0 from cell where sweep_id = ?1
    on conflict (sweep_id) do update
        set retry = coalesce(?2, retry), cell_id = excluded.cell_id, job_id = 0, placed = 0";

/// The jobs of a sweep that are at workers.
const LEASED: &str = "select distinct job.id
    from job join cell_job on cell_job.job_id = job.id join cell on cell.id = cell_job.cell_id
    where job.state = 'leased' and cell.sweep_id = ?1";

/// A sweep whose jobs are not all in line: this one (?1), or any.
const NEXT: &str = "select sweep_id, retry, cell_id, job_id, placed from settling
    where ?1 is null or sweep_id = ?1 order by sweep_id limit 1";

/// The next cells and jobs of sweep ?1 behind (?2, ?3).
const PAGE: &str = "select cell_id, job_id from cell_job
    where (cell_id, job_id) > (?2, ?3) and cell_id <= (select max(id) from cell where sweep_id = ?1)
    order by cell_id, job_id limit ?4 + 0";

/// How far a sweep is: cell, job, places given.
const ADVANCE: &str = "update settling set cell_id = ?2, job_id = ?3, placed = ?4 where sweep_id = ?1";

/// All jobs of a sweep are in line.
const END: &str = "delete from settling where sweep_id = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[STATE, CHANGE, CANCEL, REOPEN, BEGIN, LEASED, NEXT, PAGE, ADVANCE, END];

/// What a user does to a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Control {
    /// Another priority, pause, resume.
    Change(SweepChange),
    /// Its jobs are given up, as far as no other live sweep wants them.
    Cancel,
    /// Failed and cancelled jobs are queued again.
    Retry,
    /// It is removed with all that no other sweep wants.
    Remove,
}

/// What came of it so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Begun {
    /// There is no such sweep.
    Unknown,
    /// All is done.
    Ended,
    /// Steps are left.
    GoesOn,
}

/// Does it to the sweep, to its jobs at workers, and to the first of the others. Doing it again changes nothing more.
pub(crate) async fn begin(
    conn: &mut SqliteConnection,
    sweep: SweepId,
    control: Control,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<Begun, StoreError>, StoreError> {
    let word: Option<String> = sqlx::query_scalar(STATE).bind(sweep.0).fetch_optional(&mut *conn).await?;
    let Some(word) = word else { return Ok(Ok(Begun::Unknown)) };
    let resumed = matches!(control, Control::Change(SweepChange { paused: Some(false), .. }));
    if resumed && state(&word)? == SweepState::Cancelled {
        return Ok(Err(StoreError::Cancelled(sweep)));
    }
    change(conn, sweep, control, now_ms).await?;
    let mut tally = Tally::default();
    let leased: Vec<i64> = sqlx::query_scalar(LEASED).bind(sweep.0).fetch_all(&mut *conn).await?;
    let leased: Vec<JobId> = leased.into_iter().map(JobId).collect();
    let mut turns = Turns::load(conn, 0).await?;
    settle(conn, &leased, false, &mut turns, engine_id, now_ms, &mut tally).await?;
    tally.write(conn, now_ms).await?;
    let ended = match control {
        Control::Remove => removal::step(conn, sweep, engine_id, now_ms).await?,
        _ => step(conn, Some(sweep), engine_id, now_ms).await? == Stepped::Ended(sweep),
    };
    Ok(Ok(if ended { Begun::Ended } else { Begun::GoesOn }))
}

async fn change(conn: &mut SqliteConnection, sweep: SweepId, control: Control, now_ms: i64) -> Result<(), StoreError> {
    let (statement, retry) = match control {
        Control::Change(SweepChange { priority, paused }) => {
            (sqlx::query(CHANGE).bind(sweep.0).bind(priority).bind(paused), None)
        }
        Control::Cancel => (sqlx::query(CANCEL).bind(sweep.0).bind(now_ms), Some(false)),
        Control::Retry => (sqlx::query(REOPEN).bind(sweep.0), Some(true)),
        Control::Remove => return removal::unlist(conn, sweep, now_ms).await,
    };
    statement.execute(&mut *conn).await?;
    sqlx::query(BEGIN).bind(sweep.0).bind(retry).execute(conn).await?;
    Ok(())
}

/// What a step did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stepped {
    /// There was nothing to do.
    Nothing,
    /// Some jobs are in line.
    GoesOn,
    /// All jobs of this sweep are in line.
    Ended(SweepId),
}

/// Brings the next jobs of a changed sweep in line: of the one given, or of any.
pub(crate) async fn step(
    conn: &mut SqliteConnection,
    only: Option<SweepId>,
    engine_id: i64,
    now_ms: i64,
) -> Result<Stepped, StoreError> {
    let next = sqlx::query_as(NEXT).bind(only.map(|sweep| sweep.0));
    let row: Option<(i64, bool, i64, i64, i64)> = next.fetch_optional(&mut *conn).await?;
    let Some((sweep, retry, cell, job, placed)) = row else { return Ok(Stepped::Nothing) };
    let (sweep, mut tally) = (SweepId(sweep), Tally::default());
    let page = page(conn, sweep, (CellId(cell), JobId(job))).await?;
    let jobs: Vec<_> = page.iter().map(|(_, job)| *job).collect();
    let mut turns = Turns::load(conn, placed).await?;
    settle(conn, &jobs, retry, &mut turns, engine_id, now_ms, &mut tally).await?;
    let stepped = match page.last() {
        Some((cell, job)) if page.len() == STEP => {
            let advance = sqlx::query(ADVANCE).bind(sweep.0).bind(cell.0).bind(job.0).bind(turns.ahead);
            advance.execute(&mut *conn).await?;
            Stepped::GoesOn
        }
        _ => {
            sqlx::query(END).bind(sweep.0).execute(&mut *conn).await?;
            // Its state is looked at even where no job moved.
            tally.sweep(sweep);
            Stepped::Ended(sweep)
        }
    };
    tally.write(conn, now_ms).await?;
    Ok(stepped)
}

/// The next cells and jobs of `sweep` behind `after`, in their order.
pub(super) async fn page(
    conn: &mut SqliteConnection,
    sweep: SweepId,
    after: (CellId, JobId),
) -> Result<Vec<(CellId, JobId)>, StoreError> {
    let limit = i64::try_from(STEP).unwrap_or(i64::MAX);
    let page = sqlx::query_as(PAGE).bind(sweep.0).bind(after.0.0).bind(after.1.0).bind(limit);
    let rows: Vec<(i64, i64)> = page.fetch_all(conn).await?;
    Ok(rows.into_iter().map(|(cell, job)| (CellId(cell), JobId(job))).collect())
}

#[cfg(test)]
mod tests;
