//! What the store answers to users: pages of jobs, one job in full, cells and their values; workers.

mod cells;
mod runs;
mod worker;

use std::collections::BTreeMap;

use furrow_schema::id::{CellId, Digest, EngineId, JobId, JobKey, SweepId, WorkerId};
use furrow_schema::job::{JobState, Timings};

pub use cells::{CellColumns, CellSummary, CellValues};
pub use runs::{RunCursor, RunRow, RunValue, UnfinishedRun};
pub use worker::{Bar, WorkerChange, WorkerInfo};

/// Which jobs to list. The default is all of them.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct JobFilter {
    /// Only jobs of this sweep.
    pub sweep: Option<SweepId>,
    /// Only jobs in this state.
    pub state: Option<JobState>,
    /// Only jobs in cells with all these labels (label by factor).
    pub factors: BTreeMap<String, String>,
    /// At most this many; 0 stands for [`JobFilter::DEFAULT_LIMIT`], more than [`JobFilter::MAX_LIMIT`] for that.
    pub limit: u32,
    /// Only jobs behind this place: [`JobPage::next`] of the page before.
    pub after: Option<JobCursor>,
}

impl JobFilter {
    /// How many jobs a page has where nothing else is asked.
    pub const DEFAULT_LIMIT: u32 = 100;
    /// How many jobs a page has at most.
    pub const MAX_LIMIT: u32 = 10_000;
}

/// A place in a list of jobs, which is ordered by cell, then job. Written `cell.job`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct JobCursor {
    /// The cell of the last job seen.
    pub cell: CellId,
    /// The last job seen.
    pub job: JobId,
}

impl std::fmt::Display for JobCursor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}", self.cell, self.job)
    }
}

