//! A coordinator on a database in memory with a clock moved by hand, and workers to talk to it.

use std::collections::BTreeMap;
use std::sync::Arc;

use furrow_schema::id::{Credential, Digest, EngineId, RequestId, SweepId, WorkerId};
use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::protocol::{
    Call, Claim, HeldJob, Hello, LeasedJob, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, RunEnd, RunReport,
};
use furrow_schema::sweep::{NewCell, NewSweep, Submitted, Sweep};

use crate::config::{Clock, ClockHand, Config, Verify};
use crate::coordinator::Coordinator;
use crate::store::Store;
use crate::view::{CellSummary, JobDetail, JobRef};

pub(crate) const ENGINE: EngineId = EngineId([7; 32]);
const START_MS: i64 = 1_700_000_000_000;

pub(crate) struct Bench {
    pub(crate) coordinator: Coordinator,
    pub(crate) store: Store,
    pub(crate) clock: ClockHand,
}

impl Bench {
    pub(crate) async fn new() -> Self {
        Self::over(Store::in_memory().await.unwrap())
    }

    /// Verifies a share of the results.
    pub(crate) async fn verifying(share: f64) -> Self {
        Self::with(Store::in_memory().await.unwrap(), Verify::share(share))
    }

    pub(crate) fn over(store: Store) -> Self {
        Self::with(store, Verify::NOTHING)
    }

    fn with(store: Store, verify: Verify) -> Self {
        let (clock, hand) = Clock::manual(START_MS);
        let config = Config { verify, clock, ..Config::new(ENGINE) };
        Self { coordinator: Coordinator::start(store.clone(), config), store, clock: hand }
    }

    pub(crate) async fn submit(&self, sweep: NewSweep) -> Submitted {
        self.coordinator.submit(sweep).await.unwrap()
    }

    pub(crate) async fn worker(&self) -> Worker {
        let worker = Worker::new(&self.coordinator);
        worker.hello().await;
        worker
    }

    pub(crate) async fn sweep(&self, id: SweepId) -> Sweep {
        self.coordinator.sweep(id).await.unwrap().unwrap()
    }

    pub(crate) async fn cells(&self, id: SweepId) -> Vec<CellSummary> {
        self.coordinator.cells(id).await.unwrap()
    }

    pub(crate) async fn job(&self, job: &LeasedJob) -> JobDetail {
        self.coordinator.job(JobRef::Id(job.job)).await.unwrap().unwrap()
    }

    /// Moves the clock and lets leases expire.
    pub(crate) async fn pass(&self, ms: i64) {
        self.clock.advance(ms);
        self.coordinator.keep_house().await.unwrap();
    }

    /// Every count of sweeps and cells, and every moment, is what the jobs and results say.
    pub(crate) async fn assert_consistent(&self) {
        assert_eq!(self.store.broken_rules().await.unwrap(), Vec::<&str>::new());
    }
}

/// A sweep over cells of one factor, a scenario each.
pub(crate) fn sweep(labels: &[&str], seeds: u64) -> NewSweep {
    let cell = |label: &&str| NewCell {
        factors: BTreeMap::from([("algorithm".to_owned(), (*label).to_owned())]),
        scenarios: vec![Arc::from(format!(r#"{{"algorithm":"{label}"}}"#))],
    };
    NewSweep {
        name: "a sweep".to_owned(),
        plan: "test/plan".to_owned(),
        request_json: r#"{"plan":"test/plan"}"#.to_owned(),
        engine: ENGINE,
        priority: 0,
        record: false,
        timing: false,
        seeds,
        factors: vec!["algorithm".to_owned()],
        cells: labels.iter().map(cell).collect(),
        idempotency_key: None,
    }
}

pub(crate) struct Worker {
    coordinator: Coordinator,
    pub(crate) id: WorkerId,
    pub(crate) credential: Credential,
}

impl Worker {
    pub(crate) fn new(coordinator: &Coordinator) -> Self {
        Self { coordinator: coordinator.clone(), id: WorkerId::random(), credential: Credential::random() }
    }

    pub(crate) fn call<T>(&self, body: T) -> Call<T> {
        Call { request: RequestId::random(), worker: self.id.clone(), credential: self.credential.clone(), body }
    }

    pub(crate) async fn hello(&self) {
        let hello = Hello { name: "tester".to_owned(), engine: ENGINE, threads: 2 };
        self.coordinator.hello(self.call(hello)).await.into_result().unwrap();
    }

    pub(crate) fn claim_call(&self, want: u32) -> Call<Claim> {
        self.call(Claim { engine: ENGINE, want, known_scenarios: Vec::new(), first: false })
    }

    pub(crate) async fn leases(&self, want: u32) -> Leases {
        self.coordinator.claim(self.claim_call(want)).await.into_result().unwrap()
    }

    pub(crate) async fn claim(&self, want: u32) -> Vec<LeasedJob> {
        self.leases(want).await.jobs
    }

    pub(crate) async fn report(&self, runs: Vec<RunReport>) -> Recorded {
        self.coordinator.result(self.call(Report { engine: ENGINE, runs })).await.into_result().unwrap()
    }

    /// Reports one run; true if it was accepted.
    pub(crate) async fn ended(&self, job: &LeasedJob, ended: RunEnd) -> bool {
        let recorded = self.report(vec![RunReport { job: job.job, attempt: job.attempt, ended }]).await;
        assert_eq!(recorded.recorded.len() + recorded.ignored.len(), 1);
        !recorded.recorded.is_empty()
    }

    pub(crate) async fn renew(&self, jobs: &[LeasedJob], running: bool) -> Renewed {
        let held = jobs.iter().map(|job| HeldJob { job: job.job, attempt: job.attempt, running }).collect();
        self.coordinator.renew(self.call(Renew { held })).await.into_result().unwrap()
    }
}

impl Worker {
    /// Claims one job.
    pub(crate) async fn claim_one(&self) -> LeasedJob {
        let mut jobs = self.claim(1).await;
        assert_eq!(jobs.len(), 1, "there is something to do");
        jobs.remove(0)
    }

    /// Whether it is served no more.
    pub(crate) async fn is_barred(&self) -> bool {
        let renew = self.coordinator.renew(self.call(Renew { held: Vec::new() })).await;
        matches!(renew, Reply::Refused(Refusal::Barred { .. }))
    }

    /// Why it gets nothing.
    pub(crate) async fn refusal(&self) -> Refusal {
        self.coordinator.claim(self.claim_call(1)).await.into_result().unwrap_err()
    }
}

pub(crate) fn done(value: f64) -> RunEnd {
    RunEnd::Done(record(value))
}

/// A result whose digest follows from its value.
pub(crate) fn record(value: f64) -> RunRecord {
    RunRecord {
        digest: Digest(blake3::hash(&value.to_le_bytes()).into()),
        outcome: if value < 0.0 { "lost" } else { "success" }.to_owned(),
        metrics: BTreeMap::from([("distance_m".to_owned(), value), ("success".to_owned(), 1.0)]),
        timings: Timings::default(),
        trajectory: None,
    }
}

pub(crate) fn panicked(message: &str) -> RunEnd {
    RunEnd::Panicked { message: message.to_owned() }
}
