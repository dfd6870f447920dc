//! The routes on a real coordinator, with results that a test hands in as a worker would.

mod access;
mod catalogue;
mod comparisons;
mod control;
mod events;
mod metrics;
mod pages;
mod problems;
mod publications;
mod reports;
mod resources;
mod results;
mod runs;
mod workers;

use std::collections::BTreeMap;

use axum::body::{Body, to_bytes};
use axum::http::header::{ACCEPT, CONTENT_TYPE, IF_NONE_MATCH};
use axum::http::{HeaderMap, Request};
use furrow_coordinator::{Config, Coordinator, Store};
use furrow_schema::id::{Credential, Digest, RequestId, WorkerId};
use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::protocol::{Call, Claim, Hello, LeasedJob, Report, RunEnd, RunReport};
use serde_json::{Value, json};
use tower::ServiceExt;

use super::{Access, App, router};

/// A service whose database lives in memory.
pub(super) struct Service {
    router: axum::Router,
    coordinator: Coordinator,
    worker: WorkerId,
    credential: Credential,
}

/// An answer.
pub(super) struct Answer {
    status: u16,
    headers: HeaderMap,
    body: String,
    bytes: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|error| panic!("{error}: {}", self.body))
    }

    fn header(&self, name: &str) -> &str {
        self.headers.get(name).map_or("", |value| value.to_str().unwrap())
    }
}

impl Service {
    async fn start() -> Self {
        let store = Store::in_memory().await.unwrap();
        Self::of(Coordinator::start(store, Config::new(crate::engine())))
    }

    fn of(coordinator: Coordinator) -> Self {
        Self::with_access(coordinator, Access::default())
    }

    fn with_access(coordinator: Coordinator, access: Access) -> Self {
        let router = router(App::with_access(coordinator.clone(), access));
        Self { router, coordinator, worker: WorkerId::random(), credential: Credential::random() }
    }

    async fn send(&self, request: Request<Body>) -> Answer {
        let response = self.router.clone().oneshot(request).await.unwrap();
        let (status, headers) = (response.status().as_u16(), response.headers().clone());
        let bytes = to_bytes(response.into_body(), usize::MAX).await.unwrap().to_vec();
        Answer { status, headers, body: String::from_utf8_lossy(&bytes).into_owned(), bytes }
    }

    async fn get(&self, path: &str) -> Answer {
        self.send(Request::get(path).body(Body::empty()).unwrap()).await
    }

    async fn get_as(&self, path: &str, accept: &str) -> Answer {
        self.send(Request::get(path).header(ACCEPT, accept).body(Body::empty()).unwrap()).await
    }

    async fn get_if_changed(&self, path: &str, tag: &str) -> Answer {
        self.send(Request::get(path).header(IF_NONE_MATCH, tag).body(Body::empty()).unwrap()).await
    }

    async fn post(&self, body: &Value, headers: &[(&str, &str)]) -> Answer {
        let request = Request::post("/v1/sweeps").header(CONTENT_TYPE, "application/json");
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        self.send(request.body(Body::from(body.to_string())).unwrap()).await
    }

    /// Submits [`plan`] and runs it to its end.
    async fn with_results(seeds: u64) -> Self {
        let service = Self::start().await;
        let created = service.post(&json!({"plan": plan(), "seeds": seeds}), &[]).await;
        assert_eq!(created.status, 201, "{}", created.body);
        service.work().await;
        service
    }

    fn call<T>(&self, body: T) -> Call<T> {
        let (worker, credential) = (self.worker.clone(), self.credential.clone());
        Call { request: RequestId::random(), worker, credential, body }
    }

    /// Claims everything there is, and reports a result for each.
    async fn work(&self) {
        let engine = crate::engine();
        let hello = Hello { name: "test".to_owned(), engine, threads: 1 };
        self.coordinator.hello(self.call(hello)).await.into_result().unwrap();
        let claim = Claim { engine, want: 256, known_scenarios: Vec::new(), first: false };
        let leases = self.coordinator.claim(self.call(claim)).await.into_result().unwrap();
        let runs: Vec<RunReport> = leases.jobs.iter().map(report).collect();
        let count = runs.len();
        let recorded = self.coordinator.result(self.call(Report { engine, runs })).await.into_result().unwrap();
        assert_eq!(recorded.recorded.len(), count);
    }
}

/// A result that depends on the seed alone: half of the runs succeed.
fn report(lease: &LeasedJob) -> RunReport {
    let success = (lease.seed % 2) as f64;
    let metrics = BTreeMap::from([
        ("success".to_owned(), success),
        ("mean_squared_error_mm2".to_owned(), 10.0 * lease.seed as f64),
    ]);
    let record = RunRecord {
        digest: Digest([u8::try_from(lease.seed).unwrap(); 32]),
        outcome: if success > 0.0 { "success" } else { "lost" }.to_owned(),
        metrics,
        timings: Timings { wall_ms: 5.0, ..Timings::default() },
        trajectory: None,
    };
    RunReport { job: lease.job, attempt: lease.attempt, ended: RunEnd::Done(record) }
}

/// Two algorithms on two fields.
fn plan() -> Value {
    let patch = |key: &str, value: Value| json!({key: value});
    json!({
        "name": "guyonneau2022/two-by-two", "title": "Two algorithms on two fields.", "source": "a test", "seeds": 3,
        "base": {
            "field": {"kind": "guyonneau2022", "crop": 1, "seed": {"fixed": 1}},
            "robot": {"kind": "two-wheeled"}, "sensors": {"kind": "two-planar-lidars"},
            "perception": {"kind": "rgop"}, "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
            "mission": {"kind": "row-by-row"}, "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time"}
        },
        "factors": [
            {"name": "algorithm", "levels": [
                {"label": "rgop", "patch": patch("perception", json!({"kind": "rgop"}))},
                {"label": "oracle", "patch": patch("perception", json!({"kind": "oracle"}))}
            ]},
            {"name": "field", "levels": [
                {"label": "crop-1", "patch": {}},
                {"label": "crop-2", "patch": patch("field", json!({"crop": 2}))}
            ]}
        ]
    })
}
