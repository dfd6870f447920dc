//! `furrow run`: a plan from the first job to the tables, in one process.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use furrow_coordinator::{Config, Coordinator, Store, VerificationCounts, Verify};
use furrow_schema::id::{EngineId, SweepId};
use furrow_schema::sweep::{NewSweep, Submitted, Sweep, SweepState};
use furrow_schema::table::Cell;
use serde::Serialize;
use serde_json::Value;
use tokio_util::sync::CancellationToken;

use super::error::CliError;
use super::progress::{Progress, span};
use super::selection::Selection;
use super::serve::{open, share};
use super::submit::warn;
use super::until::{Search, Until};
use super::{output, stop, threads, until};
use crate::http::sweeps::new_sweep;
use crate::http::tables::sweep_data;
use crate::in_process::Farm;
use crate::plan::expand;
use crate::publication::{self, Comparison};
use crate::sequential::Judgement;
use crate::table::{Format, Query, SweepData, tabulate};

/// Progress is looked at no more often than this.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Metrics in the table on the terminal; `--json` has all of them.
const SHOWN: usize = 4;

/// Run a plan to its end on this machine and print its tables beside the published values
#[derive(Debug, clap::Args)]
pub(super) struct RunArgs {
    #[command(flatten)]
    selection: Selection,
    /// Keep the results in this database, and use those that are there; otherwise a temporary one is used
    #[arg(long, value_name = "FILE")]
    db: Option<PathBuf>,
    /// Runs at a time; all cores if not given
    #[arg(long, value_name = "N", value_parser = threads())]
    threads: Option<u64>,
    #[command(flatten)]
    until: Until,
    /// Run everything anew and one at a time, whatever --threads says, to measure times
    #[arg(long)]
    timing: bool,
    /// Store the trajectories
    #[arg(long)]
    record: bool,
    /// Compute this share of the new results again before the end and compare, from 0 to 1: the same run must give the
    /// same bits
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, value_parser = share)]
    verify: f64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// How a run ended.
struct Finished {
    sweep: Sweep,
    cached: u64,
    verified: VerificationCounts,
    data: SweepData,
    comparisons: Vec<Comparison>,
    judgement: Option<Judgement>,
    wall_s: f64,
}

/// # Errors
/// Bad input; or a job failed, or the user stopped it.
pub(super) async fn run(args: RunArgs) -> Result<(), CliError> {
    let started = Instant::now();
    let request = args.selection.request()?;
    let expanding = tokio::task::spawn_blocking(move || expand(&request));
    let expansion = expanding.await.map_err(CliError::failed("cannot expand the plan"))??;
    warn(&expansion.not_applied);
    args.until.check(&expansion.factors)?;
    let search = args.until.search(expansion.seeds);
    let sweep = NewSweep { record: args.record, timing: args.timing, ..new_sweep(expansion, None) };

    let stop = stop::on_signals()?;
    let (store, _directory) = database(args.db.as_deref()).await?;
    // There is no other worker to wait for.
    let verify = Verify { share: args.verify, alone_after: Duration::ZERO };
    let config = Config { verify, ..Config::new(sweep.engine) };
    let mut farm = Farm::start(store, config, thread_count(&args));
    let ended = finish(&mut farm, sweep, search, &stop, started).await;
    farm.stop().await;
    let finished = ended?;
    if args.json {
        print_json(&finished)?
    } else {
        print_tables(&finished)?
    }
    match finished.sweep.failed {
        0 => until::conclude(finished.judgement.as_ref()),
        failed => Err(CliError::JobsFailed(failed)),
    }
}

/// The user's database, or one in a new directory that goes when its guard does.
async fn database(file: Option<&Path>) -> Result<(Store, Option<tempfile::TempDir>), CliError> {
    if let Some(file) = file {
        return Ok((open(file).await?, None));
    }
    let directory = tempfile::tempdir().map_err(CliError::failed("cannot make a temporary directory"))?;
    Ok((open(&directory.path().join("furrow.db")).await?, Some(directory)))
}

