//! Incidents: a second result of a job that differs from the one on record.

use furrow_schema::id::{Digest, EngineId, JobId};
use serde::Serialize;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::worker::worker_id;
use crate::store::{Store, hash, to_json, verification};
use crate::view::Incident;

/// Keeps incidents with what is on record for their jobs; the same one again changes nothing.
const ADD: &str = "insert into incident (job_id, noted_ms,
        recorded_worker_id, recorded_engine_id, recorded_attempt, recorded_digest,
        other_worker_id, other_engine_id, other_attempt, other_digest, other_outcome, other_metrics)
    select result.job_id, ?2, claim.worker_id, job.engine_id, result.attempt, result.digest,
        value ->> 1, ?3, value ->> 2, unhex(value ->> 3), value ->> 4, value -> 5
    from json_each(?1) join result on result.job_id = value ->> 0
        join claim on claim.id = result.claim_id join job on job.id = result.job_id
    where true
    on conflict do nothing
    returning id";

/// The latest incidents, or those of one job, from incident ?3 on.
const LIST: &str = "select incident.job_id, recorded.uid, recorded_engine.hash, recorded_digest,
        other.uid, other_engine.hash, other_digest, other_outcome, noted_ms, verification.state
    from incident join worker recorded on recorded.id = recorded_worker_id
        join engine recorded_engine on recorded_engine.id = recorded_engine_id
        join worker other on other.id = other_worker_id join engine other_engine on other_engine.id = other_engine_id
        left join verification on verification.job_id = incident.job_id
    where (?1 is null or incident.job_id = ?1) and incident.id >= ?3
    order by incident.id desc limit ?2 + 0";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[ADD, LIST];

/// A result that is not the one on record: job, worker, attempt, digest, outcome, metrics.
#[derive(Debug, Serialize)]
pub(crate) struct Other<'a>(
    pub(crate) JobId,
    pub(crate) i64,
    pub(crate) u32,
    pub(crate) Digest,
    pub(crate) &'a str,
    pub(crate) &'a std::collections::BTreeMap<String, f64>,
);

/// Keeps `others`, which came from workers of engine `engine_id`.
pub(crate) async fn add(
    conn: &mut SqliteConnection,
    others: &[Other<'_>],
    engine_id: i64,
    now_ms: i64,
) -> Result<(), StoreError> {
    if others.is_empty() {
        return Ok(());
    }
    let add = sqlx::query_scalar(ADD).bind(to_json(&others)).bind(now_ms).bind(engine_id);
    let added: Vec<i64> = add.fetch_all(&mut *conn).await?;
    let Some(first) = added.iter().min() else { return Ok(()) };
    for incident in select(conn, None, *first, u32::MAX).await? {
        let Incident { job, recorded_worker, recorded_engine, recorded_digest, .. } = &incident;
        let Incident { other_worker, other_engine, other_digest, .. } = &incident;
        tracing::error!(
            %job, %recorded_worker, %recorded_engine, %recorded_digest, %other_worker, %other_engine, %other_digest,
            "a result differs from the one on record"
        );
    }
    Ok(())
}

/// The latest incidents, newest first.
pub(crate) async fn list(store: &Store, limit: u32) -> Result<Vec<Incident>, StoreError> {
    let mut conn = store.readers().acquire().await?;
    of_job(&mut conn, None, limit).await
}

/// The incidents of one job or, without one, of all; newest first.
pub(crate) async fn of_job(
    conn: &mut SqliteConnection,
    job: Option<JobId>,
    limit: u32,
) -> Result<Vec<Incident>, StoreError> {
    select(conn, job, 0, limit).await
}

type Row = (i64, String, Vec<u8>, Vec<u8>, String, Vec<u8>, Vec<u8>, String, i64, Option<String>);

async fn select(
    conn: &mut SqliteConnection,
    job: Option<JobId>,
    from: i64,
    limit: u32,
) -> Result<Vec<Incident>, StoreError> {
    let list = sqlx::query_as(LIST).bind(job.map(|job| job.0)).bind(limit).bind(from);
    let rows: Vec<Row> = list.fetch_all(conn).await?;
    rows.into_iter().map(read).collect()
}

fn read(row: Row) -> Result<Incident, StoreError> {
    let (job, recorded, recorded_engine, recorded_digest, other, other_engine, other_digest, outcome, noted, state) =
        row;
    Ok(Incident {
        job: JobId(job),
        recorded_worker: worker_id(recorded)?,
        recorded_engine: EngineId(hash("an engine", &recorded_engine)?),
        recorded_digest: Digest(hash("a digest", &recorded_digest)?),
        other_worker: worker_id(other)?,
        other_engine: EngineId(hash("an engine", &other_engine)?),
        other_digest: Digest(hash("a digest", &other_digest)?),
        other_outcome: outcome,
        noted_ms: noted,
        verification: state.map(|state| verification::state_of(&state)).transpose()?,
    })
}
