//! `furrow bench`: how fast the queue is on this machine.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use furrow_worker::Config;
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::{Child, ChildStdout, Command};

use super::error::CliError;
use super::{output, stop, threads};
use crate::bench::coordinator::Host;
use crate::bench::idle::{self, Idle};
use crate::bench::sessions::{self, Seen};
use crate::bench::{Figures, Load, Ready, worker};

/// Before and after a queue, runs are done so long without one.
const ALONE_FOR: Duration = Duration::from_secs(10);

/// Measure how fast the queue is on this machine
#[derive(Debug, clap::Args)]
pub(super) struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Queue(QueueArgs),
    Sessions(SessionsArgs),
    #[command(hide = true)]
    QueueCoordinator(CoordinatorArgs),
    #[command(hide = true)]
    QueueWorker(WorkerArgs),
    #[command(hide = true)]
    QueueAlone(AloneArgs),
    #[command(hide = true)]
    SessionsWorker(SessionsWorkerArgs),
}

/// Idle jobs, claimed, run and durably recorded, between a coordinator and workers in processes of their own
#[derive(Debug, clap::Args)]
struct QueueArgs {
    /// Jobs of the sweep
    #[arg(long, value_name = "N", default_value_t = 200_000, value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    jobs: u64,
    /// Cells of the sweep's table
    #[arg(long, value_name = "N", default_value_t = 24, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    cells: u64,
    /// Worker processes
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=256))]
    workers: u64,
    /// Threads of each worker
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = threads())]
    threads: u64,
    /// Processor time of each run [ms]; with it, such runs are done without a queue for 10 s before and after
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=60_000))]
    job_ms: u64,
    /// Each worker holds this many conversations, and claims and reports job by job; 0: in batches, as workers do
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=1_000))]
    one_by_one: u64,
    /// Where the database is made and removed again; the system's folder for temporary files if not given
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
    /// Make the database here and keep it, to try tables on it
    #[arg(long, value_name = "FILE", conflicts_with = "dir")]
    keep: Option<PathBuf>,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

/// Many worker sessions at once, each of which renews the lease of a job every second
#[derive(Debug, clap::Args)]
struct SessionsArgs {
    /// Sessions in all
    #[arg(long, value_name = "N", default_value_t = 1_000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    sessions: u64,
    /// Processes that share them
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u64).range(1..=256))]
    processes: u64,
    /// How long they hold their jobs [s]
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    /// Where the database is made and removed again; the system's folder for temporary files if not given
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
    /// One JSON object
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct CoordinatorArgs {
    #[arg(long)]
    db: PathBuf,
    #[arg(long)]
    jobs: u64,
    #[arg(long)]
    cells: u64,
}

#[derive(Debug, clap::Args)]
struct WorkerArgs {
    #[arg(long)]
    connect: String,
    #[arg(long)]
    spool: PathBuf,
    #[arg(long)]
    threads: usize,
    #[arg(long)]
    job_ms: u64,
    #[arg(long)]
    one_by_one: usize,
}

#[derive(Debug, clap::Args)]
struct AloneArgs {
    #[arg(long)]
    threads: usize,
    #[arg(long)]
    job_ms: u64,
}

#[derive(Debug, clap::Args)]
struct SessionsWorkerArgs {
    #[arg(long)]
    connect: String,
    #[arg(long)]
    sessions: usize,
    #[arg(long)]
    seconds: u64,
}

/// What is printed of sessions.
#[derive(Debug, Serialize)]
struct SessionsAnswer {
    #[serde(flatten)]
    seen: Seen,
    seconds: u64,
    /// The coordinator's processor time over all its time [%]; 100 is one core.
    coordinator_cpu_percent: f64,
    coordinator_peak_rss_mb: f64,
}

/// What is printed.
#[derive(Debug, Serialize)]
struct Answer {
    #[serde(flatten)]
    figures: Figures,
    workers: u64,
    threads: u64,
    job_ms: u64,
    /// The share of the workers' time that the queue took from runs [%]: what they did not spend on runs, less what they do
    /// not spend on them without a queue. Null for runs that take no time.
    overhead_percent: Option<f64>,
    /// The share of their time that such runs lose to the rest of the machine without a queue [%].
    without_queue_percent: Option<f64>,
}

