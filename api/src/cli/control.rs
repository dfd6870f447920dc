//! `furrow pause`, `furrow cancel` and `furrow retry`: what a user does to a sweep that is under way.

use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};
use reqwest::Method;
use serde_json::json;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use super::status::word;
use crate::http::sweep_control::SweepPatch;

/// Which sweep, where, and how to answer.
#[derive(Debug, clap::Args)]
struct Target {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    source: Source,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Let a sweep's jobs wait; those that run may end
#[derive(Debug, clap::Args)]
pub(super) struct PauseArgs {
    #[command(flatten)]
    target: Target,
    /// Let them go on
    #[arg(long)]
    resume: bool,
}

/// Give up a sweep's jobs, as far as no other sweep wants them
#[derive(Debug, clap::Args)]
pub(super) struct CancelArgs {
    #[command(flatten)]
    target: Target,
    /// Remove the sweep, too, with the results that no other sweep lists
    #[arg(long)]
    purge: bool,
}

/// Run a sweep's failed and cancelled jobs again
#[derive(Debug, clap::Args)]
pub(super) struct RetryArgs {
    #[command(flatten)]
    target: Target,
}

/// What is asked.
enum Request {
    Patch(SweepPatch),
    Cancel,
    Purge,
    Retry,
}

/// # Errors
/// The server is away, there is no such sweep, or it is cancelled and cannot be resumed.
pub(super) async fn pause(args: PauseArgs) -> Result<(), CliError> {
    run(args.target, Request::Patch(SweepPatch { priority: None, paused: Some(!args.resume) })).await
}

/// # Errors
/// The server is away, or there is no such sweep.
pub(super) async fn cancel(args: CancelArgs) -> Result<(), CliError> {
    run(args.target, if args.purge { Request::Purge } else { Request::Cancel }).await
}

/// # Errors
/// The server is away, or there is no such sweep.
pub(super) async fn retry(args: RetryArgs) -> Result<(), CliError> {
    run(args.target, Request::Retry).await
}

async fn run(target: Target, request: Request) -> Result<(), CliError> {
    let client = Client::open_to_change(&target.source).await?;
    let ended = send(&client, &target, request).await;
    client.close().await;
    ended
}

async fn send(client: &Client, target: &Target, request: Request) -> Result<(), CliError> {
    let id = target.sweep.to_string();
    let path = ["v1", "sweeps", &id];
    let sweep: Sweep = match request {
        Request::Patch(patch) => client.change(Method::PATCH, &path, Some(&patch)).await?,
        Request::Cancel => client.change(Method::DELETE, &path, None::<&()>).await?,
        Request::Retry => client.change(Method::POST, &["v1", "sweeps", &id, "retry"], None::<&()>).await?,
        Request::Purge => {
            client.remove(&path, &[("purge", "true")]).await?;
            let removed = json!({"id": target.sweep, "state": "removed"});
            return if target.json { output::json(&removed) } else { output::line(&format!("sweep {id} is removed")) };
        }
    };
    if target.json { output::json(&sweep) } else { output::line(&sentence(&sweep)) }
}

/// Where a sweep stands, in a sentence.
pub(super) fn sentence(sweep: &Sweep) -> String {
    let Sweep { id, done, total, state, .. } = sweep;
    let others =
        [("queued", sweep.queued), ("running", sweep.leased), ("failed", sweep.failed), ("cancelled", sweep.cancelled)];
    let others = others.iter().filter(|(_, n)| *n > 0).map(|(what, n)| format!(", {n} {what}"));
    let also = if *state == SweepState::Paused { " (what runs may end)" } else { "" };
    format!("sweep {id} is {}{also}: {done} of {total} done{}", word(*state), others.collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::super::progress::tests::sweep;
    use super::*;

    #[test]
    fn a_sentence_counts_what_there_is() {
        let cancelled = Sweep { state: SweepState::Cancelled, queued: 0, cancelled: 9, ..sweep(3, 12) };
        assert_eq!(sentence(&cancelled), "sweep 1 is cancelled: 3 of 12 done, 9 cancelled");
        let paused = Sweep { state: SweepState::Paused, queued: 7, leased: 2, ..sweep(3, 12) };
        assert_eq!(sentence(&paused), "sweep 1 is paused (what runs may end): 3 of 12 done, 7 queued, 2 running");
        assert_eq!(sentence(&Sweep { state: SweepState::Done, ..sweep(12, 12) }), "sweep 1 is done: 12 of 12 done");
    }
}
