//! One job in full.

use std::collections::BTreeMap;

use furrow_schema::id::{CellId, Digest, JobId, JobKey, SweepId};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::job::state_of;
use crate::store::worker::worker_id;
use crate::store::{Store, from_json, hash, incident, unsigned, verification};
use crate::view::{Attempt, AttemptEnd, JobCell, JobDetail, JobRef, JobResult, KeyPrefix};

/// At most this many incidents of a job are shown.
const MOST_INCIDENTS: u32 = 100;

/// A job by number or key with its scenario.
const JOB: &str = "select job.id, key, state, scenario.json, seed, priority, created_ms, ended_ms, attempt, claim_id
    from job join scenario on scenario.id = job.scenario_id where job.id = ?1 or job.key = ?2";

/// The keys from ?1 to ?2, as far as needed to tell one from several.
const KEYS: &str = "select key from job where key between ?1 and ?2 order by key limit 2";

/// The key of a job.
const KEY_OF: &str = "select key from job where id = ?1";

/// The cells that want a job.
const CELLS: &str = "select cell.sweep_id, cell.id, cell.factors
    from cell_job join cell on cell.id = cell_job.cell_id
    where cell_job.job_id = ?1 and cell.sweep_id not in (select sweep_id from unlisted) order by cell.id";

/// Past handings-out of a job; the one whose result is on record stands elsewhere.
const ATTEMPTS: &str = "select attempt, worker.uid, claim.claimed_ms, ended_ms, ended, reason
    from attempt join claim on claim.id = attempt.claim_id join worker on worker.id = claim.worker_id
    where job_id = ?1 and attempt not in (select result.attempt from result where result.job_id = ?1)
    order by attempt";

/// Who a claim was granted to, and when.
const CLAIM: &str = "select worker.uid, claimed_ms
    from claim join worker on worker.id = claim.worker_id where claim.id = ?1";

/// The result of a job.
const RESULT: &str = "select claim_id, attempt, digest, outcome, metrics, timings, recorded_ms, poses
    from result left join trajectory on trajectory.job_id = result.job_id where result.job_id = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[JOB, KEYS, KEY_OF, CELLS, ATTEMPTS, CLAIM, RESULT];

type JobRow = (i64, Vec<u8>, String, String, i64, i64, i64, Option<i64>, i64, Option<i64>);
type ResultRow = (i64, i64, Vec<u8>, String, String, String, i64, Option<Vec<u8>>);

/// A job in full, if there is one, as of one moment.
pub(crate) async fn get(store: &Store, job: JobRef) -> Result<Option<JobDetail>, StoreError> {
    let mut transaction = store.readers().begin().await?;
    let conn = &mut *transaction;
    let (by_id, by_key) = match job {
        JobRef::Id(id) => (Some(id.0), None),
        JobRef::Key(key) => (None, Some(key.0.to_vec())),
        JobRef::Prefix(prefix) => (None, key_of(conn, prefix).await?),
    };
    let row: Option<JobRow> = sqlx::query_as(JOB).bind(by_id).bind(by_key).fetch_optional(&mut *conn).await?;
    let Some((id, key, state, scenario_json, seed, priority, created_ms, ended_ms, attempt, claim)) = row else {
        return Ok(None);
    };
    let mut attempts = past(conn, id).await?;
    let result = result(conn, id, &mut attempts).await?;
    if let Some(claim) = claim {
        attempts.push(present(conn, claim, attempt, None, AttemptEnd::Open).await?);
    }
    attempts.sort_by_key(|attempt| attempt.attempt);
    Ok(Some(JobDetail {
        id: JobId(id),
        key: JobKey(hash("a job's key", &key)?),
        state: state_of(&state)?,
        scenario_json,
        seed: unsigned("a seed", seed)?,
        priority,
        cells: cells(conn, id).await?,
        attempts,
        result,
        incidents: incident::of_job(conn, Some(JobId(id)), MOST_INCIDENTS).await?,
        verification: verification::of_job(conn, id).await?,
        created_ms,
        ended_ms,
    }))
}

