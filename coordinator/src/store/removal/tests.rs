//! What is left when a sweep is removed, and what must not be.

use furrow_schema::protocol::RunEnd;
use furrow_schema::sweep::NewSweep;

use crate::testing::{Bench, done, panicked, record, sweep};
use crate::view::{JobFilter, JobRef};

async fn rows(bench: &Bench, count: &'static str) -> i64 {
    sqlx::query_scalar(count).fetch_one(bench.store.readers()).await.unwrap()
}

#[tokio::test]
async fn a_removed_sweep_leaves_nothing() {
    let bench = Bench::new().await;
    let id = bench.submit(NewSweep { record: true, ..sweep(&["rgop", "rg"], 3) }).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(4).await;
    let mut recorded = record(1.0);
    recorded.trajectory = Some("00ff".to_owned());
    worker.ended(&jobs[0], RunEnd::Done(recorded)).await;
    worker.ended(&jobs[0], done(2.0)).await;
    worker.ended(&jobs[1], panicked("no")).await;
    assert!(bench.coordinator.remove(id).await.unwrap());
    for count in [
        "select count(*) from sweep",
        "select count(*) from cell",
        "select count(*) from cell_metric",
        "select count(*) from cell_job",
        "select count(*) from job",
        "select count(*) from scenario",
        "select count(*) from attempt",
        "select count(*) from result",
        "select count(*) from trajectory",
        "select count(*) from incident",
    ] {
        assert_eq!(rows(&bench, count).await, 0, "{count}");
    }
    assert_eq!(bench.coordinator.sweep(id).await.unwrap(), None);
    assert!(!bench.coordinator.remove(id).await.unwrap(), "there is nothing to remove again");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn what_another_sweep_lists_stays_with_its_result() {
    let bench = Bench::new().await;
    let gone = bench.submit(sweep(&["shared", "own"], 2)).await.id;
    let stays = bench.submit(sweep(&["shared"], 2)).await.id;
    let worker = bench.worker().await;
    for job in worker.claim(4).await {
        worker.ended(&job, done(job.seed as f64)).await;
    }
    let cells = bench.cells(stays).await;
    assert!(bench.coordinator.remove(gone).await.unwrap());
    assert_eq!(bench.cells(stays).await, cells);
    assert_eq!(bench.coordinator.jobs(&JobFilter::default()).await.unwrap().items.len(), 2);
    assert_eq!(rows(&bench, "select count(*) from result").await, 2);
    assert_eq!(rows(&bench, "select count(*) from scenario").await, 1);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn what_only_a_cancelled_sweep_lists_stays_cancelled() {
    let bench = Bench::new().await;
    let cancelled = bench.submit(sweep(&["shared"], 2)).await.id;
    let gone = bench.submit(sweep(&["shared"], 2)).await.id;
    bench.coordinator.cancel(cancelled).await.unwrap();
    let worker = bench.worker().await;
    let jobs = worker.claim(1).await;
    assert!(bench.coordinator.remove(gone).await.unwrap());
    assert_eq!(bench.sweep(cancelled).await.cancelled, 2);
    assert_eq!(worker.renew(&jobs, true).await.lost, [jobs[0].job]);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_worker_that_runs_a_removed_job_hears_of_it_and_its_result_is_ignored() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 2)).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(2).await;
    bench.coordinator.remove(id).await.unwrap();
    assert_eq!(worker.renew(&jobs, true).await.lost.len(), 2);
    assert!(!worker.ended(&jobs[0], done(1.0)).await);
    assert!(!worker.ended(&jobs[1], RunEnd::HandedBack).await);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn no_number_is_given_twice() {
    let bench = Bench::new().await;
    let first = bench.submit(sweep(&["old"], 2)).await.id;
    let worker = bench.worker().await;
    let old = worker.claim(2).await;
    bench.coordinator.remove(first).await.unwrap();
    let second = bench.submit(sweep(&["new"], 2)).await.id;
    assert!(second > first);
    let new = worker.claim(2).await;
    assert!(new.iter().all(|new| old.iter().all(|old| old.job < new.job && old.scenario < new.scenario)));
    assert!(!worker.ended(&old[0], done(1.0)).await, "a late result is not taken for another job's");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn the_same_jobs_run_anew_after_a_removal_under_the_same_idempotency_key() {
    let bench = Bench::new().await;
    let keyed = || NewSweep { idempotency_key: Some("monday".to_owned()), ..sweep(&["rgop"], 1) };
    let first = bench.submit(keyed()).await.id;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);
    worker.ended(&job, done(1.0)).await;
    bench.coordinator.remove(first).await.unwrap();
    assert_eq!(bench.coordinator.job(JobRef::Id(job.job)).await.unwrap(), None);
    let second = bench.submit(keyed()).await;
    assert_eq!((second.new, second.cached), (1, 0));
    assert_ne!(second.id, first);
    bench.assert_consistent().await;
}
