//! What pausing, cancelling and retrying do to jobs, counts and workers.

use furrow_schema::job::JobState;
use furrow_schema::protocol::{LeasedJob, RunEnd};
use furrow_schema::sweep::{NewSweep, Sweep};

use super::*;
use crate::testing::{Bench, Worker, done, panicked, sweep};
use crate::view::AttemptEnd;

impl Bench {
    async fn pause(&self, id: SweepId, paused: bool) -> Sweep {
        let change = SweepChange { paused: Some(paused), ..SweepChange::default() };
        self.coordinator.change(id, change).await.unwrap().unwrap()
    }

    async fn set_priority(&self, id: SweepId, priority: i64) -> Sweep {
        let change = SweepChange { priority: Some(priority), ..SweepChange::default() };
        self.coordinator.change(id, change).await.unwrap().unwrap()
    }

    async fn cancel(&self, id: SweepId) -> Sweep {
        self.coordinator.cancel(id).await.unwrap().unwrap()
    }

    async fn retry(&self, id: SweepId) -> Sweep {
        self.coordinator.retry(id).await.unwrap().unwrap()
    }

    /// Lets the one job of a sweep fail for good.
    async fn fail_one(&self, worker: &Worker) -> LeasedJob {
        let mut last = None;
        for _ in 0..3 {
            let job = worker.claim(1).await.remove(0);
            worker.ended(&job, panicked("no")).await;
            self.clock.advance(10_000);
            last = Some(job);
        }
        last.unwrap()
    }
}

/// The scenarios of jobs, by which sweeps of one label each can be told apart.
fn scenarios(jobs: &[LeasedJob]) -> Vec<i64> {
    jobs.iter().map(|job| job.scenario.0).collect()
}

#[tokio::test]
async fn a_paused_sweep_hands_out_nothing_and_what_runs_may_end() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 5)).await.id;
    let worker = bench.worker().await;
    let running = worker.claim(2).await;

    let paused = bench.pause(id, true).await;
    assert_eq!((paused.state, paused.queued, paused.leased, paused.eta_s), (SweepState::Paused, 3, 2, None));
    assert!(worker.claim(5).await.is_empty());
    assert!(worker.renew(&running, true).await.lost.is_empty(), "what runs stays the worker's");
    assert!(worker.ended(&running[0], done(1.0)).await);
    assert!(worker.ended(&running[1], RunEnd::HandedBack).await);
    assert!(worker.claim(5).await.is_empty(), "what is handed back waits, too");
    bench.assert_consistent().await;

    let resumed = bench.pause(id, false).await;
    assert_eq!((resumed.state, resumed.done, resumed.queued), (SweepState::Active, 1, 4));
    assert_eq!(worker.claim(5).await.len(), 4);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_job_that_another_sweep_wants_goes_on_with_that_ones_priority() {
    let bench = Bench::new().await;
    let high = bench.submit(NewSweep { priority: 9, ..sweep(&["shared", "own"], 1) }).await.id;
    bench.submit(NewSweep { priority: 1, ..sweep(&["shared"], 1) }).await;
    bench.submit(NewSweep { priority: 5, ..sweep(&["between"], 1) }).await;
    bench.pause(high, true).await;
    bench.assert_consistent().await;
    let worker = bench.worker().await;
    assert_eq!(scenarios(&worker.claim(9).await), [3, 1], "`between` before `shared`, and nothing else");
}

