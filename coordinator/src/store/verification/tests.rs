use furrow_schema::job::JobState;
use furrow_schema::protocol::{LEASE_MS, LeasedJob, Refusal, RunEnd};
use furrow_schema::sweep::NewSweep;

use super::*;
use crate::testing::{Bench, Worker, done, panicked, record, sweep};
use crate::view::{JobDetail, VerificationState};

/// Others had this long to come.
const ALONE_MS: i64 = 60_000;

/// One job with the result 1.0 of the first worker, to be verified.
async fn one_result() -> (Bench, Worker, LeasedJob) {
    let bench = Bench::verifying(1.0).await;
    bench.submit(sweep(&["rgop"], 1)).await;
    let worker = bench.worker().await;
    let job = worker.claim_one().await;
    assert!(worker.ended(&job, done(1.0)).await);
    (bench, worker, job)
}

async fn state(bench: &Bench, job: &LeasedJob) -> VerificationState {
    bench.job(job).await.verification.unwrap().state
}

/// What is on record after all.
async fn assert_untouched(bench: &Bench, job: &LeasedJob) -> JobDetail {
    bench.assert_consistent().await;
    let detail = bench.job(job).await;
    assert_eq!(detail.state, JobState::Done);
    assert_eq!(detail.result.as_ref().unwrap().digest, record(1.0).digest);
    assert_eq!(detail.result.as_ref().unwrap().attempt, 1);
    detail
}

#[test]
fn a_share_of_the_keys_is_chosen_and_always_the_same() {
    let keys: Vec<_> = (0..10_000u32).map(|n| JobKey(blake3::hash(&n.to_le_bytes()).into())).collect();
    let chosen = |share: f64| keys.iter().filter(|key| is_chosen(key, share)).count();
    assert_eq!((chosen(0.0), chosen(1.0)), (0, keys.len()));
    assert!((50..200).contains(&chosen(0.01)), "{}", chosen(0.01));
    assert!(keys.iter().all(|key| !is_chosen(key, 0.01) || is_chosen(key, 0.02)));
    assert!(is_chosen(&JobKey([0; 32]), f64::MIN_POSITIVE) && !is_chosen(&JobKey([255; 32]), 0.999_999));
}

#[tokio::test]
async fn another_worker_computes_a_result_again_and_agrees() {
    let (bench, first, job) = one_result().await;
    assert_eq!(bench.sweep(furrow_schema::id::SweepId(1)).await.state, furrow_schema::sweep::SweepState::Done);
    assert!(first.claim(1).await.is_empty(), "its own result is for others to verify");
    let second = bench.worker().await;
    let again = second.claim_one().await;
    assert_eq!((again.job, again.scenario, again.seed, again.attempt), (job.job, job.scenario, job.seed, 2));
    assert!(second.renew(std::slice::from_ref(&again), true).await.lost.is_empty());

    assert!(second.ended(&again, done(1.0)).await);
    assert!(second.ended(&again, done(1.0)).await, "the same report again is answered alike");

    assert_eq!(state(&bench, &job).await, VerificationState::Agreed);
    assert!(second.claim(1).await.is_empty() && first.claim(1).await.is_empty());
    assert_eq!(bench.coordinator.verifications().await.unwrap().agreed, 1);
    let detail = assert_untouched(&bench, &job).await;
    assert_eq!((detail.attempts.len(), detail.incidents.len()), (1, 0));
    assert_eq!(detail.verification.unwrap().opinions[0].worker, second.id);
}

#[tokio::test]
async fn nothing_is_verified_unless_asked_for_and_never_a_measurement() {
    let (plain, timing) = (Bench::new().await, Bench::verifying(1.0).await);
    for (bench, timing) in [(&plain, false), (&timing, true)] {
        bench.submit(NewSweep { timing, ..sweep(&["rgop"], 1) }).await;
        let (worker, other) = (bench.worker().await, bench.worker().await);
        let job = worker.claim_one().await;
        worker.ended(&job, done(1.0)).await;
        assert!(other.claim(1).await.is_empty());
        assert_eq!(bench.job(&job).await.verification, None);
    }
}

