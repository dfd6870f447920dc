//! Verification: jobs with a result that are run again, on another worker where there is one.
//!
//! Which ones follows from the job's key ([`is_chosen`]); a job also comes here when a second result of it differs, and
//! when its worker was barred. It is handed out in an ordinary claim under an attempt number of its own, and what
//! comes back is an *opinion*: `judge` says what opinions come to. None of this touches the job's state, its result
//! or any count, and nothing that goes wrong with it is charged to the job.

mod judge;
mod report;

use furrow_schema::id::{Digest, EngineId, JobId, JobKey, WorkerId};
use furrow_schema::protocol::{HeldJob, LEASE_MS};
use sqlx::SqliteConnection;

use crate::config::Verify;
use crate::error::StoreError;
use crate::store::claim::Row;
use crate::store::renew::HeldRow;
use crate::store::worker::worker_id;
use crate::store::{Store, hash, to_json, unsigned};
use crate::view::{Opinion, Verification, VerificationCounts, VerificationState};

pub(crate) use report::{Cases, Dispute, Findings};

/// A verification that was handed out so often without an opinion is given up.
pub(crate) const MOST_FRUITLESS: i64 = 3;
/// A claim looks at so many that wait, the oldest.
const LOOKED_AT: i64 = 64;

/// Jobs to verify from now on.
const OPEN: &str = "insert into verification (job_id, since_ms) select value, ?2 from json_each(?1) where true
    on conflict (job_id) do nothing";

/// All results of worker ?1 but measurements of time.
const OPEN_ALL_OF: &str = "insert into verification (job_id, since_ms)
    select result.job_id, ?2 from result join claim on claim.id = result.claim_id join job on job.id = result.job_id
    where claim.worker_id = ?1 and job.alone = 0
    on conflict (job_id) do nothing";

/// Whether any wait.
const ANY: &str = "select exists (select 1 from verification where state = 'waits')";

/// Those of the oldest ?5 that worker ?1 of engine ?2 may have, at most ?6: it had no result of the job yet; or they
/// waited for ?4 ms, and of all workers that were heard of in that time none had fewer of the job's results.
const CANDIDATES: &str = "with opinions (job_id, worker_id) as not materialized (
        select result.job_id, claim.worker_id from result join claim on claim.id = result.claim_id
        union all select job_id, worker_id from opinion)
    select oldest.job_id from (
            select job_id, since_ms,
                (select count(*) from opinions where opinions.job_id = waits.job_id and worker_id = ?1) as own
            from verification as waits where state = 'waits' order by since_ms, job_id limit ?5 + 0) as oldest
        cross join job on job.id = oldest.job_id
    where job.engine_id = ?2 and (own = 0 or (since_ms <= ?3 - ?4 and not exists (
        select 1 from worker as other
        where other.id <> ?1 and other.engine_id = ?2 and other.barred_ms is null and other.last_seen_ms > ?3 - ?4
            and own > (select count(*) from opinions where opinions.job_id = oldest.job_id and worker_id = other.id))))
    order by since_ms, oldest.job_id limit ?6 + 0";

/// Gives jobs another attempt number. They go before all others of a claim.
const NUMBER: &str = "update job set attempt = attempt + 1 where id in (select value from json_each(?1))
    returning id, attempt, scenario_id, seed, 0, 0, 9223372036854775807, 0";

/// Hands out to claim ?2 until ?3: job, attempt.
const LEASE: &str = "update verification
    set state = 'leased', claim_id = ?2, lease_until_ms = ?3, running = 0, attempt = value ->> 1
    from json_each(?1) where job_id = value ->> 0";

/// What a claim still holds.
const HELD: &str = "select job.id, verification.attempt, scenario_id, seed, 0, 0, 9223372036854775807, 0
    from verification join job on job.id = verification.job_id
    where verification.state = 'leased' and verification.claim_id = ?1";

/// Those of the jobs (job, attempt, running) that are worker ?2's to verify, with how the database has them.
const HELD_BY: &str = "select job_id, lease_until_ms, running, held.value ->> 2
    from json_each(?1) as held join verification on job_id = held.value ->> 0
        join claim on claim.id = verification.claim_id
    where state = 'leased' and attempt = held.value ->> 1 and claim.worker_id = ?2";

/// Moves leases to ?2 and notes which run: job, running.
const EXTEND: &str = "update verification set lease_until_ms = ?2, running = value ->> 1
    from json_each(?1) where job_id = value ->> 0";

