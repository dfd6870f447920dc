//! `furrow work`: lend this machine's cores to a coordinator.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use furrow_schema::protocol::Refusal;
use furrow_worker::lan::{self, EnrolError};
use furrow_worker::{
    Config, ConnectConfig, ConnectError, Spool, SpoolError, Summary, Worker, WorkerError, ZenohLink, spool,
};
use tokio_util::sync::CancellationToken;

use super::error::CliError;
use super::{join, output, stop, threads};

/// Lend this machine's cores to a coordinator until told to stop
#[derive(Debug, clap::Args)]
pub(super) struct WorkArgs {
    /// The coordinator's endpoint, such as tcp/127.0.0.1:7447; without it the one that this worker joined is reached where
    /// it said, or one on this machine is looked for
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// Join a coordinator on the local network with the join secret in this file (`-`: standard input), or, without the
    /// option, with the one in $FURROW_JOIN. Needed once
    #[arg(long, value_name = "FILE")]
    join: Option<PathBuf>,
    /// Runs at a time; all cores if not given
    #[arg(long, value_name = "N", value_parser = threads())]
    threads: Option<u64>,
    /// A name for people; the host's if not given
    #[arg(long)]
    name: Option<String>,
    /// Where finished runs are kept until the coordinator has them; each worker takes a folder of its own in it.
    /// Without it, furrow/spool in $XDG_STATE_HOME or ~/.local/state
    #[arg(long, value_name = "DIR")]
    spool: Option<PathBuf>,
    /// A worker keeps so much there, and takes on nothing more until there is room again
    #[arg(long, value_name = "MB", default_value_t = Spool::DEFAULT_LIMIT_BYTES >> 20, value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    spool_mb: u64,
}

/// # Errors
/// Bad input: there is no coordinator, it runs another engine, or the spool cannot be used. Otherwise the link or the
/// threads fail.
pub(super) async fn run(args: WorkArgs) -> Result<(), CliError> {
    let secret = join::given(args.join.as_deref())?;
    let stop = stop::on_signals()?;
    let host = Config::of_this_host();
    let config = Config {
        name: args.name.unwrap_or(host.name),
        threads: args.threads.map_or(host.threads, |threads| threads as usize),
        engine: crate::engine(),
    };
    let place = args.spool.map_or_else(spool::default_place, Ok)?;
    let spool = Arc::new(Mutex::new(Spool::open(&place, config.engine, args.spool_mb << 20)?));
    if let Some(secret) = secret {
        match stop.run_until_cancelled(lan::enrol(&secret, config.hello(), &spool)).await {
            Some(enrolled) => enrolled?,
            None => return Ok(()),
        }
    }
    let connect = connect(args.connect, &spool)?;
    let summary = work(connect, &config, &spool, &stop).await?;
    output::note(&format!("furrow: {} runs done, {} panicked", summary.done, summary.panicked));
    Ok(())
}

/// Where to look for a coordinator: an enrolled worker goes to its own, unless it is told a place without encryption.
fn connect(endpoint: Option<String>, spool: &Mutex<Spool>) -> Result<ConnectConfig, CliError> {
    let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
    let plain = endpoint.as_ref().is_some_and(|endpoint| endpoint.starts_with("tcp/"));
    let config = match spool.enrolment().filter(|_| !plain) {
        Some(enrolment) => ConnectConfig::enrolled(enrolment, &spool.key_pem()?),
        None => ConnectConfig::default(),
    };
    Ok(ConnectConfig { endpoint, ..config })
}

/// Works for one coordinator, and for another when that one is in its place, until told to stop.
async fn work(
    mut connect: ConnectConfig,
    config: &Config,
    spool: &Arc<Mutex<Spool>>,
    stop: &CancellationToken,
) -> Result<Summary, CliError> {
    let mut summary = Summary::default();
    while let Some(link) = stop.run_until_cancelled(ZenohLink::connect(connect.clone())).await {
        let link = Arc::new(link?);
        let worker = Worker::new(link.clone(), config.clone()).spooling(Arc::clone(spool), link.coordinator());
        let ended = tokio::select! {
            ended = worker.run(stop.clone()) => ended,
            never = lan::keep_fresh(&link, spool) => match never {},
        };
        link.close().await;
        match ended {
            Ok(last) => {
                summary += last;
                break;
            }
            Err(WorkerError::OtherCoordinator(coordinator)) => {
                tracing::warn!(coordinator, "another coordinator is in the old one's place: working for it");
                connect.patience = None;
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(summary)
}

impl From<EnrolError> for CliError {
    fn from(error: EnrolError) -> Self {
        match error {
            EnrolError::Spool(error) => error.into(),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

impl From<ConnectError> for CliError {
    fn from(error: ConnectError) -> Self {
        match error {
            ConnectError::Session(_) => Self::Failed(error.to_string()),
            _ => Self::BadInput(error.to_string()),
        }
    }
}

impl From<WorkerError> for CliError {
    fn from(error: WorkerError) -> Self {
        match error {
            WorkerError::Refused(Refusal::Barred { .. }) => Self::Failed(error.to_string()),
            WorkerError::Refused(_) => Self::BadInput(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl From<SpoolError> for CliError {
    fn from(error: SpoolError) -> Self {
        match error {
            SpoolError::Folder { .. } | SpoolError::NoPlace => Self::BadInput(error.to_string()),
            SpoolError::Full { .. } | SpoolError::Disk(_) => Self::Failed(error.to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_barred_worker_is_no_bad_input() {
        let refused = |refusal| CliError::from(WorkerError::Refused(refusal)).exit_code();
        assert_eq!(refused(Refusal::Barred { detail: "its result differs".to_owned() }), 1);
        assert_eq!(refused(Refusal::BadCredential), 2);
    }
}
