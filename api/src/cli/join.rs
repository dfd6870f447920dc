//! Join secrets: `furrow join` makes one, `furrow work --join` reads one. None is ever taken from the command line,
//! which every process of the machine can read.

use std::fs::{self, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use furrow_schema::join::{JoinSecret, MARK};

use super::client::{Client, Server};
use super::error::CliError;
use super::output;
use super::time::seconds;
use crate::http::workers::{CreatedJoinSecret, NewJoinSecret};

/// Where a join secret is, if `--join` does not say.
const VARIABLE: &str = "FURROW_JOIN";
/// A longer text is no join secret.
const MOST_BYTES: u64 = 64 << 10;

/// Make a join secret, with which new machines on the local network enrol
#[derive(Debug, clap::Args)]
pub(super) struct JoinArgs {
    #[command(flatten)]
    server: Server,
    /// How long it can be used, such as 30m, 12h or 7d; a day if not given
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    valid: Option<u64>,
    /// How many workers may enrol with it; 100 if not given
    #[arg(long, value_name = "N")]
    uses: Option<u32>,
    /// How long these workers are let in; for good if not given
    #[arg(long, value_name = "TIME", value_parser = seconds)]
    expires: Option<u64>,
    /// Write it to a new file that only its owner reads, instead of printing it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long, conflicts_with = "out")]
    json: bool,
}

/// # Errors
/// The server is away or serves no local network, or the file cannot be written or is there already.
pub(super) async fn run(args: JoinArgs) -> Result<(), CliError> {
    let wanted = NewJoinSecret { valid_s: args.valid, uses: args.uses, workers_s: args.expires };
    let client = Client::new(&args.server)?;
    // A file that cannot be made is found out before there is a secret to lose.
    let file = args.out.as_ref().map(|path| Ok::<_, CliError>((path, new_file("--out", path)?))).transpose()?;
    let created: Result<CreatedJoinSecret, _> =
        client.change(reqwest::Method::POST, &["v1", "join-secrets"], Some(&wanted)).await;
    match (created, file) {
        (Ok(created), None) if args.json => output::json(&created),
        (Ok(created), None) => output::line(&created.secret),
        (Ok(created), Some((path, file))) => write(path, file, &created.secret),
        (Err(error), Some((path, _))) => {
            let _ = fs::remove_file(path);
            Err(error)
        }
        (Err(error), None) => Err(error),
    }
}

/// Opens a new file that only its owner reads; `key` is the option that names it.
///
/// # Errors
/// Bad input: it cannot be made, or is there already.
pub(super) fn new_file(key: &str, path: &Path) -> Result<fs::File, CliError> {
    let new = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    new.map_err(CliError::bad_input(format_args!("{key} {}", path.display())))
}

/// Writes a join secret for good.
///
/// # Errors
/// The disk is full, or fails.
pub(super) fn write(path: &Path, mut file: fs::File, secret: &str) -> Result<(), CliError> {
    let written = writeln!(file, "{secret}").and_then(|()| file.sync_all());
    written.map_err(CliError::failed(format_args!("cannot write {}", path.display())))
}

/// Reads the join secret that a worker was given: from the file `--join` names (`-` for standard input), or from the
/// environment. None if there is neither.
///
/// # Errors
/// Bad input: there is no such file, or what it holds is no join secret.
pub(super) fn given(file: Option<&Path>) -> Result<Option<JoinSecret>, CliError> {
    let (key, text) = match file {
        Some(path) if path.as_os_str().to_string_lossy().starts_with(MARK) => {
            let text = "--join names a file, or `-` for standard input: on the command line everybody on this machine \
                        can read a secret, so this one should not be used any more";
            return Err(CliError::BadInput(text.to_owned()));
        }
        Some(path) if path == Path::new("-") => ("--join -".to_owned(), read(&mut io::stdin().lock())),
        Some(path) => (format!("--join {}", path.display()), read_file(path)),
        None => match std::env::var(VARIABLE) {
            Ok(text) => (VARIABLE.to_owned(), Ok(text)),
            Err(_) => return Ok(None),
        },
    };
    let text = text.map_err(CliError::bad_input(&key))?;
    text.parse().map(Some).map_err(CliError::bad_input(&key))
}

fn read_file(path: &Path) -> io::Result<String> {
    let mut file = fs::File::open(path)?;
    if file.metadata()?.permissions().mode() & 0o077 != 0 {
        tracing::warn!(file = %path.display(), "others can read the join secret: `chmod 600` it");
    }
    read(&mut file)
}

fn read(from: &mut impl Read) -> io::Result<String> {
    let mut text = String::new();
    from.take(MOST_BYTES).read_to_string(&mut text)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_on_the_command_line_is_refused_and_not_repeated() {
        let typed = format!("{MARK}abcdef");
        let error = given(Some(Path::new(&typed))).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("--join") && !error.to_string().contains("abcdef"), "{error}");
    }

    #[test]
    fn what_is_no_secret_is_refused_by_its_file_and_not_repeated() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("secret");
        fs::write(&file, "password").unwrap();
        let error = given(Some(&file)).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        let text = error.to_string();
        assert!(text.contains(file.to_str().unwrap()) && !text.contains("password"), "{text}");
        let nowhere = folder.path().join("nowhere");
        assert!(given(Some(&nowhere)).unwrap_err().to_string().contains("nowhere"));
    }

    #[test]
    fn a_secrets_file_is_its_owners_alone_and_none_is_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("secret");
        write(&path, new_file("--out", &path).unwrap(), "a secret").unwrap();
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert!(new_file("--out", &path).unwrap_err().to_string().contains("--out"));
        assert_eq!(fs::read_to_string(&path).unwrap(), "a secret\n");
    }
}
