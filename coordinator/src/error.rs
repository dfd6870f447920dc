//! What can go wrong on this side of the queue.

use std::path::PathBuf;

use furrow_schema::id::{EngineId, SweepId};

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
    #[error("`{}` is not a database of furrow: {reason}", path.display())]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// How one can tell.
        reason: String,
    },
    /// A newer version of the program wrote the file. The caller gives up; the file is left alone.
    #[error("the database `{}` is of a newer version ({found}) than this program knows ({known})", path.display())]
    Newer {
        /// The file.
        path: PathBuf,
        /// The version of its schema.
        found: i64,
        /// The newest version that this program knows.
        known: i64,
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
    /// The database failed: disk full, file gone, I/O. Nothing was changed; the caller may try again.
    #[error("the database failed: {0}")]
    Database(#[from] sqlx::Error),
    /// The batch that held this command could not be committed. Nothing was changed; the caller may try again.
    #[error("could not be written: {0}")]
    NotWritten(String),
    /// A stored value is not what it should be. The caller reports it; trying again does not help.
    #[error("the database is damaged: {0}")]
    Damaged(String),
    /// The coordinator was shut down. The caller stops.
    #[error("the coordinator is shut down")]
    Closed,
}
