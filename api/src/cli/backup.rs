//! `furrow backup`: a copy of a database, in use or not.

use std::path::PathBuf;

use furrow_coordinator::{Backup, Store};
use serde_json::json;

use super::error::CliError;
use super::{output, stop};

/// Copy a database to a new file, while a server uses it or not
#[derive(Debug, clap::Args)]
pub(super) struct BackupArgs {
    /// The database
    #[arg(long, value_name = "FILE")]
    db: PathBuf,
    /// The copy; nothing may be there yet
    #[arg(long, value_name = "FILE")]
    to: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// Bad input: there is no such database, it cannot be used, or the copy cannot be written there. Otherwise the disk is
/// full, or the user stopped it. What was begun is removed.
pub(super) async fn run(args: BackupArgs) -> Result<(), CliError> {
    let stop = stop::on_signals()?;
    let Backup { bytes, sweeps, jobs, results } = tokio::select! {
        copied = Store::backup(&args.db, &args.to) => copied?,
        () = stop.cancelled() => return Err(CliError::Stopped),
    };
    let file = args.to.display().to_string();
    if args.json {
        return output::json(
            &json!({"file": file, "bytes": bytes, "sweeps": sweeps, "jobs": jobs, "results": results}),
        );
    }
    output::line(&format!("{file}: {sweeps} sweeps, {jobs} jobs, {results} results, {bytes} bytes"))
}
