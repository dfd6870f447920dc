//! What the board hands out and what it answers.

use furrow_schema::id::ScenarioId;

use super::*;
use crate::scenarios::Scenarios;
use crate::scripted::record_of;

fn scenario() -> Option<Arc<HeldScenario<()>>> {
    let mut scenarios = Scenarios::new();
    let text = furrow_schema::protocol::ScenarioText { id: ScenarioId(1), json: String::new() };
    scenarios.learn(vec![text]);
    scenarios.get(ScenarioId(1))
}

fn lease(job: i64) -> LeasedJob {
    LeasedJob { job: JobId(job), attempt: 1, scenario: ScenarioId(1), seed: 1, record: false, alone: false }
}

fn alone(job: i64) -> LeasedJob {
    LeasedJob { alone: true, ..lease(job) }
}

fn board_with(threads: usize, leases: impl IntoIterator<Item = LeasedJob>) -> Board<()> {
    let mut board = Board::new(threads, false);
    leases.into_iter().for_each(|lease| board.add(lease, scenario()));
    board
}

fn done() -> RunEnd {
    RunEnd::Done(record_of(1))
}

fn run_one(board: &mut Board<()>, took: Duration) {
    let work = board.take().unwrap();
    board.finish(&work.lease, done(), took);
}

#[test]
fn a_first_claim_is_for_one_job_a_thread() {
    assert_eq!(board_with(3, []).want(), 3);
    assert_eq!(board_with(3, [lease(1), lease(2)]).want(), 3);
    assert_eq!(board_with(3, [lease(1), lease(2), lease(3)]).want(), 0);
}

#[test]
fn a_batch_is_two_seconds_of_work_within_its_limits() {
    let want_after = |took_ms| {
        let mut board = board_with(2, [lease(1)]);
        run_one(&mut board, Duration::from_millis(took_ms));
        board.want()
    };
    assert_eq!(want_after(100), 40);
    assert_eq!(want_after(60_000), 2);
    assert_eq!(want_after(0), MAX_CLAIM);
}

#[test]
fn where_jobs_are_scarce_more_is_claimed_only_when_a_thread_has_none_to_go_on_with() {
    let mut board = board_with(2, (1..=4).map(lease));
    run_one(&mut board, Duration::from_millis(100));
    assert_eq!(board.want(), 40);
    board.note_grant(40, 3);
    assert_eq!(board.want(), 0);
    (0..2).for_each(|_| run_one(&mut board, Duration::from_millis(100)));
    assert_eq!(board.want(), 40);
    board.add(lease(5), scenario());
    board.note_grant(40, 40);
    assert_eq!(board.want(), 40);
}

#[test]
fn no_more_is_claimed_while_too_many_results_wait_for_their_acknowledgement() {
    let mut board = board_with(1, []);
    let mut unacknowledged = Vec::new();
    for job in 1.. {
        if board.want() == 0 {
            break;
        }
        board.add(lease(job), scenario());
        run_one(&mut board, Duration::ZERO);
        unacknowledged.extend(board.take_ended());
    }
    assert!(unacknowledged.len() <= MAX_HELD);
    board.forget(&unacknowledged);
    assert_eq!(board.want(), MAX_CLAIM);
}

#[test]
fn threads_beyond_the_work_are_not_engaged() {
    let mut board = board_with(4, [lease(1), lease(2)]);
    assert_eq!(board.engage(), 2);
    board.add(lease(3), scenario());
    assert_eq!(board.engage(), 2, "three waiting jobs and two free threads");
    assert_eq!(board.engage(), 0);
}

#[test]
fn a_thread_that_found_nothing_can_be_engaged_again() {
    let mut board = board_with(1, [lease(1)]);
    assert_eq!(board.engage(), 1);
    run_one(&mut board, Duration::ZERO);
    assert!(board.take().is_none());
    board.add(lease(2), scenario());
    assert_eq!(board.engage(), 1);
}

#[test]
fn a_run_that_must_be_alone_waits_for_the_others_and_holds_up_those_behind() {
    let mut board = board_with(2, [lease(1), alone(2), lease(3)]);
    assert_eq!(board.engage(), 2);
    let first = board.take().unwrap();
    assert!(board.take().is_none(), "it may not start yet");
    board.finish(&first.lease, done(), Duration::ZERO);
    let second = board.take().unwrap();
    assert_eq!(second.lease.job, JobId(2));
    assert!(board.take().is_none(), "nothing starts beside it");
    board.finish(&second.lease, done(), Duration::ZERO);
    assert_eq!(board.engage(), 1);
    assert_eq!(board.take().unwrap().lease.job, JobId(3));
}

