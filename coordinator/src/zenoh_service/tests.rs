use std::time::Duration;

use furrow_schema::protocol::{Leases, Recorded, Refusal, Reply, Report, RunReport, work_key, worker_key};
use serde::Serialize;
use serde::de::DeserializeOwned;
use zenoh::query::ConsolidationMode;

use super::*;
use crate::testing::{Bench, ENGINE, Worker, done, sweep};

const PATIENCE: Duration = Duration::from_secs(10);

async fn client(endpoint: &str) -> Session {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"").unwrap();
    config.insert_json5("connect/endpoints", &serde_json::json!([endpoint]).to_string()).unwrap();
    config.insert_json5("scouting/multicast/enabled", "false").unwrap();
    zenoh::open(config).await.unwrap()
}

async fn ask<A: DeserializeOwned>(session: &Session, key: &str, question: &impl Serialize) -> Option<Reply<A>> {
    let replies = session
        .get(key)
        .payload(serde_json::to_vec(question).unwrap())
        .consolidation(ConsolidationMode::None)
        .timeout(PATIENCE)
        .await
        .unwrap();
    let reply = replies.recv_async().await.ok()?;
    let sample = reply.into_result().unwrap();
    Some(serde_json::from_slice(&sample.payload().to_bytes()).unwrap())
}

async fn tokens(session: &Session, namespace: &str) -> Vec<String> {
    let replies = session.liveliness().get(coordinator_key(namespace, "*")).timeout(PATIENCE).await.unwrap();
    let mut keys = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        keys.push(reply.into_result().unwrap().key_expr().to_string());
    }
    keys
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_finds_the_coordinator_and_runs_its_jobs_over_the_network() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 2)).await;
    let config = ZenohConfig { namespace: "test-1".to_owned(), ..ZenohConfig::default() };
    let service = serve(bench.coordinator.clone(), config).await.unwrap();
    let session = client(&service.endpoints()[0]).await;
    let id = bench.coordinator.id();
    assert_eq!(tokens(&session, "test-1").await, [coordinator_key("test-1", id)]);
    assert!(tokens(&session, "elsewhere").await.is_empty());

    let worker = Worker::new(&bench.coordinator);
    let key = |method| key("test-1", id, method);
    let early: Reply<Leases> = ask(&session, &key(Method::Claim), &worker.claim_call(1)).await.unwrap();
    assert_eq!(early, Reply::Refused(Refusal::UnknownWorker));
    worker.hello().await;
    let leases: Reply<Leases> = ask(&session, &key(Method::Claim), &worker.claim_call(8)).await.unwrap();
    let jobs = leases.into_result().unwrap().jobs;
    assert_eq!(jobs.len(), 2);
    let runs = jobs.iter().map(|job| RunReport { job: job.job, attempt: 1, ended: done(1.0) }).collect();
    let report = worker.call(Report { engine: ENGINE, runs });
    let recorded: Reply<Recorded> = ask(&session, &key(Method::Result), &report).await.unwrap();
    assert_eq!(recorded.into_result().unwrap().recorded.len(), 2);
    let garbage: Reply<Leases> = ask(&session, &key(Method::Renew), &"garbage").await.unwrap();
    assert!(matches!(garbage, Reply::Refused(Refusal::Malformed { .. })));
    bench.assert_consistent().await;

    service.close().await;
    assert_eq!(ask::<Leases>(&session, &key(Method::Claim), &worker.claim_call(1)).await, None);
    session.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scout_on_this_machine_is_told_the_endpoint() {
    let bench = Bench::new().await;
    let service = serve(bench.coordinator.clone(), ZenohConfig::default()).await.unwrap();
    let mut config = zenoh::Config::default();
    config.insert_json5("scouting/multicast/interface", "\"127.0.0.1\"").unwrap();
    let scout = zenoh::scout(zenoh::config::WhatAmI::Peer, config).await.unwrap();
    let found = tokio::time::timeout(PATIENCE, async {
        loop {
            let hello = scout.recv_async().await.unwrap();
            let locators: Vec<_> = hello.locators().iter().map(ToString::to_string).collect();
            if locators == service.endpoints() {
                return;
            }
        }
    });
    found.await.expect("the coordinator answers a scout on the loopback interface");
    service.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn two_coordinators_cannot_share_a_port() {
    let (first, second) = (Bench::new().await, Bench::new().await);
    let service = serve(first.coordinator.clone(), ZenohConfig::default()).await.unwrap();
    let endpoint = service.endpoints()[0].clone();
    let error = serve(second.coordinator.clone(), ZenohConfig::on(&endpoint)).await.unwrap_err();
    assert_eq!(error, ZenohError::Busy(endpoint));
    service.close().await;
}

/// A worker's session with its token shown, so far as the coordinator knows.
async fn alive(session: &Session, namespace: &str, bench: &Bench, worker: &Worker) -> LivelinessToken {
    let key = worker_key(namespace, bench.coordinator.id(), worker.id.as_str());
    session.liveliness().declare_token(key).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_jobs_of_a_worker_whose_token_went_are_free_soon_and_idle_workers_hear_of_it() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 1)).await;
    let config = ZenohConfig { namespace: "test-gone".to_owned(), ..ZenohConfig::default() };
    let service = serve(bench.coordinator.clone(), config).await.unwrap();
    let (dying, idle) = (client(&service.endpoints()[0]).await, client(&service.endpoints()[0]).await);
    let hints = idle.declare_subscriber(work_key("test-gone", bench.coordinator.id())).await.unwrap();
    let (worker, other) = (bench.worker().await, bench.worker().await);
    let _token = alive(&dying, "test-gone", &bench, &worker).await;
    let job = worker.claim(1).await.remove(0);
    let mut work = bench.coordinator.work();
    work.mark_unchanged();

    dying.close().await.unwrap();
    tokio::time::timeout(PATIENCE, work.changed()).await.expect("its lease is ended").unwrap();

    assert_eq!(other.claim(1).await[0].attempt, job.attempt + 1);
    tokio::time::timeout(PATIENCE, hints.recv_async()).await.expect("an idle worker hears of it").unwrap();
    service.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_flapping_token_does_no_harm_to_a_worker_that_asks() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 1)).await;
    let config = ZenohConfig { namespace: "test-flap".to_owned(), ..ZenohConfig::default() };
    let service = serve(bench.coordinator.clone(), config).await.unwrap();
    let forger = client(&service.endpoints()[0]).await;
    let worker = bench.worker().await;
    let jobs = worker.claim(1).await;
    // Long enough for what is decided after the grace period to be seen.
    let until = tokio::time::Instant::now() + Duration::from_millis(2_500);
    let mut ticks = tokio::time::interval(Duration::from_millis(100));
    while tokio::time::Instant::now() < until {
        ticks.tick().await;
        drop(alive(&forger, "test-flap", &bench, &worker).await);
        bench.clock.advance(100);
        assert!(worker.renew(&jobs, true).await.lost.is_empty());
    }
    service.close().await;
}
