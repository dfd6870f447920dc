//! `furrow compare`: two levels of a factor, or two sweeps, in pairs of runs.

use furrow_schema::id::SweepId;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;

/// Compare two levels of a factor in pairs of runs that differ in nothing else
#[derive(Debug, clap::Args)]
pub(super) struct CompareArgs {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    source: Source,
    /// The factor; with --other it may be left out, to compare all cells
    #[arg(long)]
    factor: Option<String>,
    /// Its label on side a
    #[arg(long, value_name = "LABEL")]
    a: Option<String>,
    /// Its label on side b
    #[arg(long, value_name = "LABEL")]
    b: Option<String>,
    /// Take side b from this sweep, which has the same factors
    #[arg(long, value_name = "SWEEP")]
    other: Option<SweepId>,
    /// Metrics to compare, with commas; success if not given
    #[arg(long, value_name = "METRICS")]
    metric: Option<String>,
    /// Other factors, with commas, by whose levels to answer, too
    #[arg(long, value_name = "FACTORS")]
    group_by: Option<String>,
    /// text, md, csv, json or latex
    #[arg(long, default_value = "text", conflicts_with = "json")]
    format: String,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// The server is away, there is no such sweep, or it has no such factor, label or metric.
pub(super) async fn run(args: CompareArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let ended = show(&client, &args).await;
    client.close().await;
    ended
}

async fn show(client: &Client, args: &CompareArgs) -> Result<(), CliError> {
    let other = args.other.map(|other| other.to_string());
    let given = [
        ("factor", &args.factor),
        ("a", &args.a),
        ("b", &args.b),
        ("other", &other),
        ("metric", &args.metric),
        ("group_by", &args.group_by),
    ];
    let mut query = vec![("format", if args.json { "json" } else { args.format.as_str() })];
    query.extend(given.iter().filter_map(|(key, value)| Some((*key, value.as_deref()?))));
    let path = ["v1", "sweeps", &args.sweep.to_string(), "compare"];
    if args.json {
        return output::json(&client.get::<serde_json::Value>(&path, &query).await?);
    }
    output::line(&client.text(&path, &query).await?)
}
