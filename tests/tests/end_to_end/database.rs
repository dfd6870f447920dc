//! Databases that cannot be used, or not now: refused with a reason, and left as they were.

use std::fs;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};
use sqlx::{AssertSqlSafe, Connection, SqliteConnection};
use tempfile::TempDir;

use crate::bad_input::refused;
use crate::mount::Mount;
use crate::plan::{directory, file, path, plan};
use crate::process;
use crate::server::Server;

/// A database with a finished sweep in it.
async fn database(directory: &TempDir, db: &str) {
    let plan = file(directory, "plan.json", &plan(1.0, 2));
    process::json(&["run", &plan, "--db", db, "--threads", "2", "--json"]).await;
}

async fn execute(db: &str, sql: &str) {
    let mut connection = SqliteConnection::connect(&format!("sqlite://{db}")).await.unwrap();
    sqlx::raw_sql(AssertSqlSafe(sql.to_owned())).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

/// Every command that opens the database names it and says `words`, and leaves every byte of it.
async fn refused_by_all(directory: &TempDir, db: &str, words: &[&str]) {
    let before = fs::read(db).unwrap();
    let plan = file(directory, "plan.json", &plan(1.0, 2));
    let words = [words, &[Path::new(db).file_name().unwrap().to_str().unwrap()]].concat();
    refused(&["serve", "--db", db, "--http", "127.0.0.1:0"], &words).await;
    refused(&["run", &plan, "--db", db], &words).await;
    refused(&["cancel", "1", "--db", db], &words).await;
    assert!(fs::read(db).unwrap() == before, "{db} was changed");
}

/// The same for commands that only read.
async fn refused_by_readers(directory: &TempDir, db: &str, words: &[&str]) {
    let before = fs::read(db).unwrap();
    let copy = path(directory, "copy-of-it.db");
    refused(&["status", "--db", db], words).await;
    refused(&["backup", "--db", db, "--to", &copy], words).await;
    assert!(fs::read(db).unwrap() == before, "{db} was changed");
    assert!(!Path::new(&copy).exists());
}

#[tokio::test]
async fn a_database_of_another_version_or_program_is_left_alone() {
    let directory = directory();
    let newer = path(&directory, "newer.db");
    database(&directory, &newer).await;
    let later = "insert into _sqlx_migrations (version, description, success, checksum, execution_time)
        values (9999, 'later', 1, x'00', 0)";
    execute(&newer, later).await;
    refused_by_all(&directory, &newer, &["9999", "newer program"]).await;
    refused_by_readers(&directory, &newer, &["9999"]).await;

    let other = path(&directory, "recipes.db");
    fs::write(&other, "").unwrap();
    execute(&other, "create table recipe (name text)").await;
    refused_by_all(&directory, &other, &["another program"]).await;
    refused_by_readers(&directory, &other, &["another program"]).await;
    assert!(!Path::new(&format!("{other}.lock")).exists(), "nothing is put beside it either");
}

#[tokio::test]
async fn a_damaged_database_is_refused_before_anything_is_written() {
    let directory = directory();
    let good = path(&directory, "good.db");
    database(&directory, &good).await;
    let bytes = fs::read(&good).unwrap();
    let page_size = usize::from(u16::from_be_bytes([bytes[16], bytes[17]]));
    let last = bytes.len() / page_size - 1;
    let broken = path(&directory, "broken.db");
    for page in [2, last / 2, last] {
        let mut bytes = bytes.clone();
        // The head of a page says what is where in it.
        bytes[page * page_size..page * page_size + 16].iter_mut().for_each(|byte| *byte ^= 0xff);
        fs::write(&broken, &bytes).unwrap();
        refused_by_all(&directory, &broken, &["damaged", "backup"]).await;
    }
    fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    refused_by_all(&directory, &broken, &["damaged", "backup"]).await;
    refused_by_readers(&directory, &broken, &["damaged"]).await;
}

#[tokio::test]
async fn a_second_coordinator_is_refused_and_readers_are_not() {
    let directory = directory();
    let (db, alias) = (path(&directory, "served.db"), path(&directory, "alias.db"));
    let mut server = Server::start(&db, 1).await;
    std::os::unix::fs::symlink(&db, &alias).unwrap();
    let sweep = server.submit(&json!({"plan": plan(1.0, 2)})).await;
    server.done(sweep).await;

    let pid = server.process.child.id().unwrap().to_string();
    let plan = file(&directory, "plan.json", &plan(1.0, 3));
    let words = ["served.db", "in use", &pid, "--url"];
    for db in [&db, &alias] {
        refused(&["serve", "--db", db, "--http", "127.0.0.1:0"], &words).await;
        refused(&["run", &plan, "--db", db], &words).await;
        for command in [&["pause", "1"][..], &["cancel", "1"], &["retry", "1"], &["submit", &plan]] {
            refused(&[command, &["--db", db]].concat(), &words).await;
        }
        assert_eq!(process::json(&["status", "1", "--db", db, "--json"]).await["done"], 8);
        assert_eq!(process::json(&["job", "1", "--db", db, "--json"]).await["state"], "done");
        let table = process::finished(&["table", "1", "--db", db, "--format", "csv"]).await;
        assert_eq!(table.stdout, server.text("/v1/sweeps/1/table?format=csv").await);
    }

    server.process.child.kill().await.unwrap();
    let mut server = Server::start(&db, 0).await;
    assert_eq!(server.done(sweep).await["done"], 8, "a lock goes with its process");
    assert_eq!(server.process.terminate(Duration::from_secs(10)).await.code(), Some(0));
    let submitted = process::json(&["submit", &plan, "--db", &db, "--json"]).await;
    assert_eq!((&submitted["total"], &submitted["cached"]), (&json!(12), &json!(8)));
}

#[tokio::test]
async fn a_read_only_database_is_read_and_not_served() {
    let directory = directory();
    let Some(mount) = Mount::of_mib(4) else { return };
    let db = mount.path("archive.db");
    database(&directory, &db).await;
    let table = process::finished(&["table", "1", "--db", &db, "--format", "csv"]).await;
    mount.make_read_only();
    refused_by_all(&directory, &db, &["ead-only"]).await;
    let again = process::finished(&["table", "1", "--db", &db, "--format", "csv"]).await;
    assert_eq!((again.code, again.stdout), (Some(0), table.stdout));
    let copy = path(&directory, "copy.db");
    let backup: Value = process::json(&["backup", "--db", &db, "--to", &copy, "--json"]).await;
    assert_eq!((&backup["sweeps"], &backup["results"]), (&json!(1), &json!(8)));
}

#[tokio::test]
async fn a_read_only_file_in_a_folder_that_can_be_written_is_not_served() {
    let directory = directory();
    let Some(mount) = Mount::of_mib(4) else { return };
    let db = mount.path("archive.db");
    database(&directory, &db).await;
    mount.make_file_read_only("archive.db");
    refused_by_all(&directory, &db, &["read-only"]).await;
    assert_eq!(process::json(&["status", "1", "--db", &db, "--json"]).await["done"], 8);
}
