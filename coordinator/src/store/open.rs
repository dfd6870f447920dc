//! Opening: what the file is, before anything is changed in it; then connections and migrations.
//!
//! A file to be changed is looked at by a connection that only reads, locked, checked page by page, and only then opened
//! by the one that writes.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use sqlx::migrate::{MigrateError, Migrator};
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{ConnectOptions, Connection, SqliteConnection, SqlitePool};

use super::lock::Lock;
use super::log::{LIMIT_BYTES, Log};
use super::place::place;
use super::transaction::{BEGIN, ROLL_BACK};
use crate::error::{StoreError, code, is_full, primary_code};

static MIGRATIONS: Migrator = sqlx::migrate!("../migrations");

/// `pragma application_id` of our files; the first migration sets it.
const APPLICATION_ID: i64 = 1_182_102_135;
/// How long a statement waits for another process that holds the file.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);
/// Pages kept in memory by the writer [KiB].
const WRITER_CACHE_KIB: u32 = 8 << 10;
/// The log is moved into the file when it has grown by so many pages.
const CHECKPOINT_PAGES: u32 = 4_000;
const READERS: u32 = 4;
/// Rows that a connection's thread may be ahead of who reads them: a claim's in one go.
const ROWS_AHEAD: usize = 512;
/// The check of a file over this size may take long enough to be announced \[bytes\].
const LARGE_BYTES: u64 = 256 << 20;

/// A database that this process may change.
pub(super) struct Changeable {
    pub(super) writer: SqlitePool,
    pub(super) readers: SqlitePool,
    pub(super) lock: Lock,
    pub(super) log: Log,
}

/// Opens or creates the file to change it.
pub(super) async fn to_change(path: &Path) -> Result<Changeable, StoreError> {
    let path = place(path)?;
    let is_new = !has_content(&path);
    if !is_new {
        close(look(&path).await?.conn, &path).await?;
    }
    let lock = Lock::take(&path)?;
    if !is_new {
        check(&path).await?;
    }
    let writing = options()
        .filename(&path)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .pragma("cache_size", format!("-{WRITER_CACHE_KIB}"))
        // What a statement may have to undo, a few hundred pages at the most; as files it cost an eighth of all processor time.
        .pragma("temp_store", "memory")
        .pragma("wal_autocheckpoint", CHECKPOINT_PAGES.to_string())
        .pragma("journal_size_limit", LIMIT_BYTES.to_string());
    let writer = lasting_pool(1).connect_with(writing).await.map_err(|error| explain(&path, error))?;
    try_to_write(&writer).await.map_err(|error| explain(&path, error))?;
    migrate(&writer, &path).await?;
    let reading = options().filename(&path).read_only(true);
    let readers = lasting_pool(READERS).min_connections(0).connect_lazy_with(reading);
    Ok(Changeable { writer, readers, lock, log: Log::of(&path) })
}

/// Opens the file to read it, beside whoever changes it.
pub(super) async fn to_read(path: &Path) -> Result<SqlitePool, StoreError> {
    let (options, conn) = reader(path).await?;
    close(conn, path).await?;
    Ok(lasting_pool(READERS).min_connections(0).connect_lazy_with(options))
}

/// A connection that reads the file, which is of this program and of this version; and how to get another.
pub(super) async fn reader(path: &Path) -> Result<(SqliteConnectOptions, SqliteConnection), StoreError> {
    let path = place(path)?;
    if !has_content(&path) {
        return Err(cannot_open(&path, "there is no such file, or nothing in it".to_owned()));
    }
    let Look { options, conn, found } = look(&path).await?;
    let known = known_version();
    if found < known {
        let reason = format!("its schema is of version {found}, older than this program's ({known}): serve it once");
        return Err(cannot_open(&path, reason));
    }
    Ok((options, conn))
}

/// One connection to a file that is there and has this program's schema, beside whoever else uses it.
pub(super) async fn beside(path: &Path) -> Result<SqliteConnection, StoreError> {
    let path = place(path)?;
    close(reader(&path).await?.1, &path).await?;
    let writing = options().filename(&path).synchronous(SqliteSynchronous::Full);
    writing.connect().await.map_err(|error| explain(&path, error))
}

/// A database in memory: one connection that reads and writes, since it is the database.
pub(super) async fn memory() -> Result<SqlitePool, StoreError> {
    let name = Path::new(":memory:");
    let only = lasting_pool(1).connect_with(options().in_memory(true)).await.map_err(|error| explain(name, error))?;
    migrate(&only, name).await?;
    Ok(only)
}

pub(super) fn options() -> SqliteConnectOptions {
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

fn has_content(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|file| file.len() > 0)
}

/// A file that is ours, or that may become ours: seen by a connection that only reads.
struct Look {
    options: SqliteConnectOptions,
    conn: SqliteConnection,
    /// The version of its schema; 0 if it has none.
    found: i64,
}

