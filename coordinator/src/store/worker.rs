//! Workers: who they are, and that they are who they say.

use std::collections::HashMap;

use furrow_schema::id::{Credential, WorkerId};
use furrow_schema::protocol::{Call, Hello, Refusal};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{Store, hash, to_json, unsigned};
use crate::view::WorkerInfo;

/// When a worker was last seen is kept to this \[ms\], to save writing it with every question.
const SEEN_GRAIN_MS: i64 = 5_000;

/// Workers by name.
const FIND: &str = "select uid, id, credential_hash from worker where uid in (select value from json_each(?1))";

/// A worker's first hello.
const ADD: &str = "insert into worker (uid, credential_hash, name, engine_id, threads, first_seen_ms, last_seen_ms)
    values (?1, ?2, ?3, ?4, ?5, ?6, ?6)";

/// A later hello: it may have a new name, engine and number of threads.
const UPDATE: &str = "update worker set name = ?2, engine_id = ?3, threads = ?4, last_seen_ms = ?5 where id = ?1";

/// Workers that were heard of now.
const SEEN: &str = "update worker set last_seen_ms = ?2
    where id in (select value from json_each(?1)) and last_seen_ms < ?2 - ?3";

/// All workers with the jobs they hold.
const LIST: &str = "select uid, name, threads, first_seen_ms, last_seen_ms,
        (select count(*) from job join claim on claim.id = job.claim_id
         where job.state = 'leased' and claim.worker_id = worker.id)
    from worker order by last_seen_ms desc, id desc";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[FIND, ADD, UPDATE, SEEN, LIST];

/// The callers of a batch as the database knows them.
#[derive(Debug, Default)]
pub(crate) struct Known(HashMap<String, (i64, blake3::Hash)>);

impl Known {
    /// Looks up all of `callers` that said hello.
    pub(crate) async fn load(conn: &mut SqliteConnection, callers: &[&str]) -> Result<Self, StoreError> {
        if callers.is_empty() {
            return Ok(Self::default());
        }
        let rows: Vec<(String, i64, Vec<u8>)> = sqlx::query_as(FIND).bind(to_json(&callers)).fetch_all(conn).await?;
        let known = rows.into_iter().map(|(uid, id, credential)| {
            let expected = blake3::Hash::from_bytes(hash("a credential's hash", &credential)?);
            Ok((uid, (id, expected)))
        });
        known.collect::<Result<_, StoreError>>().map(Self)
    }

    /// The row of a caller with the right credential.
    pub(crate) fn check<T>(&self, call: &Call<T>) -> Result<i64, Refusal> {
        let (id, expected) = self.0.get(call.worker.as_str()).ok_or(Refusal::UnknownWorker)?;
        // Comparing hashes of this type takes the same time wherever they differ.
        if *expected == hash_of(&call.credential) { Ok(*id) } else { Err(Refusal::BadCredential) }
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

/// All workers, the latest seen first.
pub(crate) async fn list(store: &Store) -> Result<Vec<WorkerInfo>, StoreError> {
    let rows: Vec<(String, String, i64, i64, i64, i64)> = sqlx::query_as(LIST).fetch_all(store.readers()).await?;
    let info = |(uid, name, threads, first_seen_ms, last_seen_ms, leased)| {
        Ok(WorkerInfo {
            id: worker_id(uid)?,
            name,
            threads: unsigned("a worker's threads", threads)?,
            leased: unsigned("a worker's jobs", leased)?,
            first_seen_ms,
            last_seen_ms,
        })
    };
    rows.into_iter().map(info).collect()
}

/// A worker's name as stored.
pub(crate) fn worker_id(uid: String) -> Result<WorkerId, StoreError> {
    WorkerId::try_from(uid).map_err(|error| StoreError::Damaged(error.to_string()))
}
