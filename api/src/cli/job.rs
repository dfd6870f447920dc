//! `furrow job`: one run, with a drawing of it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use crate::http::jobs::Job;

/// Show one run, or draw it
#[derive(Debug, clap::Args)]
pub(super) struct JobArgs {
    /// Its number, its key, or the first digits of its key (8 or more)
    job: String,
    #[command(flatten)]
    source: Source,
    /// Write a drawing of field, path and damage to this file; the run is repeated for it
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// The server is away, there is no such job, or it has no result to draw.
pub(super) async fn run(args: JobArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let ended = show(&client, &args).await;
    client.close().await;
    ended
}

async fn show(client: &Client, args: &JobArgs) -> Result<(), CliError> {
    let job: Job = client.get(&["v1", "jobs", &args.job], &[]).await?;
    if let Some(file) = &args.svg {
        let svg = client.text(&["v1", "jobs", &args.job, "trajectory.svg"], &[]).await?;
        std::fs::write(file, svg).map_err(CliError::bad_input(format_args!("--svg {}", file.display())))?;
    }
    if args.json { output::json(&job) } else { output::line(&text(&job)) }
}

fn text(job: &Job) -> String {
    let mut text = format!("job {} {}, seed {}\nkey {}\n", job.id, job.state.as_str(), job.seed, job.key);
    for cell in &job.cells {
        let _ = writeln!(text, "sweep {}: {}", cell.sweep, labels(&cell.factors));
    }
    for attempt in &job.attempts {
        let reason = attempt.reason.as_ref().map(|reason| format!(": {reason}")).unwrap_or_default();
        let _ = writeln!(text, "attempt {} at {}: {}{reason}", attempt.attempt, attempt.worker, attempt.end);
    }
    if let (Some(outcome), Some(digest)) = (&job.outcome, job.digest) {
        let _ = writeln!(text, "outcome {outcome}, digest {digest}");
    }
    for (metric, value) in &job.metrics {
        let _ = writeln!(text, "  {metric} {value}");
    }
    if let Some(timings) = &job.timings {
        let _ = writeln!(text, "took {:.1} ms on {}", timings.wall_ms, timings.cpu_model);
    }
    // A panic's message or a name may hold anything, and must not steer the terminal.
    text.replace(|c: char| c.is_control() && c != '\n', "?")
}

fn labels(factors: &BTreeMap<String, String>) -> String {
    let words: Vec<_> = factors.iter().map(|(factor, label)| format!("{factor}={label}")).collect();
    words.join(", ")
}
