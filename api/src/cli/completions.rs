//! `furrow completions`: what a shell needs to complete command lines.

use clap::Command;
use clap_complete::Shell;

use super::error::CliError;
use super::output;

/// Print a completion script for a shell
#[derive(Debug, clap::Args)]
pub(super) struct CompletionsArgs {
    /// The shell
    shell: Shell,
}

/// # Errors
/// The output is closed.
pub(super) fn run(args: &CompletionsArgs, mut command: Command) -> Result<(), CliError> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "furrow", &mut script);
    output::line(&String::from_utf8_lossy(&script))
}
