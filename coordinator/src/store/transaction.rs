//! A transaction of the writer.
//!
//! It is begun and ended by plain statements: SQLite may roll back by itself, when the disk is full for one, and sqlx's
//! own transactions, which count how deep they are, would be wrong from then on.

use std::ops::{Deref, DerefMut};

use sqlx::pool::PoolConnection;
use sqlx::{Sqlite, SqliteConnection, SqlitePool};

use crate::error::StoreError;

pub(super) const BEGIN: &str = "begin immediate";
const COMMIT: &str = "commit";
pub(super) const ROLL_BACK: &str = "rollback";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[BEGIN, COMMIT, ROLL_BACK];

/// A transaction that is under way. It must be ended: dropping it does not.
pub(crate) struct Transaction(PoolConnection<Sqlite>);

impl Transaction {
    pub(super) async fn begin(writer: &SqlitePool) -> Result<Self, StoreError> {
        let mut conn = writer.acquire().await?;
        sqlx::query(BEGIN).execute(&mut *conn).await?;
        Ok(Self(conn))
    }

    /// Commits what was `done`. If it went wrong, or cannot be committed, all of it is undone.
    pub(super) async fn end<T>(mut self, done: Result<T, StoreError>) -> Result<T, StoreError> {
        let ended = match done {
            Ok(value) => sqlx::query(COMMIT).execute(&mut *self).await.map(|_| value).map_err(StoreError::from),
            Err(error) => Err(error),
        };
        if ended.is_err() {
            // An error says that SQLite has rolled back already.
            let _ = sqlx::query(ROLL_BACK).execute(&mut *self).await;
        }
        ended
    }
}

impl Deref for Transaction {
    type Target = SqliteConnection;

    fn deref(&self) -> &SqliteConnection {
        &self.0
    }
}

impl DerefMut for Transaction {
    fn deref_mut(&mut self) -> &mut SqliteConnection {
        &mut self.0
    }
}
