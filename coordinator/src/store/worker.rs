//! Workers: who they are, and that they are who they say.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::id::{Credential, EngineId, WorkerId};
use furrow_schema::protocol::{Call, Hello, Refusal};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{Store, hash, to_json, unsigned};
use crate::view::{Bar, WorkerInfo};

/// When a worker was last seen is kept to this \[ms\], to save writing it with every question.
const SEEN_GRAIN_MS: i64 = 5_000;

/// Workers by name.
const FIND: &str = "select uid, id, credential_hash, revoked_ms is not null, coalesce(until_ms <= ?2, 0), barred_reason
    from worker where uid in (select value from json_each(?1))";

/// A worker's first hello.
const ADD: &str = "insert into worker (uid, credential_hash, name, engine_id, threads, first_seen_ms, last_seen_ms)
    values (?1, ?2, ?3, ?4, ?5, ?6, ?6)";

/// A later hello: it may have a new name, engine and number of threads.
const UPDATE: &str = "update worker set name = ?2, engine_id = ?3, threads = ?4, last_seen_ms = ?5 where id = ?1";

/// Workers that were heard of now.
const SEEN: &str = "update worker set last_seen_ms = ?2
    where id in (select value from json_each(?1)) and last_seen_ms < ?2 - ?3";

/// Results that were recorded: claim they come from, number.
const COUNT_RESULTS: &str = "update worker set results = results + counted.n
    from (select claim.worker_id, sum(added.value ->> 1) as n
          from json_each(?1) as added join claim on claim.id = added.value ->> 0 group by claim.worker_id) as counted
    where worker.id = counted.worker_id";

/// Workers that get no more jobs: row, why. The first reason stays.
const BAR: &str = "update worker set barred_ms = ?2, barred_reason = value ->> 1
    from json_each(?1) where worker.id = value ->> 0 and barred_ms is null
    returning worker.id, uid, name, barred_reason";

/// A worker that may have jobs again.
const ALLOW: &str = "update worker set barred_ms = null, barred_reason = null where uid = ?1";

/// All workers (or ?1 alone) with the jobs they hold.
const LIST: &str = "select uid, name, engine.hash as engine, threads, first_seen_ms, last_seen_ms, results,
        barred_ms, barred_reason,
        (select count(*) from job join claim on claim.id = job.claim_id
         where job.state = 'leased' and claim.worker_id = worker.id) as leased,
        enrolled_ms, certificate_until_ms, until_ms, revoked_ms
    from worker join engine on engine.id = engine_id left join enrolment on enrolment.worker_id = worker.id
    where ?1 is null or uid = ?1 order by last_seen_ms desc, worker.id desc";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[FIND, ADD, UPDATE, SEEN, COUNT_RESULTS, BAR, ALLOW, LIST];

/// What becomes of a worker that says hello and is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Newcomers {
    /// It is taken in: only this machine's processes get here.
    Welcome,
    /// It has to enrol.
    Refused,
}

/// The callers of a batch as the database knows them.
#[derive(Debug, Default)]
pub(crate) struct Known(HashMap<String, Row>);

#[derive(Debug)]
struct Row {
    id: i64,
    credential: blake3::Hash,
    turned_away: Option<Refusal>,
}

impl Known {
    /// Looks up all of `callers` that said hello or enrolled.
    pub(crate) async fn load(conn: &mut SqliteConnection, callers: &[&str], now_ms: i64) -> Result<Self, StoreError> {
        if callers.is_empty() {
            return Ok(Self::default());
        }
        type Found = (String, i64, Vec<u8>, bool, bool, Option<String>);
        let rows: Vec<Found> = sqlx::query_as(FIND).bind(to_json(&callers)).bind(now_ms).fetch_all(conn).await?;
        let known = rows.into_iter().map(|(uid, id, credential, revoked, over, barred)| {
            let credential = blake3::Hash::from_bytes(hash("a credential's hash", &credential)?);
            let turned_away = match barred {
                _ if revoked => Some(Refusal::Revoked),
                _ if over => Some(Refusal::Expired),
                barred => barred.map(|detail| Refusal::Barred { detail }),
            };
            Ok((uid, Row { id, credential, turned_away }))
        });
        known.collect::<Result<_, StoreError>>().map(Self)
    }

    /// The row of a caller with the right credential that is not turned away.
    pub(crate) fn check<T>(&self, call: &Call<T>) -> Result<i64, Refusal> {
        let row = self.0.get(call.worker.as_str()).ok_or(Refusal::UnknownWorker)?;
        // Comparing hashes of this type takes the same time wherever they differ.
        if row.credential != hash_of(&call.credential) {
            return Err(Refusal::BadCredential);
        }
        row.turned_away.clone().map_or(Ok(row.id), Err)
    }

    /// Why a worker is turned away, whatever its credential.
    pub(crate) fn turned_away(&self, worker: &WorkerId) -> Option<Refusal> {
        self.0.get(worker.as_str())?.turned_away.clone()
    }
}

pub(super) fn hash_of(credential: &Credential) -> blake3::Hash {
    blake3::hash(credential.as_str().as_bytes())
}

