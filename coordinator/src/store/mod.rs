//! The database: one file, one writer, many readers. The only SQL of the program that writes is below here.
//!
//! A file a concern: `sweep` and `cell` are what users ask for, `submit` takes a sweep in, `control` pauses, cancels
//! and retries it, `removal` takes it out, and `settle` brings its jobs in line; `job`,
//! `runs` and `values` list what became of it; `claim`, `result`, `renew` and `expiry` move jobs along, by way of
//! `transition` (what changes) and `tally` (what is counted); `admission` lets workers in and turns them away,
//! `verification` has results computed again; `worker`, `scenario`, `incident` and `token` are a
//! table each; `census` counts; `rehearsal` is for tests of faults. Statements are constants with a sentence each; a test
//! prepares all of them.
//!
//! `place` finds the file, `open` looks at it before anything is changed in it, `lock` keeps a second process from
//! changing it, `transaction` and `log` are what the writer writes through, `backup` copies all of it.
//!
//! Lists of rows travel into a statement as one JSON text (`json_each`): a statement per batch, not per row. Where rows
//! are wide and many, their values are bound one by one (`rows`). A limit is written `?1 + 0`: SQLite plans by the value
//! of a bare `limit ?1`, and prepares the statement anew each time.

pub(crate) mod admission;
pub(crate) mod back_off;
mod backup;
pub(crate) mod cell;
pub(crate) mod census;
pub(crate) mod claim;
pub(crate) mod columns;
pub(crate) mod control;
pub(crate) mod expiry;
pub(crate) mod incident;
pub(crate) mod job;
pub(crate) mod job_detail;
mod lock;
mod log;
mod open;
mod place;
#[cfg(test)]
mod random_histories;
pub(crate) mod rehearsal;
pub(crate) mod removal;
pub(crate) mod renew;
pub(crate) mod result;
mod rows;
pub(crate) mod run_rows;
pub(crate) mod runs;
pub(crate) mod scenario;
pub(crate) mod settle;
pub(crate) mod submit;
pub(crate) mod sweep;
pub(crate) mod tally;
pub(crate) mod token;
pub(crate) mod transaction;
pub(crate) mod transition;
pub(crate) mod unfinished;
pub(crate) mod values;
pub(crate) mod verification;
pub(crate) mod worker;

use std::path::Path;
use std::sync::Arc;

use furrow_schema::id::EngineId;
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::{SqliteConnection, SqlitePool};

use crate::error::StoreError;
pub use backup::Backup;
use lock::Lock;
use log::Log;
use transaction::Transaction;

/// An open database. Clones are handles on the same one.
#[derive(Debug, Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

#[derive(Debug)]
struct Inner {
    /// One connection, the only one that writes; the readers where nobody writes.
    writer: SqlitePool,
    readers: SqlitePool,
    coordinator_id: String,
    /// What belongs to a file that is open to be changed.
    own: Option<Own>,
}

#[derive(Debug)]
struct Own {
    lock: Lock,
    log: Log,
}

impl Store {
    /// Opens the database in `path`, creating and migrating it as needed. It is this process's until closed.
    ///
    /// # Errors
    /// [`StoreError::Open`], [`StoreError::InUse`], [`StoreError::NotOurs`], [`StoreError::Newer`] and
    /// [`StoreError::Corrupt`] name the file and the reason; the file is left as it was.
    pub async fn open(path: &Path) -> Result<Self, StoreError> {
        let open::Changeable { writer, readers, lock, log } = open::to_change(path).await?;
        Self::over(writer, readers, Some(Own { lock, log })).await
    }

    /// Opens the database in `path` beside whoever changes it. Nothing can be written through it.
    ///
    /// # Errors
    /// Those of [`Store::open`] but [`StoreError::InUse`].
    pub async fn open_to_read(path: &Path) -> Result<Self, StoreError> {
        let readers = open::to_read(path).await?;
        Self::over(readers.clone(), readers, None).await
    }

    /// Copies the database in `from`, which may be in use, to the new file `to`: whole, or not at all.
    ///
    /// # Errors
    /// Those of [`Store::open_to_read`] about `from`; [`StoreError::Target`] and [`StoreError::Full`] about `to`.
    pub async fn backup(from: &Path, to: &Path) -> Result<Backup, StoreError> {
        backup::copy(from, to).await
    }

    /// A database that lives as long as its handles: for tests and for runs that keep nothing.
    ///
    /// # Errors
    /// [`StoreError::Open`] when there is no memory for it.
    pub async fn in_memory() -> Result<Self, StoreError> {
        let only = open::memory().await?;
        Self::over(only.clone(), only, None).await
    }

    /// The coordinator's name on the network, drawn when the database was created: 32 hexadecimal digits.
    #[must_use]
    pub fn coordinator_id(&self) -> &str {
        &self.inner.coordinator_id
    }

    pub(crate) fn writer(&self) -> &SqlitePool {
        &self.inner.writer
    }

    pub(crate) fn readers(&self) -> &SqlitePool {
        &self.inner.readers
    }

    /// Begins a transaction of the one writer.
    pub(crate) async fn begin(&self) -> Result<Transaction, StoreError> {
        Transaction::begin(self.writer()).await
    }

