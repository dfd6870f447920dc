//! Workers that have wrong results, and how the others find out.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use furrow_schema::job::RunRecord;
use furrow_schema::protocol::Refusal;
use furrow_worker::{Config, ConnectConfig, Order, Runner, Simulator, Summary, Worker, WorkerError, ZenohLink};
use serde_json::{Value, json};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use crate::plan::{directory, path, plan};
use crate::server::Server;

/// A worker that is barred has left after this long, on a busy machine, too.
const LEAVES_WITHIN: Duration = Duration::from_secs(60);

/// Simulates, and says something else.
struct Liar;

impl Runner for Liar {
    type Scenario = <Simulator as Runner>::Scenario;

    fn read(&self, scenario_json: &str) -> Result<Self::Scenario, String> {
        Simulator.read(scenario_json)
    }

    fn run(&self, scenario: &Self::Scenario, order: Order, stop: &AtomicBool) -> Option<RunRecord> {
        let mut record = Simulator.run(scenario, order, stop)?;
        record.digest.0[31] ^= 1;
        Some(record)
    }
}

/// A worker in this process that lies over the network: its name, and how it ends.
async fn liar(server: &Server) -> (String, JoinHandle<Result<Summary, WorkerError>>) {
    let connect = ConnectConfig { endpoint: Some(server.endpoint.clone()), ..ConnectConfig::default() };
    let link = Arc::new(ZenohLink::connect(connect).await.unwrap());
    let config = Config { name: "liar".to_owned(), threads: 1, engine: furrow_api::engine() };
    let worker = Worker::with_runner(link, config, Liar);
    (worker.id().to_string(), tokio::spawn(worker.run(CancellationToken::new())))
}

/// Waits until nothing is left to verify; `/v1/incidents` then.
async fn verified(server: &Server) -> Value {
    let none_open = |incidents: &Value| (incidents["verified"]["open"] == 0).then(|| incidents.clone());
    server.until("/v1/incidents", none_open).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lying_worker_is_found_out_and_its_results_are_disputed() {
    let directory = directory();
    let server = Server::verifying(&path(&directory, "served.db"), "1").await;
    let (liar, lies) = liar(&server).await;
    let sweep = server.submit(&json!({"plan": plan(5.0, 2)})).await;
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done > 0);
    server.until(&format!("/v1/sweeps/{sweep}"), some).await;
    let _honest = [server.worker(), server.worker()];

    let ended = timeout(LEAVES_WITHIN, lies).await.expect("a barred worker ends").unwrap();
    assert!(matches!(ended, Err(WorkerError::Refused(Refusal::Barred { .. }))), "{ended:?}");
    server.done(sweep).await;
    let incidents = verified(&server).await;

    let lied = server.jobs(sweep).await.iter().filter(|job| job["worker"] == json!(liar)).count() as u64;
    assert!(lied > 0);
    assert_eq!(incidents["verified"]["overruled"], lied);
    assert_eq!(server.json(&format!("/v1/sweeps/{sweep}")).await["disputed"], lied);
    let of_liar = |incident: &Value| [&incident["recorded_worker"], &incident["other_worker"]].contains(&&json!(liar));
    assert!(incidents["items"].as_array().unwrap().iter().all(of_liar), "{incidents}");
    assert_eq!(incidents["verified"]["undecided"], 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_two_others_contradict_leaves_with_a_reason_and_exit_code_1() {
    let directory = directory();
    let server = Server::verifying(&path(&directory, "served.db"), "1").await;
    let mut alone = server.worker();
    let sweep = server.submit(&json!({"plan": plan(2.0, 1), "only": {"field": ["crop-1"]}})).await;
    server.done(sweep).await;
    let digests = server.digests(sweep).await;
    let _others = [liar(&server).await, liar(&server).await];

    let (code, log) = alone.ends(LEAVES_WITHIN).await;
    assert_eq!(code, Some(1), "{log}");
    assert!(log.contains("the coordinator refused this worker: this worker is barred: its result of job"), "{log}");
    assert_eq!(verified(&server).await["verified"]["overruled"], 2);
    assert_eq!(server.digests(sweep).await, digests, "nothing is overwritten");
    let job = server.json("/v1/jobs/1").await;
    assert_eq!((&job["state"], &job["verification"]["state"]), (&json!("done"), &json!("overruled")));
}