/// The one key that begins so, or that of the job whose number reads the same.
async fn key_of(conn: &mut SqliteConnection, prefix: KeyPrefix) -> Result<Option<Vec<u8>>, StoreError> {
    if let Some(number) = prefix.number {
        let numbered = sqlx::query_scalar(KEY_OF).bind(number.0).fetch_optional(&mut *conn).await?;
        if numbered.is_some() {
            return Ok(numbered);
        }
    }
    let (low, high) = (prefix.low.to_vec(), prefix.high.to_vec());
    let mut keys: Vec<Vec<u8>> = sqlx::query_scalar(KEYS).bind(low).bind(high).fetch_all(conn).await?;
    if keys.len() > 1 { Err(StoreError::Ambiguous(prefix.to_string())) } else { Ok(keys.pop()) }
}

async fn cells(conn: &mut SqliteConnection, job: i64) -> Result<Vec<JobCell>, StoreError> {
    let rows: Vec<(i64, i64, String)> = sqlx::query_as(CELLS).bind(job).fetch_all(conn).await?;
    let cell = |(sweep, cell, factors): (i64, i64, String)| {
        let factors: BTreeMap<_, _> = from_json("a cell's factors", &factors)?;
        Ok(JobCell { sweep: SweepId(sweep), cell: CellId(cell), factors })
    };
    rows.into_iter().map(cell).collect()
}

async fn past(conn: &mut SqliteConnection, job: i64) -> Result<Vec<Attempt>, StoreError> {
    type Row = (i64, String, i64, i64, String, Option<String>);
    let rows: Vec<Row> = sqlx::query_as(ATTEMPTS).bind(job).fetch_all(conn).await?;
    let attempt = |(attempt, worker, claimed_ms, ended_ms, ended, reason): Row| {
        Ok(Attempt {
            attempt: unsigned("an attempt", attempt)?,
            worker: worker_id(worker)?,
            claimed_ms,
            ended_ms: Some(ended_ms),
            end: AttemptEnd::from_word(&ended)
                .ok_or_else(|| StoreError::Damaged(format!("an attempt ended `{ended}`")))?,
            reason,
        })
    };
    rows.into_iter().map(attempt).collect()
}

async fn present(
    conn: &mut SqliteConnection,
    claim: i64,
    attempt: i64,
    ended_ms: Option<i64>,
    end: AttemptEnd,
) -> Result<Attempt, StoreError> {
    let (worker, claimed_ms): (String, i64) = sqlx::query_as(CLAIM).bind(claim).fetch_one(conn).await?;
    let (attempt, worker) = (unsigned("an attempt", attempt)?, worker_id(worker)?);
    Ok(Attempt { attempt, worker, claimed_ms, ended_ms, end, reason: None })
}

/// The result on record; its handing-out joins `attempts`.
async fn result(
    conn: &mut SqliteConnection,
    job: i64,
    attempts: &mut Vec<Attempt>,
) -> Result<Option<JobResult>, StoreError> {
    let row: Option<ResultRow> = sqlx::query_as(RESULT).bind(job).fetch_optional(&mut *conn).await?;
    let Some((claim, attempt, digest, outcome, metrics, timings, recorded_ms, trajectory)) = row else {
        return Ok(None);
    };
    let successful = present(conn, claim, attempt, Some(recorded_ms), AttemptEnd::Done).await?;
    let result = JobResult {
        worker: successful.worker.clone(),
        attempt: successful.attempt,
        digest: Digest(hash("a digest", &digest)?),
        outcome,
        metrics: from_json("a result's metrics", &metrics)?,
        timings: from_json("a result's timings", &timings)?,
        trajectory,
        recorded_ms,
    };
    attempts.push(successful);
    Ok(Some(result))
}