/// # Errors
/// A process cannot be started or ends before its time.
pub(super) async fn run(args: BenchArgs) -> Result<(), CliError> {
    match args.what {
        What::Queue(args) => queue(&args).await,
        What::QueueCoordinator(args) => coordinate(&args).await,
        What::QueueWorker(args) => work(args).await,
        What::QueueAlone(args) => {
            let runs = Idle { run: Duration::from_millis(args.job_ms) };
            say(&idle::share_lost(runs, args.threads, ALONE_FOR))
        }
        What::Sessions(args) => sessions(&args).await,
        What::SessionsWorker(args) => {
            let time = Duration::from_secs(args.seconds);
            say(&sessions::hold(&args.connect, crate::engine(), args.sessions, time).await?)
        }
    }
}

fn new_folder(dir: Option<&Path>) -> Result<tempfile::TempDir, CliError> {
    dir.map_or_else(tempfile::tempdir, tempfile::tempdir_in).map_err(CliError::bad_input("--dir"))
}

fn start_coordinator(db: &Path, load: Load) -> Result<Child, CliError> {
    let (jobs, cells) = (load.jobs.to_string(), load.cells.to_string());
    child(&["queue-coordinator", "--jobs", &jobs, "--cells", &cells, "--db"], db.as_os_str())
}

async fn sessions(args: &SessionsArgs) -> Result<(), CliError> {
    let folder = new_folder(args.dir.as_deref())?;
    let mut coordinator = start_coordinator(&folder.path().join("queue.db"), Load { jobs: args.sessions, cells: 1 })?;
    let mut lines = lines_of(&mut coordinator)?;
    let ready: Ready = next(&mut lines).await?;
    let mut children = Vec::new();
    for process in 0..args.processes {
        let share =
            (args.sessions * (process + 1) / args.processes - args.sessions * process / args.processes).to_string();
        let words = ["sessions-worker", "--connect", &ready.endpoint, "--sessions", &share, "--seconds"];
        children.push(child(&words, args.seconds.to_string().as_ref())?);
    }
    let mut seen = Seen::default();
    for worker in &mut children {
        seen = seen.and(next(&mut lines_of(worker)?).await?);
    }
    let Figures { jobs, wall_s, coordinator_cpu_us_per_job: cpu_us, coordinator_peak_rss_mb, .. } =
        next(&mut lines).await?;
    let coordinator_cpu_percent = 100.0 * cpu_us * 1e-6 * jobs as f64 / wall_s;
    let answer = SessionsAnswer { seen, seconds: args.seconds, coordinator_cpu_percent, coordinator_peak_rss_mb };
    if args.json { output::json(&answer) } else { show_sessions(&answer) }
}

fn show_sessions(answer: &SessionsAnswer) -> Result<(), CliError> {
    let Seen { sessions, renewals, missed, lost, slowest_ms } = answer.seen;
    let SessionsAnswer { seconds, coordinator_cpu_percent, coordinator_peak_rss_mb, .. } = answer;
    output::line(&format!(
        "{sessions} sessions for {seconds} s: {renewals} renewals, {missed} missed, {lost} leases lost, the slowest took \
         {slowest_ms} ms"
    ))?;
    output::line(&format!(
        "coordinator: {coordinator_cpu_percent:.0} % of a core, {coordinator_peak_rss_mb:.0} MB at most"
    ))
}

async fn queue(args: &QueueArgs) -> Result<(), CliError> {
    let folder = new_folder(args.dir.as_deref())?;
    let db = args.keep.clone().unwrap_or_else(|| folder.path().join("queue.db"));
    if db.exists() {
        return Err(CliError::BadInput(format!("--keep {}: is there already", db.display())));
    }
    let before = without_queue(args).await?;
    let mut coordinator = start_coordinator(&db, Load { jobs: args.jobs, cells: args.cells })?;
    let mut lines = lines_of(&mut coordinator)?;
    let ready: Ready = next(&mut lines).await?;
    let workers = (0..args.workers).map(|number| start_worker(args, &ready, &folder.path().join(number.to_string())));
    let workers = workers.collect::<Result<Vec<_>, _>>()?;
    let figures = next(&mut lines).await;
    for mut worker in workers {
        // It may have ended by itself when the coordinator left.
        let _ = worker.kill().await;
    }
    let ended = coordinator.wait().await.map_err(CliError::failed("the coordinator"))?;
    let figures = figures.map_err(|error| CliError::Failed(format!("the coordinator ended with {ended}: {error}")))?;
    // What was measured until now is told in any case.
    let after = without_queue(args).await.unwrap_or(before);
    show(args, figures, before.zip(after).map(|(before, after)| (before + after) / 2.0))
}

