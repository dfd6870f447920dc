//! The same sweep gives the same bits: on any number of threads, in any database, in one process or in several.

use std::collections::BTreeMap;

use furrow_api::in_process::Farm;
use furrow_coordinator::view::JobFilter;
use furrow_coordinator::{Config, Store};
use furrow_schema::id::Digest;
use furrow_schema::sweep::{NewCell, NewSweep};
use furrow_sim::Scenario;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::plan::{directory, file, path, plan};
use crate::process;
use crate::server::{Row, Server};

const SEEDS: u64 = 3;
const RUNS: u64 = 2 * 2 * SEEDS;

fn short_plan() -> Value {
    plan(20.0, SEEDS)
}

/// Runs the plan in one process on so many threads; what it printed, and the digests in its database.
async fn run_in_one_process(directory: &TempDir, threads: &str) -> (Value, BTreeMap<Row, String>) {
    let plan = file(directory, "plan.json", &short_plan());
    let db = path(directory, &format!("{threads}-threads.db"));
    let printed = process::json(&["run", &plan, "--db", &db, "--threads", threads, "--json"]).await;
    let sweep = printed["sweep"].as_i64().unwrap();
    let server = Server::start(&db, 0).await;
    (printed, server.digests(sweep).await)
}

#[tokio::test]
async fn one_and_two_threads_give_the_same_bits() {
    let directory = directory();
    let (one, digests_of_one) = run_in_one_process(&directory, "1").await;
    let (two, digests_of_two) = run_in_one_process(&directory, "2").await;
    assert_eq!((one["runs"].as_u64(), one["failed"].as_u64(), one["cached"].as_u64()), (Some(RUNS), Some(0), Some(0)));
    assert_eq!(digests_of_one.len() as u64, RUNS);
    assert_eq!(digests_of_one, digests_of_two);
    assert_eq!(one["engine"], two["engine"]);
    assert_eq!(one["cells"], two["cells"]);
}

#[tokio::test]
async fn different_seeds_and_algorithms_give_different_bits() {
    let (_, digests) = run_in_one_process(&directory(), "2").await;
    let mut different: Vec<&String> = digests.values().collect();
    different.sort();
    different.dedup();
    assert_eq!(different.len() as u64, RUNS);
}

#[tokio::test]
async fn a_plan_that_is_run_again_in_its_database_runs_nothing() {
    let directory = directory();
    let (first, _) = run_in_one_process(&directory, "1").await;
    let (again, digests) = run_in_one_process(&directory, "1").await;
    assert_eq!((again["runs"].as_u64(), again["cached"].as_u64()), (Some(RUNS), Some(RUNS)));
    assert_eq!(again["cells"], first["cells"]);
    assert_eq!(digests.len() as u64, RUNS);
}

#[tokio::test]
async fn a_coordinator_and_two_workers_give_the_bits_of_one_process() {
    let directory = directory();
    let (printed, digests) = run_in_one_process(&directory, "2").await;

    let server = Server::start(&path(&directory, "served.db"), 0).await;
    // One after the other, so that each has a share however fast it is.
    let one = server.worker();
    let share = server.submit(&json!({"plan": short_plan(), "seeds": 1})).await;
    server.done(share).await;
    one.signal("STOP").await;
    let _other = server.worker();
    let sweep = server.submit(&json!({"plan": short_plan()})).await;
    let done = server.done(sweep).await;
    assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(RUNS), Some(0)));
    assert_eq!(done["engine"], printed["engine"]);
    assert_eq!(server.digests(sweep).await, digests);

    let mut workers: Vec<String> = server.jobs(sweep).await.iter().map(|job| job["worker"].to_string()).collect();
    workers.sort();
    workers.dedup();
    assert_eq!(workers.len(), 2, "both workers took part");
}

/// One job in a database of its own, with its own runtime.
fn digest_of_one_job(db: &std::path::Path) -> Digest {
    let mut base = short_plan()["base"].take();
    base["limits"]["max_time_s"] = json!(10.0);
    let scenario = Scenario::from_value(base).unwrap().canonical_json();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    runtime.block_on(async {
        let config = Config::new(furrow_api::engine());
        let farm = Farm::start(Store::open(db).await.unwrap(), config, 1);
        let mut changed = farm.coordinator().changed();
        let sweep = farm.coordinator().submit(sweep_of(&scenario)).await.unwrap();
        while farm.coordinator().sweep(sweep.id).await.unwrap().unwrap().done == 0 {
            changed.changed().await.unwrap();
        }
        let filter = JobFilter { sweep: Some(sweep.id), ..JobFilter::default() };
        let jobs = farm.coordinator().jobs(&filter).await.unwrap();
        farm.stop().await;
        jobs.items[0].digest.unwrap()
    })
}

fn sweep_of(scenario: &str) -> NewSweep {
    NewSweep {
        name: "one job".to_owned(),
        plan: "tests/one-job".to_owned(),
        request_json: "{}".to_owned(),
        engine: furrow_api::engine(),
        priority: 0,
        record: false,
        timing: false,
        seeds: 1,
        factors: Vec::new(),
        cells: vec![NewCell { factors: BTreeMap::new(), scenarios: vec![scenario.into()] }],
        idempotency_key: None,
    }
}

#[test]
fn one_job_in_two_threads_and_two_databases_has_one_digest() {
    let directory = directory();
    let [one, two] = ["one.db", "two.db"].map(|name| directory.path().join(name));
    let other = std::thread::spawn(move || digest_of_one_job(&two));
    let here = digest_of_one_job(&one);
    assert_eq!(other.join().unwrap(), here);
}