fn thread_count(args: &RunArgs) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    if args.timing { 1 } else { args.threads.map_or_else(cores, |threads| threads as usize) }
}

async fn finish(
    farm: &mut Farm,
    sweep: NewSweep,
    mut search: Option<Search>,
    stop: &CancellationToken,
    started: Instant,
) -> Result<Finished, CliError> {
    let coordinator = farm.coordinator().clone();
    let priority = before_others(&coordinator).await?;
    let mut cached = None;
    let mut earlier = None;
    loop {
        let seeds = search.as_ref().map_or(sweep.seeds, Search::seeds);
        let request_json = asking_for(&sweep.request_json, seeds);
        let submitted = coordinator.submit(NewSweep { priority, seeds, request_json, ..sweep.clone() }).await?;
        let known = *cached.get_or_insert(submitted.cached);
        // The seeds of the look before are in this one, too.
        if let Some(earlier) = earlier.replace(submitted.id) {
            coordinator.remove(earlier).await?;
        }
        let (sweep, verified) = run_to_its_end(farm, &sweep.name, submitted, stop, started).await?;
        let judgement = match &mut search {
            Some(search) => Some(search.judge(&coordinator, &sweep).await?),
            None => None,
        };
        if search.as_mut().zip(judgement.as_ref()).is_none_or(|(search, judgement)| search.ends_with(judgement)) {
            let data = sweep_data(&coordinator, &sweep, &Query::default()).await?;
            let comparisons = publication::of_sweep(&coordinator, &sweep, &data).await?;
            let wall_s = started.elapsed().as_secs_f64();
            return Ok(Finished { sweep, cached: known, verified, data, comparisons, judgement, wall_s });
        }
    }
}

/// The same request with so many seeds.
fn asking_for(request_json: &str, seeds: u64) -> String {
    let Ok(mut request) = serde_json::from_str::<Value>(request_json) else { return request_json.to_owned() };
    request["seeds"] = Value::from(seeds);
    request.to_string()
}

async fn run_to_its_end(
    farm: &mut Farm,
    name: &str,
    Submitted { id, total, cached, .. }: Submitted,
    stop: &CancellationToken,
    started: Instant,
) -> Result<(Sweep, VerificationCounts), CliError> {
    let coordinator = farm.coordinator().clone();
    let mut progress = Progress::start(name, total, cached);
    let ended = tokio::select! {
        ended = watch_and_verify(&coordinator, id, &mut progress) => ended,
        end = farm.ended() => Err(CliError::Failed(end.to_string())),
        () = stop.cancelled() => Err(CliError::Stopped),
    };
    progress.finish(started.elapsed().as_secs_f64());
    ended
}

/// A priority above all sweeps that an earlier command left unfinished in the same database.
async fn before_others(coordinator: &Coordinator) -> Result<i64, CliError> {
    let sweeps = coordinator.sweeps(None, 1_000).await?;
    let active = sweeps.iter().filter(|sweep| sweep.state == SweepState::Active);
    Ok(active.map(|sweep| sweep.priority.saturating_add(1)).max().unwrap_or(0))
}

/// Shows progress until every job has ended.
async fn watch(coordinator: &Coordinator, id: SweepId, progress: &mut Progress) -> Result<Sweep, CliError> {
    let mut changed = coordinator.changed();
    let mut pause = tokio::time::interval(LOOK_EVERY);
    pause.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        changed.borrow_and_update();
        let lost = || CliError::Failed(format!("sweep {id} is gone"));
        let sweep = coordinator.sweep(id).await?.ok_or_else(lost)?;
        progress.show(&sweep);
        if sweep.queued + sweep.leased == 0 {
            return Ok(sweep);
        }
        pause.tick().await;
        changed.changed().await.map_err(CliError::failed("the coordinator is gone"))?;
    }
}