/// Refuses a file that is not ours without changing a byte of it.
async fn look(path: &Path) -> Result<Look, StoreError> {
    let options = options().filename(path).read_only(true);
    let (options, mut conn) = match connect_to_read(&options).await {
        Ok(conn) => (options, conn),
        // In a folder that is read-only, readers cannot tell each other what they read; nobody writes there either.
        Err(error) if cannot_share(&error) && !has_content(&Log::of(path).path) => {
            let alone = options.immutable(true);
            let conn = connect_to_read(&alone).await.map_err(|error| explain(path, error))?;
            (alone, conn)
        }
        Err(error) => return Err(explain(path, error)),
    };
    match judge(&mut conn, path).await {
        Ok(found) => Ok(Look { options, conn, found }),
        Err(refusal) => {
            close(conn, path).await?;
            Err(refusal)
        }
    }
}

/// Connects and reads the file's first page.
async fn connect_to_read(options: &SqliteConnectOptions) -> Result<SqliteConnection, sqlx::Error> {
    let mut conn = options.connect().await?;
    sqlx::query_scalar::<_, i64>(COUNT_TABLES).fetch_one(&mut conn).await?;
    Ok(conn)
}

fn cannot_share(error: &sqlx::Error) -> bool {
    primary_code(error).is_some_and(|code| [code::READ_ONLY, code::CANNOT_OPEN].contains(&code))
}

async fn close(conn: SqliteConnection, path: &Path) -> Result<(), StoreError> {
    conn.close().await.map_err(|error| explain(path, error))
}

/// Reads every page of the file and says how long that took.
async fn check(path: &Path) -> Result<(), StoreError> {
    let started = Instant::now();
    let bytes = std::fs::metadata(path).map_or(0, |file| file.len());
    if bytes > LARGE_BYTES {
        tracing::info!(bytes, "checking the database for damage");
    }
    let mut conn = look(path).await?.conn;
    let checked = quick_check(&mut conn, path).await;
    close(conn, path).await?;
    tracing::info!(bytes, took_ms = started.elapsed().as_millis() as u64, "the database was checked for damage");
    checked
}

/// Whether all pages of a database hang together.
pub(super) async fn quick_check(conn: &mut SqliteConnection, path: &Path) -> Result<(), StoreError> {
    let verdict: String =
        sqlx::query_scalar(QUICK_CHECK).fetch_one(conn).await.map_err(|error| explain(path, error))?;
    if verdict == "ok" { Ok(()) } else { Err(corrupt(path, verdict)) }
}

/// A file that is read-only shows so only with a write, which is undone.
async fn try_to_write(writer: &SqlitePool) -> Result<(), sqlx::Error> {
    let mut conn = writer.acquire().await?;
    sqlx::query(BEGIN).execute(&mut *conn).await?;
    let written = sqlx::query(WRITE_NOTHING_NEW).execute(&mut *conn).await;
    sqlx::query(ROLL_BACK).execute(&mut *conn).await?;
    written.map(drop)
}

/// The mark of this program's files.
const READ_APPLICATION_ID: &str = "select application_id from pragma_application_id";

/// Tables that are neither SQLite's nor the list of migrations.
const COUNT_TABLES: &str = "select count(*) from sqlite_schema
    where type = 'table' and name not like 'sqlite!_%' escape '!' and name not like '!_sqlx!_%' escape '!'";

/// The version of the schema in the file: the first that this program does not know, or else the last.
const READ_VERSION: &str = "select coalesce(
    (select min(version) from _sqlx_migrations where version not in (select value from json_each(?1))),
    (select max(version) from _sqlx_migrations), 0)";

/// The first thing that is wrong with the file, or `ok`.
const QUICK_CHECK: &str = "pragma quick_check(1)";

/// Writes what is there: this program makes no use of it.
const WRITE_NOTHING_NEW: &str = "pragma user_version = 0";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] =
    &[READ_APPLICATION_ID, COUNT_TABLES, READ_VERSION, QUICK_CHECK, WRITE_NOTHING_NEW];

async fn judge(conn: &mut SqliteConnection, path: &Path) -> Result<i64, StoreError> {
    let wrong = |error| explain(path, error);
    let application: i64 = sqlx::query_scalar(READ_APPLICATION_ID).fetch_one(&mut *conn).await.map_err(wrong)?;
    let tables: i64 = sqlx::query_scalar(COUNT_TABLES).fetch_one(&mut *conn).await.map_err(wrong)?;
    if application != APPLICATION_ID {
        let fresh = application == 0 && tables == 0;
        return if fresh { Ok(0) } else { Err(not_ours(path, "it is a database of another program")) };
    }
    let versions: Vec<i64> = MIGRATIONS.iter().map(|migration| migration.version).collect();
    let found: i64 =
        sqlx::query_scalar(READ_VERSION).bind(super::to_json(&versions)).fetch_one(conn).await.map_err(wrong)?;
    if versions.contains(&found) {
        return Ok(found);
    }
    Err(StoreError::Newer { path: path.to_owned(), found, known: known_version() })
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
    match primary_code(&error) {
        Some(code::NOT_A_DATABASE) => not_ours(path, "the file is not an SQLite database"),
        Some(code::CORRUPT) => corrupt(path, database.message().to_owned()),
        _ if is_full(&error) => StoreError::Full,
        Some(code::READ_ONLY) => cannot_open(path, "it is read-only: this user must be able to write it".to_owned()),
        Some(code::CANNOT_OPEN) => {
            let reason = "this user must be able to read and write it and the folder it is in";
            cannot_open(path, format!("{}: {reason}", database.message()))
        }
        _ => cannot_open(path, database.message().to_owned()),
    }
}

