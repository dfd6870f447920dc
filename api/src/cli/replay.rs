//! `furrow replay`: a run again, as a file for other programs.

use std::path::PathBuf;

use super::client::{Client, Source};
use super::error::CliError;
use super::whole_file;

/// Run a finished job again and write what happened for Foxglove, Rerun and other programs that read logs of robots
#[derive(Debug, clap::Args)]
pub(super) struct ReplayArgs {
    /// Its number, its key, or the first digits of its key (8 or more)
    job: String,
    #[command(flatten)]
    source: Source,
    /// Write this MCAP file, in place of one that is there: all scans, poses, the field and what was found
    #[arg(long, value_name = "FILE")]
    mcap: PathBuf,
}

/// # Errors
/// The server is away, there is no such job, it has no result or cannot be repeated, or the file cannot be written.
pub(super) async fn run(args: ReplayArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let path = ["v1", "jobs", &args.job, "replay"];
    let ended = whole_file::download(&client, &path, &[("format", "mcap")], Some(&args.mcap)).await;
    client.close().await;
    ended
}
