//! `furrow work`: lend this machine's cores to a coordinator.

use std::sync::Arc;

use furrow_worker::{Config, ConnectConfig, ConnectError, Worker, WorkerError, ZenohLink};

use super::error::CliError;
use super::{output, stop, threads};

/// Lend this machine's cores to a coordinator until told to stop
#[derive(Debug, clap::Args)]
pub(super) struct WorkArgs {
    /// The coordinator's endpoint, such as tcp/127.0.0.1:7447; without it, one on this machine is looked for
    #[arg(long, value_name = "ENDPOINT")]
    connect: Option<String>,
    /// Runs at a time; all cores if not given
    #[arg(long, value_name = "N", value_parser = threads())]
    threads: Option<u64>,
    /// A name for people; the host's if not given
    #[arg(long)]
    name: Option<String>,
}

/// # Errors
/// Bad input: there is no coordinator, or it runs another engine. Otherwise the link or the threads fail.
pub(super) async fn run(args: WorkArgs) -> Result<(), CliError> {
    let stop = stop::on_signals()?;
    let host = Config::of_this_host();
    let config = Config {
        name: args.name.unwrap_or(host.name),
        threads: args.threads.map_or(host.threads, |threads| threads as usize),
        engine: crate::engine(),
    };
    let connecting = ZenohLink::connect(ConnectConfig { endpoint: args.connect, ..ConnectConfig::default() });
    let link = tokio::select! {
        link = connecting => Arc::new(link?),
        () = stop.cancelled() => return Ok(()),
    };
    let ended = Worker::new(link.clone(), config).run(stop).await;
    link.close().await;
    let summary = ended?;
    output::note(&format!("furrow: {} runs done, {} panicked", summary.done, summary.panicked));
    Ok(())
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
            WorkerError::Refused(_) => Self::BadInput(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}