#[test]
fn a_lease_that_is_held_already_is_ignored_and_another_attempt_is_not() {
    let mut board = board_with(4, [lease(1), lease(1), LeasedJob { attempt: 2, ..lease(1) }]);
    let attempts: Vec<u32> = std::iter::from_fn(|| board.take()).map(|work| work.lease.attempt).collect();
    assert_eq!(attempts, [1, 2]);
    board.finish(&lease(1), done(), Duration::ZERO);
    board.add(lease(1), scenario());
    assert!(board.take().is_none(), "it ended, and is not acknowledged yet");
}

#[test]
fn a_run_is_held_until_it_is_acknowledged() {
    let mut board = board_with(1, [lease(1)]);
    assert!(!board.held()[0].running);
    let work = board.take().unwrap();
    assert!(board.held()[0].running);
    board.finish(&work.lease, done(), Duration::ZERO);
    let runs = board.take_ended();
    assert!(!board.held()[0].running);
    assert_eq!(board.lose(&[JobId(1)]), 0, "there is nothing to stop any more");
    board.forget(&runs);
    assert!(board.held().is_empty());
}

#[test]
fn a_closed_board_hands_everything_back() {
    let mut board = board_with(2, [lease(1), lease(2)]);
    let work = board.take().unwrap();
    board.close();
    assert!(work.stop.load(Ordering::Relaxed));
    board.add(lease(3), scenario());
    assert_eq!((board.want(), board.engage()), (0, 0));
    board.finish(&work.lease, RunEnd::HandedBack, Duration::ZERO);
    board.claims_ended();
    assert!(board.is_idle() && !board.is_drained());
    assert!(board.take_ended().iter().all(|run| run.ended == RunEnd::HandedBack));
    assert!(board.is_drained());
}

#[test]
fn a_lost_job_is_dropped_or_told_to_stop_and_others_stay() {
    let mut board = board_with(2, [lease(1), lease(2), lease(3)]);
    let running = board.take().unwrap();
    assert_eq!(board.lose(&[JobId(1), JobId(2)]), 2);
    assert!(running.stop.load(Ordering::Relaxed));
    assert_eq!(board.take().unwrap().lease.job, JobId(3));
}

#[test]
fn a_run_that_ends_after_it_was_abandoned_is_not_reported_twice() {
    let mut board = board_with(1, [lease(1)]);
    let work = board.take().unwrap();
    board.close();
    board.claims_ended();
    board.abandon();
    assert!(board.is_idle());
    board.finish(&work.lease, done(), Duration::ZERO);
    assert_eq!(board.take_ended().len(), 1);
    assert!(board.is_drained());
}

#[test]
fn a_job_without_its_scenario_is_charged_with_the_reason() {
    let mut board = Board::<()>::new(1, false);
    board.add(lease(1), None);
    let ended = board.take_ended().remove(0).ended;
    assert!(matches!(ended, RunEnd::Panicked { message } if message.contains("scenario 1")));
}

#[test]
fn a_report_stays_within_its_size_and_holds_at_least_one_run() {
    let mut board = board_with(1, (1..=3).map(lease));
    for _ in 0..3 {
        let work = board.take().unwrap();
        let trajectory = Some("0".repeat(MAX_REPORT_BYTES * 2 / 3));
        let ended = RunEnd::Done(furrow_schema::job::RunRecord { trajectory, ..record_of(1) });
        board.finish(&work.lease, ended, Duration::ZERO);
    }
    let sizes: Vec<usize> = (0..4).map(|_| board.take_ended().len()).collect();
    assert_eq!(sizes, [1, 1, 1, 0]);
}

fn spooling_board() -> Board<()> {
    let mut board = Board::new(1, true);
    (1..=3).for_each(|job| board.add(lease(job), scenario()));
    (1..=3).for_each(|_| run_one(&mut board, Duration::ZERO));
    board
}

#[test]
fn an_ended_run_is_spooled_before_it_is_reported_and_forgotten_there_afterwards() {
    let mut board = spooling_board();
    assert_eq!(board.take_ended(), []);
    let (runs, acknowledged) = board.take_for_spool().unwrap();
    assert_eq!((runs.len(), acknowledged.len()), (3, 0));
    assert!(board.take_for_spool().is_none() && board.take_ended().is_empty());
    board.spooled(runs, 3);
    let reported = board.take_ended();
    board.forget(&reported);
    let (runs, acknowledged) = board.take_for_spool().unwrap();
    assert_eq!((runs.len(), acknowledged), (0, vec![(JobId(1), 1), (JobId(2), 1), (JobId(3), 1)]));
}

