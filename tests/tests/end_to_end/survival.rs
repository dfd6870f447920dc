//! Coordinators and workers that are killed in the middle of their work, and what becomes of it.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::{Duration, SystemTime};

use furrow_schema::id::JobId;
use furrow_worker::Spool;
use serde_json::{Value, json};
use sqlx::{AssertSqlSafe, SqlitePool};
use tokio::time::{interval, timeout};

use crate::plan::{directory, file, path, plan};
use crate::process;
use crate::server::Server;

/// From the start of a killed coordinator's successor to the first claim of a worker.
pub(crate) const BACK_WITHIN_MS: i64 = 10_000;
/// A worker finishes a run of these tests within this time, on a busy machine, too.
const RUN_WITHIN: Duration = Duration::from_secs(60);

/// One number from a database that is in use.
pub(crate) async fn number(db: &str, query: &str) -> i64 {
    let pool = SqlitePool::connect(&format!("sqlite://{db}?mode=ro")).await.unwrap();
    sqlx::query_scalar(AssertSqlSafe(query.to_owned())).fetch_one(&pool).await.unwrap()
}

pub(crate) fn now_ms() -> i64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap().as_millis() as i64
}

#[tokio::test]
async fn a_sweep_outlives_its_killed_coordinator_with_every_job_run_once() {
    let directory = directory();
    let plan_of_it = plan(60.0, 6);
    let (plan_file, undisturbed) = (file(&directory, "plan.json", &plan_of_it), path(&directory, "undisturbed.db"));
    process::json(&["run", &plan_file, "--db", &undisturbed, "--threads", "2", "--json"]).await;
    let digests = Server::start(&undisturbed, 0).await.digests(1).await;

    let db = path(&directory, "served.db");
    let mut server = Server::start(&db, 0).await;
    let _workers = [server.worker(), server.worker()];
    let sweep = server.submit(&json!({"plan": plan_of_it})).await;
    let some = |sweep: &Value| sweep["done"].as_u64().filter(|done| *done >= 3);
    server.until(&format!("/v1/sweeps/{sweep}"), some).await;
    server.process.child.kill().await.unwrap();

    let last_claim = number(&db, "select max(id) from claim").await;
    let restarted_ms = now_ms();
    let server = Server::start_at(&db, 0, &server.endpoint).await;
    let more = server.submit(&json!({"plan": plan(10.0, 1)})).await;
    for (sweep, jobs) in [(sweep, 24), (more, 4)] {
        let done = server.done(sweep).await;
        assert_eq!((done["done"].as_u64(), done["failed"].as_u64()), (Some(jobs), Some(0)));
        let attempts = server.attempts(sweep).await;
        assert!(attempts.values().all(|attempts| *attempts == 1), "{attempts:?}");
    }
    assert_eq!(server.digests(sweep).await, digests);

    let first_claim = format!("select min(claimed_ms) from claim where id > {last_claim}");
    let claimed_ms = number(&db, &first_claim).await;
    eprintln!("the workers claimed {} ms after the coordinator was started again", claimed_ms - restarted_ms);
    assert!(claimed_ms - restarted_ms < BACK_WITHIN_MS);
    assert_eq!(number(&db, "select count(*) from worker").await, 2);
}

/// Waits until the worker has put `more` records into its spool than are there now, which may go when it is compacted.
pub(crate) async fn finished_runs(spool: &Path, more: usize) {
    // More than a record's mark, length and checksum: no two are alike.
    const HEAD: usize = 64;
    let records = || {
        let held = fs::read(spool).unwrap();
        let heads = held.windows(HEAD).filter(|head| head.starts_with(b"\xF7run"));
        heads.map(<[u8]>::to_vec).collect::<BTreeSet<_>>()
    };
    let before = records();
    let mut looks = interval(Duration::from_millis(5));
    let search = async {
        while records().difference(&before).count() < more {
            looks.tick().await;
        }
    };
    timeout(RUN_WITHIN, search).await.expect("the worker works on while its coordinator is away");
}

#[tokio::test]
async fn a_killed_worker_delivers_after_its_restart_what_it_had_finished() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let mut server = Server::start(&db, 0).await;
    let mut worker = server.worker();
    let sweep = server.submit(&json!({"plan": plan(60.0, 6)})).await;
    let all_claimed = |sweep: &Value| (sweep["queued"] == 0).then_some(());
    server.until(&format!("/v1/sweeps/{sweep}"), all_claimed).await;
    server.process.child.kill().await.unwrap();
    let spool = Path::new(&server.spool);
    finished_runs(&spool.join("1").join("runs"), 2).await;
    worker.child.kill().await.unwrap();
    let finished: Vec<JobId> = {
        let spool = Spool::open(spool, furrow_api::engine(), Spool::DEFAULT_LIMIT_BYTES).unwrap();
        spool.waiting().map(|(_, job, attempt)| (attempt == 1).then_some(job).unwrap()).collect()
    };

    let server = Server::start_at(&db, 0, &server.endpoint).await;
    let state_of = |jobs: &[Value], id: JobId| jobs.iter().find(|job| job["id"] == id.0).unwrap()["state"].clone();
    let jobs = server.jobs(sweep).await;
    let unrecorded = finished.iter().filter(|job| state_of(&jobs, **job) == "leased").count();
    assert!(unrecorded >= 2, "{unrecorded} of {finished:?} were not recorded when both were killed");

    let _worker = server.worker();
    for job in finished {
        let done = |job: &Value| (job["state"] == "done").then(|| job["attempts"].clone());
        let attempts = server.until(&format!("/v1/jobs/{job}"), done).await;
        assert_eq!(attempts.as_array().unwrap().len(), 1, "it was not run again: {attempts}");
    }
    assert_eq!(number(&db, "select count(*) from worker").await, 1, "it is the same worker");
}
