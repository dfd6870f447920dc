//! The command `furrow`: a file per subcommand, and [`error`] for how each can end.

mod backup;
mod bench;
mod client;
mod compare;
mod completions;
mod control;
pub mod error;
mod examples;
mod export;
mod http_options;
mod job;
mod join;
mod lan;
mod output;
mod parameters;
mod plans;
mod progress;
mod replay;
mod report;
mod router;
mod run;
mod scans;
mod selection;
mod serve;
mod status;
mod stop;
mod submit;
mod table;
mod time;
mod token;
mod until;
mod watch;
mod whole_file;
mod work;
mod workers;

use std::ffi::OsString;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::LazyLock;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use tracing_subscriber::EnvFilter;

use error::CliError;

/// Runs closed-loop experiments of LiDAR crop-row navigation, on this machine or on many.
#[derive(Debug, Parser)]
#[command(name = "furrow", version = VERSION.as_str(), arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

static VERSION: LazyLock<String> =
    LazyLock::new(|| format!("{} (engine {})", env!("CARGO_PKG_VERSION"), crate::engine()));

#[derive(Debug, Subcommand)]
enum Command {
    Run(run::RunArgs),
    Serve(serve::ServeArgs),
    Work(work::WorkArgs),
    Join(join::JoinArgs),
    Router(router::RouterArgs),
    Workers(workers::WorkersArgs),
    Plans(plans::PlansArgs),
    Parameters(parameters::ParametersArgs),
    Scans(scans::ScansArgs),
    Submit(submit::SubmitArgs),
    Status(status::StatusArgs),
    Watch(watch::WatchArgs),
    Pause(control::PauseArgs),
    Cancel(control::CancelArgs),
    Retry(control::RetryArgs),
    Table(table::TableArgs),
    Compare(compare::CompareArgs),
    Export(export::ExportArgs),
    Report(report::ReportArgs),
    Job(job::JobArgs),
    Replay(replay::ReplayArgs),
    Bench(bench::BenchArgs),
    Backup(backup::BackupArgs),
    Token(token::TokenArgs),
    Completions(completions::CompletionsArgs),
}

impl Command {
    /// What is logged unless `FURROW_LOG` says otherwise: services tell what they do, the rest only what is wrong.
    fn default_log(&self) -> &'static str {
        match self {
            Self::Serve(_) | Self::Work(_) => "info,zenoh=error,zenoh_link_commons=error",
            _ => "warn",
        }
    }

    async fn execute(self) -> Result<(), CliError> {
        match self {
            Self::Run(args) => run::run(args).await,
            Self::Serve(args) => serve::run(args).await,
            Self::Work(args) => work::run(args).await,
            Self::Join(args) => join::run(args).await,
            Self::Router(args) => router::run(&args),
            Self::Workers(args) => workers::run(args).await,
            Self::Plans(args) => plans::run(&args),
            Self::Parameters(args) => parameters::run(&args),
            Self::Scans(args) => scans::run(&args),
            Self::Submit(args) => submit::run(args).await,
            Self::Status(args) => status::run(args).await,
            Self::Watch(args) => watch::run(args).await,
            Self::Pause(args) => control::pause(args).await,
            Self::Cancel(args) => control::cancel(args).await,
            Self::Retry(args) => control::retry(args).await,
            Self::Table(args) => table::run(args).await,
            Self::Compare(args) => compare::run(args).await,
            Self::Export(args) => export::run(args).await,
            Self::Report(args) => report::run(args).await,
            Self::Job(args) => job::run(args).await,
            Self::Replay(args) => replay::run(args).await,
            Self::Bench(args) => bench::run(args).await,
            Self::Backup(args) => backup::run(args).await,
            Self::Token(args) => token::run(args).await,
            Self::Completions(args) => completions::run(&args, command()),
        }
    }
}

/// Runs at a time, at most.
const MAX_THREADS: u64 = 4_096;

