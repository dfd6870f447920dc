//! What can go wrong on this side of the queue.

use std::path::PathBuf;

use furrow_schema::id::{EngineId, SweepId};
use sqlx::error::DatabaseError;

/// Why the store did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file cannot be opened or created. The caller gives up and names the file to the user.
    #[error("cannot open the database `{}`: {reason}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What stands in the way.
        reason: String,
    },
    /// The file is no database of this program. The caller gives up; the file is left alone.
    #[error("`{}` is not a database of furrow: {reason}; name another file", path.display())]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// How one can tell.
        reason: String,
    },
    /// A newer version of the program wrote the file. The caller gives up; the file is left alone.
    #[error(
        "the database `{}` is of a newer version ({found}) than this program knows ({known}): use the newer program",
        path.display()
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// The version of its schema.
        found: i64,
        /// The newest version that this program knows.
        known: i64,
    },
    /// Another process holds the database open to change it. The caller gives up, or asks that process.
    #[error("the database `{}` is in use by {}: ask its server with --url, or stop it", path.display(), holder(*pid))]
    InUse {
        /// The file.
        path: PathBuf,
        /// The process, if it said so.
        pid: Option<u32>,
    },
    /// SQLite finds the file damaged. The caller gives up; the file is left alone.
    #[error("the database `{}` is damaged: {reason}; serve a backup of it instead", path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// The first thing that is wrong with it.
        reason: String,
    },
    /// A backup cannot be written there. The caller gives up and names the file to the user.
    #[error("cannot write `{}`: {reason}", path.display())]
    Target {
        /// The file.
        path: PathBuf,
        /// What stands in the way.
        reason: String,
    },
    /// The idempotency key stands for another submission already. The caller refuses the request.
    #[error("the idempotency key `{key}` was used for another submission")]
    Conflict {
        /// The key, as the client gave it.
        key: String,
    },
    /// What was asked breaks a rule. The caller refuses the request with the text.
    #[error("{0}")]
    Invalid(String),
    /// The keys of several jobs begin with these digits. The caller refuses the request: more digits tell them apart.
    #[error("the keys of several jobs begin with `{0}`: give more digits")]
    Ambiguous(String),
    /// The sweep is cancelled and cannot be resumed. The caller refuses the request: retrying the sweep brings it back.
    #[error("sweep {0} is cancelled: retry it to bring it back")]
    Cancelled(SweepId),
    /// The sweep is for another engine than this coordinator's. The caller refuses the request.
    #[error("the sweep is for engine {sweep}, this coordinator runs engine {coordinator}")]
    OtherEngine {
        /// The coordinator's engine.
        coordinator: EngineId,
        /// The sweep's engine.
        sweep: EngineId,
    },
    /// No room is left on the disk. Nothing was changed; the caller may try again when there is.
    #[error("the disk is full: nothing was changed, and nothing will be until there is room")]
    Full,
    /// The database failed: file gone, I/O. Nothing was changed; the caller may try again.
    #[error("the database failed: {0}")]
    Database(sqlx::Error),
    /// The batch that held this command could not be committed. Nothing was changed; the caller may try again.
    #[error("could not be written: {0}")]
    NotWritten(String),
    /// SQLite finds the file damaged while it is in use. The caller reports it; a coordinator that meets this stops.
    #[error("the database file is damaged: {0}")]
    Broken(String),
    /// A stored value is not what it should be. The caller reports it; trying again does not help.
    #[error("the database is damaged: {0}")]
    Damaged(String),
    /// The coordinator was shut down, or only reads. The caller stops.
    #[error("the coordinator is shut down")]
    Closed,
}

/// SQLite's primary result codes that mean something to a caller.
pub(crate) mod code {
    pub(crate) const READ_ONLY: i32 = 8;
    pub(crate) const CORRUPT: i32 = 11;
    pub(super) const FULL: i32 = 13;
    pub(crate) const CANNOT_OPEN: i32 = 14;
    pub(crate) const NOT_A_DATABASE: i32 = 26;
    /// An extended one: what readers tell each other cannot be written down.
    pub(super) const SHARED_MEMORY_SIZE: i32 = 4_874;
    /// Those for which a single statement or its values are to blame: error, too big, constraint, mismatch, range.
    pub(super) const OF_ONE_STATEMENT: [i32; 5] = [1, 18, 19, 20, 25];
}

/// The primary result code of SQLite behind an error, if there is one.
pub(crate) fn primary_code(error: &sqlx::Error) -> Option<i32> {
    Some(extended_code(error.as_database_error()?)? & 0xff)
}

/// Whether no room is left on the disk.
pub(crate) fn is_full(error: &sqlx::Error) -> bool {
    let code = error.as_database_error().and_then(extended_code);
    code.is_some_and(|code| code & 0xff == code::FULL || code == code::SHARED_MEMORY_SIZE)
}

fn extended_code(error: &dyn DatabaseError) -> Option<i32> {
    error.code()?.parse().ok()
}

impl StoreError {
    /// Whether the database failed as a whole, so that no other command would fare better.
    pub(crate) fn concerns_all(&self) -> bool {
        match self {
            Self::Full | Self::Broken(_) => true,
            Self::Database(error) => match primary_code(error) {
                Some(code) => !code::OF_ONE_STATEMENT.contains(&code),
                None => {
                    use sqlx::Error::{Io, PoolClosed, PoolTimedOut, WorkerCrashed};
                    matches!(error, Io(_) | PoolClosed | PoolTimedOut | WorkerCrashed)
                }
            },
            _ => false,
        }
    }
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        match primary_code(&error) {
            _ if is_full(&error) => Self::Full,
            Some(code::CORRUPT | code::NOT_A_DATABASE) => Self::Broken(error.to_string()),
            _ => Self::Database(error),
        }
    }
}

fn holder(pid: Option<u32>) -> String {
    pid.map_or_else(|| "another process".to_owned(), |pid| format!("process {pid}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;

    #[tokio::test]
    async fn a_statement_is_to_blame_for_some_errors_and_the_disk_for_others() {
        let store = Store::in_memory().await.unwrap();
        let run =
            async |sql: &'static str| StoreError::from(sqlx::raw_sql(sql).execute(store.writer()).await.unwrap_err());
        let constraint = run("insert into coordinator (one, id) values (1, 'x')").await;
        assert!(!constraint.concerns_all(), "{constraint}");
        assert!(!run("nonsense").await.concerns_all());
        let full = run("pragma max_page_count = 1; create table ballast as select zeroblob(1 << 20) as bytes").await;
        assert!(matches!(full, StoreError::Full) && full.concerns_all(), "{full}");
        store.close().await;
        assert!(run("select 1").await.concerns_all());
    }
}
