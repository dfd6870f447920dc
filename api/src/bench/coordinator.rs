//! The coordinator's process: takes a sweep of idle jobs in, serves workers until it is done, and tells the figures.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use furrow_coordinator::zenoh_service::{self, ZenohConfig};
use furrow_coordinator::{Config, Coordinator, Store};
use furrow_schema::id::{EngineId, SweepId};
use furrow_schema::sweep::{NewCell, NewSweep, Sweep, SweepState};

use super::process::{Usage, usage};
use super::{Figures, Load};
use crate::cli::error::CliError;

/// A coordinator with a sweep of idle jobs.
#[derive(Debug)]
pub struct Host {
    coordinator: Coordinator,
    service: zenoh_service::ZenohService,
    sweep: SweepId,
    with_all_queued: Usage,
}

impl Host {
    /// Submits the sweep to a new database in `file` and opens it for workers.
    ///
    /// # Errors
    /// The database or the network cannot be used.
    pub async fn start(file: &Path, load: Load, engine: EngineId) -> Result<Self, CliError> {
        let coordinator = Coordinator::start(Store::open(file).await?, Config::new(engine));
        let sweep = coordinator.submit(sweep(load, engine)).await?.id;
        let config = ZenohConfig::default();
        let service =
            zenoh_service::serve(coordinator.clone(), config).await.map_err(CliError::failed("no network"))?;
        Ok(Self { coordinator, service, sweep, with_all_queued: usage()? })
    }

    /// Where workers connect.
    #[must_use]
    pub fn endpoint(&self) -> &str {
        self.service.endpoints().first().map_or("", String::as_str)
    }

    /// Serves until every job has its result.
    ///
    /// # Errors
    /// The database fails, or a job did.
    pub async fn measure(self) -> Result<Figures, CliError> {
        let sweep = self.finished().await?;
        let used = usage()?;
        let first_hello_ms = self.coordinator.workers().await?.iter().map(|worker| worker.first_seen_ms).min();
        let ended_ms = sweep.finished_ms.unwrap_or(sweep.created_ms);
        let wall_s = (ended_ms - first_hello_ms.unwrap_or(sweep.created_ms)).max(1) as f64 / 1e3;
        let cpu_s = used.cpu_s - self.with_all_queued.cpu_s;
        self.service.close().await;
        self.coordinator.shutdown().await;
        Ok(Figures {
            jobs: sweep.done,
            wall_s,
            jobs_per_s: sweep.done as f64 / wall_s,
            coordinator_cpu_us_per_job: cpu_s * 1e6 / sweep.done as f64,
            coordinator_rss_mb: self.with_all_queued.rss_mb,
            coordinator_peak_rss_mb: used.peak_rss_mb,
        })
    }

    async fn finished(&self) -> Result<Sweep, CliError> {
        let mut changed = self.coordinator.changed();
        loop {
            changed.mark_unchanged();
            let sweep = self.coordinator.sweep(self.sweep).await?;
            let sweep = sweep.ok_or_else(|| CliError::Failed("the sweep is gone".to_owned()))?;
            match (sweep.state, sweep.failed) {
                (SweepState::Done, 0) => return Ok(sweep),
                (_, 0) => {}
                (_, failed) => return Err(CliError::JobsFailed(failed)),
            }
            changed.changed().await.map_err(CliError::failed("the coordinator ended"))?;
        }
    }
}

fn sweep(load: Load, engine: EngineId) -> NewSweep {
    let cell = |number: u64| NewCell {
        factors: BTreeMap::from([("level".to_owned(), format!("level-{number}"))]),
        scenarios: vec![Arc::from(format!("{{\"level\":{number}}}"))],
    };
    NewSweep {
        name: "idle".to_owned(),
        plan: "idle".to_owned(),
        request_json: "{}".to_owned(),
        engine,
        priority: 0,
        record: false,
        timing: false,
        seeds: load.seeds(),
        factors: vec!["level".to_owned()],
        cells: (0..load.cells).map(cell).collect(),
        idempotency_key: None,
    }
}