fn corrupt(path: &Path, reason: String) -> StoreError {
    StoreError::Corrupt { path: path.to_owned(), reason }
}

pub(super) fn cannot_open(path: &Path, reason: String) -> StoreError {
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

    async fn new_database(path: &Path) {
        Store::open(path).await.unwrap().close().await;
    }

    /// Both ways of opening refuse the file, and leave every byte of it.
    async fn refused_both_ways(path: &Path, expected: impl Fn(&StoreError) -> bool) {
        let before = std::fs::read(path).unwrap();
        for opened in [Store::open(path).await, Store::open_to_read(path).await] {
            let error = refusal(opened, path);
            assert!(expected(&error), "{error}");
        }
        assert_eq!(std::fs::read(path).unwrap(), before);
    }

    #[tokio::test]
    async fn a_database_of_a_newer_version_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        new_database(&path).await;
        run(
            &path,
            "insert into _sqlx_migrations (version, description, success, checksum, execution_time)
                values (9999, 'later', 1, x'00', 0)",
        )
        .await;
        refused_both_ways(&path, |error| matches!(error, StoreError::Newer { found: 9999, .. })).await;
    }

    #[tokio::test]
    async fn a_database_of_an_older_version_is_migrated_but_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let mut conn = options().filename(&path).create_if_missing(true).connect().await.unwrap();
        MIGRATIONS.run_to(1, &mut conn).await.unwrap();
        conn.close().await.unwrap();
        let error = refusal(Store::open_to_read(&path).await, &path);
        assert!(error.to_string().contains("older"), "{error}");
        new_database(&path).await;
        Store::open_to_read(&path).await.unwrap();
    }

    #[tokio::test]
    async fn a_database_with_a_broken_page_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        new_database(&path).await;
        let mut bytes = std::fs::read(&path).unwrap();
        let page = 4_096;
        // The first page of each kind but the schema's own, which is read before all others.
        bytes[5 * page..5 * page + 64].iter_mut().for_each(|byte| *byte ^= 0xff);
        std::fs::write(&path, &bytes).unwrap();
        let error = refusal(Store::open(&path).await, &path);
        assert!(matches!(error, StoreError::Corrupt { .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), bytes);
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        refused_both_ways(&path, |error| matches!(error, StoreError::Corrupt { .. })).await;
    }

    #[tokio::test]
    async fn a_file_is_changed_by_one_at_a_time_and_read_by_many() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let first = Store::open(&path).await.unwrap();
        let alias = folder.path().join("alias.db");
        std::os::unix::fs::symlink(&path, &alias).unwrap();
        for name in [&path, &alias, &folder.path().join(".").join("furrow.db")] {
            let error = refusal(Store::open(name).await, &path);
            assert!(matches!(error, StoreError::InUse { pid, .. } if pid == Some(std::process::id())), "{error}");
            assert_eq!(Store::open_to_read(name).await.unwrap().coordinator_id(), first.coordinator_id());
        }
        first.close().await;
        new_database(&alias).await;
    }

    #[tokio::test]
    async fn a_store_opened_to_read_does_not_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        new_database(&path).await;
        let store = Store::open_to_read(&path).await.unwrap();
        assert!(sqlx::query("delete from coordinator").execute(store.writer()).await.is_err());
    }

    #[tokio::test]
    async fn a_link_into_nowhere_and_a_file_with_two_names_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("furrow.db"), folder.path().join("other.db"));
        std::os::unix::fs::symlink(folder.path().join("nowhere.db"), &other).unwrap();
        let error = refusal(Store::open(&other).await, &other);
        assert!(error.to_string().contains("not there"), "{error}");
        std::fs::remove_file(&other).unwrap();
        new_database(&path).await;
        std::fs::hard_link(&path, &other).unwrap();
        refused_both_ways(&other, |error| error.to_string().contains("2 names")).await;
    }

    #[tokio::test]
    async fn a_file_that_is_no_database_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("letter.txt");
        let text = "Dear reader, this is not a database. ".repeat(100);
        std::fs::write(&path, &text).unwrap();
        refused_both_ways(&path, |error| matches!(error, StoreError::NotOurs { .. })).await;
    }

    #[tokio::test]
    async fn a_database_of_another_program_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.db");
        run(&path, "create table recipe (name text)").await;
        refused_both_ways(&path, |error| matches!(error, StoreError::NotOurs { .. })).await;
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
