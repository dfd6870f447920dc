//! Opening: what the file is, before anything is changed in it; then connections and migrations.

use std::path::{Path, PathBuf};
use std::time::Duration;

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, SqliteConnection, SqlitePool};

use crate::error::StoreError;

static MIGRATIONS: Migrator = sqlx::migrate!("../migrations");

/// `pragma application_id` of our files; the first migration sets it.
const APPLICATION_ID: i64 = 1_182_102_135;
/// How long a statement waits for another process that holds the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);
/// Pages kept in memory by the writer [KiB].
const WRITER_CACHE_KIB: u32 = 16 << 10;
/// The log is moved into the file when it has grown by so many pages.
const CHECKPOINT_PAGES: u32 = 4_000;
const READERS: u32 = 4;
/// Rows that a connection's thread may be ahead of who reads them: a claim's in one go.
const ROWS_AHEAD: usize = 512;

/// SQLite's primary result codes for files that are no database.
const NOT_A_DATABASE: &str = "26";

/// Opens or creates the file: its one writer, and its readers.
pub(super) async fn file(path: &Path) -> Result<(SqlitePool, SqlitePool), StoreError> {
    let path = std::path::absolute(path).map_err(|error| cannot_open(path, error.to_string()))?;
    check_place(&path)?;
    if std::fs::metadata(&path).is_ok_and(|file| file.len() > 0) {
        inspect(&path).await?;
    }
    let options = options().filename(&path);
    let writing = options
        .clone()
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .pragma("cache_size", format!("-{WRITER_CACHE_KIB}"))
        .pragma("wal_autocheckpoint", CHECKPOINT_PAGES.to_string());
    let writer = lasting_pool(1).connect_with(writing).await.map_err(|error| explain(&path, error))?;
    migrate(&writer, &path).await?;
    let readers = lasting_pool(READERS).min_connections(0).connect_lazy_with(options.read_only(true));
    Ok((writer, readers))
}

/// One connection to a file that is there and has this program's schema, beside whoever else uses it.
pub(super) async fn beside(path: &Path) -> Result<SqliteConnection, StoreError> {
    let path = std::path::absolute(path).map_err(|error| cannot_open(path, error.to_string()))?;
    check_place(&path)?;
    if !path.is_file() {
        return Err(cannot_open(&path, "there is no such file".to_owned()));
    }
    inspect(&path).await?;
    let writing = options().filename(&path).synchronous(SqliteSynchronous::Full);
    let mut conn = writing.connect().await.map_err(|error| explain(&path, error))?;
    let version = sqlx::query_scalar::<_, i64>(READ_VERSION).fetch_one(&mut conn).await;
    if version.is_ok_and(|version| version == known_version()) {
        return Ok(conn);
    }
    Err(cannot_open(&path, "its schema is of an older version: start `furrow serve` on it once".to_owned()))
}

/// A database in memory: one connection that reads and writes, since it is the database.
pub(super) async fn memory() -> Result<SqlitePool, StoreError> {
    let name = Path::new(":memory:");
    let only = lasting_pool(1).connect_with(options().in_memory(true)).await.map_err(|error| explain(name, error))?;
    migrate(&only, name).await?;
    Ok(only)
}

fn options() -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
        .row_buffer_size(ROWS_AHEAD)
        .disable_statement_logging()
}

fn lasting_pool(connections: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new()
        .max_connections(connections)
        .min_connections(connections)
        .idle_timeout(None)
        .max_lifetime(None)
        .test_before_acquire(false)
}

/// What SQLite would only call "unable to open database file".
fn check_place(path: &Path) -> Result<(), StoreError> {
    if path.is_dir() {
        return Err(cannot_open(path, "it is a folder".to_owned()));
    }
    match path.parent() {
        Some(folder) if !folder.is_dir() => {
            Err(cannot_open(path, format!("the folder `{}` does not exist", folder.display())))
        }
        _ => Ok(()),
    }
}

/// Refuses a file that is not ours without changing a byte of it.
async fn inspect(path: &Path) -> Result<(), StoreError> {
    let options = options().filename(path).read_only(true);
    let mut conn = options.connect().await.map_err(|error| explain(path, error))?;
    let verdict = judge(&mut conn, path).await;
    let closed = conn.close().await.map_err(|error| explain(path, error));
    verdict.and(closed)
}

/// The mark of this program's files.
const READ_APPLICATION_ID: &str = "select application_id from pragma_application_id";

/// Tables that are neither SQLite's nor the list of migrations.
const COUNT_TABLES: &str = "select count(*) from sqlite_schema
    where type = 'table' and name not like 'sqlite!_%' escape '!' and name not like '!_sqlx!_%' escape '!'";

/// The version of the schema in the file.
const READ_VERSION: &str = "select coalesce(max(version), 0) from _sqlx_migrations";

