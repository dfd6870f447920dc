use furrow_schema::sweep::SweepState;

use super::*;
use crate::testing::{Bench, ENGINE, done, panicked, sweep};

#[tokio::test]
async fn a_sweep_is_expanded_into_cells_and_jobs() {
    let bench = Bench::new().await;
    let submitted = bench.submit(sweep(&["rgop", "rg", "lsq"], 1_500)).await;
    assert_eq!((submitted.total, submitted.new, submitted.cached), (4_500, 4_500, 0));
    let sweep = bench.sweep(submitted.id).await;
    assert_eq!((sweep.state, sweep.total, sweep.queued), (SweepState::Active, 4_500, 4_500));
    let cells = bench.cells(submitted.id).await;
    assert_eq!(cells.iter().map(|cell| cell.factors["algorithm"].as_str()).collect::<Vec<_>>(), ["rgop", "rg", "lsq"]);
    assert!(cells.iter().all(|cell| cell.total == 1_500));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn results_on_record_count_at_once_and_moments_with_them() {
    let bench = Bench::new().await;
    let first = bench.submit(sweep(&["rgop"], 3)).await;
    let worker = bench.worker().await;
    for job in worker.claim(3).await {
        worker.ended(&job, done(job.seed as f64)).await;
    }
    let grown = bench.submit(sweep(&["rgop", "rg"], 4)).await;
    assert_eq!((grown.total, grown.new, grown.cached), (8, 5, 3));
    let state = bench.sweep(grown.id).await;
    assert_eq!((state.done, state.cached, state.queued), (3, 3, 5));
    assert_eq!(bench.cells(grown.id).await[0].metrics, bench.cells(first.id).await[0].metrics);

    let again = bench.submit(sweep(&["rgop"], 3)).await;
    assert_eq!((again.new, again.cached), (0, 3));
    let again = bench.sweep(again.id).await;
    assert_eq!((again.state, again.finished_ms.is_some(), again.eta_s), (SweepState::Done, true, Some(0.0)));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_job_that_two_sweeps_want_runs_once_and_counts_in_both() {
    let bench = Bench::new().await;
    let a = bench.submit(sweep(&["rgop"], 2)).await;
    let b = bench.submit(sweep(&["rgop", "rg"], 2)).await;
    assert_eq!((b.total, b.new, b.cached), (4, 2, 0));
    let worker = bench.worker().await;
    let jobs = worker.claim(10).await;
    assert_eq!(jobs.len(), 4);
    assert_eq!((bench.sweep(a.id).await.leased, bench.sweep(b.id).await.leased), (2, 4));
    for job in &jobs {
        worker.ended(job, done(1.0)).await;
    }
    assert_eq!((bench.sweep(a.id).await.done, bench.sweep(b.id).await.done), (2, 4));
    assert_eq!(bench.sweep(a.id).await.state, SweepState::Done);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_later_sweep_lifts_the_jobs_it_shares() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop", "rg"], 2)).await;
    bench.submit(NewSweep { priority: 1, record: true, ..sweep(&["rg"], 2) }).await;
    let jobs = bench.worker().await.claim(4).await;
    assert_eq!(
        jobs.iter().map(|job| (job.scenario.0, job.record)).collect::<Vec<_>>(),
        [(2, true), (2, true), (1, false), (1, false)]
    );
}

#[tokio::test]
async fn a_failed_job_is_queued_again_by_a_new_submission() {
    let bench = Bench::new().await;
    let first = bench.submit(sweep(&["rgop"], 1)).await;
    let worker = bench.worker().await;
    for _ in 0..3 {
        let job = worker.claim(1).await.remove(0);
        worker.ended(&job, panicked("no")).await;
        bench.clock.advance(10_000);
    }
    let failed = bench.sweep(first.id).await;
    assert_eq!((failed.state, failed.failed), (SweepState::Done, 1));

    let again = bench.submit(sweep(&["rgop"], 1)).await;
    assert_eq!((again.new, again.cached), (0, 0));
    let revived = bench.sweep(first.id).await;
    assert_eq!((revived.state, revived.failed, revived.queued), (SweepState::Active, 0, 1));
    bench.assert_consistent().await;
    let job = worker.claim(1).await.remove(0);
    assert_eq!(job.attempt, 4, "attempts go on counting: the fence holds");
    assert!(worker.ended(&job, done(1.0)).await);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_timing_sweep_takes_nothing_from_the_cache_and_runs_alone() {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 1)).await;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);
    worker.ended(&job, done(1.0)).await;
    for _ in 0..2 {
        let timing = bench.submit(NewSweep { timing: true, ..sweep(&["rgop"], 1) }).await;
        assert_eq!((timing.new, timing.cached), (1, 0));
        let job = worker.claim(1).await.remove(0);
        assert!(job.alone);
        worker.ended(&job, done(1.0)).await;
    }
}

#[tokio::test]
async fn an_idempotency_key_stands_for_one_submission() {
    let bench = Bench::new().await;
    let keyed = || NewSweep { idempotency_key: Some("monday".to_owned()), ..sweep(&["rgop"], 2) };
    let first = bench.submit(keyed()).await;
    assert_eq!(bench.submit(keyed()).await, first);
    let other = NewSweep { request_json: r#"{"plan":"other"}"#.to_owned(), ..keyed() };
    let refused = bench.coordinator.submit(other).await.unwrap_err();
    assert!(matches!(&refused, StoreError::Conflict { key } if key == "monday"), "{refused}");
    assert_eq!(bench.coordinator.sweeps(None, 10).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_pool_of_scenarios_shares_a_cell_and_a_repeated_one_counts_once() {
    let bench = Bench::new().await;
    let mut pooled = sweep(&["iaf"], 2);
    pooled.cells[0].scenarios = ["{\"a\":1}", "{\"a\":2}", "{\"a\":1}"].map(Arc::from).to_vec();
    let submitted = bench.submit(pooled).await;
    assert_eq!(submitted.total, 4);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn what_breaks_a_rule_is_refused_and_leaves_nothing() {
    let bench = Bench::new().await;
    let mut no_scenario = sweep(&["rgop"], 1);
    no_scenario.cells[0].scenarios.clear();
    let mut no_factor = sweep(&["rgop"], 1);
    no_factor.cells[0].factors.clear();
    let engine = EngineId([1; 32]);
    let wrong = [
        no_scenario,
        no_factor,
        sweep(&[], 1),
        sweep(&["rgop"], 0),
        sweep(&["rgop"], u64::MAX),
        sweep(&["rgop", "rgop"], 1),
        NewSweep { name: "n".repeat(500), ..sweep(&["rgop"], 1) },
        NewSweep { idempotency_key: Some(String::new()), ..sweep(&["rgop"], 1) },
    ];
    for sweep in wrong {
        assert!(matches!(bench.coordinator.submit(sweep).await, Err(StoreError::Invalid(_))));
    }
    let foreign = bench.coordinator.submit(NewSweep { engine, ..sweep(&["rgop"], 1) }).await.unwrap_err();
    assert!(matches!(foreign, StoreError::OtherEngine { coordinator: ENGINE, .. }), "{foreign}");
    assert!(bench.coordinator.sweeps(None, 10).await.unwrap().is_empty());
}
