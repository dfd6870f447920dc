//! Processes that are told to stop, and what happens to their work.

use std::time::Duration;

use serde_json::{Value, json};

use crate::plan::{directory, path, plan};
use crate::server::Server;

/// A worker leaves this soon. It interrupts its runs; the rest is for a busy machine.
const WORKER_LEAVES_WITHIN: Duration = Duration::from_secs(5);
const SERVER_LEAVES_WITHIN: Duration = Duration::from_secs(10);
/// Less than requests under way are given.
const LISTENERS_LEAVE_WITHIN: Duration = Duration::from_secs(4);

/// More than a worker can do before it is told to stop.
fn long_sweep() -> Value {
    json!({"plan": plan(60.0, 6)})
}

/// The workers that hold two jobs or more at the moment: one that runs, and one that waits.
fn busy_worker(jobs: &Value) -> Option<String> {
    let held = jobs["items"].as_array()?;
    held.get(1).and_then(|job| job["worker"].as_str()).map(str::to_owned)
}

#[tokio::test]
async fn who_listens_to_events_hears_the_end_of_the_server_and_does_not_delay_it() {
    let directory = directory();
    let mut server = Server::start(&path(&directory, "served.db"), 0).await;
    let mut listener = server.get("/v1/events").await;
    assert!(listener.chunk().await.unwrap().is_some(), "it tells of the workers at once");
    assert_eq!(server.process.terminate(LISTENERS_LEAVE_WITHIN).await.code(), Some(0));
    while listener.chunk().await.expect("the stream ends as it should").is_some() {}
}

#[tokio::test]
async fn a_worker_that_is_told_to_stop_hands_its_jobs_to_the_others() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    let mut leaving = server.worker();
    let sweep = server.submit(&long_sweep()).await;
    let leased = format!("/v1/jobs?sweep={sweep}&state=leased");
    let left = server.until(&leased, busy_worker).await;

    let _staying = server.worker();
    assert_eq!(leaving.terminate(WORKER_LEAVES_WITHIN).await.code(), Some(0));
    let still_held = server.json(&leased).await;
    assert!(still_held["items"].as_array().unwrap().iter().all(|job| job["worker"] != left.as_str()), "{still_held}");

    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(24), Some(0)));
    let mut handed_back = 0;
    for job in server.jobs(sweep).await {
        let attempts = server.json(&format!("/v1/jobs/{}", job["id"])).await["attempts"].take();
        let attempts = attempts.as_array().unwrap();
        if attempts.iter().any(|attempt| attempt["end"] == "handed-back") {
            handed_back += 1;
            let last = attempts.last().unwrap();
            assert!(last["end"] == "done" && last["worker"] != left.as_str(), "{attempts:?}");
        }
    }
    assert!(handed_back >= 2, "one ran and one waited when the worker was told to stop");
}

#[tokio::test]
async fn a_server_that_is_told_to_stop_keeps_what_is_done_and_goes_on_later() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let mut server = Server::start(&db, 1).await;
    let sweep = server.submit(&long_sweep()).await;
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done > 0);
    let done_before = server.until(&format!("/v1/sweeps/{sweep}"), some).await;
    assert_eq!(server.process.terminate(SERVER_LEAVES_WITHIN).await.code(), Some(0));

    let server = Server::start(&db, 2).await;
    let done_at_start = server.json(&format!("/v1/sweeps/{sweep}")).await["done"].as_u64().unwrap();
    assert!(done_at_start >= done_before);
    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(24), Some(0)));
}

#[tokio::test]
async fn a_worker_goes_on_with_a_coordinator_that_was_killed_and_came_back() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let mut server = Server::start(&db, 0).await;
    let _worker = server.worker();
    let sweep = server.submit(&long_sweep()).await;
    server.until(&format!("/v1/sweeps/{sweep}"), |sweep| sweep["done"].as_u64().filter(|done| *done > 0)).await;
    server.process.child.kill().await.unwrap();

    let server = Server::start_at(&db, 0, &server.endpoint).await;
    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(24), Some(0)));
}
