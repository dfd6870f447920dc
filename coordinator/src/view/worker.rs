//! Workers, and what users change about them.

use furrow_schema::id::{EngineId, WorkerId};

/// What a user changes about a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkerChange {
    /// It is turned away for good; what it holds is given to others at once.
    Revoke,
    /// It is let in until then [ms since 1970]; for good if none.
    Until(Option<i64>),
}

/// A worker that said hello or enrolled.
#[derive(Debug, Clone, PartialEq)]
pub struct WorkerInfo {
    /// The worker.
    pub id: WorkerId,
    /// Its name for people.
    pub name: String,
    /// The simulation code it ran when it last said hello.
    pub engine: EngineId,
    /// Runs at a time.
    pub threads: u32,
    /// Jobs it holds.
    pub leased: u64,
    /// Results of it that were recorded.
    pub results: u64,
    /// Results per second over the last 30 s [1/s]; none while nothing is known.
    pub rate_per_s: Option<f64>,
    /// When it first said hello, or enrolled [ms since 1970].
    pub first_seen_ms: i64,
    /// When it last asked for something or renewed, to within 5 s [ms since 1970].
    pub last_seen_ms: i64,
    /// When it enrolled with a join secret [ms since 1970]; none if its hello was enough.
    pub enrolled_ms: Option<i64>,
    /// When its certificate ends [ms since 1970]; it asks for another one before.
    pub certificate_until_ms: Option<i64>,
    /// Until when it is let in [ms since 1970]; for good if none.
    pub until_ms: Option<i64>,
    /// When it was turned away [ms since 1970].
    pub revoked_ms: Option<i64>,
    /// Since when it gets no more jobs, and why.
    pub barred: Option<Bar>,
}

/// A worker that computed something wrong gets no more jobs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bar {
    /// Since when [ms since 1970].
    pub since_ms: i64,
    /// What speaks against it.
    pub reason: String,
}
