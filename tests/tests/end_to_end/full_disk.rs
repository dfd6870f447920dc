//! A disk that fills up while a sweep runs.

use std::fs;
use std::path::Path;
use std::time::Duration;

use reqwest::StatusCode;
use serde_json::{Value, json};
use tokio::time::{interval, timeout};

use crate::bad_input::refused;
use crate::mount::Mount;
use crate::plan::{directory, file, path, plan};
use crate::process;
use crate::server::Server;

/// A worker finishes some runs of these tests within this time, on a busy machine, too.
const RUNS_WITHIN: Duration = Duration::from_secs(60);

/// The records of finished runs in a worker's spool.
fn finished_runs(spool: &Path) -> usize {
    fs::read(spool).unwrap_or_default().windows(4).filter(|word| *word == b"\xF7run").count()
}

/// Keeps the disk full until `done`: what the database moves out of its log makes a little room again.
async fn keep_full(mount: &Mount, done: impl AsyncFn() -> bool) {
    let mut looks = interval(Duration::from_millis(20));
    let search = async {
        while !done().await {
            mount.fill();
            looks.tick().await;
        }
    };
    timeout(RUNS_WITHIN, search).await.expect("the disk is full for long enough");
}

#[tokio::test]
async fn a_sweep_goes_on_by_itself_when_a_full_disk_has_room_again() {
    let directory = directory();
    let Some(mount) = Mount::of_mib(6) else { return };
    // Long enough that workers have much to do when the disk turns out to be full.
    let (plan_of_it, jobs) = (plan(60.0, 30), 120);
    let (plan_file, undisturbed) = (file(&directory, "plan.json", &plan_of_it), path(&directory, "undisturbed.db"));
    process::json(&["run", &plan_file, "--db", &undisturbed, "--threads", "2", "--json"]).await;
    let undisturbed = Server::start(&undisturbed, 0).await;

    let mut server = Server::start(&mount.path("served.db"), 0).await;
    server.spool = path(&directory, "spool");
    let sweep = server.submit(&json!({"plan": plan_of_it})).await;
    let _workers = [server.worker(), server.worker()];
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done >= 2);
    server.until(&format!("/v1/sweeps/{sweep}"), some).await;

    let more = json!({"plan": plan(10.0, 1)}).to_string();
    let refused = async || {
        let response = server.post("/v1/sweeps", "application/json", more.clone()).await;
        if response.status() == StatusCode::CREATED {
            return false;
        }
        assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert!(response.headers().contains_key("retry-after"));
        let problem: Value = response.json().await.unwrap();
        problem["detail"].as_str().unwrap().contains("disk is full")
    };
    keep_full(&mount, refused).await;
    let spools = ["1", "2"].map(|worker| Path::new(&server.spool).join(worker).join("runs"));
    let held = || spools.iter().map(|spool| finished_runs(spool)).sum::<usize>();
    // Users may still read, and workers finish what they hold.
    let status = server.json(&format!("/v1/sweeps/{sweep}")).await;
    let leased = usize::try_from(status["leased"].as_u64().unwrap()).unwrap();
    assert!(leased > 0, "the disk was full before the sweep's end: {status}");
    keep_full(&mount, async || held() == leased).await;
    assert_eq!(server.get("/readyz").await.status(), StatusCode::SERVICE_UNAVAILABLE);

    mount.make_room();
    let ended = server.done(sweep).await;
    assert_eq!((ended["done"].as_u64(), ended["failed"].as_u64()), (Some(jobs), Some(0)));
    let attempts = server.attempts(sweep).await;
    assert!(attempts.values().all(|attempts| *attempts == 1), "{attempts:?}");
    assert_eq!(server.digests(sweep).await, undisturbed.digests(1).await);
    let table = format!("/v1/sweeps/{sweep}/table?format=csv");
    assert_eq!(server.text(&table).await, undisturbed.text("/v1/sweeps/1/table?format=csv").await);
}

#[tokio::test]
async fn a_backup_that_does_not_fit_leaves_nothing() {
    let directory = directory();
    let Some(mount) = Mount::of_mib(1) else { return };
    let (db, plan) = (path(&directory, "results.db"), file(&directory, "plan.json", &plan(1.0, 1)));
    process::json(&["run", &plan, "--db", &db, "--json"]).await;
    mount.fill();
    let copy = mount.path("copy.db");
    let failed = process::finished(&["backup", "--db", &db, "--to", &copy]).await;
    assert!(failed.code == Some(1) && failed.stderr.contains("disk is full"), "{failed:?}");
    assert_eq!(mount.names(), ["filler"]);
    mount.make_room();
    process::json(&["backup", "--db", &db, "--to", &copy, "--json"]).await;
    assert_eq!(mount.names(), ["copy.db"]);
    refused(&["backup", "--db", &db, "--to", &copy], &["copy.db", "there already"]).await;
}

#[tokio::test]
async fn a_server_on_a_full_disk_says_so_and_may_be_started_again() {
    let Some(mount) = Mount::of_mib(1) else { return };
    let db = mount.path("served.db");
    mount.fill();
    let failed = process::finished(&["serve", "--db", &db, "--http", "127.0.0.1:0"]).await;
    assert!(failed.code == Some(1) && failed.stderr.contains("disk is full"), "{failed:?}");
    mount.make_room();
    Server::start(&db, 0).await;
}
