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
        Self::begin_as(queue, threads, |worker| worker)
    }

    /// A life of the worker to which `spool` belongs, with the coordinator of that name.
    fn begin_spooling(queue: &Arc<Queue>, spool: &Arc<Mutex<Spool>>, coordinator: &str) -> Self {
        Self::begin_as(Arc::clone(queue), 1, |worker| worker.spooling(Arc::clone(spool), coordinator))
    }

    fn begin_as(
        queue: Arc<Queue>,
        threads: usize,
        change: impl FnOnce(Worker<Arc<Arithmetic>>) -> Worker<Arc<Arithmetic>>,
    ) -> Self {
        let config = Config { name: "host".to_owned(), threads, engine: ENGINE };
        let arithmetic = Arc::new(Arithmetic::new());
        let stop = CancellationToken::new();
        let worker = change(Worker::with_runner(queue, config, Arc::clone(&arithmetic)));
        let worker = tokio::spawn(worker.run(stop.clone()));
        Self { arithmetic, stop, worker }
    }

    /// Ends it without a word, as a kill does, and gives up its folder.
    async fn kill(self, spool: Arc<Mutex<Spool>>) {
        self.worker.abort();
        assert!(self.worker.await.unwrap_err().is_cancelled());
        while Arc::strong_count(&spool) > 1 {
            tokio::task::yield_now().await;
        }
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
async fn a_barred_worker_hears_of_it_when_it_renews_and_ends_with_its_runs() {
    let queue = queue();
    queue.with(|state| state.retry_after_ms = Some(60_000));
    queue.submit(r#""endless""#, 1..=2);
    let life = Life::begin(Arc::clone(&queue), 1);
    // Nothing is claimed or reported any more: one job runs, the other waits.
    queue.until(|state| state.renewals.iter().any(|renew| renew.held.len() == 2).then_some(())).await;
    let refusal = Refusal::Barred { detail: "its result of job 1 differs".to_owned() };
    queue.with(|state| state.refusal = Some(refusal.clone()));
    let Err(error) = life.worker.await.unwrap() else { panic!("a barred worker ends") };
    assert!(error.to_string().ends_with("this worker is barred: its result of job 1 differs"), "{error}");
    assert!(matches!(error, WorkerError::Refused(reason) if reason == refusal));
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

fn spool(place: &tempfile::TempDir, limit_bytes: u64) -> Arc<Mutex<Spool>> {
    Arc::new(Mutex::new(Spool::open(place.path(), ENGINE, limit_bytes).unwrap()))
}

fn waiting(spool: &Mutex<Spool>) -> usize {
    spool.lock().unwrap().waiting().len()
}

#[tokio::test]
async fn runs_that_a_killed_worker_finished_are_delivered_by_its_next_life_before_it_claims() {
    let (queue, place) = (queue(), tempfile::tempdir().unwrap());
    queue.submit(r#"{"sum": 3}"#, 1..=3);
    queue.with(|state| state.deaf_to_reports = true);
    let kept = spool(&place, Spool::DEFAULT_LIMIT_BYTES);
    let life = Life::begin_spooling(&queue, &kept, "c1");
    queue.until(|_| (waiting(&kept) == 3).then_some(())).await;
    life.kill(kept).await;

    let claims = queue.until(|state| Some(state.claims.len())).await;
    queue.with(|state| state.deaf_to_reports = false);
    let kept = spool(&place, Spool::DEFAULT_LIMIT_BYTES);
    let life = Life::begin_spooling(&queue, &kept, "c1");
    let delivered = queue.until(|state| (state.claims.len() > claims).then_some(state.ended.len())).await;
    assert_eq!(delivered, 3);
    assert_eq!(life.end().await, Summary { done: 3, ..Summary::default() });
    assert_eq!(waiting(&kept), 0);
    queue.with(|state| {
        assert!(state.workers.len() == 2 && state.workers[0] == state.workers[1], "it is the same worker")
    });
}

#[tokio::test]
async fn a_worker_with_a_spool_does_every_job_once_and_leaves_nothing_in_it() {
    let (queue, place) = (queue(), tempfile::tempdir().unwrap());
    queue.submit(r#"{"sum": 3}"#, 1..=500);
    queue.submit(r#""panic""#, 501..=501);
    queue.with(|state| state.lost_answers = 2);
    let kept = spool(&place, Spool::DEFAULT_LIMIT_BYTES);
    let life = Life::begin_spooling(&queue, &kept, "c1");
    assert_eq!(queue.ends(501).await.len(), 501);
    assert_eq!(life.end().await, Summary { done: 500, panicked: 1, ..Summary::default() });
    assert_eq!(waiting(&kept), 0);
}

#[tokio::test]
async fn a_worker_whose_spool_is_full_goes_on_when_its_runs_are_acknowledged() {
    let (queue, place) = (queue(), tempfile::tempdir().unwrap());
    queue.submit(r#"{"sum": 3}"#, 1..=2_000);
    queue.with(|state| state.deaf_to_reports = true);
    let kept = spool(&place, 4_000);
    let life = Life::begin_spooling(&queue, &kept, "c1");
    let held = |state: &State| state.renewals.iter().map(|renewal| renewal.held.len()).collect::<Vec<_>>();
    let settled = |held: &[usize]| held.iter().filter(|held| **held > 100).count() > 3;
    let held = queue.until(|state| Some(held(state)).filter(|held| settled(held))).await;
    assert!(
        held.iter().all(|held| *held < 600),
        "two batches at the most, and not all the 1,000 that it may hold: {held:?}"
    );
    queue.with(|state| state.deaf_to_reports = false);
    assert_eq!(queue.ends(2_000).await.len(), 2_000);
    assert_eq!(life.end().await.done, 2_000);
    assert_eq!(waiting(&kept), 0);
}

#[tokio::test]
async fn what_one_coordinator_handed_out_is_not_told_to_another() {
    let (first, second, place) = (queue(), queue(), tempfile::tempdir().unwrap());
    first.submit(r#"{"sum": 3}"#, 1..=1);
    first.with(|state| state.deaf_to_reports = true);
    let kept = spool(&place, Spool::DEFAULT_LIMIT_BYTES);
    let life = Life::begin_spooling(&first, &kept, "c1");
    first.until(|_| (waiting(&kept) == 1).then_some(())).await;
    first.with(|state| {
        state.deaf_to_reports = false;
        state.replaced_by = Some("c2".to_owned());
    });
    let ended = life.worker.await.unwrap();
    assert!(matches!(&ended, Err(WorkerError::OtherCoordinator(other)) if other == "c2"), "{ended:?}");

    second.submit(r#"{"sum": 9}"#, 1..=1);
    let life = Life::begin_spooling(&second, &kept, "c2");
    let ends = second.ends(1).await;
    assert_eq!(life.end().await.done, 1);
    second.with(|state| assert_eq!(state.ended.len(), 1));
    assert_eq!(waiting(&kept), 1, "the first one's run waits for it");

    first.with(|state| state.replaced_by = None);
    let life = Life::begin_spooling(&first, &kept, "c1");
    assert_ne!(first.ends(1).await, ends);
    life.end().await;
}

#[tokio::test]
async fn a_worker_goes_on_computing_while_the_coordinator_is_away() {
    let (queue, place) = (queue(), tempfile::tempdir().unwrap());
    queue.submit(r#""meet""#, 1..=1);
    queue.submit(r#"{"sum": 3}"#, 2..=2);
    let kept = spool(&place, Spool::DEFAULT_LIMIT_BYTES);
    let life = Life::begin_spooling(&queue, &kept, "c1");
    let holds_both = |state: &State| {
        let both = |renewal: &furrow_schema::protocol::Renew| renewal.held.len() == 2 && renewal.held[0].running;
        state.renewals.iter().any(both).then_some(())
    };
    queue.until(holds_both).await;
    queue.with(|state| state.away = true);
    life.arithmetic.meet();
    queue.until(|_| (waiting(&kept) == 2).then_some(())).await;
    queue.with(|state| state.away = false);
    assert_eq!(queue.ends(2).await.len(), 2);
    life.end().await;
}
