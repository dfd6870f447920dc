//! A worker's process: the usual worker with idle runs, or one that asks for a job and reports it, one by one.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use furrow_schema::id::{Credential, EngineId, RequestId, ScenarioId, WorkerId};
use furrow_schema::protocol::{Call, Claim, Hello, LeasedJob, Leases, Reply, Report, RunEnd, RunReport, Welcome};
use furrow_worker::{Config, ConnectConfig, Link, LinkError, Spool, Worker, ZenohLink};
use futures::future::join_all;
use tokio_util::sync::CancellationToken;

use super::idle::{Idle, record};
use crate::cli::error::CliError;

/// A busy coordinator is waited for so long.
const PATIENCE: Duration = Duration::from_secs(60);
/// A question is asked so often at most, with such a pause.
const MOST_TRIES: u32 = 50;
const PAUSE: Duration = Duration::from_millis(200);

pub(super) async fn connect(endpoint: &str) -> Result<ZenohLink, CliError> {
    let config =
        ConnectConfig { endpoint: Some(endpoint.to_owned()), patience: Some(PATIENCE), ..ConnectConfig::default() };
    Ok(ZenohLink::connect(config).await?)
}

/// Works as `furrow work` does, with its spool in `place`, until told to stop.
///
/// # Errors
/// There is no coordinator, the spool cannot be used, or the worker ends by itself.
pub async fn work(
    endpoint: &str,
    config: Config,
    place: &Path,
    runs: Idle,
    stop: CancellationToken,
) -> Result<(), CliError> {
    let spool = Spool::open(place, config.engine, Spool::DEFAULT_LIMIT_BYTES)?;
    let link = Arc::new(connect(endpoint).await?);
    let worker = Worker::with_runner(link.clone(), config, runs);
    let worker = worker.spooling(Arc::new(Mutex::new(spool)), link.coordinator());
    let ended = worker.run(stop).await;
    link.close().await;
    Ok(ended.map(|_| ())?)
}

/// Claims a job, reports it, claims the next: `at_a_time` such conversations, until told to stop.
///
/// # Errors
/// There is no coordinator, or it refuses.
pub async fn work_one_by_one(
    endpoint: &str,
    engine: EngineId,
    at_a_time: usize,
    stop: CancellationToken,
) -> Result<(), CliError> {
    let link = connect(endpoint).await?;
    let conversations = (0..at_a_time).map(|_| one_by_one(&link, engine, &stop));
    join_all(conversations).await.into_iter().collect::<Result<Vec<()>, _>>().map_err(CliError::failed("worker"))?;
    link.close().await;
    Ok(())
}

async fn one_by_one(link: &ZenohLink, engine: EngineId, stop: &CancellationToken) -> Result<(), Trouble> {
    let me = Myself::new();
    me.introduce(link, engine).await?;
    let mut known = Vec::new();
    while !stop.is_cancelled() {
        let leases = me.claim_one(link, engine, known.clone()).await?;
        known.extend(leases.scenarios.iter().map(|scenario| scenario.id));
        let Some(job) = leases.jobs.first() else { return Ok(()) };
        me.report(link, engine, job).await?;
    }
    Ok(())
}

/// A worker that speaks for itself, one message at a time.
pub(super) struct Myself {
    worker: WorkerId,
    credential: Credential,
}

impl Myself {
    pub(super) fn new() -> Self {
        Self { worker: WorkerId::random(), credential: Credential::random() }
    }

    pub(super) fn call<T>(&self, body: T) -> Call<T> {
        Call { request: RequestId::random(), worker: self.worker.clone(), credential: self.credential.clone(), body }
    }

    pub(super) async fn introduce(&self, link: &ZenohLink, engine: EngineId) -> Result<Welcome, Trouble> {
        let call = self.call(Hello { name: "benchmark".to_owned(), engine, threads: 1 });
        patiently(|| link.hello(call.clone())).await
    }

    pub(super) async fn claim_one(
        &self,
        link: &ZenohLink,
        engine: EngineId,
        known_scenarios: Vec<ScenarioId>,
    ) -> Result<Leases, Trouble> {
        let call = self.call(Claim { engine, want: 1, known_scenarios, first: false });
        patiently(|| link.claim(call.clone())).await
    }

    pub(super) async fn report(&self, link: &ZenohLink, engine: EngineId, job: &LeasedJob) -> Result<(), Trouble> {
        let ended = RunEnd::Done(record("{}", job.seed));
        let runs = vec![RunReport { job: job.job, attempt: job.attempt, ended }];
        let call = self.call(Report { engine, runs });
        patiently(|| link.result(call.clone())).await?;
        Ok(())
    }
}

/// Asks again where there is no answer, as workers do.
async fn patiently<T, F: Future<Output = Result<Reply<T>, LinkError>>>(ask: impl Fn() -> F) -> Result<T, Trouble> {
    let mut tries = 1;
    loop {
        match ask().await {
            Err(LinkError::NoAnswer(_)) if tries < MOST_TRIES => {
                tries += 1;
                tokio::time::sleep(PAUSE).await;
            }
            answer => return Ok(answer?.into_result()?),
        }
    }
}

/// Why a conversation ended before the jobs did. The benchmark fails.
#[derive(Debug, thiserror::Error)]
pub(super) enum Trouble {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Refused(#[from] furrow_schema::protocol::Refusal),
}
