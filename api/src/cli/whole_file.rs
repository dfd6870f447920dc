//! Downloads to files that are there as a whole or not at all.

use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use super::client::Client;
use super::error::CliError;

/// GETs what is at `path` (its segments) with `query` into `file`, in place of one that is there, or to standard output.
///
/// # Errors
/// As [`Client::download`], or the file cannot be written.
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
