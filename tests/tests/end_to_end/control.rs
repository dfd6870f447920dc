//! Sweeps that are paused, cancelled and retried while real workers are at them.

use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};

use crate::plan::{directory, path, plan};
use crate::process;
use crate::server::Server;

/// A cancelled sweep's runs have stopped after this long.
const STOPS_WITHIN: Duration = Duration::from_secs(2);

/// Waits until `sweep` has done some of its jobs.
async fn under_way(server: &Server, sweep: i64) {
    let leased = |jobs: &Value| jobs["items"].get(0).map(|_| ());
    server.until(&format!("/v1/jobs?sweep={sweep}&state=leased"), leased).await;
}

#[tokio::test]
async fn a_cancelled_sweep_leaves_its_worker_idle_within_two_seconds() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    let _worker = server.worker();
    // So thorough a search takes minutes a run, far longer than this test.
    let slow =
        json!({"plan": plan(3_000.0, 20), "only": {"algorithm": ["rgop"]}, "set": {"perception.iterations": 1_000}});
    let long = server.submit(&slow).await;
    under_way(&server, long).await;
    let waiting = server.submit(&json!({"plan": plan(1.0, 1), "priority": -1})).await;

    let asked = Instant::now();
    let cancelled = server.change(Method::DELETE, &format!("/v1/sweeps/{long}"), None).await;
    assert_eq!(
        (&cancelled["state"], &cancelled["leased"], &cancelled["failed"]),
        (&json!("cancelled"), &json!(0), &json!(0))
    );

    // Its one thread is free as soon as a job of the other sweep is done.
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done > 0);
    server.until(&format!("/v1/sweeps/{waiting}"), some).await;
    let idle_after = asked.elapsed();
    assert!(idle_after < STOPS_WITHIN, "{idle_after:?}");
    server.done(waiting).await;
    let stopped = server.json(&format!("/v1/sweeps/{long}")).await;
    assert_eq!((&stopped["done"], &stopped["failed"], &stopped["cancelled"]), (&json!(0), &json!(0), &json!(40)));
}

#[tokio::test]
async fn the_command_line_pauses_resumes_cancels_retries_and_watches() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    let sweep = server.submit(&json!({"plan": plan(1.0, 2)})).await.to_string();
    let run = async |words: &[&str]| {
        let args = [words, &[sweep.as_str(), "--url", &server.url, "--json"]].concat();
        process::json(&args).await
    };
    assert_eq!(run(&["pause"]).await["state"], "paused");
    assert_eq!(run(&["pause", "--resume"]).await["state"], "active");
    assert_eq!(run(&["cancel"]).await["state"], "cancelled");
    let watched = process::finished(&["watch", &sweep, "--url", &server.url]).await;
    assert!(watched.code == Some(1) && watched.stderr.contains("cancelled"), "{watched:?}");
    let _worker = server.worker();
    run(&["retry"]).await;
    let watched = run(&["watch"]).await;
    assert_eq!((&watched["state"], &watched["done"]), (&json!("done"), &json!(8)));
    assert_eq!(run(&["cancel", "--purge"]).await["state"], "removed");
    let gone = process::finished(&["watch", &sweep, "--url", &server.url]).await;
    assert_eq!(gone.code, Some(2), "{gone:?}");
}

#[tokio::test]
async fn a_sweep_in_a_file_is_cancelled_and_retried_without_a_server() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let mut server = Server::start(&db, 0).await;
    let sweep = server.submit(&json!({"plan": plan(1.0, 2)})).await.to_string();
    assert_eq!(server.process.terminate(Duration::from_secs(10)).await.code(), Some(0));
    let cancelled = process::json(&["cancel", &sweep, "--db", &db, "--json"]).await;
    assert_eq!((&cancelled["state"], &cancelled["cancelled"]), (&json!("cancelled"), &json!(8)));
    let retried = process::finished(&["retry", &sweep, "--db", &db]).await;
    assert_eq!((retried.code, retried.stdout.as_str()), (Some(0), "sweep 1 is active: 0 of 8 done, 8 queued\n"));
}

#[tokio::test]
async fn a_server_whose_own_worker_is_revoked_goes_on_for_others() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 1).await;
    let own = server.until("/v1/workers", |workers| workers["items"].get(0).map(|worker| worker["id"].clone())).await;
    server.change(Method::DELETE, &format!("/v1/workers/{}", own.as_str().unwrap()), None).await;
    let sweep = server.submit(&json!({"plan": plan(1.0, 1)})).await;
    let _other = server.worker();
    server.done(sweep).await;
    let workers: Vec<Value> = server.jobs(sweep).await.iter().map(|job| job["worker"].clone()).collect();
    assert!(workers.iter().all(|worker| *worker != own), "{workers:?}");
}
