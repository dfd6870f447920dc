//! Schedules of faults: one seed is one course of events between users, a coordinator and its workers, in simulated time.
//!
//! What decides is the real thing: the coordinator with its SQL on SQLite in memory, and the worker with its
//! conversations, its board and its spool. What is simulated is the world: `world` draws everything from one generator,
//! `wire` is the network, `server` the coordinator's process, `machine` a worker's, `jobs` what is to be run, `users` what
//! people do meanwhile. `ledger` holds every answer against those before, `schedule` is the course and its final account.
//!
//! `FURROW_SCHEDULES` says how many (10,000), `FURROW_SCHEDULE_SEED` with which seed they begin; alone, it runs one again.
//! They keep all cores busy, so they are a program of their own: tests of real processes do not wait for them.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "all of this is test code")]

mod database;
mod jobs;
mod ledger;
mod letter;
mod machine;
mod schedule;
mod server;
mod users;
mod wire;
mod world;

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use core_affinity::CoreId;
use furrow_schema::id::EngineId;
use tempfile::TempDir;

use database::Database;
use schedule::Broken;

const ENGINE: EngineId = EngineId([7; 32]);
/// So many schedules unless told otherwise.
const SCHEDULES: u64 = 10_000;

/// A number from the environment.
fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name}={text}: a whole number is needed")))
}

/// A folder for spools, in memory where the system has such a place: a schedule syncs hundreds of times.
fn folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    folder.expect("a temporary directory can be made")
}

fn run(seed: u64, database: &Arc<Database>) -> Result<Vec<String>, Broken> {
    schedule::run(seed, database, folder().path())
}

/// Runs schedules on this core until one breaks a claim. The threads of a schedule work in turn: on one core they need
/// not wake another for that, which takes longer than what they do.
fn run_some(core: CoreId, next: &AtomicU64, end: u64) -> Result<(), Broken> {
    core_affinity::set_for_current(core);
    let database = Arc::new(Database::new());
    loop {
        let seed = next.fetch_add(1, Ordering::Relaxed);
        if seed >= end {
            return Ok(());
        }
        run(seed, &database).inspect_err(|_| next.store(end, Ordering::Relaxed))?;
    }
}

#[test]
fn no_schedule_of_faults_breaks_a_claim() {
    let first = number("FURROW_SCHEDULE_SEED");
    let many = number("FURROW_SCHEDULES").unwrap_or(if first.is_some() { 1 } else { SCHEDULES });
    let first = first.unwrap_or(0);
    let (next, began) = (AtomicU64::new(first), Instant::now());
    let cores = core_affinity::get_core_ids().unwrap_or_else(|| vec![CoreId { id: 0 }]);
    std::thread::scope(|scope| {
        let begin = |core| {
            scope.spawn({
                let next = &next;
                move || run_some(core, next, first + many)
            })
        };
        let all: Vec<_> = cores.into_iter().map(begin).collect();
        for some in all {
            if let Err(Broken { seed, claim, trace }) = some.join().expect("a schedule does not panic") {
                panic!("{}\n\n{claim}\nrun it again with FURROW_SCHEDULE_SEED={seed}", trace.join("\n"));
            }
        }
    });
    eprintln!("{many} schedules in {:.1} s", began.elapsed().as_secs_f64());
}

#[test]
fn a_schedule_takes_the_same_course_every_time() {
    let (one, other) = (Arc::new(Database::new()), Arc::new(Database::new()));
    for seed in 0..20 {
        let first = run(seed, &one).unwrap();
        assert!(first.len() > 5, "something happens: {first:?}");
        assert_eq!(first, run(seed, &one).unwrap(), "seed {seed}, on the same database");
        assert_eq!(first, run(seed, &other).unwrap(), "seed {seed}, on another one");
    }
}
