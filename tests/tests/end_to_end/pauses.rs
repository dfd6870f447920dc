//! Processes that stand still for longer than a lease (SIGSTOP), and go on.

use std::time::Duration;

use serde_json::{Value, json};

use crate::kills::{LOST_OR_DOUBLED, RUN_AGAIN};
use crate::plan::{directory, path, plan};
use crate::server::Server;
use crate::survival::number;

/// Longer than a lease: the fault itself, nothing is waited for.
const STANDSTILL: Duration = Duration::from_secs(33);

/// Jobs that a worker holds.
const HELD: &str = "select count(*) from job where state = 'leased'";
/// Seeds of a sweep that is far from its end when its first job is done, even if that is seen seconds later.
const SEEDS: u64 = 25;
const JOBS: u64 = 4 * SEEDS;

/// Waits until so many jobs of the sweep are done.
async fn done(server: &Server, sweep: i64, least: u64) {
    let enough = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done >= least);
    server.until(&format!("/v1/sweeps/{sweep}"), enough).await;
}

#[tokio::test]
async fn a_worker_that_stood_still_for_longer_than_its_lease_neither_doubles_nor_fails_anything() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let server = Server::start(&db, 0).await;
    let mut still = server.worker();
    let sweep = server.submit(&json!({"plan": plan(60.0, SEEDS)})).await;
    done(&server, sweep, 1).await;
    still.signal("STOP").await;
    assert!(number(&db, HELD).await > 0, "it holds jobs");
    let other = server.worker();
    let ended = server.done(sweep).await;
    assert_eq!((ended["done"].as_u64(), ended["failed"].as_u64()), (Some(JOBS), Some(0)), "{ended}");
    assert!(number(&db, "select count(*) from job where attempt > 1").await > 0, "its jobs went to the other");

    drop(other);
    still.signal("CONT").await;
    let more = server.submit(&json!({"plan": plan(10.0, 1)})).await;
    assert_eq!(server.done(more).await["done"].as_u64(), Some(4));
    still.terminate(Duration::from_secs(20)).await;
    assert_eq!(number(&db, LOST_OR_DOUBLED).await, 0);
    assert_eq!(number(&db, RUN_AGAIN).await, 0);
}

#[tokio::test]
async fn a_coordinator_that_stood_still_for_longer_than_a_lease_charges_nobody() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let server = Server::start(&db, 0).await;
    let _workers = [server.worker(), server.worker()];
    let sweep = server.submit(&json!({"plan": plan(60.0, SEEDS)})).await;
    done(&server, sweep, 1).await;
    server.process.signal("STOP").await;
    assert!(number(&db, HELD).await > 0, "jobs are being run");
    tokio::time::sleep(STANDSTILL).await;
    server.process.signal("CONT").await;
    let ended = server.done(sweep).await;
    assert_eq!((ended["done"].as_u64(), ended["failed"].as_u64()), (Some(JOBS), Some(0)), "{ended}");
    let attempts = server.attempts(sweep).await;
    assert!(attempts.values().all(|attempts| *attempts == 1), "{attempts:?}");
    assert_eq!(number(&db, LOST_OR_DOUBLED).await, 0);
}
