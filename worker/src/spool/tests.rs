//! What is read back after a restart, whatever happened to the file.

use furrow_schema::protocol::RunEnd;
use proptest::prelude::*;
use tempfile::TempDir;

use super::*;
use crate::scripted::record_of;

const ENGINE: EngineId = EngineId([5; 32]);
const LIMIT: u64 = 1 << 20;

fn place() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn open(place: &TempDir) -> Spool {
    Spool::open(place.path(), ENGINE, LIMIT).unwrap()
}

fn run(job: i64) -> RunReport {
    RunReport { job: JobId(job), attempt: 1, ended: RunEnd::Done(record_of(job as u64)) }
}

fn heavy_run(job: i64) -> RunReport {
    let record = furrow_schema::job::RunRecord { trajectory: Some("00".repeat(500_000)), ..record_of(1) };
    RunReport { ended: RunEnd::Done(record), ..run(job) }
}

fn runs(jobs: std::ops::RangeInclusive<i64>) -> Vec<RunReport> {
    jobs.map(run).collect()
}

fn keep(spool: &mut Spool, coordinator: &str, runs: &[RunReport]) {
    let (kept, outcome) = spool.keep(coordinator, runs);
    outcome.unwrap();
    assert_eq!(kept, runs.len());
}

fn acknowledge(spool: &mut Spool, coordinator: &str, jobs: impl IntoIterator<Item = i64>) {
    let runs: Vec<_> = jobs.into_iter().map(|job| (JobId(job), 1)).collect();
    spool.acknowledge(coordinator, &runs).unwrap();
}

fn waiting(spool: &mut Spool, coordinator: &str) -> Vec<RunReport> {
    spool.waiting_for(coordinator, usize::MAX, u64::MAX).unwrap()
}

/// The file of records in the place's first folder.
fn file(place: &TempDir) -> PathBuf {
    place.path().join("1").join(RUNS)
}

/// A place in which the file holds `bytes`.
fn place_with(bytes: &[u8]) -> TempDir {
    let place = place();
    drop(open(&place));
    std::fs::write(file(&place), bytes).unwrap();
    place
}

/// The bytes of a file with these runs, each synced for itself, and where each ends.
fn written(runs: &[RunReport]) -> (Vec<u8>, Vec<usize>) {
    let place = place();
    let mut spool = open(&place);
    let mut ends = Vec::new();
    for run in runs {
        keep(&mut spool, "c1", std::slice::from_ref(run));
        ends.push(spool.length as usize);
    }
    (std::fs::read(file(&place)).unwrap(), ends)
}

#[test]
fn runs_outlive_the_worker_until_they_are_acknowledged() {
    let place = place();
    let mut spool = open(&place);
    keep(&mut spool, "c1", &runs(1..=5));
    acknowledge(&mut spool, "c1", [1, 3]);
    drop(spool);
    let mut spool = open(&place);
    assert_eq!(waiting(&mut spool, "c1"), [run(2), run(4), run(5)]);
    acknowledge(&mut spool, "c1", [2, 4, 5, 6]);
    assert_eq!(file(&place).metadata().unwrap().len(), 0, "all of it is acknowledged");
    drop(spool);
    assert_eq!(open(&place).waiting().len(), 0);
}

#[test]
fn wherever_the_last_record_is_torn_what_was_synced_before_is_read_back() {
    let (bytes, ends) = written(&runs(1..=3));
    for length in ends[1]..ends[2] {
        let place = place_with(&bytes[..length]);
        let mut spool = open(&place);
        assert_eq!(waiting(&mut spool, "c1"), runs(1..=2), "torn at {length}");
        keep(&mut spool, "c1", &[run(4)]);
        drop(spool);
        assert_eq!(waiting(&mut open(&place), "c1"), [run(1), run(2), run(4)]);
    }
}

#[test]
fn a_damaged_record_in_the_middle_is_skipped_and_kept_aside() {
    let (mut bytes, ends) = written(&runs(1..=3));
    let damaged = ends[0]..ends[1];
    bytes[damaged.start + 60] ^= 1;
    let place = place_with(&bytes);
    assert_eq!(waiting(&mut open(&place), "c1"), [run(1), run(3)]);
    let aside = place.path().join("1").join(DAMAGED);
    assert_eq!(std::fs::read(&aside).unwrap(), bytes[damaged.clone()]);
    assert_eq!(waiting(&mut open(&place), "c1"), [run(1), run(3)]);
    assert_eq!(std::fs::read(&aside).unwrap().len(), damaged.len(), "it is kept aside once");
}