/// The same, and then until every verification has ended.
async fn watch_and_verify(
    coordinator: &Coordinator,
    id: SweepId,
    progress: &mut Progress,
) -> Result<(Sweep, VerificationCounts), CliError> {
    let mut sweep = watch(coordinator, id, progress).await?;
    let mut changed = coordinator.changed();
    loop {
        changed.borrow_and_update();
        let verified = coordinator.verifications().await?;
        if verified.open == 0 || !coordinator.verifies() {
            sweep = coordinator.sweep(id).await?.unwrap_or(sweep);
            return Ok((sweep, verified));
        }
        changed.changed().await.map_err(CliError::failed("the coordinator is gone"))?;
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary<'a> {
    plan: &'a str,
    sweep: SweepId,
    engine: EngineId,
    runs: u64,
    cached: u64,
    failed: u64,
    wall_s: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    until: Option<&'a Judgement>,
    cells: &'a [Cell],
}

fn print_json(finished: &Finished) -> Result<(), CliError> {
    let Finished { sweep, cached, data, judgement, wall_s, .. } = finished;
    let table = tabulate(data, &Query::default()).map_err(CliError::failed("no table"))?;
    output::json(&Summary {
        plan: &sweep.plan,
        sweep: sweep.id,
        engine: sweep.engine,
        runs: sweep.done,
        cached: *cached,
        failed: sweep.failed,
        wall_s: *wall_s,
        until: judgement.as_ref(),
        cells: &table.cells,
    })
}

fn print_tables(finished: &Finished) -> Result<(), CliError> {
    let Finished { sweep, cached, verified, data, comparisons, judgement, wall_s } = finished;
    let everything = tabulate(data, &Query::default()).map_err(CliError::failed("no table"))?;
    let metrics = Some(everything.first_metrics(SHOWN));
    let table = tabulate(data, &Query { metrics, ..Query::default() }).map_err(CliError::failed("no table"))?;
    output::line(&table.write(Format::Text))?;
    for comparison in comparisons {
        output::line(&format!("\n{}", comparison.write(Format::Text)))?;
    }
    if let Some(hint) = hint_at_timing(&publication::unmeasured_tables_of(&sweep.plan, data)) {
        output::line(&format!("\n{hint}"))?;
    }
    if let Some(judgement) = judgement {
        output::line(&format!("\n{}", until::shown(judgement)))?;
    }
    let (runs, failed) = (sweep.done, sweep.failed);
    output::line(&format!("\n{runs} runs, {cached} of them cached, {failed} failed, in {}", span(*wall_s)))?;
    match (verified.agreed, sweep.disputed) {
        (0, 0) => Ok(()),
        (agreed, disputed) => {
            output::line(&format!("{agreed} computed again with the same digest, {disputed} disputed"))
        }
    }
}

/// What to do for tables that need measured times; nothing if there are none such.
fn hint_at_timing(tables: &[&str]) -> Option<String> {
    let (plural, verb) = if tables.len() > 1 { ("s", "") } else { ("", "s") };
    let named = match tables {
        [] => return None,
        ["times"] => "The table of times".to_owned(),
        _ => {
            let numbers: Vec<&str> = tables.iter().map(|table| table.trim_start_matches("table-")).collect();
            format!("Table{plural} {}", numbers.join(" and "))
        }
    };
    Some(format!("{named} need{verb} computing times: add --timing to measure them."))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_on_record_as_asked_for_has_the_seeds_that_were_run() {
        assert_eq!(asking_for(r#"{"plan":"a/b","seeds":1}"#, 12), r#"{"plan":"a/b","seeds":12}"#);
    }

    #[test]
    fn tables_of_times_that_are_missing_are_named() {
        let hint = hint_at_timing(&["table-4", "table-6"]).unwrap();
        assert_eq!(hint, "Tables 4 and 6 need computing times: add --timing to measure them.");
        let hint = hint_at_timing(&["times"]).unwrap();
        assert_eq!(hint, "The table of times needs computing times: add --timing to measure them.");
        assert_eq!(hint_at_timing(&[]), None);
    }
}
