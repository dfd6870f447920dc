//! `kill -9` of workers and of the coordinator, one after the other, while a sweep goes on.

use std::collections::BTreeSet;

use serde_json::{Value, json};
use sqlx::SqlitePool;

use crate::plan::{directory, path, plan};
use crate::process::Running;
use crate::server::Server;
use crate::survival::number;

/// So many kills unless FURROW_KILLS says otherwise: every second one is the coordinator's.
const KILLS: u64 = 4;
const WORKERS: usize = 3;
/// A job may lose as many workers as there are kills, and every run counts: none is done twice to verify it.
const SERVED: [&str; 6] = ["--threads", "0", "--max-attempts", "1000", "--verify", "0"];

/// Jobs that were handed out after their result was on record.
pub(crate) const RUN_AGAIN: &str = "select count(*) from result join attempt on attempt.job_id = result.job_id
    join claim on claim.id = attempt.claim_id where claim.claimed_ms > result.recorded_ms";
/// Jobs without exactly one result, and results that another one contradicted.
pub(crate) const LOST_OR_DOUBLED: &str = "select (select count(*) from job where state <> 'done'
        or (select count(*) from result where job_id = job.id) <> 1) + (select count(*) from incident)";

/// A job with a result: number, its attempts, the result's attempt, when it was recorded, its digest.
type OnRecord = (i64, i64, i64, i64, Vec<u8>);

async fn on_record(db: &str) -> BTreeSet<OnRecord> {
    let pool = SqlitePool::connect(&format!("sqlite://{db}?mode=ro")).await.unwrap();
    let all = "select job.id, job.attempt, result.attempt, recorded_ms, digest from result join job on job.id = job_id";
    sqlx::query_as(all).fetch_all(&pool).await.unwrap().into_iter().collect()
}

fn kills() -> u64 {
    let Ok(text) = std::env::var("FURROW_KILLS") else { return KILLS };
    text.parse().unwrap_or_else(|_| panic!("FURROW_KILLS={text}: a whole number is needed"))
}

async fn serve(db: &str, endpoint: &str) -> Server {
    Server::start_with(db, &[&SERVED[..], &["--zenoh", endpoint]].concat(), &[]).await
}

/// The tables of a sweep as programs read them.
async fn table(server: &Server, sweep: i64) -> String {
    let columns = "metric=success,mean_squared_error_mm2,simulated_s&format=csv";
    server.text(&format!("/v1/sweeps/{sweep}/table?{columns}")).await
}

/// Waits until the sweep has got further, if it has not ended; how many of its jobs are done.
async fn progress(server: &Server, sweep: i64, before: u64) -> u64 {
    let further = |sweep: &Value| {
        let (done, total) = (sweep["done"].as_u64()?, sweep["total"].as_u64()?);
        (done > before || done == total).then_some(done)
    };
    server.until(&format!("/v1/sweeps/{sweep}"), further).await
}

/// Waits for the end of a sweep however long it is, as long as it gets further; the sweep.
async fn to_its_end(server: &Server, sweep: i64) -> Value {
    let mut done = 0;
    while server.json(&format!("/v1/sweeps/{sweep}")).await["state"] != "done" {
        done = progress(server, sweep, done).await;
    }
    server.done(sweep).await
}

#[tokio::test]
async fn kills_of_workers_and_coordinator_in_a_loop_lose_nothing_and_double_nothing() {
    let directory = directory();
    // Each worker reports once a second: from one kill to the next some runs end, but by far not all.
    let plan_of_it = plan(100.0, 10 + 2 * kills());
    let undisturbed = Server::start(&path(&directory, "undisturbed.db"), 2).await;
    let sweep = undisturbed.submit(&json!({"plan": plan_of_it})).await;
    to_its_end(&undisturbed, sweep).await;
    let (expected, digests) = (table(&undisturbed, sweep).await, undisturbed.digests(sweep).await);
    drop(undisturbed);

    let db = path(&directory, "served.db");
    let mut server = serve(&db, "tcp/127.0.0.1:0").await;
    let mut workers: Vec<Running> = (0..WORKERS).map(|_| server.worker()).collect();
    let sweep = server.submit(&json!({"plan": plan_of_it})).await;
    let (mut done, mut in_time, mut kept) = (0, 0, BTreeSet::new());
    for kill in 0..kills() {
        let before = done;
        done = progress(&server, sweep, done).await;
        in_time += u64::from(done > before);
        kept.append(&mut on_record(&db).await);
        if kill % 2 == 0 {
            let worker = &mut workers[kill as usize / 2 % WORKERS];
            worker.child.kill().await.unwrap();
            *worker = server.worker();
        } else {
            server.process.child.kill().await.unwrap();
            server = serve(&db, &server.endpoint).await;
        }
    }
    assert_eq!(in_time, kills(), "the sweep went on from each kill to the next");

    let ended = to_its_end(&server, sweep).await;
    assert_eq!((&ended["done"], ended["failed"].as_u64()), (&ended["total"], Some(0)), "{ended}");
    assert_eq!(table(&server, sweep).await, expected);
    assert_eq!(server.digests(sweep).await, digests);
    let changed: Vec<_> = kept.difference(&on_record(&db).await).cloned().collect();
    assert!(
        kept.len() as u64 >= kills() && changed.is_empty(),
        "on record before a kill, and not after it: {changed:?}"
    );
    assert_eq!(number(&db, RUN_AGAIN).await, 0);
    assert_eq!(number(&db, LOST_OR_DOUBLED).await, 0);
    let again = number(&db, "select count(*) from job where attempt > 1").await;
    let total = &ended["total"];
    eprintln!("{} kills: {total} jobs done, {again} of them handed out more than once", kills());
}