impl std::str::FromStr for JobCursor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{}` is no place in a list of jobs", text.chars().take(80).collect::<String>());
        let (cell, job) = text.split_once('.').ok_or_else(wrong)?;
        Ok(Self { cell: cell.parse().map_err(|_| wrong())?, job: job.parse().map_err(|_| wrong())? })
    }
}

/// Some jobs of a list.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobPage {
    /// The jobs; one that several cells want stands once for each.
    pub items: Vec<JobItem>,
    /// Where the next page begins; none at the end.
    pub next: Option<JobCursor>,
}

/// A job as a line of a list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobItem {
    /// The job.
    pub id: JobId,
    /// Its key.
    pub key: JobKey,
    /// The sweep of the cell in which it is listed.
    pub sweep: SweepId,
    /// The cell in which it is listed.
    pub cell: CellId,
    /// Where it stands.
    pub state: JobState,
    /// The cell's label by factor.
    pub factors: BTreeMap<String, String>,
    /// Its seed.
    pub seed: u64,
    /// How often it was handed out.
    pub attempts: u32,
    /// Who holds it, or whose result is on record.
    pub worker: Option<WorkerId>,
    /// How its run ended, when it has.
    pub outcome: Option<String>,
    /// The digest of its result, when it has one.
    pub digest: Option<Digest>,
}

/// How to name a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobRef {
    /// By number.
    Id(JobId),
    /// By key.
    Key(JobKey),
    /// By the first digits of its key.
    Prefix(KeyPrefix),
}

impl std::str::FromStr for JobRef {
    type Err = furrow_schema::id::IdError;

    /// A number, the 64 hexadecimal digits of a key, or the first of them.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match KeyPrefix::new(text) {
            _ if text.len() == 64 => text.parse().map(Self::Key),
            Some(prefix) => Ok(Self::Prefix(prefix)),
            None => text.parse().map(Self::Id),
        }
    }
}

/// The first digits of a job's key: at least [`KeyPrefix::DIGITS`], fewer than all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct KeyPrefix {
    /// The smallest key that begins so.
    pub(crate) low: [u8; 32],
    /// The largest.
    pub(crate) high: [u8; 32],
    /// The job whose number is written in the same way, if it can be read as one. The number has precedence.
    pub(crate) number: Option<JobId>,
}

impl std::fmt::Display for KeyPrefix {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Up to where the smallest and the largest key that begin so are one.
        let (low, high) = (JobKey(self.low).to_string(), JobKey(self.high).to_string());
        low.chars()
            .zip(high.chars())
            .take_while(|(low, high)| low == high)
            .try_for_each(|(digit, _)| write!(f, "{digit}"))
    }
}

impl KeyPrefix {
    /// How many digits it has at least.
    pub const DIGITS: usize = 8;

    fn new(text: &str) -> Option<Self> {
        let fits = (Self::DIGITS..64).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_hexdigit());
        let filled = |filler: &str| -> Option<JobKey> {
            (text.to_ascii_lowercase() + &filler.repeat(64 - text.len())).parse().ok()
        };
        if !fits {
            return None;
        }
        Some(Self { low: filled("0")?.0, high: filled("f")?.0, number: text.parse().ok() })
    }
}

/// A job in full.
#[derive(Debug, Clone, PartialEq)]
pub struct JobDetail {
    /// The job.
    pub id: JobId,
    /// Its key.
    pub key: JobKey,
    /// Where it stands.
    pub state: JobState,
    /// Canonical JSON of its scenario.
    pub scenario_json: String,
    /// Its seed.
    pub seed: u64,
    /// The highest priority among the sweeps that want it.
    pub priority: i64,
    /// The cells that want it, oldest first.
    pub cells: Vec<JobCell>,
    /// Every handing-out, oldest first.
    pub attempts: Vec<Attempt>,
    /// Its result, when there is one.
    pub result: Option<JobResult>,
    /// Further results that differ from the one on record.
    pub incidents: Vec<Incident>,
    /// Whether and how its result was verified.
    pub verification: Option<Verification>,
    /// When it was first asked for [ms since 1970].
    pub created_ms: i64,
    /// When it ended [ms since 1970].
    pub ended_ms: Option<i64>,
}

/// A cell that wants a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobCell {
    /// Its sweep.
    pub sweep: SweepId,
    /// The cell.
    pub cell: CellId,
    /// Its label by factor.
    pub factors: BTreeMap<String, String>,
}

/// One handing-out of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attempt {
    /// Which, from 1.
    pub attempt: u32,
    /// To whom.
    pub worker: WorkerId,
    /// When [ms since 1970].
    pub claimed_ms: i64,
    /// Until when [ms since 1970]; none while it lasts.
    pub ended_ms: Option<i64>,
    /// What became of it.
    pub end: AttemptEnd,
    /// The panic's message, or what else there is to say.
    pub reason: Option<String>,
}

/// What became of a handing-out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttemptEnd {
    /// It lasts.
    Open,
    /// Its result is on record.
    Done,
    /// The run panicked: charged to the job.
    Panicked,
    /// The lease ran out while the job ran there: charged to the job as a worker's death.
    Died,
    /// The lease ran out before the job was begun: not charged.
    Expired,
    /// The worker gave it back.
    HandedBack,
    /// The result of another holder was recorded meanwhile.
    Superseded,
    /// No live sweep wanted the job any more.
    Cancelled,
}

impl AttemptEnd {
    /// The word for it: `open`, `done`, `panicked`, `died`, `expired`, `handed-back`, `superseded` or `cancelled`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Done => "done",
            Self::Panicked => "panicked",
            Self::Died => "died",
            Self::Expired => "expired",
            Self::HandedBack => "handed-back",
            Self::Superseded => "superseded",
            Self::Cancelled => "cancelled",
        }
    }

    /// What `word` stands for, if anything.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        use AttemptEnd::{Cancelled, Died, Done, Expired, HandedBack, Open, Panicked, Superseded};
        [Open, Done, Panicked, Died, Expired, HandedBack, Superseded, Cancelled]
            .into_iter()
            .find(|end| end.as_str() == word)
    }
}

/// The result on record for a job.
#[derive(Debug, Clone, PartialEq)]
pub struct JobResult {
    /// Who ran it.
    pub worker: WorkerId,
    /// In which handing-out.
    pub attempt: u32,
    /// Hash over trajectory, outcome and metrics.
    pub digest: Digest,
    /// How the run ended.
    pub outcome: String,
    /// Per-run values by metric name.
    pub metrics: BTreeMap<String, f64>,
    /// Wall-clock figures of that run.
    pub timings: Timings,
    /// 20 Hz poses, delta-coded and compressed; none unless the sweep asked for it.
    pub trajectory: Option<Vec<u8>>,
    /// When it was recorded [ms since 1970].
    pub recorded_ms: i64,
}

/// A second result that differs from the one on record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Incident {
    /// The job.
    pub job: JobId,
    /// Whose result is on record.
    pub recorded_worker: WorkerId,
    /// With which code.
    pub recorded_engine: EngineId,
    /// The digest on record.
    pub recorded_digest: Digest,
    /// Who sent the other.
    pub other_worker: WorkerId,
    /// With which code.
    pub other_engine: EngineId,
    /// The other's digest.
    pub other_digest: Digest,
    /// The other's outcome.
    pub other_outcome: String,
    /// When it came [ms since 1970].
    pub noted_ms: i64,
    /// Who is right, as far as that was looked into.
    pub verification: Option<VerificationState>,
}

/// A result that is, or was, computed again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Verification {
    /// Where that stands.
    pub state: VerificationState,
    /// The digests that came back, by attempt; those that differ are incidents, too.
    pub opinions: Vec<Opinion>,
}

/// A digest that a worker had for a job beside the one on record.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Opinion {
    /// In which handing-out.
    pub attempt: u32,
    /// Whose.
    pub worker: WorkerId,
    /// What came out.
    pub digest: Digest,
    /// When it came [ms since 1970].
    pub given_ms: i64,
}

/// Where a verification stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum VerificationState {
    /// It waits for a worker.
    Waits,
    /// A worker is at it.
    Leased,
    /// Every digest is the one on record.
    Agreed,
    /// Digests differ, and the one on record is right.
    Upheld,
    /// Digests differ, and the one on record is wrong. It stays there until a user removes it.
    Overruled,
    /// Digests differ, and nobody knows which is right.
    Undecided,
    /// Nobody brought it to an end.
    GivenUp,
}

impl VerificationState {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Waits, Self::Leased, Self::Agreed, Self::Upheld, Self::Overruled, Self::Undecided, Self::GivenUp];

    /// The word for it: `waits`, `leased`, `agreed`, `upheld`, `overruled`, `undecided` or `given-up`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Waits => "waits",
            Self::Leased => "leased",
            Self::Agreed => "agreed",
            Self::Upheld => "upheld",
            Self::Overruled => "overruled",
            Self::Undecided => "undecided",
            Self::GivenUp => "given-up",
        }
    }

    /// What `word` stands for, if anything.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == word)
    }
}

/// How many results were, or are being, verified.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct VerificationCounts {
    /// Those that wait or are at a worker.
    pub open: u64,
    /// Those whose digests were all equal.
    pub agreed: u64,
    /// Those with another digest, which is wrong.
    pub upheld: u64,
    /// Those with another digest, which is right.
    pub overruled: u64,
    /// Those with another digest, nobody knows which is right.
    pub undecided: u64,
    /// Those that nobody brought to an end.
    pub given_up: u64,
}

impl VerificationCounts {
    pub(crate) fn of(&mut self, state: VerificationState) -> &mut u64 {
        match state {
            VerificationState::Waits | VerificationState::Leased => &mut self.open,
            VerificationState::Agreed => &mut self.agreed,
            VerificationState::Upheld => &mut self.upheld,
            VerificationState::Overruled => &mut self.overruled,
            VerificationState::Undecided => &mut self.undecided,
            VerificationState::GivenUp => &mut self.given_up,
        }
    }
}

/// What a user changes about a sweep; what is not given stays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SweepChange {
    /// Higher goes first.
    pub priority: Option<i64>,
    /// Whether its jobs wait until it is resumed.
    pub paused: Option<bool>,
}

/// How much there is of everything, for who watches over the service.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Census {
    /// Sweeps by state; a state that none is in is missing.
    pub sweeps: BTreeMap<String, u64>,
    /// Jobs by state as the sweeps list them: one that two list counts twice.
    pub jobs: BTreeMap<String, u64>,
    /// Workers that were heard of within a lease.
    pub workers_live: u64,
    /// Results that differ from the one on record.
    pub incidents: u64,
    /// The database's file \[bytes\].
    pub database_bytes: u64,
    /// The write-ahead log beside it \[bytes\].
    pub wal_bytes: u64,
}