#[test]
fn a_record_of_another_form_is_kept_aside() {
    let mut bytes = Vec::new();
    frame::append(&mut bytes, br#"{"begun":{}}"#);
    let place = place_with(&bytes);
    assert_eq!(open(&place).waiting().len(), 0);
    assert_eq!(std::fs::read(place.path().join("1").join(DAMAGED)).unwrap(), bytes);
}

#[test]
fn runs_of_another_coordinator_wait_for_it() {
    let place = place();
    let mut spool = open(&place);
    keep(&mut spool, "c1", &runs(1..=2));
    keep(&mut spool, "c2", &[run(1)]);
    acknowledge(&mut spool, "c2", [1, 2]);
    drop(spool);
    let mut spool = open(&place);
    assert_eq!(waiting(&mut spool, "c2"), []);
    assert_eq!(waiting(&mut spool, "c1"), runs(1..=2));
}

#[test]
fn runs_of_another_engine_are_dropped() {
    let place = place();
    keep(&mut open(&place), "c1", &runs(1..=2));
    let other = Spool::open(place.path(), EngineId([6; 32]), LIMIT).unwrap();
    assert_eq!((other.waiting().len(), file(&place).metadata().unwrap().len()), (0, 0));
}

#[test]
fn a_full_spool_takes_what_fits_and_more_after_an_acknowledgement() {
    let place = place();
    let size = written(&[run(1)]).0.len() as u64;
    let mut spool = Spool::open(place.path(), ENGINE, 3 * size + size / 2).unwrap();
    let (kept, outcome) = spool.keep("c1", &runs(1..=5));
    assert!(matches!(outcome, Err(SpoolError::Full { .. })));
    assert_eq!((kept, waiting(&mut spool, "c1")), (3, runs(1..=3)));
    acknowledge(&mut spool, "c1", [1, 2]);
    keep(&mut spool, "c1", &runs(4..=5));
    assert_eq!(waiting(&mut spool, "c1"), runs(3..=5));
}

#[test]
fn a_long_file_is_written_anew_while_runs_wait() {
    let place = place();
    let mut spool = Spool::open(place.path(), ENGINE, Spool::DEFAULT_LIMIT_BYTES).unwrap();
    keep(&mut spool, "c1", &[run(1)]);
    for job in 2..=20 {
        keep(&mut spool, "c1", &[heavy_run(job)]);
        acknowledge(&mut spool, "c1", [job]);
    }
    assert!(spool.length < SMALL + 2_000_000, "20 MB went through it, {} B are left", spool.length);
    drop(spool);
    assert_eq!(waiting(&mut open(&place), "c1"), [run(1)]);
}

#[test]
fn what_waits_is_read_in_lots_that_fit_a_report() {
    let place = place();
    let mut spool = Spool::open(place.path(), ENGINE, Spool::DEFAULT_LIMIT_BYTES).unwrap();
    keep(&mut spool, "c1", &[run(1), heavy_run(2), heavy_run(3), run(4)]);
    let mut jobs = |most, most_bytes| {
        let runs = spool.waiting_for("c1", most, most_bytes).unwrap();
        runs.iter().map(|run| run.job.0).collect::<Vec<_>>()
    };
    assert_eq!(jobs(2, u64::MAX), [1, 2]);
    assert_eq!(jobs(9, 1_500_000), [1, 2]);
    assert_eq!(jobs(9, 1), [1], "at least one");
}

/// What can happen to a file.
#[derive(Debug, Clone)]
enum Damage {
    Flip { at: usize, bits: u8 },
    Cut { at: usize },
    Insert { at: usize, bytes: Vec<u8> },
    Remove { at: usize, n: usize },
}

impl Damage {
    fn any() -> impl Strategy<Value = Self> {
        let at = any::<prop::sample::Index>().prop_map(|index| index.index(4_096));
        prop_oneof![
            (at.clone(), 1..=u8::MAX).prop_map(|(at, bits)| Self::Flip { at, bits }),
            at.clone().prop_map(|at| Self::Cut { at }),
            (at.clone(), prop::collection::vec(any::<u8>(), 1..80)).prop_map(|(at, bytes)| Self::Insert { at, bytes }),
            (at, 1..400_usize).prop_map(|(at, n)| Self::Remove { at, n }),
        ]
    }

    fn strike(&self, bytes: &mut Vec<u8>) {
        let within = |at: usize| at % (bytes.len() + 1);
        match self {
            Self::Flip { at, bits } => {
                let at = within(*at);
                bytes.get_mut(at).into_iter().for_each(|byte| *byte ^= bits);
            }
            Self::Cut { at } => bytes.truncate(within(*at)),
            Self::Insert { at, bytes: more } => {
                let at = within(*at);
                bytes.splice(at..at, more.iter().copied());
            }
            Self::Remove { at, n } => {
                let at = within(*at);
                bytes.drain(at..(at + n).min(bytes.len()));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_damaged_file_is_opened_without_a_panic_and_yields_only_what_was_written(
        damages in prop::collection::vec(Damage::any(), 1..5)
    ) {
        let (mut bytes, _) = written(&runs(1..=6));
        damages.iter().for_each(|damage| damage.strike(&mut bytes));
        let place = place_with(&bytes);
        let mut spool = open(&place);
        let found = waiting(&mut spool, "c1");
        prop_assert!(found.iter().all(|found| *found == run(found.job.0)));
        keep(&mut spool, "c1", &[run(7)]);
        drop(spool);
        prop_assert_eq!(waiting(&mut open(&place), "c1").len(), found.len() + 1);
    }
}