    /// Ends a transaction, and sees to its log: kept short, and out of the way of a full disk.
    pub(crate) async fn end<T>(&self, transaction: Transaction, done: Result<T, StoreError>) -> Result<T, StoreError> {
        let ended = transaction.end(done).await;
        match (&self.inner.own, &ended) {
            (Some(own), Ok(_)) => own.log.bound(self.writer()).await,
            // What the log holds may fit into the file, and the next transaction then into the log.
            (Some(own), Err(StoreError::Full)) if own.log.bytes() > 0 => _ = own.log.empty(self.writer()).await,
            _ => {}
        }
        ended
    }

    /// Moves the log into the file, closes it, and lets others have it.
    pub(crate) async fn close(&self) {
        self.inner.readers.close().await;
        if let Some(own) = &self.inner.own
            && let Err(error) = own.log.empty(self.writer()).await
            && !self.inner.writer.is_closed()
        {
            tracing::warn!(%error, "the database's log could not be moved into its file; the next start does it");
        }
        self.inner.writer.close().await;
        if let Some(own) = &self.inner.own {
            own.lock.release();
        }
    }

    async fn over(writer: SqlitePool, readers: SqlitePool, own: Option<Own>) -> Result<Self, StoreError> {
        let coordinator_id = sqlx::query_scalar(COORDINATOR_ID).fetch_one(&writer).await?;
        Ok(Self { inner: Arc::new(Inner { writer, readers, coordinator_id, own }) })
    }
}

/// One connection to the file at `path`, beside whoever else uses it: nothing is created or migrated.
pub(crate) async fn open_beside(path: &Path) -> Result<SqliteConnection, StoreError> {
    open::beside(path).await
}

/// The name that the first migration drew.
const COORDINATOR_ID: &str = "select id from coordinator";

/// Adds an engine unless it is known.
const ADD_ENGINE: &str = "insert into engine (hash) values (?1) on conflict (hash) do nothing";

/// The number of an engine.
const ENGINE: &str = "select id from engine where hash = ?1";

/// The number of `engine`, which is stored if it is new.
pub(crate) async fn engine_id(conn: &mut SqliteConnection, engine: EngineId) -> Result<i64, StoreError> {
    let find = || sqlx::query_scalar::<_, i64>(ENGINE).bind(engine.0.to_vec());
    if let Some(id) = find().fetch_optional(&mut *conn).await? {
        return Ok(id);
    }
    sqlx::query(ADD_ENGINE).bind(engine.0.to_vec()).execute(&mut *conn).await?;
    Ok(find().fetch_one(conn).await?)
}

/// Rows as the JSON text that a statement's `json_each` takes apart.
pub(crate) fn to_json(rows: &impl Serialize) -> String {
    serde_json::to_string(rows).expect("rows of numbers and texts are JSON")
}

/// A stored JSON text as what it was.
pub(crate) fn from_json<T: DeserializeOwned>(what: &str, text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| StoreError::Damaged(format!("{what}: {error}")))
}

/// A stored hash.
pub(crate) fn hash(what: &str, bytes: &[u8]) -> Result<[u8; 32], StoreError> {
    bytes.try_into().map_err(|_| StoreError::Damaged(format!("{what} has {} bytes", bytes.len())))
}

/// A stored number that is not negative.
pub(crate) fn unsigned<T: TryFrom<i64>>(what: &str, number: i64) -> Result<T, StoreError> {
    T::try_from(number).map_err(|_| StoreError::Damaged(format!("{what} is {number}")))
}

/// Bytes as hexadecimal digits, which SQL's `unhex` reads.
pub(crate) fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let digit = |nibble: u8| char::from(DIGITS[usize::from(nibble)]);
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sqlx::{Executor, SqlSafeStr};

    #[tokio::test]
    async fn every_statement_fits_the_schema() {
        let store = Store::in_memory().await.unwrap();
        let mut conn = store.writer().acquire().await.unwrap();
        let own: &[&'static str] = &[COORDINATOR_ID, ADD_ENGINE, ENGINE];
        let all = [
            own,
            admission::STATEMENTS,
            backup::STATEMENTS,
            cell::STATEMENTS,
            census::STATEMENTS,
            claim::STATEMENTS,
            control::STATEMENTS,
            expiry::STATEMENTS,
            incident::STATEMENTS,
            job::STATEMENTS,
            job_detail::STATEMENTS,
            log::STATEMENTS,
            open::STATEMENTS,
            removal::STATEMENTS,
            renew::STATEMENTS,
            result::STATEMENTS,
            run_rows::STATEMENTS,
            runs::STATEMENTS,
            scenario::STATEMENTS,
            settle::STATEMENTS,
            submit::STATEMENTS,
            sweep::STATEMENTS,
            tally::STATEMENTS,
            token::STATEMENTS,
            transaction::STATEMENTS,
            transition::STATEMENTS,
            unfinished::STATEMENTS,
            columns::STATEMENTS,
            values::STATEMENTS,
            verification::STATEMENTS,
            verification::REPORT_STATEMENTS,
            worker::STATEMENTS,
        ];
        let by_rows = [submit::BY_ROWS, transition::BY_ROWS].into_iter().flatten().flatten();
        for statement in all.into_iter().flatten().chain(by_rows) {
            conn.prepare(statement.into_sql_str()).await.unwrap_or_else(|e| panic!("{e}: {statement}"));
        }
    }

    #[test]
    fn hexadecimal_digits_are_the_usual_ones() {
        assert_eq!(hex(&[0, 15, 255]), "000fff");
    }
}