/// Reads a number of threads from 1 on.
fn threads() -> clap::builder::RangedU64ValueParser<u64> {
    clap::value_parser!(u64).range(1..=MAX_THREADS)
}

/// All commands, with examples in their help.
fn command() -> clap::Command {
    examples::with_examples(Cli::command())
}

fn parse(args: impl IntoIterator<Item = OsString>) -> Result<Cli, clap::Error> {
    Cli::from_arg_matches(&command().try_get_matches_from(args)?)
}

/// Runs the command line `args` (the program's name first) to its end.
///
/// 0: done; 1: a job failed, or the command could not finish; 2: bad input.
pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    match parse(args) {
        Ok(cli) => conclude(execute(cli.command)),
        Err(error) => {
            // Nobody is left to tell if this cannot be printed.
            let _ = error.print();
            ExitCode::from(if error.use_stderr() { 2 } else { 0 })
        }
    }
}

fn execute(command: Command) -> Result<(), CliError> {
    let filter = EnvFilter::try_from_env("FURROW_LOG").unwrap_or_else(|_| EnvFilter::new(command.default_log()));
    let colours = std::io::stderr().is_terminal();
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_ansi(colours).init();
    crate::http::tls::provide();
    let runtime = tokio::runtime::Runtime::new().map_err(CliError::failed("cannot start"))?;
    let ended = runtime.block_on(command.execute());
    // Blocking work that nobody waits for any more must not hold the process.
    runtime.shutdown_background();
    ended
}

