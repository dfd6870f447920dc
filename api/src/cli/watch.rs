//! `furrow watch`: progress of a sweep until it has ended.

use std::time::{Duration, Instant};

use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};
use tokio::time::{MissedTickBehavior, interval};

use super::client::{Client, Server};
use super::control::sentence;
use super::error::CliError;
use super::progress::Progress;
use super::{output, stop};

/// The server is asked this often.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// A server that is away for longer than this is given up.
const PATIENCE: Duration = Duration::from_secs(30);

/// Show how a sweep gets on until it has ended
#[derive(Debug, clap::Args)]
pub(super) struct WatchArgs {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    server: Server,
    /// Print one JSON object in the end
    #[arg(long)]
    json: bool,
}

/// # Errors
/// There is no such sweep, the server is away for long, or the user stops. In the end: a job failed, or the sweep was
/// cancelled.
pub(super) async fn run(args: WatchArgs) -> Result<(), CliError> {
    let client = Client::new(&args.server)?;
    let stop = stop::on_signals()?;
    let started = Instant::now();
    let sweep: Sweep = look(&client, args.sweep).await?;
    let mut progress = Progress::start(&sweep.name, sweep.total, sweep.cached);
    let ended = tokio::select! {
        ended = watch(&client, args.sweep, &mut progress) => ended,
        () = stop.cancelled() => Err(CliError::Stopped),
    };
    progress.finish(started.elapsed().as_secs_f64());
    let sweep = ended?;
    if args.json {
        output::json(&sweep)?
    } else {
        output::line(&sentence(&sweep))?
    }
    verdict(&sweep)
}

async fn look(client: &Client, sweep: SweepId) -> Result<Sweep, CliError> {
    client.get(&["v1", "sweeps", &sweep.to_string()], &[]).await
}

/// Shows progress until the sweep has ended. A server that restarts is waited for.
async fn watch(client: &Client, id: SweepId, progress: &mut Progress) -> Result<Sweep, CliError> {
    let mut looks = interval(LOOK_EVERY);
    looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut heard = Instant::now();
    loop {
        looks.tick().await;
        match look(client, id).await {
            Ok(sweep) => {
                heard = Instant::now();
                progress.show(&sweep);
                if matches!(sweep.state, SweepState::Done | SweepState::Cancelled) {
                    return Ok(sweep);
                }
            }
            Err(CliError::Unreachable { .. }) if heard.elapsed() < PATIENCE => {}
            Err(error) => return Err(error),
        }
    }
}

/// How the command ends when the sweep has.
fn verdict(sweep: &Sweep) -> Result<(), CliError> {
    match (sweep.state, sweep.failed) {
        (SweepState::Cancelled, _) => Err(CliError::Failed(format!("sweep {} was cancelled", sweep.id))),
        (_, 0) => Ok(()),
        (_, failed) => Err(CliError::JobsFailed(failed)),
    }
}

#[cfg(test)]
mod tests {
    use super::super::progress::tests::sweep;
    use super::*;

    #[test]
    fn only_a_sweep_that_is_done_without_failures_ends_well() {
        let done = Sweep { state: SweepState::Done, ..sweep(12, 12) };
        assert!(verdict(&done).is_ok());
        let code = |sweep: &Sweep| verdict(sweep).unwrap_err().exit_code();
        assert_eq!(code(&Sweep { failed: 1, ..done.clone() }), 1);
        assert_eq!(code(&Sweep { state: SweepState::Cancelled, ..done }), 1);
    }
}