/// How a handing-out without an opinion leaves a verification.
macro_rules! fruitless {
    ($which:literal) => {
        concat!(
            "update verification
            set fruitless = fruitless + 1, attempt = null, claim_id = null, lease_until_ms = null, running = 0,
                state = case when fruitless + 1 < 3 then 'waits'
                    when exists (select 1 from incident where incident.job_id = verification.job_id) then 'undecided'
                    else 'given-up' end
            where state = 'leased' and ",
            $which,
            " returning job_id, state"
        )
    };
}

/// Leases that ran out.
const EXPIRE: &str = fruitless!("lease_until_ms <= ?1");

/// Leases of a worker that is gone.
const GONE: &str = fruitless!(
    "claim_id in (
        select claim.id from claim join worker on worker.id = claim.worker_id where worker.uid = ?1)"
);

/// Leases of a worker that was barred.
const FREE: &str = "update verification
    set state = 'waits', attempt = null, claim_id = null, lease_until_ms = null, running = 0
    where state = 'leased' and claim_id in (select id from claim where worker_id = ?1)";

/// The verification of a job.
const GET: &str = "select state from verification where job_id = ?1";

/// The opinions on a job.
const OPINIONS: &str = "select attempt, worker.uid, digest, given_ms
    from opinion join worker on worker.id = opinion.worker_id where job_id = ?1 order by attempt";

/// Verifications of results of engine ?1 by state.
const COUNT: &str = "select verification.state, count(*)
    from verification join job on job.id = verification.job_id join engine on engine.id = job.engine_id
    where engine.hash = ?1 group by verification.state";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[
    OPEN,
    OPEN_ALL_OF,
    ANY,
    CANDIDATES,
    NUMBER,
    LEASE,
    HELD,
    HELD_BY,
    EXTEND,
    EXPIRE,
    GONE,
    FREE,
    GET,
    OPINIONS,
    COUNT,
];

#[cfg(test)]
pub(super) use report::STATEMENTS as REPORT_STATEMENTS;

/// Whether a job is among the `share` whose results are verified: its key decides, so that it is the same ones
/// everywhere and always.
pub(crate) fn is_chosen(key: &JobKey, share: f64) -> bool {
    let [a, b, c, d, e, f, g, h, ..] = key.0;
    let first_53_bits = u64::from_be_bytes([a, b, c, d, e, f, g, h]) >> 11;
    // Both are exact: the product with a power of two, and a whole number of 53 bits.
    (first_53_bits as f64) < share * (1u64 << 53) as f64
}

/// Verifies `jobs` from now on; those that are, or were, stay as they are.
pub(crate) async fn open(conn: &mut SqliteConnection, jobs: &[JobId], now_ms: i64) -> Result<(), StoreError> {
    if !jobs.is_empty() {
        sqlx::query(OPEN).bind(to_json(&jobs)).bind(now_ms).execute(conn).await?;
    }
    Ok(())
}

/// Verifies all that a worker ever had a result of, and frees what it verifies itself.
pub(crate) async fn doubt(conn: &mut SqliteConnection, worker: i64, now_ms: i64) -> Result<(), StoreError> {
    sqlx::query(FREE).bind(worker).execute(&mut *conn).await?;
    sqlx::query(OPEN_ALL_OF).bind(worker).bind(now_ms).execute(conn).await?;
    Ok(())
}

/// Whether any waits for a worker.
pub(crate) async fn any(conn: &mut SqliteConnection) -> Result<bool, StoreError> {
    Ok(sqlx::query_scalar(ANY).fetch_one(conn).await?)
}

/// The jobs that `worker` may verify now, at most `want`.
pub(crate) async fn candidates(
    conn: &mut SqliteConnection,
    worker: i64,
    want: u32,
    verify: &Verify,
    engine_id: i64,
    now_ms: i64,
) -> Result<Vec<JobId>, StoreError> {
    let candidates = sqlx::query_scalar(CANDIDATES).bind(worker).bind(engine_id).bind(now_ms);
    let alone_after_ms = i64::try_from(verify.alone_after.as_millis()).unwrap_or(i64::MAX);
    let jobs: Vec<i64> = candidates.bind(alone_after_ms).bind(LOOKED_AT).bind(want).fetch_all(conn).await?;
    Ok(jobs.into_iter().map(JobId).collect())
}

/// Hands `jobs` out to `claim`.
pub(crate) async fn lease(
    conn: &mut SqliteConnection,
    claim: i64,
    jobs: &[JobId],
    now_ms: i64,
) -> Result<Vec<Row>, StoreError> {
    if jobs.is_empty() {
        return Ok(Vec::new());
    }
    let rows: Vec<Row> = sqlx::query_as(NUMBER).bind(to_json(&jobs)).fetch_all(&mut *conn).await?;
    let numbered: Vec<_> = rows.iter().map(|row| (row.0, row.1)).collect();
    sqlx::query(LEASE).bind(to_json(&numbered)).bind(claim).bind(now_ms + LEASE_MS).execute(conn).await?;
    Ok(rows)
}

