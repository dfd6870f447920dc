//! A worker's whole life against a queue in memory.

use furrow_schema::id::JobId;
use furrow_schema::protocol::LeasedJob;
use tokio::task::JoinHandle;

use super::*;
use crate::scripted::{Arithmetic, Queue, State};

const ENGINE: EngineId = EngineId([5; 32]);

struct Life {
    arithmetic: Arc<Arithmetic>,
    stop: CancellationToken,
    worker: JoinHandle<Result<Summary, WorkerError>>,
}

impl Life {
    fn begin(queue: Arc<Queue>, threads: usize) -> Self {
        let config = Config { name: "host".to_owned(), threads, engine: ENGINE };
        let arithmetic = Arc::new(Arithmetic::new());
        let stop = CancellationToken::new();
        let worker = Worker::with_runner(queue, config, Arc::clone(&arithmetic));
        let worker = tokio::spawn(worker.run(stop.clone()));
        Self { arithmetic, stop, worker }
    }

    async fn end(self) -> Summary {
        self.stop.cancel();
        self.worker.await.unwrap().unwrap()
    }
}

fn queue() -> Arc<Queue> {
    Arc::new(Queue::default())
}

#[tokio::test]
async fn every_job_is_run_once_with_its_own_seed() {
    let queue = queue();
    queue.submit(r#"{"sum": 1000}"#, 1..=500);
    let life = Life::begin(Arc::clone(&queue), 3);
    let ends = queue.ends(500).await;
    assert_eq!(ends.len(), 500);
    let digest = |job| match &ends[&JobId(job)] {
        RunEnd::Done(record) => record.digest,
        other => panic!("job {job} ended as {other:?}"),
    };
    assert_ne!(digest(1), digest(2));
    assert_eq!(life.end().await, Summary { done: 500, ..Summary::default() });
    queue.with(|state| assert_eq!(state.texts_sent, 1, "a scenario is sent once"));
}

#[tokio::test]
async fn new_work_is_begun_at_once_where_the_link_can_tell() {
    let queue = queue();
    queue.with(|state| state.retry_after_ms = Some(60_000));
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.until(|state| (!state.claims.is_empty()).then_some(())).await;
    let submitted = std::time::Instant::now();
    queue.submit(r#"{"sum": 3}"#, 1..=1);
    queue.ends(1).await;
    assert!(submitted.elapsed() < Duration::from_secs(5));
    life.end().await;
}

#[tokio::test]
async fn equal_jobs_give_equal_digests_on_any_number_of_threads() {
    let mut seen = Vec::new();
    for threads in [1, 2] {
        let queue = queue();
        queue.submit(r#"{"sum": 10}"#, 1..=50);
        let life = Life::begin(Arc::clone(&queue), threads);
        seen.push(queue.ends(50).await);
        life.end().await;
    }
    assert_eq!(seen[0], seen[1]);
}

#[tokio::test]
async fn a_panic_and_an_unreadable_scenario_are_charged_to_their_jobs_alone() {
    let queue = queue();
    queue.submit(r#""panic""#, 1..=1);
    queue.submit(r#"{"summ": 3}"#, 2..=2);
    queue.submit(r#"{"sum": 3}"#, 3..=3);
    let life = Life::begin(Arc::clone(&queue), 2);
    let ends = queue.ends(3).await;
    assert_eq!(ends[&JobId(1)], RunEnd::Panicked { message: "seed 1 is unlucky".to_owned() });
    assert!(matches!(&ends[&JobId(2)], RunEnd::Panicked { message } if message.contains("summ")));
    assert!(matches!(ends[&JobId(3)], RunEnd::Done(_)));
    assert_eq!(life.end().await.panicked, 2);
}

#[tokio::test]
async fn a_lost_job_is_stopped() {
    let queue = queue();
    queue.submit(r#""endless""#, 1..=1);
    let life = Life::begin(Arc::clone(&queue), 1);
    let runs =
        |state: &State| state.renewals.iter().any(|renewal| renewal.held.iter().any(|held| held.running)).then_some(());
    queue.until(runs).await;
    queue.with(|state| state.lost = vec![JobId(1)]);
    assert_eq!(queue.ends(1).await[&JobId(1)], RunEnd::HandedBack);
    queue.submit(r#"{"sum": 3}"#, 2..=2);
    queue.ends(2).await;
    life.end().await;
}

#[tokio::test]
async fn a_run_on_record_is_not_renewed_any_more() {
    let queue = queue();
    queue.submit(r#"{"sum": 3}"#, 1..=1);
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.ends(1).await;
    queue.submit(r#""endless""#, 2..=2);
    let only_the_second = |state: &State| {
        let jobs = |renewal: &furrow_schema::protocol::Renew| renewal.held.iter().map(|held| held.job.0).collect();
        state.renewals.iter().map(jobs).find(|jobs: &Vec<i64>| jobs == &[2])
    };
    queue.until(only_the_second).await;
    life.end().await;
}

#[tokio::test]
async fn a_worker_that_is_told_to_stop_hands_back_what_waits_and_what_runs() {
    let queue = queue();
    queue.submit(r#""endless""#, 1..=4);
    let life = Life::begin(Arc::clone(&queue), 2);
    let holds_all = |state: &State| {
        let full = |renewal: &furrow_schema::protocol::Renew| {
            renewal.held.len() == 4 && renewal.held.iter().filter(|held| held.running).count() == 2
        };
        state.renewals.iter().any(full).then_some(())
    };
    queue.until(holds_all).await;
    assert_eq!(life.end().await, Summary { handed_back: 4, ..Summary::default() });
    assert!(queue.ends(4).await.values().all(|end| *end == RunEnd::HandedBack));
}

#[tokio::test]
async fn a_report_without_an_answer_is_sent_again_as_the_same_request() {
    let queue = queue();
    queue.submit(r#"{"sum": 3}"#, 1..=1);
    queue.with(|state| state.lost_answers = 2);
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.until(|state| state.reports.values().any(|times| *times == 3).then_some(())).await;
    assert_eq!(life.end().await.done, 1);
    queue.with(|state| assert_eq!((state.ended.len(), state.reports.len()), (1, 1)));
}

#[tokio::test]
async fn a_worker_that_was_forgotten_presents_itself_again_and_goes_on() {
    let queue = queue();
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.until(|state| (!state.claims.is_empty()).then_some(())).await;
    queue.with(|state| state.forgot_workers = true);
    queue.until(|state| (state.hellos.len() == 2).then_some(())).await;
    queue.submit(r#"{"sum": 3}"#, 1..=1);
    queue.ends(1).await;
    life.end().await;
}

#[tokio::test]
async fn a_worker_of_another_engine_gives_up_with_the_reason() {
    let queue = queue();
    let refusal = Refusal::OtherEngine { coordinator: EngineId([6; 32]), worker: ENGINE };
    queue.with(|state| state.refusal = Some(refusal.clone()));
    let life = Life::begin(queue, 1);
    assert!(matches!(life.worker.await.unwrap(), Err(WorkerError::Refused(reason)) if reason == refusal));
}

#[tokio::test]
async fn a_refusal_in_the_middle_of_work_ends_the_worker_and_its_runs() {
    let queue = queue();
    queue.submit(r#""endless""#, 1..=1);
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.until(|state| (!state.renewals.is_empty()).then_some(())).await;
    queue.with(|state| state.refusal = Some(Refusal::BadCredential));
    assert!(matches!(life.worker.await.unwrap(), Err(WorkerError::Refused(Refusal::BadCredential))));
}

#[tokio::test]
async fn two_runs_go_on_at_once() {
    let queue = queue();
    queue.submit(r#""meet""#, 1..=2);
    let life = Life::begin(Arc::clone(&queue), 2);
    queue.ends(2).await;
    life.end().await;
}

#[tokio::test]
async fn a_run_that_must_be_alone_is() {
    let queue = queue();
    let every_third = |lease: LeasedJob| LeasedJob { alone: lease.job.0 % 3 == 0, ..lease };
    queue.submit_as(r#"{"sum": 20000}"#, 1..=60, every_third);
    let life = Life::begin(Arc::clone(&queue), 4);
    queue.ends(60).await;
    assert!(!life.arithmetic.disturbed.load(std::sync::atomic::Ordering::SeqCst));
    life.end().await;
}

#[tokio::test]
async fn a_record_that_the_coordinator_cannot_read_does_not_hold_up_the_others() {
    let queue = queue();
    queue.with(|state| state.unreadable_results_of = Some(JobId(2)));
    queue.submit(r#"{"sum": 3}"#, 1..=20);
    let life = Life::begin(Arc::clone(&queue), 2);
    let ends = queue.ends(20).await;
    assert!(matches!(&ends[&JobId(2)], RunEnd::Panicked { message } if message.contains("refused")));
    assert_eq!(ends.values().filter(|end| matches!(end, RunEnd::Done(_))).count(), 19);
    life.end().await;
}

#[tokio::test(start_paused = true)]
async fn a_worker_can_be_stopped_while_the_coordinator_is_away() {
    let queue = queue();
    queue.with(|state| state.away = true);
    let life = Life::begin(queue, 1);
    tokio::task::yield_now().await;
    assert_eq!(life.end().await, Summary::default());
}

#[tokio::test]
async fn a_worker_whose_coordinator_vanished_leaves_within_five_seconds() {
    let queue = queue();
    queue.submit(r#"{"sum": 3}"#, 1..=10);
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.ends(1).await;
    queue.submit(r#""endless""#, 11..=11);
    queue.until(|state| state.queue.is_empty().then_some(())).await;
    queue.with(|state| state.away = true);
    tokio::time::pause();
    let began = tokio::time::Instant::now();
    life.end().await;
    assert!(began.elapsed() < Duration::from_secs(5));
}

#[tokio::test]
async fn the_way_to_a_coordinator_that_was_away_is_found_again() {
    let queue = queue();
    queue.with(|state| state.away = true);
    let life = Life::begin(Arc::clone(&queue), 1);
    queue.submit(r#"{"sum": 3}"#, 1..=3);
    queue.with(|state| state.away = false);
    queue.ends(3).await;
    assert_eq!(life.end().await.done, 3);
}
