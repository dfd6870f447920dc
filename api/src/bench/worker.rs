//! A worker's process: the usual worker with idle runs, or one that asks for a job and reports it, one by one.

use std::path::Path;
use std::sync::{Arc, Mutex};

use furrow_schema::id::{Credential, EngineId, RequestId, WorkerId};
use furrow_schema::protocol::{Call, Claim, Hello, LeasedJob, Report, RunEnd, RunReport};
use furrow_worker::{Config, ConnectConfig, Link, LinkError, Spool, Worker, ZenohLink};
use futures::future::join_all;
use tokio_util::sync::CancellationToken;

use super::idle::{Idle, record};
use crate::cli::error::CliError;

async fn connect(endpoint: &str) -> Result<ZenohLink, CliError> {
    let config = ConnectConfig { endpoint: Some(endpoint.to_owned()), ..ConnectConfig::default() };
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
    let me = Myself { worker: WorkerId::random(), credential: Credential::random() };
    let hello = Hello { name: "one by one".to_owned(), engine, threads: 1 };
    link.hello(me.call(hello)).await?.into_result()?;
    let mut known = Vec::new();
    while !stop.is_cancelled() {
        let claim = Claim { engine, want: 1, known_scenarios: known.clone() };
        let leases = link.claim(me.call(claim)).await?.into_result()?;
        known.extend(leases.scenarios.iter().map(|scenario| scenario.id));
        let Some(job) = leases.jobs.first() else { return Ok(()) };
        link.result(me.call(Report { engine, runs: vec![done(job)] })).await?.into_result()?;
    }
    Ok(())
}

fn done(job: &LeasedJob) -> RunReport {
    RunReport { job: job.job, attempt: job.attempt, ended: RunEnd::Done(record("{}", job.seed)) }
}

struct Myself {
    worker: WorkerId,
    credential: Credential,
}

impl Myself {
    fn call<T>(&self, body: T) -> Call<T> {
        Call { request: RequestId::random(), worker: self.worker.clone(), credential: self.credential.clone(), body }
    }
}

/// Why a conversation ended before the jobs did. The benchmark fails.
#[derive(Debug, thiserror::Error)]
enum Trouble {
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Refused(#[from] furrow_schema::protocol::Refusal),
}