/// The share of their time that the runs lose without a queue, in as many processes; none for runs that take no time.
async fn without_queue(args: &QueueArgs) -> Result<Option<f64>, CliError> {
    if args.job_ms == 0 {
        return Ok(None);
    }
    let threads = args.threads.to_string();
    let words = ["queue-alone", "--threads", &threads, "--job-ms"];
    let start = |_| child(&words, args.job_ms.to_string().as_ref());
    let mut processes = (0..args.workers).map(start).collect::<Result<Vec<_>, _>>()?;
    let mut sum = 0.0;
    for process in &mut processes {
        sum += next::<f64>(&mut lines_of(process)?).await?;
    }
    Ok(Some(sum / args.workers as f64))
}

fn start_worker(args: &QueueArgs, ready: &Ready, spool: &Path) -> Result<Child, CliError> {
    let (threads, job_ms, one_by_one) =
        (args.threads.to_string(), args.job_ms.to_string(), args.one_by_one.to_string());
    let words = ["queue-worker", "--connect", &ready.endpoint, "--threads", &threads, "--job-ms", &job_ms];
    let more = ["--one-by-one", &one_by_one, "--spool"];
    child(&[&words[..], &more[..]].concat(), spool.as_os_str())
}

fn show(args: &QueueArgs, figures: Figures, without_queue: Option<f64>) -> Result<(), CliError> {
    let busy_s = figures.jobs as f64 * args.job_ms as f64 / 1e3 / (args.workers * args.threads) as f64;
    let overhead_percent = without_queue.map(|share| 100.0 * (1.0 - share - busy_s / figures.wall_s));
    let without_queue_percent = without_queue.map(|share| 100.0 * share);
    let (workers, threads, job_ms) = (args.workers, args.threads, args.job_ms);
    let answer = Answer { figures, workers, threads, job_ms, overhead_percent, without_queue_percent };
    if args.json {
        return output::json(&answer);
    }
    let Figures { jobs, wall_s, jobs_per_s, coordinator_cpu_us_per_job, .. } = &answer.figures;
    let Figures { coordinator_rss_mb, coordinator_peak_rss_mb, .. } = &answer.figures;
    output::line(&format!(
        "{jobs} jobs in {wall_s:.1} s: {jobs_per_s:.0} jobs/s, {workers} workers of {threads} threads"
    ))?;
    output::line(&format!(
        "coordinator: {coordinator_cpu_us_per_job:.1} us of processor time a job, \
         {coordinator_rss_mb:.0} MB with all jobs queued, {coordinator_peak_rss_mb:.0} MB at most"
    ))?;
    overhead_percent.zip(without_queue_percent).map_or(Ok(()), |(percent, without)| {
        output::line(&format!(
            "overhead on runs of {job_ms} ms: {percent:.2} %, beside {without:.2} % that they lose without a queue"
        ))
    })
}

fn child(words: &[&str], last: &OsStr) -> Result<Child, CliError> {
    let program = std::env::current_exe().map_err(CliError::failed("this program cannot be found"))?;
    let mut command = Command::new(program);
    command.arg("bench").args(words).arg(last).stdin(Stdio::null()).stdout(Stdio::piped()).kill_on_drop(true);
    command.spawn().map_err(CliError::failed("cannot start a process"))
}

fn lines_of(child: &mut Child) -> Result<Lines<BufReader<ChildStdout>>, CliError> {
    let out = child.stdout.take().ok_or_else(|| CliError::Failed("a process without output".to_owned()))?;
    Ok(BufReader::new(out).lines())
}

async fn next<T: DeserializeOwned>(lines: &mut Lines<BufReader<ChildStdout>>) -> Result<T, CliError> {
    let line = lines.next_line().await?.ok_or_else(|| CliError::Failed("a process ended too early".to_owned()))?;
    serde_json::from_str(&line).map_err(CliError::failed("a process said something else"))
}

async fn coordinate(args: &CoordinatorArgs) -> Result<(), CliError> {
    let load = Load { jobs: args.jobs, cells: args.cells };
    let host = Host::start(&args.db, load, crate::engine()).await?;
    say(&Ready { endpoint: host.endpoint().to_owned() })?;
    say(&host.measure().await?)
}

fn say(value: &impl Serialize) -> Result<(), CliError> {
    output::line(&serde_json::to_string(value).map_err(CliError::failed("cannot write JSON"))?)
}

async fn work(args: WorkerArgs) -> Result<(), CliError> {
    let stop = stop::on_signals()?;
    if args.one_by_one > 0 {
        return worker::work_one_by_one(&args.connect, crate::engine(), args.one_by_one, stop).await;
    }
    let config = Config { name: "idle".to_owned(), threads: args.threads, engine: crate::engine() };
    let runs = Idle { run: Duration::from_millis(args.job_ms) };
    worker::work(&args.connect, config, &args.spool, runs, stop).await
}