fn conclude(ended: Result<(), CliError>) -> ExitCode {
    let Err(error) = ended else { return ExitCode::SUCCESS };
    if !matches!(error, CliError::OutputClosed) {
        output::note(&format!("furrow: {error}"));
    }
    ExitCode::from(error.exit_code())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<Command, clap::Error> {
        let words = line.split_whitespace().map(|word| OsString::from(word.trim_matches('\'')));
        super::parse(words).map(|cli| cli.command)
    }

    #[test]
    fn the_command_line_is_sound() {
        command().debug_assert();
    }

    #[test]
    fn every_command_shows_examples_that_are_read() {
        for subcommand in command().get_subcommands() {
            let name = subcommand.get_name();
            let examples = examples::EXAMPLES.iter().find(|(of, _)| *of == name);
            let (_, examples) = examples.unwrap_or_else(|| panic!("{name} has no example"));
            for (line, _) in *examples {
                assert!(line.starts_with(name), "{line}");
                parse(&format!("furrow {line}")).unwrap_or_else(|error| panic!("{line}: {error}"));
            }
        }
    }

    #[test]
    fn every_documented_command_line_is_read() {
        for line in [
            "furrow run guyonneau2022/algorithm-5 --seeds 3 --only algorithm=rgop|rg --only field=crop-2 --set a.b=1",
            "furrow run my.json --vary a.b=1,2 --field f.json --db x.db --threads 2 --timing --record --json",
            "furrow serve --db x.db --http 127.0.0.1:0 --zenoh tcp/127.0.0.1:0 --threads 0 --max-attempts 3",
            "furrow work --connect tcp/127.0.0.1:7447 --threads 4 --name barn --spool /var/spool --spool-mb 64",
            "furrow work",
            "furrow serve --db x.db --lan --zenoh quic/0.0.0.0:7447 --lan-name barn.example --join-out secret",
            "furrow work --join secret --connect quic/192.0.2.2:7447",
            "furrow work --join -",
            "furrow join --valid 1h --uses 3 --expires 30d --url http://127.0.0.1:1 --out secret",
            "furrow join --json",
            "furrow router --name router.example --name 192.0.2.7 --expires 90d --to router --db x.db",
            "furrow workers --url http://127.0.0.1:1 --json",
            "furrow workers revoke 0123456789abcdef0123456789abcdef --db x.db",
            "furrow workers expire 0123456789abcdef0123456789abcdef --in 7d --json",
            "furrow workers expire 0123456789abcdef0123456789abcdef --never",
            "furrow workers allow 0123456789abcdef0123456789abcdef --json",
            "furrow plans guyonneau2022/bounds --json",
            "furrow parameters perception.rgop --json",
            "furrow completions zsh",
            "furrow scans lane.csv.gz --perception pl --set mission.lane_width_m=0.6 --prior-noise 5 --seed 2 --json",
            "furrow scans lane.csv --perception particle-filter --sequence 0.1",
            "furrow submit guyonneau2022/bounds --url http://127.0.0.1:1 --name night --priority -3 --json",
            "furrow status",
            "furrow status 3 --url http://127.0.0.1:1 --json",
            "furrow watch 3 --url http://127.0.0.1:1 --json",
            "furrow pause 3 --url http://127.0.0.1:1 --json",
            "furrow pause 3 --resume --db x.db",
            "furrow cancel 3 --purge --json",
            "furrow retry 3",
            "furrow table 3 --group-by algorithm --metric success --columns field --statistic mean,ci95 --format csv",
            "furrow job 12 --svg out.svg --json",
            "furrow job 12 --pose-graph graph.svg",
            "furrow replay 12 --mcap out.mcap --db x.db",
            "furrow report 3 --output report.html --url http://127.0.0.1:1",
            "furrow report 3 --format md --db x.db",
            "furrow run p --until success<=0.2 --max-seeds 50",
            "furrow run p --until algorithm:success --json",
            "furrow bench queue --jobs 1000 --cells 24 --workers 2 --threads 1 --job-ms 50 --dir /var/tmp --json",
            "furrow bench queue --one-by-one 8",
            "furrow bench queue --jobs 1000000 --keep many.db",
            "furrow bench sessions --sessions 1000 --processes 4 --seconds 600",
            "furrow submit guyonneau2022/bounds --db x.db",
            "furrow backup --db x.db --to y.db --json",
            "furrow serve --db x.db --http 0.0.0.0:8080 --http-name furrow.example --http-rate 50",
            "furrow serve --db x.db --http 0.0.0.0:8080 --http-cert cert.pem --http-key key.pem",
            "furrow serve --db x.db --http 0.0.0.0:8080 --http-plain",
            "furrow status --url https://furrow.example:8080 --ca cert.pem --token-file token",
            "furrow token create --name laptop --scope read,submit --expires 90d --db x.db",
            "furrow token list --db x.db --json",
            "furrow token revoke laptop --db x.db",
        ] {
            parse(line).unwrap_or_else(|error| panic!("{line}: {error}"));
        }
    }

    #[test]
    fn a_wrong_command_line_is_bad_input() {
        for line in [
            "furrow",
            "furrow workers revoke x",
            "furrow router --db x.db --to router",
            "furrow router --db x.db --to router --name a --expires 21y",
            "furrow serve --db x.db --lan-name x",
            "furrow run",
            "furrow run p --seeds x",
            "furrow run p --until luck",
            "furrow run p --max-seeds 9",
            "furrow run p --until success<=0.2 --timing",
            "furrow serve",
            "furrow grow",
            "furrow table",
            "furrow replay 12",
            "furrow scans x",
            "furrow scans x --perception pl --prior-noise 5 --sequence 1",
            "furrow scans x --perception pl --prior-noise -1",
        ] {
            let error = parse(line).expect_err(line);
            assert!(error.use_stderr(), "{line}");
            let args = line.split_whitespace().map(OsString::from);
            assert_eq!(format!("{:?}", main(args)), format!("{:?}", ExitCode::from(2)), "{line}");
        }
    }

    #[test]
    fn the_version_names_the_engine() {
        let shown = parse("furrow --version").unwrap_err();
        assert!(!shown.use_stderr());
        assert!(shown.to_string().contains(&crate::engine().to_string()));
    }
}