/// What a claim still holds.
pub(crate) async fn held(conn: &mut SqliteConnection, claim: i64) -> Result<Vec<Row>, StoreError> {
    Ok(sqlx::query_as(HELD).bind(claim).fetch_all(conn).await?)
}

/// Those of `held` (job, attempt, running) that are the worker's to verify.
pub(crate) async fn held_by(
    conn: &mut SqliteConnection,
    worker: i64,
    held: &[HeldJob],
) -> Result<Vec<HeldRow>, StoreError> {
    let held: Vec<_> = held.iter().map(|held| (held.job, held.attempt, i64::from(held.running))).collect();
    Ok(sqlx::query_as(HELD_BY).bind(to_json(&held)).bind(worker).fetch_all(conn).await?)
}

/// Moves leases: job, running.
pub(crate) async fn extend(conn: &mut SqliteConnection, due: &[(i64, i64)], until_ms: i64) -> Result<(), StoreError> {
    if !due.is_empty() {
        sqlx::query(EXTEND).bind(to_json(&due)).bind(until_ms).execute(conn).await?;
    }
    Ok(())
}

/// Takes back what nobody renewed. Returns how many there were.
pub(crate) async fn expire(conn: &mut SqliteConnection, now_ms: i64) -> Result<usize, StoreError> {
    let ended: Vec<(i64, String)> = sqlx::query_as(EXPIRE).bind(now_ms).fetch_all(conn).await?;
    Ok(log_fruitless(&ended))
}

/// Takes back what a worker held that is gone. Returns how many there were.
pub(crate) async fn worker_gone(conn: &mut SqliteConnection, worker: &WorkerId) -> Result<usize, StoreError> {
    let ended: Vec<(i64, String)> = sqlx::query_as(GONE).bind(worker.as_str()).fetch_all(conn).await?;
    Ok(log_fruitless(&ended))
}

fn log_fruitless(ended: &[(i64, String)]) -> usize {
    for (job, state) in ended.iter().filter(|(_, state)| state != VerificationState::Waits.as_str()) {
        given_up(JobId(*job), state);
    }
    ended.len()
}

fn given_up(job: JobId, state: &str) {
    if state == VerificationState::Undecided.as_str() {
        tracing::error!(%job, "its results differ and no more opinions can be had: undecided");
    } else {
        tracing::warn!(%job, "its result could not be verified: handed out in vain {MOST_FRUITLESS} times");
    }
}

/// The verification of a job, if there is one.
pub(crate) async fn of_job(conn: &mut SqliteConnection, job: i64) -> Result<Option<Verification>, StoreError> {
    let state: Option<String> = sqlx::query_scalar(GET).bind(job).fetch_optional(&mut *conn).await?;
    let Some(state) = state else { return Ok(None) };
    let rows: Vec<(i64, String, Vec<u8>, i64)> = sqlx::query_as(OPINIONS).bind(job).fetch_all(conn).await?;
    let opinion = |(attempt, worker, digest, given_ms): (i64, String, Vec<u8>, i64)| {
        let worker: WorkerId = worker_id(worker)?;
        let (attempt, digest) = (unsigned("an attempt", attempt)?, Digest(hash("a digest", &digest)?));
        Ok(Opinion { attempt, worker, digest, given_ms })
    };
    let opinions = rows.into_iter().map(opinion).collect::<Result<_, StoreError>>()?;
    Ok(Some(Verification { state: state_of(&state)?, opinions }))
}

/// How many verifications of results of `engine` are in which state.
pub(crate) async fn count(store: &Store, engine: EngineId) -> Result<VerificationCounts, StoreError> {
    let rows: Vec<(String, i64)> = sqlx::query_as(COUNT).bind(engine.0.to_vec()).fetch_all(store.readers()).await?;
    let mut counts = VerificationCounts::default();
    for (state, jobs) in rows {
        *counts.of(state_of(&state)?) += unsigned::<u64>("a count", jobs)?;
    }
    Ok(counts)
}

/// A stored state.
pub(crate) fn state_of(word: &str) -> Result<VerificationState, StoreError> {
    VerificationState::from_word(word).ok_or_else(|| StoreError::Damaged(format!("a verification's state is `{word}`")))
}

#[cfg(test)]
mod tests;
