//! Errands of several steps: nobody waits for them, and they survive what can happen between two steps.

use furrow_schema::sweep::{NewSweep, SweepState};
use futures::future::join_all;

use super::*;
use crate::store::Store;
use crate::testing::{Bench, done, sweep};
use crate::view::{JobFilter, SweepChange};

/// More than one step of a submission, and several of everything else.
const SEEDS: u64 = 4_600;

fn large() -> NewSweep {
    sweep(&["rgop", "rg"], SEEDS)
}

const PAUSED: SweepChange = SweepChange { priority: None, paused: Some(true) };
const RESUMED: SweepChange = SweepChange { priority: Some(3), paused: Some(false) };

/// Leaves the database as if the process had been killed after `statements`.
async fn killed_after(path: &std::path::Path, statements: &'static str) -> Bench {
    let store = Store::open(path).await.unwrap();
    sqlx::raw_sql(statements).execute(store.writer()).await.unwrap();
    store.close().await;
    Bench::over(Store::open(path).await.unwrap())
}

/// Housekeeping until nothing is half done.
async fn settled(bench: &Bench) {
    let left = "select (select count(*) from settling) + (select count(*) from unlisted)";
    while sqlx::query_scalar::<_, i64>(left).fetch_one(bench.store.readers()).await.unwrap() > 0 {
        bench.coordinator.keep_house().await.unwrap();
    }
}

#[tokio::test]
async fn a_large_sweep_goes_through_all_its_states() {
    let bench = Bench::new().await;
    let submitted = bench.submit(large()).await;
    assert_eq!((submitted.total, submitted.new), (2 * SEEDS, 2 * SEEDS));
    bench.assert_consistent().await;
    let (id, worker) = (submitted.id, bench.worker().await);
    let jobs = worker.claim(256).await;
    bench.coordinator.change(id, PAUSED).await.unwrap();
    bench.assert_consistent().await;
    assert!(worker.claim(1).await.is_empty());
    bench.coordinator.change(id, RESUMED).await.unwrap();
    bench.assert_consistent().await;
    let cancelled = bench.coordinator.cancel(id).await.unwrap().unwrap();
    assert_eq!((cancelled.cancelled, cancelled.queued, cancelled.leased), (2 * SEEDS, 0, 0));
    assert_eq!(worker.renew(&jobs, true).await.lost.len(), 256);
    bench.assert_consistent().await;
    let retried = bench.coordinator.retry(id).await.unwrap().unwrap();
    assert_eq!((retried.state, retried.queued), (SweepState::Active, 2 * SEEDS));
    bench.assert_consistent().await;
    assert!(bench.coordinator.remove(id).await.unwrap());
    assert!(bench.coordinator.jobs(&JobFilter::default()).await.unwrap().items.is_empty(), "nobody sees it any more");
    settled(&bench).await;
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_large_sweep_is_seen_only_when_it_is_whole_and_workers_are_served_meanwhile() {
    let bench = Bench::new().await;
    let (worker, seeds) = (bench.worker().await, 5 * SEEDS);
    let looks = async {
        let mut claimed_early = 0;
        loop {
            let jobs_before = bench.coordinator.jobs(&JobFilter::default()).await.unwrap();
            let sweeps = bench.coordinator.sweeps(None, 10).await.unwrap();
            if let Some(sweep) = sweeps.first() {
                assert_eq!(sweep.total, 2 * seeds);
                return claimed_early;
            }
            assert!(jobs_before.items.is_empty());
            for job in worker.claim(1).await {
                worker.ended(&job, done(1.0)).await;
                claimed_early += 1;
            }
        }
    };
    let (submitted, claimed_early) = tokio::join!(bench.submit(sweep(&["rgop", "rg"], seeds)), looks);
    assert_eq!(submitted.total, 2 * seeds);
    assert!(claimed_early > 0, "its first jobs run while the others come in");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn the_same_large_submission_twice_at_once_is_one_sweep() {
    let bench = Bench::new().await;
    let keyed = || NewSweep { idempotency_key: Some("monday".to_owned()), ..large() };
    let both = join_all([bench.submit(keyed()), bench.submit(keyed())]).await;
    assert_eq!(both[0], both[1]);
    assert_eq!(bench.coordinator.sweeps(None, 10).await.unwrap().len(), 1);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_large_sweep_that_cannot_be_written_leaves_nothing_and_may_be_submitted_again() {
    let bench = Bench::new().await;
    sqlx::query(
        "create trigger sabotage before insert on job when new.seed = 4500 begin select raise(abort, 'no'); end",
    )
    .execute(bench.store.writer())
    .await
    .unwrap();
    let keyed = || NewSweep { idempotency_key: Some("monday".to_owned()), ..large() };
    let refused = bench.coordinator.submit(keyed()).await.unwrap_err();
    assert!(matches!(refused, StoreError::NotWritten(_)), "{refused}");
    assert!(bench.coordinator.sweeps(None, 10).await.unwrap().is_empty());
    settled(&bench).await;
    bench.assert_consistent().await;
    sqlx::query("drop trigger sabotage").execute(bench.store.writer()).await.unwrap();
    assert_eq!(bench.submit(keyed()).await.new, 2 * SEEDS);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_submission_that_a_crash_broke_off_is_removed_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("furrow.db");
    let bench = Bench::over(Store::open(&path).await.unwrap());
    let keyed = || NewSweep { idempotency_key: Some("monday".to_owned()), ..large() };
    bench.submit(keyed()).await;
    let shared = bench.submit(sweep(&["rg"], 10)).await.id;
    bench.coordinator.shutdown().await;

    let bench = killed_after(&path, "insert into unlisted (sweep_id) values (1)").await;
    let again = bench.submit(keyed()).await;
    assert_ne!(again.id, SweepId(1), "the key stands for no sweep that broke off");
    settled(&bench).await;
    bench.assert_consistent().await;
    assert_eq!(bench.sweep(shared).await.queued, 10);
    assert_eq!(bench.sweep(again.id).await.queued, 2 * SEEDS);
}

#[tokio::test]
async fn what_was_done_to_a_sweep_goes_on_after_a_crash() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("furrow.db");
    let bench = Bench::over(Store::open(&path).await.unwrap());
    let id = bench.submit(large()).await.id;
    bench.coordinator.shutdown().await;
    let bench = killed_after(
        &path,
        "update sweep set state = 'cancelled', finished_ms = 1;
        insert into settling (sweep_id, retry, cell_id, job_id, placed) values (1, 0, 1, 0, 0)",
    )
    .await;
    settled(&bench).await;
    assert_eq!(bench.sweep(id).await.cancelled, 2 * SEEDS);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_change_of_mind_half_way_ends_as_the_last_one_said() {
    let bench = Bench::new().await;
    let id = bench.submit(large()).await.id;
    let coordinator = &bench.coordinator;
    let (cancelled, retried, paused) =
        tokio::join!(coordinator.cancel(id), coordinator.retry(id), coordinator.change(id, PAUSED));
    assert!(cancelled.is_ok() && retried.is_ok());
    let paused = paused.unwrap().unwrap();
    assert_eq!((paused.state, paused.queued, paused.cancelled), (SweepState::Paused, 2 * SEEDS, 0));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn who_waits_for_an_errand_at_a_shutdown_is_told() {
    let bench = Bench::new().await;
    let (submitted, ()) = tokio::join!(bench.coordinator.submit(large()), bench.coordinator.shutdown());
    assert!(matches!(submitted, Err(StoreError::Closed) | Ok(_)));
}
