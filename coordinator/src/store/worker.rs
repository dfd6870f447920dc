//! Workers: who they are, and that they are who they say.

use std::collections::HashMap;

use furrow_schema::id::{Credential, WorkerId};
use furrow_schema::protocol::{Call, Hello, Refusal};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{Store, hash, to_json, unsigned};
use crate::view::{Bar, WorkerInfo};

/// When a worker was last seen is kept to this \[ms\], to save writing it with every question.
const SEEN_GRAIN_MS: i64 = 5_000;

/// Workers by name.
const FIND: &str =
    "select uid, id, credential_hash, barred_reason from worker where uid in (select value from json_each(?1))";

/// A worker's first hello.
const ADD: &str = "insert into worker (uid, credential_hash, name, engine_id, threads, first_seen_ms, last_seen_ms)
    values (?1, ?2, ?3, ?4, ?5, ?6, ?6)";

/// A later hello: it may have a new name, engine and number of threads.
const UPDATE: &str = "update worker set name = ?2, engine_id = ?3, threads = ?4, last_seen_ms = ?5 where id = ?1";

/// Workers that were heard of now.
const SEEN: &str = "update worker set last_seen_ms = ?2
    where id in (select value from json_each(?1)) and last_seen_ms < ?2 - ?3";

/// Workers that get no more jobs: row, why. The first reason stays.
const BAR: &str = "update worker set barred_ms = ?2, barred_reason = value ->> 1
    from json_each(?1) where worker.id = value ->> 0 and barred_ms is null
    returning worker.id, uid, name, barred_reason";

/// A worker that may have jobs again.
const ALLOW: &str = "update worker set barred_ms = null, barred_reason = null where uid = ?1";

/// All workers with the jobs they hold.
const LIST: &str = "select uid, name, threads, first_seen_ms, last_seen_ms, barred_ms, barred_reason,
        (select count(*) from job join claim on claim.id = job.claim_id
         where job.state = 'leased' and claim.worker_id = worker.id)
    from worker order by last_seen_ms desc, id desc";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[FIND, ADD, UPDATE, SEEN, BAR, ALLOW, LIST];

/// The callers of a batch as the database knows them.
#[derive(Debug, Default)]
pub(crate) struct Known(HashMap<String, Party>);

#[derive(Debug)]
struct Party {
    row: i64,
    credential: blake3::Hash,
    barred: Option<String>,
}

impl Known {
    /// Looks up all of `callers` that said hello.
    pub(crate) async fn load(conn: &mut SqliteConnection, callers: &[&str]) -> Result<Self, StoreError> {
        if callers.is_empty() {
            return Ok(Self::default());
        }
        let rows: Vec<(String, i64, Vec<u8>, Option<String>)> =
            sqlx::query_as(FIND).bind(to_json(&callers)).fetch_all(conn).await?;
        let known = rows.into_iter().map(|(uid, row, credential, barred)| {
            let credential = blake3::Hash::from_bytes(hash("a credential's hash", &credential)?);
            Ok((uid, Party { row, credential, barred }))
        });
        known.collect::<Result<_, StoreError>>().map(Self)
    }

    /// The row of a caller with the right credential that is not barred.
    pub(crate) fn check<T>(&self, call: &Call<T>) -> Result<i64, Refusal> {
        let party = self.0.get(call.worker.as_str()).ok_or(Refusal::UnknownWorker)?;
        // Comparing hashes of this type takes the same time wherever they differ.
        if party.credential != hash_of(&call.credential) {
            return Err(Refusal::BadCredential);
        }
        party.barred.as_ref().map_or(Ok(party.row), |detail| Err(Refusal::Barred { detail: detail.clone() }))
    }
}

fn hash_of(credential: &Credential) -> blake3::Hash {
    blake3::hash(credential.as_str().as_bytes())
}

/// Takes a worker in, or refreshes what is known of it.
pub(crate) async fn hello(
    conn: &mut SqliteConnection,
    call: &Call<Hello>,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<(), Refusal>, StoreError> {
    let known = Known::load(conn, &[call.worker.as_str()]).await?;
    let Hello { name, threads, .. } = &call.body;
    let statement = match known.check(call) {
        Ok(id) => sqlx::query(UPDATE).bind(id),
        Err(Refusal::UnknownWorker) => {
            sqlx::query(ADD).bind(call.worker.as_str()).bind(hash_of(&call.credential).as_bytes().to_vec())
        }
        Err(refusal) => return Ok(Err(refusal)),
    };
    statement.bind(name).bind(engine_id).bind(i64::from(*threads)).bind(now_ms).execute(conn).await?;
    Ok(Ok(()))
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

/// All workers, the latest seen first.
pub(crate) async fn list(store: &Store) -> Result<Vec<WorkerInfo>, StoreError> {
    type Row = (String, String, i64, i64, i64, Option<i64>, Option<String>, i64);
    let rows: Vec<Row> = sqlx::query_as(LIST).fetch_all(store.readers()).await?;
    let info = |(uid, name, threads, first_seen_ms, last_seen_ms, barred_ms, reason, leased): Row| {
        Ok(WorkerInfo {
            id: worker_id(uid)?,
            name,
            threads: unsigned("a worker's threads", threads)?,
            leased: unsigned("a worker's jobs", leased)?,
            first_seen_ms,
            last_seen_ms,
            barred: barred_ms.zip(reason).map(|(since_ms, reason)| Bar { since_ms, reason }),
        })
    };
    rows.into_iter().map(info).collect()
}

/// A worker's name as stored.
pub(crate) fn worker_id(uid: String) -> Result<WorkerId, StoreError> {
    WorkerId::try_from(uid).map_err(|error| StoreError::Damaged(error.to_string()))
}