async fn judge(conn: &mut SqliteConnection, path: &Path) -> Result<(), StoreError> {
    let application: i64 =
        sqlx::query_scalar(READ_APPLICATION_ID).fetch_one(&mut *conn).await.map_err(|error| explain(path, error))?;
    let tables: i64 =
        sqlx::query_scalar(COUNT_TABLES).fetch_one(&mut *conn).await.map_err(|error| explain(path, error))?;
    if application != APPLICATION_ID {
        let fresh = application == 0 && tables == 0;
        return if fresh { Ok(()) } else { Err(not_ours(path, "it is a database of another program")) };
    }
    let found: i64 = sqlx::query_scalar(READ_VERSION).fetch_one(conn).await.map_err(|error| explain(path, error))?;
    let known = known_version();
    if found > known { Err(StoreError::Newer { path: path.to_owned(), found, known }) } else { Ok(()) }
}

async fn migrate(writer: &SqlitePool, path: &Path) -> Result<(), StoreError> {
    MIGRATIONS.run(writer).await.map_err(|error| match error {
        MigrateError::VersionMissing(found) if found > known_version() => {
            StoreError::Newer { path: path.to_owned(), found, known: known_version() }
        }
        MigrateError::VersionMissing(version) | MigrateError::VersionMismatch(version) => {
            not_ours(path, &format!("its schema differs from this program's in version {version}"))
        }
        MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => explain(path, error),
        other => cannot_open(path, other.to_string()),
    })
}

fn known_version() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or(0)
}

fn explain(path: &Path, error: sqlx::Error) -> StoreError {
    let Some(database) = error.as_database_error() else { return cannot_open(path, error.to_string()) };
    match database.code().as_deref() {
        Some(NOT_A_DATABASE) => not_ours(path, "the file is not an SQLite database"),
        _ => cannot_open(path, database.message().to_owned()),
    }
}

fn cannot_open(path: &Path, reason: String) -> StoreError {
    StoreError::Open { path: PathBuf::from(path), reason }
}

fn not_ours(path: &Path, reason: &str) -> StoreError {
    StoreError::NotOurs { path: PathBuf::from(path), reason: reason.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use sqlx::AssertSqlSafe;

    async fn run(path: &Path, sql: &str) {
        let mut conn = options().filename(path).create_if_missing(true).connect().await.unwrap();
        sqlx::raw_sql(AssertSqlSafe(sql.to_owned())).execute(&mut conn).await.unwrap();
        conn.close().await.unwrap();
    }

    fn refusal(opened: Result<Store, StoreError>, path: &Path) -> StoreError {
        let error = opened.unwrap_err();
        assert!(error.to_string().contains(path.to_str().unwrap()), "{error} does not name the file");
        error
    }

    #[tokio::test]
    async fn a_file_is_created_and_keeps_its_coordinator() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let first = Store::open(&path).await.unwrap();
        let id = first.coordinator_id().to_owned();
        first.close().await;
        assert_eq!(Store::open(&path).await.unwrap().coordinator_id(), id);
    }

    #[tokio::test]
    async fn a_database_of_a_newer_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        Store::open(&path).await.unwrap().close().await;
        run(
            &path,
            "insert into _sqlx_migrations (version, description, success, checksum, execution_time)
                values (9999, 'later', 1, x'00', 0)",
        )
        .await;
        let error = refusal(Store::open(&path).await, &path);
        assert!(matches!(error, StoreError::Newer { found: 9999, .. }), "{error}");
    }

    #[tokio::test]
    async fn a_file_that_is_no_database_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("letter.txt");
        let text = "Dear reader, this is not a database. ".repeat(100);
        std::fs::write(&path, &text).unwrap();
        let error = refusal(Store::open(&path).await, &path);
        assert!(matches!(error, StoreError::NotOurs { .. }), "{error}");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }

    #[tokio::test]
    async fn a_database_of_another_program_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.db");
        run(&path, "create table recipe (name text)").await;
        let before = std::fs::read(&path).unwrap();
        let error = refusal(Store::open(&path).await, &path);
        assert!(matches!(error, StoreError::NotOurs { .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }

    #[tokio::test]
    async fn a_folder_and_a_path_into_nowhere_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(matches!(refusal(Store::open(folder.path()).await, folder.path()), StoreError::Open { .. }));
        let nowhere = folder.path().join("missing/furrow.db");
        let error = refusal(Store::open(&nowhere).await, &nowhere);
        assert!(error.to_string().contains("does not exist"), "{error}");
    }

    #[tokio::test]
    async fn a_path_that_looks_like_an_address_is_a_path() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file:x?mode=memory");
        Store::open(&path).await.unwrap().close().await;
        assert!(path.is_file());
    }
}
