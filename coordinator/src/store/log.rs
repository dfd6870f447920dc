//! The write-ahead log, kept from growing.
//!
//! SQLite moves the log into the file whenever it has grown by some megabytes, and starts it anew once nobody reads from
//! it. As long as readers overlap there is no such moment, and the log grows on. So when it is over a limit the writer
//! makes one: it waits until those who read older pages are through, while new ones already read from the file.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqlitePool};

use crate::error::StoreError;

/// A log over this size is emptied, and one that was larger is cut to it \[bytes\].
pub(super) const LIMIT_BYTES: u64 = 32 << 20;
/// After a try in vain the log may grow by so much before the next [bytes].
const MORE_BYTES: u64 = 8 << 20;

/// For so long the writer waits for readers: all others wait for the writer.
const WAIT_BRIEFLY: &str = "pragma busy_timeout = 1000";
/// As long as every other statement waits.
const WAIT_AS_USUAL: &str = "pragma busy_timeout = 5000";
/// Moves the log into the file and makes it empty.
const EMPTY: &str = "pragma wal_checkpoint(truncate)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[WAIT_BRIEFLY, WAIT_AS_USUAL, EMPTY];

/// The log of one database.
#[derive(Debug)]
pub(super) struct Log {
    pub(super) path: PathBuf,
    /// From this size on it is emptied.
    next_bytes: AtomicU64,
}

impl Log {
    pub(super) fn of(database: &Path) -> Self {
        let mut name = database.as_os_str().to_owned();
        name.push("-wal");
        Self { path: name.into(), next_bytes: AtomicU64::new(LIMIT_BYTES) }
    }

    /// How long it is [bytes].
    pub(super) fn bytes(&self) -> u64 {
        std::fs::metadata(&self.path).map_or(0, |log| log.len())
    }

    /// Empties it if it has grown too long.
    pub(super) async fn bound(&self, writer: &SqlitePool) {
        let bytes = self.bytes();
        if bytes < LIMIT_BYTES {
            return self.next_bytes.store(LIMIT_BYTES, Ordering::Relaxed);
        }
        if bytes < self.next_bytes.load(Ordering::Relaxed) {
            return;
        }
        let next = match self.empty(writer).await {
            Ok(true) => LIMIT_BYTES,
            Ok(false) => {
                tracing::warn!(bytes, "a long read keeps the database's log from being emptied");
                bytes + MORE_BYTES
            }
            Err(error) => {
                tracing::warn!(bytes, %error, "the database's log could not be moved into its file");
                bytes + MORE_BYTES
            }
        };
        self.next_bytes.store(next, Ordering::Relaxed);
    }

    /// Moves it into the file; false if a reader held it up.
    pub(super) async fn empty(&self, writer: &SqlitePool) -> Result<bool, StoreError> {
        let mut conn = writer.acquire().await?;
        sqlx::query(WAIT_BRIEFLY).execute(&mut *conn).await?;
        let emptied = sqlx::query(EMPTY).fetch_one(&mut *conn).await;
        sqlx::query(WAIT_AS_USUAL).execute(&mut *conn).await?;
        let busy = |row: SqliteRow| row.try_get::<i64, _>(0).map(|busy| busy != 0);
        Ok(!emptied.and_then(busy)?)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use sqlx::sqlite::SqliteConnectOptions;
    use sqlx::{ConnectOptions, SqliteConnection};

    use super::*;
    use crate::store::Store;

    const BOUND_BYTES: u64 = 64 << 20;
    /// Transactions of a MiB each.
    const TRANSACTIONS: u64 = 120;

    async fn reader(path: &Path) -> SqliteConnection {
        SqliteConnectOptions::new().filename(path).read_only(true).connect().await.unwrap()
    }

    /// Begins a read transaction; the snapshot is taken with the first statement.
    async fn begin(conn: &mut SqliteConnection) {
        sqlx::query("begin").execute(&mut *conn).await.unwrap();
        sqlx::query("select count(*) from result").execute(conn).await.unwrap();
    }

    /// Reads with two connections, each of which begins before the other ends.
    async fn read_without_a_gap(path: PathBuf, enough: &AtomicBool) -> u64 {
        let (mut this, mut other) = (reader(&path).await, reader(&path).await);
        begin(&mut this).await;
        let mut reads = 1;
        while !enough.load(Ordering::Relaxed) {
            begin(&mut other).await;
            sqlx::query("commit").execute(&mut this).await.unwrap();
            std::mem::swap(&mut this, &mut other);
            reads += 1;
        }
        reads
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn the_log_stays_short_though_there_is_always_a_reader() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let store = Store::open(&path).await.unwrap();
        sqlx::query("create table ballast (bytes blob)").execute(store.writer()).await.unwrap();
        let (log, enough) = (Log::of(&path), AtomicBool::new(false));
        let mut largest = 0;
        let write = async {
            for _ in 0..TRANSACTIONS {
                let mut transaction = store.begin().await.unwrap();
                let insert = sqlx::query("insert into ballast (bytes) values (zeroblob(1 << 20))");
                let written = insert.execute(&mut *transaction).await.map_err(StoreError::from);
                store.end(transaction, written).await.unwrap();
                largest = log.bytes().max(largest);
            }
            enough.store(true, Ordering::Relaxed);
        };
        let (reads, ()) = tokio::join!(read_without_a_gap(path, &enough), write);
        assert!(reads > TRANSACTIONS, "{reads} reads");
        assert!(largest < BOUND_BYTES, "the log grew to {largest} bytes");
        store.close().await;
    }
}
