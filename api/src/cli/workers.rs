//! `furrow workers`: who works; and turning a worker away, or letting it in for a time.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use furrow_schema::id::WorkerId;
use reqwest::Method;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use super::progress::span;
use super::time::seconds;
use crate::http::workers::{EnrolledBy, WorkerLine, WorkerPatch, WorkerState, Workers};
use crate::table::{Column, Entry, Format, Grid, render};

/// List workers, turn one away, or let it in for a time
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(super) struct WorkersArgs {
    #[command(subcommand)]
    change: Option<Change>,
    #[command(flatten)]
    source: Source,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Subcommand)]
enum Change {
    /// Turn a worker away for good; what it holds goes to others at once
    Revoke {
        #[command(flatten)]
        target: Target,
    },
    /// Let a worker in for a time from now, or for good
    Expire {
        #[command(flatten)]
        target: Target,
        /// For so long, such as 30m, 12h or 7d
        #[arg(long = "in", value_name = "TIME", value_parser = seconds, required_unless_present = "never")]
        after: Option<u64>,
        /// For good
        #[arg(long, conflicts_with = "after")]
        never: bool,
    },
}

/// Which worker, where, and how to answer.
#[derive(Debug, clap::Args)]
struct Target {
    /// The worker's id, from the list
    #[arg(value_parser = worker)]
    worker: WorkerId,
    #[command(flatten)]
    source: Source,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

fn worker(text: &str) -> Result<WorkerId, String> {
    WorkerId::try_from(text.to_owned()).map_err(|error| error.to_string())
}

/// # Errors
/// The server is away, or there is no such worker.
pub(super) async fn run(args: WorkersArgs) -> Result<(), CliError> {
    let source = match &args.change {
        None => &args.source,
        Some(Change::Revoke { target } | Change::Expire { target, .. }) => &target.source,
    };
    let client = Client::open(source).await?;
    let ended = match &args.change {
        None => list(&client, args.json).await,
        Some(change) => apply(&client, change).await,
    };
    client.close().await;
    ended
}

async fn list(client: &Client, json: bool) -> Result<(), CliError> {
    let workers: Workers = client.get(&["v1", "workers"], &[]).await?;
    if json { output::json(&workers) } else { output::line(&table(&workers.items, now_ms())) }
}

async fn apply(client: &Client, change: &Change) -> Result<(), CliError> {
    let (Change::Revoke { target } | Change::Expire { target, .. }) = change;
    let path = ["v1", "workers", target.worker.as_str()];
    let changed: WorkerLine = match change {
        Change::Revoke { .. } => client.change(Method::DELETE, &path, None::<&()>).await?,
        Change::Expire { after, .. } => {
            let until = |after: &u64| now_ms().saturating_add(i64::try_from(after * 1_000).unwrap_or(i64::MAX));
            let patch = WorkerPatch { until_ms: after.as_ref().map(until) };
            client.change(Method::PATCH, &path, Some(&patch)).await?
        }
    };
    if target.json { output::json(&changed) } else { output::line(&table(&[changed], now_ms())) }
}

fn table(workers: &[WorkerLine], now_ms: i64) -> String {
    let words = ["worker", "name", "state", "let in by", "until", "seen"].map(Column::left);
    let numbers = ["threads", "jobs", "results", "runs/s"].map(Column::right);
    let columns = words.into_iter().chain(numbers).collect();
    let rows = workers.iter().map(|worker| row(worker, now_ms)).collect();
    render(&Grid { columns, rows, ..Grid::default() }, Format::Text)
}

fn row(worker: &WorkerLine, now_ms: i64) -> Vec<Entry> {
    let state = match worker.state {
        WorkerState::Live => "live",
        WorkerState::Away => "away",
        WorkerState::Expired => "expired",
        WorkerState::Revoked => "revoked",
    };
    let let_in_by = match worker.enrolled_by {
        EnrolledBy::Hello => "hello",
        EnrolledBy::JoinSecret => "join secret",
    };
    let seconds = |ms: i64| Duration::from_millis(u64::try_from(ms).unwrap_or(0)).as_secs_f64();
    let until = match worker.until_ms {
        Some(until_ms) if until_ms > now_ms => format!("in {}", span(seconds(until_ms - now_ms))),
        Some(_) => "over".to_owned(),
        None => String::new(),
    };
    let seen = format!("{} ago", span(seconds(now_ms - worker.last_seen_ms)));
    let id = worker.id.to_string();
    let words = [id, worker.name.clone(), state.to_owned(), let_in_by.to_owned(), until, seen].map(Entry::Text);
    let counts = [u64::from(worker.threads), worker.leased, worker.results].map(Entry::Count);
    let rate = Entry::Text(worker.rate_per_s.map(|rate| format!("{rate:.1}")).unwrap_or_default());
    words.into_iter().chain(counts).chain([rate]).collect()
}

/// This machine's time [ms since 1970].
fn now_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use furrow_schema::id::EngineId;

    use super::*;

    #[test]
    fn a_line_says_who_a_worker_is_and_how_long_it_is_let_in() {
        let worker = WorkerLine {
            id: WorkerId::random(),
            name: "barn".to_owned(),
            state: WorkerState::Live,
            engine: EngineId([1; 32]),
            threads: 2,
            enrolled_by: EnrolledBy::JoinSecret,
            leased: 3,
            results: 40,
            rate_per_s: Some(1.25),
            first_seen_ms: 0,
            last_seen_ms: 8_000,
            certificate_until_ms: Some(1),
            until_ms: Some(70_000),
            revoked_ms: None,
        };
        let shown = table(std::slice::from_ref(&worker), 10_000);
        let line = shown.lines().find(|line| line.contains("barn")).unwrap();
        let words: Vec<_> = line.split_whitespace().collect();
        let id = worker.id.to_string();
        let expected =
            ["barn", "live", "join", "secret", "in", "1", "min", "00", "s", "2.0", "s", "ago", "2", "3", "40", "1.2"];
        assert_eq!((words[0], &words[1..]), (id.as_str(), &expected[..]));
        let over = WorkerLine { until_ms: Some(9_000), ..worker };
        assert!(table(&[over], 10_000).contains("over"));
    }
}
