//! What a user submits, and what is said about it later.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::id::{EngineId, SweepId};

/// A sweep as the way in hands it to the coordinator: expanded, validated, resolved.
#[derive(Debug, Clone)]
pub struct NewSweep {
    /// The user's name for it, or the plan's.
    pub name: String,
    /// The plan's name.
    pub plan: String,
    /// What was asked, as JSON (plan, only, set, field, seeds): enough to ask again.
    pub request_json: String,
    /// Which code will run it.
    pub engine: EngineId,
    /// Higher goes first.
    pub priority: i64,
    /// Whether trajectories are stored.
    pub record: bool,
    /// Whether this measures times: no cached result counts, and workers run one job at a time.
    pub timing: bool,
    /// Every scenario runs with seeds 1 to this.
    pub seeds: u64,
    /// Names of the factors, in the plan's order: the dimensions of every table.
    pub factors: Vec<String>,
    /// The combinations of labels.
    pub cells: Vec<NewCell>,
    /// The client's key for this submission; the same key with the same request gives the same sweep.
    pub idempotency_key: Option<String>,
}

/// One combination of factor labels.
#[derive(Debug, Clone)]
pub struct NewCell {
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// Canonical JSON of the scenarios pooled in this cell: one, unless a level is a pool.
    pub scenarios: Vec<Arc<str>>,
}

/// What a submission came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Submitted {
    /// The sweep.
    pub id: SweepId,
    /// All its jobs.
    pub total: u64,
    /// Jobs that no sweep had asked for before.
    pub new: u64,
    /// Jobs whose result was there already.
    pub cached: u64,
}

/// Where a sweep stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SweepState {
    /// Some jobs wait or run.
    Active,
    /// Its jobs wait until it is resumed.
    Paused,
    /// Every job has ended.
    Done,
    /// Its jobs were given up by a user.
    Cancelled,
}

/// A sweep as clients see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Sweep {
    /// Its number.
    pub id: SweepId,
    /// The user's name for it, or the plan's.
    pub name: String,
    /// The plan's name.
    pub plan: String,
    /// Where it stands.
    pub state: SweepState,
    /// Higher goes first.
    pub priority: i64,
    /// All its jobs.
    pub total: u64,
    /// Jobs with a result.
    pub done: u64,
    /// Jobs given up on.
    pub failed: u64,
    /// Jobs that wait.
    pub queued: u64,
    /// Jobs at a worker.
    pub leased: u64,
    /// Jobs cancelled.
    pub cancelled: u64,
    /// Of the jobs done, those whose result was there at submission.
    pub cached: u64,
    /// Of the jobs done, those whose result on record is in doubt: other workers had another one.
    pub disputed: u64,
    /// Results recorded per second over the last 30 s [1/s]; null while nothing is known.
    pub rate_per_s: Option<f64>,
    /// Time left at that rate \[s\]; null while nothing is known, 0 when nothing is left.
    pub eta_s: Option<f64>,
    /// Which code runs it.
    #[schema(value_type = String)]
    pub engine: EngineId,
    /// Seeds per scenario.
    pub seeds: u64,
    /// Names of the factors, in the plan's order.
    pub factors: Vec<String>,
    /// Whether trajectories are stored.
    pub record: bool,
    /// Whether it measures times.
    pub timing: bool,
    /// When it was submitted [ms since 1970].
    pub created_ms: i64,
    /// When its last job ended [ms since 1970].
    pub finished_ms: Option<i64>,
}