/// Takes a worker in if `newcomers` are, or refreshes what is known of it.
pub(crate) async fn hello(
    conn: &mut SqliteConnection,
    call: &Call<Hello>,
    newcomers: Newcomers,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<(), Refusal>, StoreError> {
    let known = Known::load(conn, &[call.worker.as_str()], now_ms).await?;
    let Hello { name, threads, .. } = &call.body;
    let statement = match (known.check(call), newcomers) {
        (Ok(id), _) => sqlx::query(UPDATE).bind(id),
        (Err(Refusal::UnknownWorker), Newcomers::Welcome) => {
            sqlx::query(ADD).bind(call.worker.as_str()).bind(hash_of(&call.credential).as_bytes().to_vec())
        }
        (Err(Refusal::UnknownWorker), Newcomers::Refused) => return Ok(Err(Refusal::NotEnrolled)),
        (Err(refusal), _) => return Ok(Err(refusal)),
    };
    statement.bind(name).bind(engine_id).bind(i64::from(*threads)).bind(now_ms).execute(conn).await?;
    Ok(Ok(()))
}

/// Counts results that were recorded, by the claims they come from.
pub(super) async fn count_results(
    conn: &mut SqliteConnection,
    claims: impl Iterator<Item = i64>,
) -> Result<(), StoreError> {
    let mut counted = BTreeMap::<i64, u64>::new();
    claims.for_each(|claim| *counted.entry(claim).or_default() += 1);
    if !counted.is_empty() {
        let rows: Vec<_> = counted.into_iter().collect();
        sqlx::query(COUNT_RESULTS).bind(to_json(&rows)).execute(conn).await?;
    }
    Ok(())
}

/// Notes that workers were heard of.
pub(crate) async fn seen(conn: &mut SqliteConnection, workers: &[i64], now_ms: i64) -> Result<(), StoreError> {
    if !workers.is_empty() {
        sqlx::query(SEEN).bind(to_json(&workers)).bind(now_ms).bind(SEEN_GRAIN_MS).execute(conn).await?;
    }
    Ok(())
}

/// Bars workers: row, why. Returns the rows of those that were not barred before.
pub(crate) async fn bar(
    conn: &mut SqliteConnection,
    workers: &[(i64, String)],
    now_ms: i64,
) -> Result<Vec<i64>, StoreError> {
    let rows: Vec<(i64, String, String, String)> =
        sqlx::query_as(BAR).bind(to_json(&workers)).bind(now_ms).fetch_all(conn).await?;
    for (_, worker, name, reason) in &rows {
        tracing::error!(worker, name, reason, "a worker is barred: it gets no more jobs");
    }
    Ok(rows.into_iter().map(|row| row.0).collect())
}

/// Lets a worker have jobs again; false if there is no such worker.
pub(crate) async fn allow(conn: &mut SqliteConnection, worker: &WorkerId) -> Result<bool, StoreError> {
    let changed = sqlx::query(ALLOW).bind(worker.as_str()).execute(conn).await?;
    Ok(changed.rows_affected() > 0)
}

#[derive(sqlx::FromRow)]
struct InfoRow {
    uid: String,
    name: String,
    engine: Vec<u8>,
    threads: i64,
    first_seen_ms: i64,
    last_seen_ms: i64,
    results: i64,
    leased: i64,
    enrolled_ms: Option<i64>,
    certificate_until_ms: Option<i64>,
    until_ms: Option<i64>,
    revoked_ms: Option<i64>,
    barred_ms: Option<i64>,
    barred_reason: Option<String>,
}

/// All workers, the latest seen first; or the one named.
pub(crate) async fn list(store: &Store, worker: Option<&WorkerId>) -> Result<Vec<WorkerInfo>, StoreError> {
    let one = worker.map(WorkerId::as_str);
    let rows: Vec<InfoRow> = sqlx::query_as(LIST).bind(one).fetch_all(store.readers()).await?;
    let info = |row: InfoRow| {
        Ok(WorkerInfo {
            id: worker_id(row.uid)?,
            name: row.name,
            engine: EngineId(hash("an engine", &row.engine)?),
            threads: unsigned("a worker's threads", row.threads)?,
            leased: unsigned("a worker's jobs", row.leased)?,
            results: unsigned("a worker's results", row.results)?,
            rate_per_s: None,
            first_seen_ms: row.first_seen_ms,
            last_seen_ms: row.last_seen_ms,
            enrolled_ms: row.enrolled_ms,
            certificate_until_ms: row.certificate_until_ms,
            until_ms: row.until_ms,
            revoked_ms: row.revoked_ms,
            barred: row.barred_ms.zip(row.barred_reason).map(|(since_ms, reason)| Bar { since_ms, reason }),
        })
    };
    rows.into_iter().map(info).collect()
}

/// A worker's name as stored.
pub(crate) fn worker_id(uid: String) -> Result<WorkerId, StoreError> {
    WorkerId::try_from(uid).map_err(|error| StoreError::Damaged(error.to_string()))
}
