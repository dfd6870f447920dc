//! A copy of a database in use, and a sweep that goes on from it.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};

use crate::plan::{directory, file, path, plan};
use crate::process;
use crate::server::Server;

#[tokio::test]
async fn a_sweep_goes_on_from_a_backup_made_while_it_ran() {
    let directory = directory();
    let plan_of_it = plan(60.0, 6);
    let (plan_file, undisturbed) = (file(&directory, "plan.json", &plan_of_it), path(&directory, "undisturbed.db"));
    process::json(&["run", &plan_file, "--db", &undisturbed, "--threads", "2", "--json"]).await;
    let undisturbed = Server::start(&undisturbed, 0).await;

    let (db, copy) = (path(&directory, "served.db"), path(&directory, "copy.db"));
    let mut server = Server::start(&db, 0).await;
    let _worker = server.worker();
    let sweep = server.submit(&json!({"plan": plan_of_it})).await;
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done >= 3);
    server.until(&format!("/v1/sweeps/{sweep}"), some).await;
    let backup = process::json(&["backup", "--db", &db, "--to", &copy, "--json"]).await;
    assert_eq!((&backup["file"], &backup["sweeps"], &backup["jobs"]), (&json!(copy), &json!(1), &json!(24)));
    assert_eq!(backup["bytes"], fs::metadata(&copy).unwrap().len());
    assert!(backup["results"].as_u64().is_some_and(|results| (3..24).contains(&results)), "{backup}");

    // The database is lost; its workers find the restored one in its place.
    server.process.child.kill().await.unwrap();
    for lost in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(format!("{db}{lost}"));
    }
    let server = Server::start_at(&copy, 0, &server.endpoint).await;
    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(24), Some(0)));
    assert_eq!(server.digests(sweep).await, undisturbed.digests(1).await);
    let table = "/v1/sweeps/1/table?format=csv";
    assert_eq!(server.text(table).await, undisturbed.text(table).await);
    assert!(!Path::new(&db).exists());
}
