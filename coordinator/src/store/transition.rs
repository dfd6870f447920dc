//! What a transaction changes about jobs: decided in memory first, then written a kind at a time.

use furrow_schema::id::JobId;
use furrow_schema::job::{JobState, RunRecord};
use serde::Serialize;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::incident::{self, Other};
use crate::store::rows::{self, ByRows, by_rows};
use crate::store::tally::{Moved, Tally};
use crate::store::{to_json, worker};
use crate::view::AttemptEnd;

/// Records results. The first of a job stays.
const ADD_RESULTS: ByRows = by_rows!(
    "insert into result (job_id, claim_id, attempt, digest, outcome, recorded_ms, metrics, timings) values ",
    "(?, ?, ?, ?, ?, ?, ?, ?)",
    " on conflict (job_id) do nothing"
);

/// Keeps trajectories of recorded results: job, poses.
const ADD_TRAJECTORIES: &str = "insert into trajectory (job_id, poses)
    select value ->> 0, unhex(value ->> 1) from json_each(?1) where true
    on conflict (job_id) do nothing";

/// Jobs whose result is recorded.
const FINISH: &str = "update job
    set state = 'done', claim_id = null, lease_until_ms = null, running = 0, ended_ms = ?2
    where id in (select value from json_each(?1))";

/// Handings-out that ended without a result: job, attempt, claim, how, why.
const ARCHIVE: &str = "insert into attempt (job_id, attempt, claim_id, ended_ms, ended, reason)
    select value ->> 0, value ->> 1, value ->> 2, ?2, value ->> 3, value ->> 4 from json_each(?1)";

/// Jobs that go back into the queue: job, not before, panics, deaths.
const REQUEUE: &str = "update job
    set state = 'queued', claim_id = null, lease_until_ms = null, running = 0, ended_ms = null,
        not_before_ms = value ->> 1, panics = value ->> 2, deaths = value ->> 3
    from json_each(?1) where job.id = value ->> 0";

/// Jobs that are given up on: job, panics, deaths.
const FAIL: &str = "update job
    set state = 'failed', claim_id = null, lease_until_ms = null, running = 0, ended_ms = ?2,
        panics = value ->> 1, deaths = value ->> 2
    from json_each(?1) where job.id = value ->> 0";

/// Jobs that no live sweep wants any more.
const CANCEL: &str = "update job
    set state = 'cancelled', claim_id = null, lease_until_ms = null, running = 0, ended_ms = ?2
    where id in (select value from json_each(?1))";

/// Failed and cancelled jobs start anew; their attempts go on counting.
const REVIVE: &str = "update job set state = 'queued', ended_ms = null, not_before_ms = 0, panics = 0, deaths = 0
    where id in (select value from json_each(?1))";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[ADD_TRAJECTORIES, FINISH, ARCHIVE, REQUEUE, FAIL, CANCEL, REVIVE];

#[cfg(test)]
pub(super) const BY_ROWS: &[ByRows] = &[ADD_RESULTS];

/// Changes to jobs that are not written yet.
#[derive(Debug, Default)]
pub(crate) struct Changes<'a> {
    results: Vec<ResultRow<'a>>,
    trajectories: Vec<(JobId, &'a str)>,
    archived: Vec<(JobId, u32, i64, &'static str, Option<String>)>,
    requeued: Vec<(JobId, i64, u32, u32)>,
    failed: Vec<(JobId, u32, u32)>,
    cancelled: Vec<JobId>,
    revived: Vec<JobId>,
    moved: Vec<Moved<'a>>,
    incidents: Vec<Other<'a>>,
}

/// A result that is new: job, claim, attempt, record.
#[derive(Debug)]
struct ResultRow<'a>(JobId, i64, u32, &'a RunRecord);

/// How often a job went wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Charges {
    /// Runs that panicked.
    pub(crate) panics: u32,
    /// Workers that died while it ran there.
    pub(crate) deaths: u32,
}

