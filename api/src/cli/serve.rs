//! `furrow serve`: the coordinator, for workers and users.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use furrow_coordinator::zenoh_service::{self, ZenohConfig};
use furrow_coordinator::{Config, Store, Verify};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

use super::error::CliError;
use super::http_options::{Front, HttpOptions};
use super::{lan, output, stop};
use crate::http::{self, App};
use crate::in_process::{Farm, FarmEnd};

/// Requests under way have this long after a signal.
const FINISH_WITHIN: Duration = Duration::from_secs(5);

/// Take sweeps in over HTTP, hand their jobs to workers, keep the results
#[derive(Debug, clap::Args)]
pub(super) struct ServeArgs {
    /// The database; made if it is not there
    #[arg(long, value_name = "FILE")]
    db: PathBuf,
    #[command(flatten)]
    http: HttpOptions,
    /// Where workers connect: tcp/127.0.0.1:0 if not given, which workers on this machine find by themselves (port 0 is any
    /// free one); with --lan quic/0.0.0.0:7447, all addresses of this machine
    #[arg(long, value_name = "ENDPOINT")]
    zenoh: Option<String>,
    #[command(flatten)]
    lan: lan::LanArgs,
    /// Runs at a time in this process; 0 leaves them to `furrow work`
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=super::MAX_THREADS))]
    threads: u64,
    /// Give a job up after this many workers died while it ran there
    #[arg(long, value_name = "N", default_value_t = Config::DEFAULT_MAX_ATTEMPTS, value_parser = clap::value_parser!(u32).range(1..))]
    max_attempts: u32,
    /// Compute this share of the results again on another worker and compare, from 0 to 1
    #[arg(long, value_name = "SHARE", default_value_t = Verify::DEFAULT_SHARE, value_parser = share)]
    verify: f64,
}

/// A share as the user gives it.
///
/// # Errors
/// It is not a number from 0 to 1.
pub(super) fn share(text: &str) -> Result<f64, String> {
    let share = text.parse::<f64>().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "a number from 0 to 1 is expected".to_owned())
}

/// # Errors
/// Bad input: an address that is taken or not of this machine, a database that cannot be used.
pub(super) async fn run(args: ServeArgs) -> Result<(), CliError> {
    let listener = listen(args.http.address).await?;
    let stop = stop::on_signals()?;
    let leases_hold_for = Config::WORKERS_ARE_BACK_WITHIN;
    let (max_attempts, verify) = (args.max_attempts, Verify::share(args.verify));
    let config = Config { max_attempts, leases_hold_for, verify, ..Config::new(crate::engine()) };
    let mut workers = ZenohConfig { local_network: args.lan.network(&args.db, &config)?, ..ZenohConfig::default() };
    workers.listen = vec![args.zenoh.unwrap_or_else(|| args.lan.default_endpoint().to_owned())];
    let store = open(&args.db).await?;
    let front = args.http.front(&args.db)?;
    let farm = Farm::start(store, config, args.threads as usize);
    serve(listener, front, workers, &args.lan, farm, stop).await
}

async fn serve(
    listener: TcpListener,
    front: Front,
    config: ZenohConfig,
    lan: &lan::LanArgs,
    mut farm: Farm,
    stop: CancellationToken,
) -> Result<(), CliError> {
    let service = match zenoh_service::serve(farm.coordinator().clone(), config).await {
        Ok(service) => service,
        Err(error) => {
            farm.stop().await;
            return Err(CliError::BadInput(format!("--zenoh: {error}")));
        }
    };
    let address = listener.local_addr().map_err(CliError::failed("cannot tell the address"))?;
    let told = match service.gate() {
        Some(gate) => lan.tell_first_secret(gate).await,
        None => Ok(()),
    };
    // A service outlives whoever read its first lines.
    let _ = announce(&address, &front, service.endpoints());
    let app = App::with_access(farm.coordinator().clone(), front.access).with_gate(service.gate().cloned());
    let ended = tokio::select! {
        biased;
        error = refused(told) => Err(error),
        ended = http::serve(listener, app, stop.clone()) => ended.map_err(CliError::failed("HTTP failed")),
        end = without_coordinator(&mut farm) => Err(CliError::Failed(end.to_string())),
        () = overdue(&stop) => Ok(()),
    };
    service.close().await;
    farm.stop().await;
    ended
}

/// Waits until the coordinator ends; without a worker of its own it serves others.
async fn without_coordinator(farm: &mut Farm) -> FarmEnd {
    loop {
        match farm.ended().await {
            end @ FarmEnd::Worker(_) => tracing::error!("{end}; the coordinator goes on for others"),
            FarmEnd::Coordinator => return FarmEnd::Coordinator,
        }
    }
}

/// The error; never, without one.
async fn refused(outcome: Result<(), CliError>) -> CliError {
    match outcome {
        Ok(()) => std::future::pending().await,
        Err(error) => error,
    }
}

/// Requests under way had their time after `stop`.
async fn overdue(stop: &CancellationToken) {
    stop.cancelled().await;
    tokio::time::sleep(FINISH_WITHIN).await;
}

fn announce(http: &SocketAddr, front: &Front, workers: &[String]) -> Result<(), CliError> {
    let scheme = if front.access.tls.is_some() { "https" } else { "http" };
    output::line(&format!("listening on {scheme}://{http}"))?;
    if let Some((file, fingerprint)) = &front.certificate {
        output::line(&format!("certificate {}, SHA-256 {fingerprint}", file.display()))?;
    }
    workers.iter().try_for_each(|endpoint| output::line(&format!("workers connect to {endpoint}")))
}

async fn listen(address: SocketAddr) -> Result<TcpListener, CliError> {
    let refuse = |reason: String| CliError::BadInput(format!("--http {address}: {reason}"));
    TcpListener::bind(address).await.map_err(|error| refuse(error.to_string()))
}

/// Opens the database in `file`, creating it if it is not there.
///
/// # Errors
/// Bad input: it cannot be opened or created, or is not one that this program knows.
pub(super) async fn open(file: &Path) -> Result<Store, CliError> {
    Ok(Store::open(file).await?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_a_number_from_0_to_1() {
        assert_eq!(["0", "0.01", "1"].map(|text| share(text).unwrap()), [0.0, 0.01, 1.0]);
        for wrong in ["-0.1", "1.01", "NaN", "inf", "1%", ""] {
            assert!(share(wrong).is_err(), "{wrong}");
        }
    }

    #[tokio::test]
    async fn a_taken_port_is_bad_input() {
        let taken = listen("127.0.0.1:0".parse().unwrap()).await.unwrap();
        let error = listen(taken.local_addr().unwrap()).await.unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("in use"), "{error}");
    }
}
