//! `furrow job`: one run, with a drawing of it.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use crate::http::incidents::IncidentLine;
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
    /// Write a drawing of the graph of poses to this file, of a run in a nursery with localization; the run is repeated for it
    #[arg(long, value_name = "FILE")]
    pose_graph: Option<PathBuf>,
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
    let drawings = [("--svg", &args.svg, "trajectory.svg"), ("--pose-graph", &args.pose_graph, "pose-graph.svg")];
    for (option, file, drawing) in drawings {
        let Some(file) = file else { continue };
        let svg = client.text(&["v1", "jobs", &args.job, drawing], &[]).await?;
        std::fs::write(file, svg).map_err(CliError::bad_input(format_args!("{option} {}", file.display())))?;
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
    if let Some(verification) = &job.verification {
        let _ = writeln!(text, "verification: {}", in_words(&verification.state));
        for opinion in &verification.opinions {
            let _ = writeln!(text, "attempt {} at {}: digest {}", opinion.attempt, opinion.worker, opinion.digest);
        }
    }
    for incident in job.incidents.iter().filter(|_| job.verification.is_none()) {
        let IncidentLine { other_worker, other_digest, .. } = incident;
        let _ = writeln!(text, "DISPUTED: {other_worker} has another digest, {other_digest}");
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

/// What the state of a verification means for the result.
fn in_words(state: &str) -> String {
    let meaning = match state {
        "waits" | "leased" => "is being computed again",
        "agreed" => "computed again, with the same digest",
        "upheld" => "another worker had another digest, which was wrong",
        "overruled" => "DISPUTED: other workers have another digest, and the one on record is wrong",
        "undecided" => "DISPUTED: another worker has another digest, and nobody knows which is right",
        _ => "could not be computed again",
    };
    format!("{state}: {meaning}")
}

fn labels(factors: &BTreeMap<String, String>) -> String {
    let words: Vec<_> = factors.iter().map(|(factor, label)| format!("{factor}={label}")).collect();
    words.join(", ")
}

#[cfg(test)]
mod tests {
    use furrow_schema::id::{Digest, JobId, JobKey, WorkerId};
    use furrow_schema::job::JobState;

    use super::*;
    use crate::http::jobs::{AttemptOfJob, OpinionOfJob, VerificationOfJob};

    fn job(state: JobState) -> Job {
        Job {
            id: JobId(7),
            key: JobKey([0xab; 32]),
            state,
            seed: 3,
            priority: 0,
            cells: Vec::new(),
            attempts: Vec::new(),
            outcome: None,
            digest: None,
            metrics: BTreeMap::new(),
            timings: None,
            recorded: false,
            incidents: Vec::new(),
            verification: None,
            created_ms: 0,
            ended_ms: None,
            scenario: serde_json::Value::Null,
        }
    }

    #[test]
    fn a_quarantined_job_says_which_worker_ended_how_and_why() {
        let worker = WorkerId::random();
        let attempt = |attempt, end: &str, reason: &str| AttemptOfJob {
            attempt,
            worker: worker.clone(),
            claimed_ms: 0,
            ended_ms: Some(1),
            end: end.to_owned(),
            reason: Some(reason.to_owned()),
        };
        let attempts = vec![attempt(1, "panicked", "no\u{1b}[2J row"), attempt(2, "died", "the worker was gone")];
        let text = text(&Job { attempts, ..job(JobState::Failed) });
        assert!(text.starts_with("job 7 failed, seed 3\n"), "{text}");
        assert!(text.contains(&format!("attempt 1 at {worker}: panicked: no?[2J row\n")), "{text}");
        assert!(text.contains(&format!("attempt 2 at {worker}: died: the worker was gone\n")), "{text}");
    }

    #[test]
    fn a_disputed_result_says_so_and_who_had_which_digest() {
        let worker = WorkerId::random();
        let opinion = OpinionOfJob { attempt: 2, worker: worker.clone(), digest: Digest([1; 32]), given_ms: 0 };
        let verification = Some(VerificationOfJob { state: "overruled".to_owned(), opinions: vec![opinion] });
        let text = text(&Job { verification, ..job(JobState::Done) });
        assert!(text.contains("verification: overruled: DISPUTED"), "{text}");
        assert!(text.contains(&format!("attempt 2 at {worker}: digest 0101")), "{text}");
    }
}