#[tokio::test]
async fn verifications_go_before_ordinary_jobs_and_a_repeated_claim_gets_them_again() {
    let bench = Bench::verifying(1.0).await;
    bench.submit(sweep(&["rgop"], 4)).await;
    let (first, second) = (bench.worker().await, bench.worker().await);
    let job = first.claim_one().await;
    first.ended(&job, done(1.0)).await;
    let call = second.claim_call(2);
    let leases = bench.coordinator.claim(call.clone()).await;
    let jobs = leases.clone().into_result().unwrap().jobs;
    assert_eq!(jobs.iter().map(|job| (job.job.0, job.attempt)).collect::<Vec<_>>(), [(1, 2), (2, 1)]);
    assert_eq!(bench.coordinator.claim(call).await, leases);
    bench.assert_consistent().await;
}

#[tokio::test]
async fn alone_for_a_minute_a_worker_verifies_its_own_results() {
    let (bench, only, job) = one_result().await;
    bench.clock.advance(ALONE_MS - 1);
    assert!(only.claim(1).await.is_empty());
    bench.clock.advance(1);
    let again = only.claim_one().await;
    assert!(only.ended(&again, done(1.0)).await);
    assert_eq!(state(&bench, &job).await, VerificationState::Agreed);
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn a_worker_leaves_its_own_results_to_others_as_long_as_they_are_heard_of() {
    let (bench, first, _) = one_result().await;
    let busy = bench.worker().await;
    for _ in 0..3 {
        bench.clock.advance(ALONE_MS / 2);
        busy.renew(&[], true).await;
        assert!(first.claim(1).await.is_empty());
    }
    bench.clock.advance(ALONE_MS);
    first.claim_one().await;
}

#[tokio::test]
async fn a_liar_is_outvoted_by_the_recorder_and_a_third_and_barred() {
    let (bench, _, job) = one_result().await;
    let (liar, third) = (bench.worker().await, bench.worker().await);
    let again = liar.claim_one().await;
    assert!(!liar.ended(&again, done(9.0)).await);
    assert_eq!(state(&bench, &job).await, VerificationState::Waits);
    assert!(liar.claim(1).await.is_empty(), "a third is asked");
    let vote = third.claim_one().await;
    assert_eq!((vote.job, vote.attempt), (job.job, 3));
    assert!(third.ended(&vote, done(1.0)).await);

    assert_eq!(state(&bench, &job).await, VerificationState::Upheld);
    assert!(matches!(liar.refusal().await, Refusal::Barred { detail } if detail.contains("job 1")));
    assert!(third.claim(1).await.is_empty());
    let detail = assert_untouched(&bench, &job).await;
    assert_eq!((detail.incidents.len(), &detail.incidents[0].other_worker), (1, &liar.id));
    assert_eq!(detail.incidents[0].verification, Some(VerificationState::Upheld));
    assert_eq!(detail.incidents[0].recorded_engine, detail.incidents[0].other_engine);
}

#[tokio::test]
async fn a_liar_whose_result_is_on_record_is_outvoted_and_the_result_is_disputed() {
    let (bench, liar, job) = one_result().await;
    let (second, third) = (bench.worker().await, bench.worker().await);
    for worker in [&second, &third] {
        let vote = worker.claim_one().await;
        assert!(!worker.ended(&vote, done(2.0)).await, "the result on record stays");
    }
    assert_eq!(state(&bench, &job).await, VerificationState::Overruled);
    assert!(matches!(liar.refusal().await, Refusal::Barred { .. }));
    assert_eq!(bench.sweep(furrow_schema::id::SweepId(1)).await.disputed, 1);
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn two_that_insist_are_asked_again_and_left_undecided() {
    let (bench, first, job) = one_result().await;
    let second = bench.worker().await;
    let again = second.claim_one().await;
    second.ended(&again, done(2.0)).await;
    for (worker, value) in [(&first, 1.0), (&second, 2.0)] {
        assert!(worker.claim(1).await.is_empty(), "others have a minute to come");
        bench.clock.advance(ALONE_MS);
        let vote = worker.claim_one().await;
        worker.ended(&vote, done(value)).await;
    }
    assert_eq!(state(&bench, &job).await, VerificationState::Undecided);
    assert!(bench.coordinator.workers().await.unwrap().iter().all(|worker| worker.barred.is_none()));
    assert_eq!(bench.sweep(furrow_schema::id::SweepId(1)).await.disputed, 1);
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn a_worker_that_contradicts_itself_is_barred() {
    let (bench, torn, job) = one_result().await;
    let second = bench.worker().await;
    let again = second.claim_one().await;
    second.ended(&again, done(2.0)).await;
    bench.clock.advance(ALONE_MS);
    let vote = torn.claim_one().await;
    torn.ended(&vote, done(3.0)).await;
    assert_eq!(state(&bench, &job).await, VerificationState::Overruled);
    assert!(matches!(torn.refusal().await, Refusal::Barred { .. }));
    assert!(second.claim(1).await.is_empty());
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn a_verifier_that_has_a_second_opinion_is_barred_and_the_second_is_not_taken() {
    for (first_opinion, second_opinion) in [(1.0, -2.0), (-2.0, -3.0)] {
        let (bench, first, job) = one_result().await;
        let second = bench.worker().await;
        let again = second.claim_one().await;
        assert_eq!(second.ended(&again, done(first_opinion)).await, first_opinion == 1.0);
        assert!(!second.is_barred().await);

        assert!(!second.ended(&again, done(second_opinion)).await, "what is not on record is not acknowledged");

        assert!(second.is_barred().await && !first.is_barred().await);
        let detail = assert_untouched(&bench, &job).await;
        let others: Vec<_> = detail.incidents.iter().map(|incident| incident.other_digest).collect();
        assert!(others.contains(&record(second_opinion).digest), "{others:?}");
        assert_eq!(detail.verification.unwrap().opinions[0].digest, record(first_opinion).digest);
    }
}

#[tokio::test]
async fn a_second_result_that_came_unasked_is_voted_on_too() {
    let bench = Bench::verifying(1e-12).await;
    bench.submit(sweep(&["rgop"], 1)).await;
    let (slow, quick, third) = (bench.worker().await, bench.worker().await, bench.worker().await);
    let stale = slow.claim_one().await;
    bench.pass(LEASE_MS).await;
    let job = quick.claim_one().await;
    quick.ended(&job, done(1.0)).await;
    assert_eq!(bench.job(&job).await.verification, None, "it was not chosen");

    assert!(!slow.ended(&stale, done(2.0)).await);
    let vote = third.claim_one().await;
    third.ended(&vote, done(1.0)).await;

    assert_eq!(state(&bench, &job).await, VerificationState::Upheld);
    assert!(matches!(slow.refusal().await, Refusal::Barred { .. }));
    bench.assert_consistent().await;
}

#[tokio::test]
async fn a_barred_worker_loses_its_jobs_free_of_charge_and_its_other_results_are_verified() {
    let bench = Bench::verifying(1e-12).await;
    bench.submit(sweep(&["rgop"], 4)).await;
    let liar = bench.worker().await;
    let jobs = liar.claim(4).await;
    let (honest, third) = (bench.worker().await, bench.worker().await);
    liar.renew(&jobs, true).await;
    liar.ended(&jobs[0], done(1.0)).await;
    liar.ended(&jobs[1], done(7.0)).await;
    open(&mut bench.store.writer().acquire().await.unwrap(), &[jobs[0].job], 0).await.unwrap();
    for worker in [&honest, &third] {
        let vote = worker.claim_one().await;
        worker.ended(&vote, done(2.0)).await;
    }

    bench.clock.advance(4_000);
    let left: Vec<_> = honest.claim(9).await;
    let numbers: Vec<_> = left.iter().map(|job| (job.job.0, job.attempt)).collect();
    assert_eq!(numbers, [(2, 2), (3, 2), (4, 2)], "a result to verify, and the two jobs that it held");
    let detail = bench.job(&jobs[2]).await;
    assert_eq!(
        (detail.attempts[0].end, detail.attempts[0].reason.as_deref()),
        (crate::AttemptEnd::Expired, Some("the worker was barred"))
    );

    assert!(!honest.ended(&left[0], done(8.0)).await);
    assert_eq!(state(&bench, &jobs[1]).await, VerificationState::Overruled, "the liar has no voice any more");
    bench.assert_consistent().await;
}

#[tokio::test]
async fn the_reports_renewals_and_hellos_of_a_barred_worker_are_refused_until_it_is_allowed_again() {
    let (bench, liar, _) = one_result().await;
    for worker in [&bench.worker().await, &bench.worker().await] {
        let vote = worker.claim_one().await;
        worker.ended(&vote, done(2.0)).await;
    }
    let barred = |refusal| matches!(refusal, Refusal::Barred { .. });
    let renew = liar.call(furrow_schema::protocol::Renew { held: vec![] });
    assert!(barred(bench.coordinator.renew(renew).await.into_result().unwrap_err()));
    let report = furrow_schema::protocol::Report { engine: crate::testing::ENGINE, runs: vec![] };
    assert!(barred(bench.coordinator.result(liar.call(report)).await.into_result().unwrap_err()));
    let hello = furrow_schema::protocol::Hello { name: "x".to_owned(), engine: crate::testing::ENGINE, threads: 1 };
    assert!(barred(bench.coordinator.hello(liar.call(hello)).await.into_result().unwrap_err()));
    let info = bench.coordinator.workers().await.unwrap().into_iter().find(|worker| worker.id == liar.id).unwrap();
    assert!(info.barred.unwrap().reason.contains("job 1"));

    assert!(bench.coordinator.allow(liar.id.clone()).await.unwrap());
    assert!(!bench.coordinator.allow(WorkerId::random()).await.unwrap());
    liar.hello().await;
    assert!(liar.claim(1).await.is_empty());
}

#[tokio::test]
async fn what_goes_wrong_with_a_verification_is_never_charged_and_it_is_given_up_in_the_end() {
    let (bench, _, job) = one_result().await;
    let other = bench.worker().await;
    let panics = other.claim_one().await;
    assert!(other.ended(&panics, panicked("no")).await);
    for _ in 0..5 {
        let back = other.claim_one().await;
        assert!(other.ended(&back, RunEnd::HandedBack).await, "that counts for nothing");
    }
    let dies = other.claim_one().await;
    other.renew(std::slice::from_ref(&dies), true).await;
    let gone_ms = bench.coordinator.now_ms();
    bench.clock.advance(2_000);
    assert_eq!(bench.coordinator.worker_gone(other.id.clone(), gone_ms).await.unwrap(), None);
    assert_eq!(other.renew(std::slice::from_ref(&dies), true).await.lost, [job.job]);
    assert!(!other.ended(&dies, done(1.0)).await, "that came too late");
    let expires = other.claim_one().await;
    bench.pass(LEASE_MS).await;

    assert_eq!(state(&bench, &job).await, VerificationState::GivenUp);
    assert_eq!(expires.attempt, 9);
    assert!(other.claim(1).await.is_empty());
    let detail = assert_untouched(&bench, &job).await;
    assert_eq!(detail.attempts.len(), 1);
}

#[tokio::test]
async fn a_vote_that_nobody_brings_to_an_end_is_undecided() {
    let (bench, _, job) = one_result().await;
    let (second, third) = (bench.worker().await, bench.worker().await);
    let again = second.claim_one().await;
    second.ended(&again, done(2.0)).await;
    for _ in 0..MOST_FRUITLESS {
        third.claim_one().await;
        bench.pass(LEASE_MS).await;
    }
    assert_eq!(state(&bench, &job).await, VerificationState::Undecided);
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn nobody_has_a_say_in_what_was_not_handed_to_him() {
    let (bench, first, job) = one_result().await;
    let (second, stranger) = (bench.worker().await, bench.worker().await);
    let again = second.claim_one().await;
    assert!(!stranger.ended(&again, done(9.0)).await);
    assert!(!first.ended(&again, done(9.0)).await);
    assert_eq!(stranger.renew(std::slice::from_ref(&again), true).await.lost, [job.job]);
    assert!(second.ended(&again, done(1.0)).await);
    assert_eq!(state(&bench, &job).await, VerificationState::Agreed);
    assert_untouched(&bench, &job).await;
}

#[tokio::test]
async fn a_removed_job_takes_its_verification_along() {
    let (bench, _, _) = one_result().await;
    let other = bench.worker().await;
    let again = other.claim_one().await;
    bench.coordinator.remove(furrow_schema::id::SweepId(1)).await.unwrap();
    assert!(!other.ended(&again, done(2.0)).await);
    bench.coordinator.keep_house().await.unwrap();
    bench.assert_consistent().await;
    assert_eq!(bench.coordinator.verifications().await.unwrap(), VerificationCounts::default());
}