#[test]
fn nothing_is_claimed_while_a_run_is_in_memory_only() {
    let mut board = spooling_board();
    let (runs, _) = board.take_for_spool().unwrap();
    board.spooled(runs, 1);
    assert_eq!(board.want(), 0);
    let reported = board.take_ended();
    assert_eq!(reported.len(), 3, "all of them are reported");
    board.forget(&reported[..2]);
    assert_eq!(board.want(), 0);
    board.forget(&reported[2..]);
    assert_eq!(board.want(), MAX_CLAIM);
    assert_eq!(board.take_for_spool().unwrap().1, [(JobId(1), 1)], "the spool knows of one only");
}

#[test]
fn a_board_is_drained_when_the_spool_gave_all_runs_back_and_spooled_when_it_was_told_their_fate() {
    let mut board = spooling_board();
    let (runs, _) = board.take_for_spool().unwrap();
    board.close();
    board.claims_ended();
    assert!(board.is_idle() && !board.is_drained());
    board.spooled(runs, 3);
    let reported = board.take_ended();
    assert!(board.is_drained() && !board.is_spooled());
    board.forget(&reported);
    board.reports_ended();
    assert!(!board.is_spooled());
    board.take_for_spool();
    assert!(board.is_spooled());
}

#[test]
fn what_is_handed_back_does_not_pass_through_the_spool() {
    let mut board: Board<()> = Board::new(1, true);
    board.add(lease(1), scenario());
    board.close();
    assert!(board.take_for_spool().is_none());
    let reported = board.take_ended();
    assert_eq!(reported[0].ended, RunEnd::HandedBack);
    board.forget(&reported);
    assert!(board.take_for_spool().is_none());
}

#[test]
fn ended_runs_wait_for_others_only_while_one_goes_on_and_they_do_not_fill_a_report() {
    let most = i64::from(MAX_CLAIM);
    let mut board = board_with(1, [lease(1), lease(2)]);
    assert!(!board.gathers_for_report(), "nothing ended");
    run_one(&mut board, Duration::ZERO);
    assert!(board.gathers_for_report() && !board.gathers_for_spool(), "the next one is about to begin");
    let goes_on = board.take().unwrap();
    assert!(board.gathers_for_report(), "the next one goes on");
    board.finish(&goes_on.lease, done(), Duration::ZERO);
    assert!(!board.gathers_for_report(), "nothing goes on");
    board.add(lease(3), scenario());
    board.close();
    assert!(!board.gathers_for_report(), "the worker is leaving");

    let mut full = board_with(2, (1..=most + 1).map(lease));
    (0..most).for_each(|_| run_one(&mut full, Duration::ZERO));
    full.take().unwrap();
    assert!(!full.gathers_for_report(), "a report is full");
}

#[test]
fn ended_runs_that_pass_through_the_spool_gather_there() {
    let mut board = Board::new(1, true);
    (1..=2).for_each(|job| board.add(lease(job), scenario()));
    run_one(&mut board, Duration::ZERO);
    board.take().unwrap();
    assert!(board.gathers_for_spool() && !board.gathers_for_report());
    let (runs, _) = board.take_for_spool().unwrap();
    board.spooled(runs, 1);
    assert!(!board.gathers_for_spool() && !board.gathers_for_report(), "what was spooled is reported at once");
}

#[test]
fn of_runs_that_gather_only_the_first_and_the_last_are_news() {
    for spooling in [false, true] {
        let mut board = Board::new(1, spooling);
        (1..=4).for_each(|job| board.add(lease(job), scenario()));
        let news = [(); 4].map(|()| {
            run_one(&mut board, Duration::ZERO);
            board.has_news()
        });
        assert_eq!(news, [true, false, false, true], "with a spool: {spooling}");
    }
}

#[test]
fn a_run_that_is_handed_back_is_news_beside_runs_that_gather() {
    let mut board = Board::new(2, true);
    (1..=4).for_each(|job| board.add(lease(job), scenario()));
    (0..2).for_each(|_| run_one(&mut board, Duration::ZERO));
    let stopped = board.take().unwrap();
    board.finish(&stopped.lease, RunEnd::HandedBack, Duration::ZERO);
    assert!(board.has_news());
}
