//! `furrow report`: a sweep as one document.

use std::path::PathBuf;

use clap::ValueEnum;
use furrow_schema::id::SweepId;

use super::client::{Client, Source};
use super::error::CliError;
use super::whole_file;

/// Write one document about a sweep: tables, figures, failures, engine, seeds, and how to reproduce it
#[derive(Debug, clap::Args)]
pub(super) struct ReportArgs {
    /// The sweep's number
    sweep: SweepId,
    #[command(flatten)]
    source: Source,
    /// The form; if not given the one that the file's name ends in, else html
    #[arg(long)]
    format: Option<Form>,
    /// Write this file, in place of one that is there; standard output if not given
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Form {
    /// One page that needs nothing else
    Html,
    /// Markdown, drawings included
    Md,
}

/// # Errors
/// The server is away, there is no such sweep, or the file cannot be written.
pub(super) async fn run(args: ReportArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let path = ["v1", "sweeps", &args.sweep.to_string(), "report"];
    let format = if args.form() == Form::Md { "md" } else { "html" };
    let ended = whole_file::download(&client, &path, &[("format", format)], args.output.as_deref()).await;
    client.close().await;
    ended
}

impl ReportArgs {
    fn form(&self) -> Form {
        let ending = self.output.as_ref().and_then(|file| file.extension());
        let markdown = ending.is_some_and(|ending| ending == "md" || ending == "markdown");
        self.format.unwrap_or(if markdown { Form::Md } else { Form::Html })
    }
}
