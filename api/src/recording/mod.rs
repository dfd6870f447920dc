//! A run as an MCAP file, for Foxglove, Rerun and whatever else reads logs of robots.
//!
//! [`record`] simulates a finished run once more before a probe (`recorder`) that writes all it sees (`file`), so a
//! recording is never in memory as a whole. `scene` draws, `messages` are the pieces of Foxglove's schemas, `facts` the
//! messages that have no such schema, `motion` looks at one pose after the other, `mount` knows the LiDARs. Time is
//! simulated and begins at 0: nothing in the file depends on a clock, and the same run gives the same bytes.

mod facts;
mod file;
mod messages;
mod motion;
mod mount;
mod recorder;
mod scene;
mod space;
#[cfg(test)]
mod tests;

use std::io::Write;

use furrow_schema::id::{JobId, JobKey};
use furrow_sim::{RunResult, Scenario};
use furrow_worker::replay::{ReplayError, watch};

use recorder::Recorder;
pub(crate) use scene::body_m;

/// A finished run.
#[derive(Debug, Clone, Copy)]
pub struct Run<'a> {
    /// The job.
    pub job: JobId,
    /// Its key.
    pub key: JobKey,
    /// Its scenario's canonical JSON.
    pub scenario_json: &'a str,
    /// The same, read.
    pub scenario: &'a Scenario,
    /// Its seed.
    pub seed: u64,
    /// What came out of it.
    pub result: &'a RunResult,
}

/// Why a run was not recorded. What was written until then is not a whole file.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It could not be written, or nobody reads it any more. The caller gives up.
    #[error("the recording cannot be written: {0}")]
    Write(#[from] mcap::McapError),
    /// The simulation panicked. The caller shows the message; trying again will not help.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The run came out otherwise than its result says: another engine made it. The caller says so.
    #[error("the repeated run has another digest than the recorded one")]
    OtherDigest,
}

/// Simulates `run` once more and writes it to `out` meanwhile; takes a few times as long as the run did.
///
/// # Errors
/// See [`RecordError`].
pub fn record(run: &Run<'_>, out: impl Write) -> Result<(), RecordError> {
    let field = run.scenario.field.build(run.seed);
    let mut recorder = Recorder::begin(run, &field, out)?;
    let result = watch(run.scenario, run.seed, &mut recorder)?;
    recorder.finish()?;
    if result.digest == run.result.digest { Ok(()) } else { Err(RecordError::OtherDigest) }
}
