//! `furrow export`: all runs of a sweep as a file.

use std::path::PathBuf;

use furrow_schema::id::SweepId;

use super::client::{Client, Source};
use super::error::CliError;
use super::whole_file;

/// Write all runs of a sweep, a row each with everything that was measured
#[derive(Debug, clap::Args)]
pub(super) struct ExportArgs {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    source: Source,
    /// csv, json (an object a line) or parquet
    #[arg(long, default_value = "csv")]
    format: String,
    /// Write this file, in place of one that is there; standard output if not given
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// # Errors
/// The server is away, there is no such sweep or format, or the file cannot be written.
pub(super) async fn run(args: ExportArgs) -> Result<(), CliError> {
    if args.output.is_none() && args.format == "parquet" {
        return Err(CliError::BadInput("--output: is missing; Parquet is not for standard output".to_owned()));
    }
    let client = Client::open(&args.source).await?;
    let ended = write(&client, &args).await;
    client.close().await;
    ended
}

async fn write(client: &Client, args: &ExportArgs) -> Result<(), CliError> {
    let sweep = args.sweep.to_string();
    let (path, query) = (["v1", "sweeps", &sweep, "results"], [("format", args.format.as_str())]);
    whole_file::download(client, &path, &query, args.output.as_deref()).await
}
