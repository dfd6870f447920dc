//! The unit of work: its states, and what a run of it leaves behind.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::id::Digest;

/// Where a job stands. The database's constraints tie the lease and the timestamps to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum JobState {
    /// Waits for a worker.
    Queued,
    /// A worker holds it until its lease runs out.
    Leased,
    /// Its result is recorded.
    Done,
    /// Given up on, with reasons; a user may retry.
    Failed,
    /// No live sweep wants it any more.
    Cancelled,
}

impl JobState {
    /// All states, in the order of a job's life.
    pub const ALL: [Self; 5] = [Self::Queued, Self::Leased, Self::Done, Self::Failed, Self::Cancelled];

    /// The word that stands in the database and in JSON.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Leased => "leased",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// The state that `word` names, if any.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == word)
    }
}

/// What a finished run leaves behind: the part that is the same on every machine, and the part that is not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunRecord {
    /// Hash over trajectory, outcome and metrics.
    pub digest: Digest,
    /// How it ended, one kebab-case word: `success`, `lost`, `crushed`, ..
    pub outcome: String,
    /// Per-run values by metric name; a metric that is undefined for this run is absent. All finite.
    pub metrics: BTreeMap<String, f64>,
    /// Wall-clock figures: never part of the digest, the cache or a comparison of bits.
    pub timings: Timings,
    /// 20 Hz poses, delta-coded and compressed, as hexadecimal text; present when the lease asked for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<String>,
}

/// Wall-clock figures of one run on one machine.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Timings {
    /// The whole run \[ms\].
    pub wall_ms: f64,
    /// True when nothing else ran on the worker at the time: only such figures go into tables of times.
    pub alone: bool,
    /// The processor's name as the operating system gives it.
    pub cpu_model: String,
    /// The machine's one-minute load average when the run ended.
    pub load: f64,
    /// Per-run timing metrics by name, such as `line_finding_time_ms`.
    pub metrics: BTreeMap<String, f64>,
    /// Where the time went.
    pub parts: Vec<PartTiming>,
}

/// What one part of the loop cost.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PartTiming {
    /// The part, kebab-case: `scan`, `line-finding`, `control`, `drive`, `observe`, ..
    pub part: String,
    /// How many times it ran.
    pub calls: u64,
    /// Mean of a call \[us\].
    pub mean_us: f64,
    /// Median of a call \[us\].
    pub p50_us: f64,
    /// 99th percentile of a call \[us\].
    pub p99_us: f64,
}