impl<'a> Changes<'a> {
    /// The job's result is `record`, from the handing-out `attempt` of `claim`.
    pub(crate) fn record(&mut self, job: JobId, from: JobState, claim: i64, attempt: u32, record: &'a RunRecord) {
        self.results.push(ResultRow(job, claim, attempt, record));
        self.trajectories.extend(record.trajectory.as_deref().map(|poses| (job, poses)));
        self.moved.push(Moved { job, from, to: JobState::Done, metrics: Some(&record.metrics) });
    }

    /// A handing-out ended without a result.
    pub(crate) fn archive(&mut self, job: JobId, attempt: u32, claim: i64, end: AttemptEnd, reason: Option<String>) {
        self.archived.push((job, attempt, claim, end.as_str(), reason));
    }

    /// A leased job goes back into the queue and may be handed out from `not_before_ms` on.
    pub(crate) fn requeue(&mut self, job: JobId, not_before_ms: i64, charges: Charges) {
        self.requeued.push((job, not_before_ms, charges.panics, charges.deaths));
    }

    /// A leased job is given up on.
    pub(crate) fn fail(&mut self, job: JobId, charges: Charges) {
        self.failed.push((job, charges.panics, charges.deaths));
        self.moved.push(Moved { job, from: JobState::Leased, to: JobState::Failed, metrics: None });
    }

    /// A queued or leased job is wanted no more.
    pub(crate) fn cancel(&mut self, job: JobId, from: JobState) {
        self.cancelled.push(job);
        self.moved.push(Moved { job, from, to: JobState::Cancelled, metrics: None });
    }

    /// A failed or cancelled job is wanted again.
    pub(crate) fn revive(&mut self, job: JobId, from: JobState) {
        self.revived.push(job);
        self.moved.push(Moved { job, from, to: JobState::Queued, metrics: None });
    }

    /// A result that differs from the one on record.
    pub(crate) fn incident(&mut self, other: Other<'a>) {
        self.incidents.push(other);
    }

    /// Writes all of it and counts it in `tally`.
    pub(crate) async fn write(
        &self,
        conn: &mut SqliteConnection,
        engine_id: i64,
        now_ms: i64,
        tally: &mut Tally,
    ) -> Result<(), StoreError> {
        execute(conn, ARCHIVE, &self.archived, now_ms).await?;
        // In this order a job that was given back and then finished within one batch ends up done.
        execute_without_time(conn, REQUEUE, &self.requeued).await?;
        execute(conn, FAIL, &self.failed, now_ms).await?;
        execute(conn, CANCEL, &self.cancelled, now_ms).await?;
        execute_without_time(conn, REVIVE, &self.revived).await?;
        self.write_results(conn, now_ms).await?;
        let done: Vec<_> = self.results.iter().map(|row| row.0).collect();
        execute(conn, FINISH, &done, now_ms).await?;
        worker::count_results(conn, self.results.iter().map(|row| row.1)).await?;
        execute_without_time(conn, ADD_TRAJECTORIES, &self.trajectories).await?;
        tally.moved(conn, &self.moved).await?;
        incident::add(conn, &self.incidents, engine_id, now_ms).await
    }

    async fn write_results(&self, conn: &mut SqliteConnection, now_ms: i64) -> Result<(), StoreError> {
        rows::write(conn, &ADD_RESULTS, &self.results, |add, ResultRow(job, claim, attempt, record)| {
            let add = add.bind(job.0).bind(claim).bind(attempt).bind(record.digest.0.as_slice()).bind(&record.outcome);
            add.bind(now_ms).bind(to_json(&record.metrics)).bind(to_json(&record.timings))
        })
        .await
    }
}

async fn execute<T: Serialize>(
    conn: &mut SqliteConnection,
    statement: &'static str,
    rows: &[T],
    now_ms: i64,
) -> Result<(), StoreError> {
    if !rows.is_empty() {
        sqlx::query(statement).bind(to_json(&rows)).bind(now_ms).execute(conn).await?;
    }
    Ok(())
}

async fn execute_without_time<T: Serialize>(
    conn: &mut SqliteConnection,
    statement: &'static str,
    rows: &[T],
) -> Result<(), StoreError> {
    if !rows.is_empty() {
        sqlx::query(statement).bind(to_json(&rows)).execute(conn).await?;
    }
    Ok(())
}
