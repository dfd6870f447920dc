//! `furrow export`: all runs of a sweep as a file.

use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use furrow_schema::id::SweepId;

use super::client::{Client, Source};
use super::error::CliError;

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
    download(client, &path, &query, args.output.as_deref()).await
}

/// Writes what the server answers to `file`, which gets its name when it is whole, or to standard output.
///
/// # Errors
/// The server refuses or is away, or the file cannot be written.
pub(super) async fn download(
    client: &Client,
    path: &[&str],
    query: &[(&str, &str)],
    file: Option<&Path>,
) -> Result<(), CliError> {
    let Some(file) = file else { return client.download(path, query, &mut std::io::stdout()).await };
    let cannot = || format!("cannot write {}", file.display());
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // As any other file of the user's; it gets its name when it is whole.
    let beside = tempfile::Builder::new().permissions(Permissions::from_mode(0o666)).tempfile_in(folder);
    let mut beside = beside.map_err(CliError::failed(cannot()))?;
    client.download(path, query, &mut beside).await?;
    beside.flush().map_err(CliError::failed(cannot()))?;
    beside.persist(file).map(drop).map_err(|error| CliError::failed(cannot())(error.error))
}
