//! Removing sweeps: those that a user wants gone, and those whose submission broke off.
//!
//! Such a sweep is unlisted at once, so that nobody sees it; what it leaves goes in steps. A job stays, with its result and
//! scenario, as long as any other sweep lists it, a cancelled one included.

use furrow_schema::id::{CellId, JobId, SweepId};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::control::{STEP, page};
use crate::store::settle::{Turns, settle};
use crate::store::tally::Tally;
use crate::store::to_json;

/// A sweep that nobody sees is not live, and its idempotency key is free.
const DISOWN: &str = "update sweep
    set state = 'cancelled', finished_ms = coalesce(finished_ms, ?2), idempotency_key = null where id = ?1";

/// The same for all of them: their submissions broke off.
const DISOWN_ALL: &str = "update sweep
    set state = 'cancelled', finished_ms = coalesce(finished_ms, ?1), idempotency_key = null
    where id in (select sweep_id from unlisted)";

/// Takes a sweep out of sight.
pub(super) const UNLIST: &str = "insert into unlisted (sweep_id) values (?1) on conflict do nothing";

/// Nothing is left to bring in line.
const FORGET_SETTLING: &str = "delete from settling where sweep_id = ?1";

/// A sweep to remove.
const NEXT: &str = "select sweep_id from unlisted order by sweep_id limit 1";

/// The first cell of a sweep.
const FIRST: &str = "select coalesce(min(id), 0) from cell where sweep_id = ?1";

/// Cells from ?1 on no longer list jobs, up to cell ?2 and job ?3.
const LEAVE: &str = "delete from cell_job where cell_id >= ?1 and (cell_id, job_id) <= (?2, ?3)";

/// Those of the jobs that no cell lists, with their scenarios.
const ORPHANS: &str = "select id, scenario_id from job
    where id in (select value from json_each(?1))
        and not exists (select 1 from cell_job where cell_job.job_id = job.id)";

/// Keeps the largest numbers, since those of what is removed must not be given again.
const REMEMBER: &str = "update last_number
    set job = max(job, coalesce((select max(id) from job), 0)),
        scenario = max(scenario, coalesce((select max(id) from scenario), 0))";

/// What belongs to jobs, and then they themselves.
const REMOVE_JOBS: [&str; 7] = [
    "delete from opinion where job_id in (select value from json_each(?1))",
    "delete from verification where job_id in (select value from json_each(?1))",
    "delete from trajectory where job_id in (select value from json_each(?1))",
    "delete from result where job_id in (select value from json_each(?1))",
    "delete from incident where job_id in (select value from json_each(?1))",
    "delete from attempt where job_id in (select value from json_each(?1))",
    "delete from job where id in (select value from json_each(?1))",
];

/// Those of the scenarios that no job needs.
const REMOVE_SCENARIOS: &str = "delete from scenario
    where id in (select value from json_each(?1))
        and not exists (select 1 from job where job.scenario_id = scenario.id)";

/// What belongs to the cells of sweep ?1 before cell ?2 (all of them without it), and then they themselves.
const REMOVE_CELLS: [&str; 2] = [
    "delete from cell_metric where cell_id in (select id from cell where sweep_id = ?1 and (?2 is null or id < ?2))",
    "delete from cell where sweep_id = ?1 and (?2 is null or id < ?2)",
];

/// The sweep itself.
const REMOVE_SWEEP: [&str; 2] = ["delete from unlisted where sweep_id = ?1", "delete from sweep where id = ?1"];

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[
    DISOWN,
    DISOWN_ALL,
    UNLIST,
    FORGET_SETTLING,
    NEXT,
    FIRST,
    LEAVE,
    ORPHANS,
    REMEMBER,
    REMOVE_JOBS[0],
    REMOVE_JOBS[1],
    REMOVE_JOBS[2],
    REMOVE_JOBS[3],
    REMOVE_JOBS[4],
    REMOVE_JOBS[5],
    REMOVE_JOBS[6],
    REMOVE_SCENARIOS,
    REMOVE_CELLS[0],
    REMOVE_CELLS[1],
    REMOVE_SWEEP[0],
    REMOVE_SWEEP[1],
];

