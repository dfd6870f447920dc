//! How fast the queue is: jobs that do nothing, through real processes, real Zenoh and a real database.
//!
//! The command starts a [`coordinator`] process on a fresh database and [`worker`] processes; jobs are as usual
//! (scenario, seed, eight metrics, a digest, all bookkeeping), only that a run does [`idle`] work. Figures are the
//! coordinator's own: its clock, its processor time, its memory ([`process`]). In place of workers, many [`sessions`] may
//! hold a job each.

pub mod coordinator;
pub mod idle;
pub mod process;
pub mod sessions;
pub mod worker;

use serde::{Deserialize, Serialize};

/// What a sweep of idle jobs looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Load {
    /// Jobs in all; rounded up to whole seeds of every cell.
    pub jobs: u64,
    /// Cells of the sweep's table.
    pub cells: u64,
}

impl Load {
    /// Seeds of each cell.
    #[must_use]
    pub fn seeds(&self) -> u64 {
        self.jobs.div_ceil(self.cells)
    }
}

/// What the coordinator measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figures {
    /// Jobs with a result on record.
    pub jobs: u64,
    /// From the first worker's hello to the commit of the last result \[s\].
    pub wall_s: f64,
    /// Jobs claimed, run and durably on record per second \[1/s\].
    pub jobs_per_s: f64,
    /// The coordinator's processor time a job \[us\].
    pub coordinator_cpu_us_per_job: f64,
    /// The coordinator's resident memory with all jobs queued \[MB\].
    pub coordinator_rss_mb: f64,
    /// The largest it was at any time \[MB\].
    pub coordinator_peak_rss_mb: f64,
}

/// Where the coordinator process can be reached: its first line.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ready {
    /// For workers.
    pub endpoint: String,
}