#[tokio::test]
async fn a_priority_moves_a_sweep_before_others_and_behind() {
    let bench = Bench::new().await;
    let first = bench.submit(sweep(&["first"], 2)).await.id;
    bench.submit(sweep(&["second"], 2)).await;
    let worker = bench.worker().await;
    assert_eq!(bench.set_priority(first, -1).await.priority, -1);
    assert_eq!(scenarios(&worker.claim(1).await), [2]);
    assert_eq!(bench.set_priority(first, 7).await.priority, 7);
    assert_eq!(bench.set_priority(first, 7).await.priority, 7);
    assert_eq!(scenarios(&worker.claim(9).await), [1, 1, 2]);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_resumed_sweep_takes_turns_and_does_not_catch_up() {
    let bench = Bench::new().await;
    let paused = bench.submit(sweep(&["paused"], 100)).await.id;
    bench.submit(sweep(&["other"], 200)).await;
    bench.pause(paused, true).await;
    let worker = bench.worker().await;
    assert!(scenarios(&worker.claim(100).await).iter().all(|scenario| *scenario == 2));
    bench.pause(paused, false).await;
    let resumed = scenarios(&worker.claim(40).await).iter().filter(|scenario| **scenario == 1).count();
    assert!((19..=21).contains(&resumed), "{resumed} of 40");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn priorities_go_before_turns_whatever_is_paused_between() {
    let bench = Bench::new().await;
    let a = bench.submit(NewSweep { priority: 2, ..sweep(&["a"], 30) }).await.id;
    let b = bench.submit(NewSweep { priority: 2, ..sweep(&["b"], 30) }).await.id;
    bench.submit(sweep(&["low"], 30)).await;
    let worker = bench.worker().await;
    let count = |jobs: &[LeasedJob]| [1, 2, 3].map(|it| jobs.iter().filter(|job| job.scenario.0 == it).count());
    assert_eq!(count(&worker.claim(10).await), [5, 5, 0]);
    bench.pause(a, true).await;
    assert_eq!(count(&worker.claim(10).await), [0, 10, 0]);
    bench.pause(b, true).await;
    assert_eq!(count(&worker.claim(10).await), [0, 0, 10]);
    bench.pause(a, false).await;
    bench.pause(b, false).await;
    let both = count(&worker.claim(10).await);
    assert!(both[2] == 0 && (4..=6).contains(&both[0]), "{both:?}");
}

#[tokio::test]
async fn a_cancelled_sweep_gives_its_jobs_up_and_its_workers_hear_of_it() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 5)).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(3).await;
    worker.ended(&jobs[0], done(1.0)).await;

    let cancelled = bench.cancel(id).await;
    let counts = (cancelled.done, cancelled.cancelled, cancelled.queued, cancelled.leased);
    assert_eq!((cancelled.state, counts), (SweepState::Cancelled, (1, 4, 0, 0)));
    assert!(cancelled.finished_ms.is_some());
    assert_eq!(worker.renew(&jobs[1..], true).await.lost, [jobs[1].job, jobs[2].job]);
    assert!(worker.claim(5).await.is_empty());
    assert_eq!(bench.job(&jobs[1]).await.attempts[0].end, AttemptEnd::Cancelled);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_run_stopped_by_a_cancel_is_neither_a_result_nor_a_failure() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 2)).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(2).await;
    bench.cancel(id).await;
    assert!(!worker.ended(&jobs[0], RunEnd::HandedBack).await);
    assert!(!worker.ended(&jobs[1], panicked("too late")).await);
    let stopped = bench.sweep(id).await;
    assert_eq!((stopped.done, stopped.failed, stopped.cancelled), (0, 0, 2));
    assert_eq!(bench.job(&jobs[0]).await.state, JobState::Cancelled);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_result_that_comes_after_the_cancel_is_recorded() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 2)).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(2).await;
    bench.cancel(id).await;
    assert!(worker.ended(&jobs[0], done(1.0)).await);
    let late = bench.sweep(id).await;
    assert_eq!((late.state, late.done, late.cancelled), (SweepState::Cancelled, 1, 1));
    assert_eq!(bench.job(&jobs[0]).await.state, JobState::Done);
    bench.assert_consistent().await;
    let again = bench.submit(sweep(&["rgop"], 2)).await;
    assert_eq!((again.cached, again.new), (1, 0));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn cancelling_spares_what_another_live_sweep_wants() {
    let bench = Bench::new().await;
    let a = bench.submit(sweep(&["shared", "own"], 1)).await.id;
    let b = bench.submit(sweep(&["shared"], 1)).await.id;
    let worker = bench.worker().await;
    let jobs = worker.claim(2).await;
    let cancelled = bench.cancel(a).await;
    assert_eq!((cancelled.leased, cancelled.cancelled), (1, 1));
    assert_eq!(worker.renew(&jobs, true).await.lost, [jobs[1].job]);
    bench.pause(b, true).await;
    assert_eq!(bench.cancel(b).await.cancelled, 1);
    assert_eq!(bench.sweep(a).await.cancelled, 2, "counts are per sweep");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_retry_brings_back_what_failed_and_what_was_cancelled() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 3)).await.id;
    let worker = bench.worker().await;
    let failed = bench.fail_one(&worker).await;
    bench.cancel(id).await;
    let retried = bench.retry(id).await;
    let counts = (retried.queued, retried.failed, retried.cancelled);
    assert_eq!((retried.state, counts, retried.finished_ms), (SweepState::Active, (3, 0, 0), None));
    assert_eq!(bench.job(&failed).await.attempts.len(), 3, "the history stays");
    bench.assert_consistent().await;
    let jobs = worker.claim(5).await;
    let again = jobs.iter().find(|job| job.job == failed.job).unwrap();
    assert_eq!(again.attempt, 4);
    for job in &jobs {
        assert!(worker.ended(job, done(1.0)).await);
    }
    assert_eq!(bench.sweep(id).await.state, SweepState::Done);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_retry_of_a_sweep_that_is_done_makes_it_active_if_anything_failed() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 1)).await.id;
    let worker = bench.worker().await;
    bench.fail_one(&worker).await;
    assert_eq!(bench.sweep(id).await.state, SweepState::Done);
    assert_eq!(bench.retry(id).await.state, SweepState::Active);
    let job = worker.claim(1).await.remove(0);
    worker.ended(&job, done(1.0)).await;
    let finished = bench.sweep(id).await;
    assert_eq!(bench.retry(id).await, finished, "nothing failed: nothing changes");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_retry_of_a_cancelled_sweep_whose_results_came_anyway_is_done() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 1)).await.id;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);
    bench.cancel(id).await;
    worker.ended(&job, done(1.0)).await;
    assert_eq!(bench.sweep(id).await.state, SweepState::Cancelled);
    assert_eq!(bench.retry(id).await.state, SweepState::Done);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn submitting_a_cancelled_sweep_again_queues_its_jobs() {
    let bench = Bench::new().await;
    let first = bench.submit(sweep(&["rgop"], 2)).await.id;
    bench.cancel(first).await;
    let second = bench.submit(NewSweep { priority: 4, ..sweep(&["rgop"], 2) }).await;
    assert_eq!((second.total, second.new), (2, 0));
    assert_eq!(bench.worker().await.claim(9).await.len(), 2);
    let first = bench.sweep(first).await;
    assert_eq!((first.state, first.cancelled, first.leased), (SweepState::Cancelled, 0, 2));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn submitting_what_is_paused_hands_it_out_for_the_new_sweep() {
    let bench = Bench::new().await;
    let first = bench.submit(NewSweep { priority: 4, ..sweep(&["rgop"], 2) }).await.id;
    bench.pause(first, true).await;
    bench.submit(sweep(&["rgop"], 2)).await;
    bench.assert_consistent().await;
    assert_eq!(bench.worker().await.claim(9).await.len(), 2);
}

#[tokio::test]
async fn doing_it_again_changes_nothing() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 3)).await.id;
    bench.worker().await.claim(1).await;
    assert_eq!(bench.pause(id, true).await, bench.pause(id, true).await);
    assert_eq!(bench.pause(id, false).await, bench.pause(id, false).await);
    let cancelled = bench.cancel(id).await;
    bench.clock.advance(1_000);
    assert_eq!(bench.cancel(id).await, cancelled);
    assert_eq!(bench.pause(id, true).await, cancelled, "there is nothing to pause");
    assert_eq!(bench.retry(id).await, bench.retry(id).await);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_cancelled_sweep_cannot_be_resumed_and_an_unknown_one_is_none() {
    let bench = Bench::new().await;
    let id = bench.submit(sweep(&["rgop"], 1)).await.id;
    bench.cancel(id).await;
    let resume = SweepChange { paused: Some(false), ..SweepChange::default() };
    let refused = bench.coordinator.change(id, resume).await.unwrap_err();
    assert!(matches!(refused, StoreError::Cancelled(sweep) if sweep == id), "{refused}");
    let unknown = SweepId(77);
    assert_eq!(bench.coordinator.change(unknown, resume).await.unwrap(), None);
    assert_eq!(bench.coordinator.cancel(unknown).await.unwrap(), None);
    assert_eq!(bench.coordinator.retry(unknown).await.unwrap(), None);
    assert!(!bench.coordinator.remove(unknown).await.unwrap());
}
