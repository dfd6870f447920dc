use furrow_schema::job::JobState;
use furrow_schema::protocol::{LEASE_MS, LeasedJob, RunEnd, RunReport};

use super::*;
use crate::testing::{Bench, done, panicked, record, sweep};

const LEASE_PASSED_MS: i64 = LEASE_MS + 1;

async fn one_job() -> Bench {
    let bench = Bench::new().await;
    bench.submit(sweep(&["rgop"], 1)).await;
    bench
}

#[tokio::test]
async fn a_result_is_recorded_once() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);

    assert!(worker.ended(&job, done(2.5)).await);
    assert!(worker.ended(&job, done(2.5)).await, "an equal result is the one on record");

    let detail = bench.job(&job).await;
    assert_eq!(detail.state, JobState::Done);
    let result = detail.result.unwrap();
    assert_eq!((result.worker, result.attempt, result.outcome.as_str()), (worker.id.clone(), 1, "success"));
    assert_eq!(result.metrics, record(2.5).metrics);
    assert_eq!(detail.attempts.len(), 1);
    assert_eq!(detail.attempts[0].end, AttemptEnd::Done);
    assert!(detail.incidents.is_empty());
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_report_twice_in_one_batch_counts_once() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);
    let run = RunReport { job: job.job, attempt: 1, ended: done(1.0) };
    let answer = worker.report(vec![run.clone(), run]).await;
    assert_eq!(answer.recorded, [job.job, job.job]);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_second_digest_is_an_incident_and_changes_nothing() {
    let bench = one_job().await;
    let (slow, quick) = (bench.worker().await, bench.worker().await);
    let stale = slow.claim(1).await.remove(0);
    bench.pass(LEASE_PASSED_MS).await;
    let job = quick.claim(1).await.remove(0);
    assert!(quick.ended(&job, done(1.0)).await);

    assert!(!slow.ended(&stale, done(2.0)).await);
    assert!(!slow.ended(&stale, done(2.0)).await, "the same incident again is kept once");

    let detail = bench.job(&job).await;
    assert_eq!(detail.result.unwrap().digest, record(1.0).digest);
    let incidents = bench.coordinator.incidents(10).await.unwrap();
    assert_eq!(incidents, detail.incidents);
    assert_eq!(incidents.len(), 1);
    assert_eq!((&incidents[0].recorded_worker, &incidents[0].other_worker), (&quick.id, &slow.id));
    assert_eq!((incidents[0].recorded_digest, incidents[0].other_digest), (record(1.0).digest, record(2.0).digest));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_past_holder_may_still_bring_the_result() {
    let bench = one_job().await;
    let (slow, other) = (bench.worker().await, bench.worker().await);
    let stale = slow.claim(1).await.remove(0);
    bench.pass(LEASE_PASSED_MS).await;
    let job = other.claim(1).await.remove(0);
    assert_eq!(job.attempt, 2);

    assert!(slow.ended(&stale, done(1.0)).await);

    let detail = bench.job(&job).await;
    assert_eq!(detail.state, JobState::Done);
    assert_eq!(detail.result.unwrap().worker, slow.id);
    let ends: Vec<_> = detail.attempts.iter().map(|attempt| (attempt.attempt, attempt.end)).collect();
    assert_eq!(ends, [(1, AttemptEnd::Done), (2, AttemptEnd::Superseded)]);
    assert_eq!(other.renew(&[job], true).await.lost, [stale.job]);
    assert!(other.ended(&LeasedJob { attempt: 2, ..stale }, done(1.0)).await, "an equal result is welcome");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_worker_that_never_held_the_job_is_ignored() {
    let bench = one_job().await;
    let (holder, liar) = (bench.worker().await, bench.worker().await);
    let job = holder.claim(1).await.remove(0);
    for ended in [done(9.0), panicked("no"), RunEnd::HandedBack] {
        assert!(!liar.ended(&job, ended).await);
    }
    assert!(!holder.ended(&LeasedJob { attempt: 7, ..job.clone() }, done(9.0)).await);
    assert!(!holder.ended(&LeasedJob { job: JobId(999), ..job.clone() }, done(9.0)).await);
    assert_eq!(bench.job(&job).await.state, JobState::Leased);
    assert!(holder.ended(&job, done(1.0)).await);
    assert!(!liar.ended(&job, done(9.0)).await);
    assert!(bench.coordinator.incidents(10).await.unwrap().is_empty());
}

#[tokio::test]
async fn a_handed_back_job_is_queued_at_once_and_uncharged() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    for attempt in 1..=5 {
        let job = worker.claim(1).await.remove(0);
        assert_eq!(job.attempt, attempt);
        assert!(worker.ended(&job, RunEnd::HandedBack).await);
        assert!(worker.ended(&job, RunEnd::HandedBack).await, "the same report again is answered alike");
    }
    bench.assert_consistent().await;
}

#[tokio::test]
async fn panics_back_off_and_the_third_is_the_last() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    for panics in 1..=2 {
        let job = worker.claim(1).await.remove(0);
        assert!(worker.ended(&job, panicked("index out of bounds")).await);
        let wait_ms = back_off_ms(&bench.job(&job).await.key, job.attempt, panics);
        assert!(worker.claim(1).await.is_empty(), "it backs off");
        bench.clock.advance(wait_ms - 1);
        assert!(worker.claim(1).await.is_empty());
        bench.clock.advance(1);
    }
    let job = worker.claim(1).await.remove(0);
    assert!(worker.ended(&job, panicked("once more")).await);

    let detail = bench.job(&job).await;
    assert_eq!(detail.state, JobState::Failed);
    let reasons: Vec<_> = detail.attempts.iter().map(|attempt| attempt.reason.as_deref().unwrap()).collect();
    assert_eq!(reasons, ["index out of bounds", "index out of bounds", "once more"]);
    bench.clock.advance(1_000_000);
    assert!(worker.claim(1).await.is_empty());
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_failed_job_that_succeeds_after_all_is_done() {
    let bench = one_job().await;
    let (slow, unlucky) = (bench.worker().await, bench.worker().await);
    let stale = slow.claim(1).await.remove(0);
    bench.pass(LEASE_PASSED_MS).await;
    for _ in 0..3 {
        let job = unlucky.claim(1).await.remove(0);
        unlucky.ended(&job, panicked("no")).await;
        bench.clock.advance(10_000);
    }
    assert_eq!(bench.job(&stale).await.state, JobState::Failed);
    bench.assert_consistent().await;

    assert!(slow.ended(&stale, done(1.0)).await);
    assert_eq!(bench.job(&stale).await.state, JobState::Done);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_panic_and_a_late_result_in_one_report_leave_the_counts_right() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    for _ in 0..2 {
        let job = worker.claim(1).await.remove(0);
        worker.ended(&job, panicked("no")).await;
        bench.clock.advance(10_000);
    }
    let job = worker.claim(1).await.remove(0);
    let run = |ended| RunReport { job: job.job, attempt: job.attempt, ended };
    worker.report(vec![run(panicked("third")), run(done(1.0))]).await;
    assert_eq!(bench.job(&job).await.state, JobState::Done);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn metrics_and_trajectories_come_back_bit_for_bit() {
    let bench = one_job().await;
    let worker = bench.worker().await;
    let job = worker.claim(1).await.remove(0);
    let values = [0.1, 1.0 / 3.0, 5e-324, 1.797e99, -0.0, 123_456_789.123_456_79, f64::MIN_POSITIVE, 2.0_f64.powi(60)];
    let mut sent = record(1.0);
    sent.metrics = values.iter().enumerate().map(|(i, v)| (format!("metric_{i}"), *v)).collect();
    sent.timings.metrics = sent.metrics.clone();
    sent.trajectory = Some("00ff10".to_owned());
    assert!(worker.ended(&job, RunEnd::Done(sent.clone())).await);

    let result = bench.job(&job).await.result.unwrap();
    let bits = |metrics: &BTreeMap<String, f64>| metrics.values().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&result.metrics), bits(&sent.metrics));
    assert_eq!(result.timings, sent.timings);
    assert_eq!(result.trajectory, Some(vec![0x00, 0xff, 0x10]));
}
