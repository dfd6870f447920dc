//! `furrow table`: a sweep's results.

use furrow_schema::id::SweepId;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;

/// Print a table of a sweep's results
#[derive(Debug, clap::Args)]
pub(super) struct TableArgs {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    source: Source,
    /// Factors to keep, with commas; all of them if not given
    #[arg(long, value_name = "FACTORS")]
    group_by: Option<String>,
    /// Metrics to show, with commas
    #[arg(long, value_name = "METRICS")]
    metric: Option<String>,
    /// A factor whose labels become columns
    #[arg(long, value_name = "FACTOR")]
    columns: Option<String>,
    /// Statistics to show, with commas: mean, std, median, min, max, ci95, n, sum, p5, p25, p75, p95
    #[arg(long, value_name = "STATISTICS")]
    statistic: Option<String>,
    /// text, md, csv, json, latex or parquet (to a file or pipe)
    #[arg(long, default_value = "text")]
    format: String,
}

/// # Errors
/// The server is away, there is no such sweep, or it has no such factor, metric or statistic.
pub(super) async fn run(args: TableArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let ended = show(&client, &args).await;
    client.close().await;
    ended
}

async fn show(client: &Client, args: &TableArgs) -> Result<(), CliError> {
    let given = [
        ("group_by", &args.group_by),
        ("metric", &args.metric),
        ("columns", &args.columns),
        ("statistic", &args.statistic),
    ];
    let mut query = vec![("format", args.format.as_str())];
    query.extend(given.iter().filter_map(|(key, value)| Some((*key, value.as_deref()?))));
    let path = ["v1", "sweeps", &args.sweep.to_string(), "table"];
    if args.format == "parquet" {
        return client.download(&path, &query, &mut std::io::stdout()).await;
    }
    output::line(&client.text(&path, &query).await?)
}