/// Takes a sweep out of sight for good.
pub(crate) async fn unlist(conn: &mut SqliteConnection, sweep: SweepId, now_ms: i64) -> Result<(), StoreError> {
    sqlx::query(DISOWN).bind(sweep.0).bind(now_ms).execute(&mut *conn).await?;
    sqlx::query(UNLIST).bind(sweep.0).execute(&mut *conn).await?;
    sqlx::query(FORGET_SETTLING).bind(sweep.0).execute(conn).await?;
    Ok(())
}

/// Marks submissions that broke off for removal; none may be under way.
pub(crate) async fn disown_all(conn: &mut SqliteConnection, now_ms: i64) -> Result<(), StoreError> {
    sqlx::query(DISOWN_ALL).bind(now_ms).execute(conn).await?;
    Ok(())
}

/// A sweep to go on removing; no submission may be under way.
pub(crate) async fn next(conn: &mut SqliteConnection) -> Result<Option<SweepId>, StoreError> {
    let next: Option<i64> = sqlx::query_scalar(NEXT).fetch_optional(conn).await?;
    Ok(next.map(SweepId))
}

/// Removes the next part of an unlisted sweep; true if that was the last.
pub(crate) async fn step(
    conn: &mut SqliteConnection,
    sweep: SweepId,
    engine_id: i64,
    now_ms: i64,
) -> Result<bool, StoreError> {
    sqlx::query(DISOWN).bind(sweep.0).bind(now_ms).execute(&mut *conn).await?;
    let first: i64 = sqlx::query_scalar(FIRST).bind(sweep.0).fetch_one(&mut *conn).await?;
    let page = page(conn, sweep, (CellId(first), JobId(0))).await?;
    let jobs: Vec<_> = page.iter().map(|(_, job)| *job).collect();
    let (mut turns, mut tally) = (Turns::load(conn, 0).await?, Tally::default());
    settle(conn, &jobs, false, &mut turns, engine_id, now_ms, &mut tally).await?;
    tally.write(conn, now_ms).await?;
    if let Some((cell, job)) = page.last() {
        sqlx::query(LEAVE).bind(first).bind(cell.0).bind(job.0).execute(&mut *conn).await?;
    }
    remove_orphans(conn, &jobs).await?;
    let goes_on = page.len() == STEP;
    let before = page.last().filter(|_| goes_on).map(|(cell, _)| cell.0);
    for statement in REMOVE_CELLS {
        sqlx::query(statement).bind(sweep.0).bind(before).execute(&mut *conn).await?;
    }
    if !goes_on {
        for statement in REMOVE_SWEEP {
            sqlx::query(statement).bind(sweep.0).execute(&mut *conn).await?;
        }
    }
    Ok(!goes_on)
}

/// Removes those of `jobs` that no cell lists, with what belongs to them.
async fn remove_orphans(conn: &mut SqliteConnection, jobs: &[JobId]) -> Result<(), StoreError> {
    let orphans: Vec<(i64, i64)> = sqlx::query_as(ORPHANS).bind(to_json(&jobs)).fetch_all(&mut *conn).await?;
    if orphans.is_empty() {
        return Ok(());
    }
    let (jobs, mut scenarios): (Vec<i64>, Vec<i64>) = orphans.into_iter().unzip();
    scenarios.sort_unstable();
    scenarios.dedup();
    sqlx::query(REMEMBER).execute(&mut *conn).await?;
    let jobs = to_json(&jobs);
    for statement in REMOVE_JOBS {
        sqlx::query(statement).bind(&jobs).execute(&mut *conn).await?;
    }
    sqlx::query(REMOVE_SCENARIOS).bind(to_json(&scenarios)).execute(conn).await?;
    Ok(())
}

#[cfg(test)]
mod tests;
