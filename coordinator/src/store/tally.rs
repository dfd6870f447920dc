//! Counts and moments: what a transaction adds to cells and sweeps, gathered in memory and written once.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::id::{CellId, JobId, SweepId};
use furrow_schema::job::JobState;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::moments::Moments;
use crate::store::{hex, to_json};

/// The cells, and their sweeps, that want jobs.
const MEMBERS: &str = "select cell_job.job_id, cell_job.cell_id, cell.sweep_id
    from json_each(?1) as wanted
        join cell_job on cell_job.job_id = wanted.value join cell on cell.id = cell_job.cell_id";

/// Adds to cells' counts: cell, total, done, failed.
const COUNT_CELLS: &str = "update cell
    set total = total + (value ->> 1), done = done + (value ->> 2), failed = failed + (value ->> 3)
    from json_each(?1) where cell.id = value ->> 0";

/// Adds to sweeps' counts: sweep, total, new, cached, done, failed, cancelled.
const COUNT_SWEEPS: &str = "update sweep
    set total = total + (value ->> 1), new = new + (value ->> 2), cached = cached + (value ->> 3),
        done = done + (value ->> 4), failed = failed + (value ->> 5), cancelled = cancelled + (value ->> 6)
    from json_each(?1) where sweep.id = value ->> 0";

/// A sweep is done when all its jobs ended, and active again when one of them was queued again; not one that was
/// cancelled, or whose jobs are being brought in line with what a user did.
const SETTLE_SWEEPS: &str = "update sweep
    set state = case when done + failed + cancelled = total then 'done' when state = 'done' then 'active' else state end,
        finished_ms = case when done + failed + cancelled = total then coalesce(finished_ms, ?2) end
    where id in (select value from json_each(?1)) and state <> 'cancelled'
        and id not in (select sweep_id from settling)";

/// The moments of cells.
const MOMENTS: &str = "select cell_id, metric, moments from cell_metric
    where cell_id in (select value from json_each(?1))";

/// Replaces moments: cell, metric, bytes.
const KEEP_MOMENTS: &str = "insert into cell_metric (cell_id, metric, moments)
    select value ->> 0, value ->> 1, unhex(value ->> 2) from json_each(?1) where true
    on conflict (cell_id, metric) do update set moments = excluded.moments";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[MEMBERS, COUNT_CELLS, COUNT_SWEEPS, SETTLE_SWEEPS, MOMENTS, KEEP_MOMENTS];

/// Per-run values by metric name.
pub(crate) type Metrics = BTreeMap<String, f64>;

/// A job that went from one state to another.
#[derive(Debug)]
pub(crate) struct Moved<'a> {
    pub(crate) job: JobId,
    pub(crate) from: JobState,
    pub(crate) to: JobState,
    /// The metrics of its result, when `to` is done.
    pub(crate) metrics: Option<&'a Metrics>,
}

/// What a transaction adds.
#[derive(Debug, Default)]
pub(crate) struct Tally {
    cells: BTreeMap<CellId, CellDelta>,
    sweeps: BTreeMap<SweepId, SweepDelta>,
}

#[derive(Debug, Default)]
struct CellDelta {
    total: i64,
    done: i64,
    failed: i64,
    metrics: BTreeMap<String, Moments>,
}

#[derive(Debug, Default)]
pub(crate) struct SweepDelta {
    pub(crate) total: i64,
    pub(crate) new: i64,
    pub(crate) cached: i64,
    pub(crate) done: i64,
    pub(crate) failed: i64,
    pub(crate) cancelled: i64,
    /// Results recorded now, which is what a rate counts.
    pub(crate) recorded: u64,
}

impl Tally {
    /// Counts jobs that moved, in every cell that wants them.
    pub(crate) async fn moved(&mut self, conn: &mut SqliteConnection, moved: &[Moved<'_>]) -> Result<(), StoreError> {
        if moved.is_empty() {
            return Ok(());
        }
        let mut jobs: Vec<JobId> = moved.iter().map(|moved| moved.job).collect();
        jobs.sort_unstable();
        jobs.dedup();
        let rows: Vec<(i64, i64, i64)> = sqlx::query_as(MEMBERS).bind(to_json(&jobs)).fetch_all(conn).await?;
        let mut members: HashMap<i64, Vec<(CellId, SweepId)>> = HashMap::with_capacity(jobs.len());
        for (job, cell, sweep) in rows {
            members.entry(job).or_default().push((CellId(cell), SweepId(sweep)));
        }
        for moved in moved {
            for (cell, sweep) in members.get(&moved.job.0).into_iter().flatten() {
                self.count(*cell, *sweep, moved);
            }
        }
        Ok(())
    }

    /// Counts a job that is new in a cell as it stands; one with a result brings its metrics.
    pub(crate) fn joined(&mut self, cell: CellId, sweep: SweepId, state: JobState, cached: Option<&Metrics>) {
        let (done, failed) = (i64::from(cached.is_some()), i64::from(state == JobState::Failed));
        let delta = self.cells.entry(cell).or_default();
        delta.total += 1;
        delta.done += done;
        delta.failed += failed;
        delta.add(cached);
        let delta = self.sweep(sweep);
        delta.total += 1;
        delta.done += done;
        delta.failed += failed;
        delta.cancelled += i64::from(state == JobState::Cancelled);
        delta.cached += done;
    }

    /// What is added to a sweep.
    pub(crate) fn sweep(&mut self, sweep: SweepId) -> &mut SweepDelta {
        self.sweeps.entry(sweep).or_default()
    }

    /// Results recorded now by sweep.
    pub(crate) fn recorded(&self) -> impl Iterator<Item = (SweepId, u64)> {
        self.sweeps.iter().map(|(sweep, delta)| (*sweep, delta.recorded)).filter(|(_, n)| *n > 0)
    }

    /// Whether there is nothing to add.
    pub(crate) fn is_empty(&self) -> bool {
        self.sweeps.is_empty()
    }

    /// Writes all of it.
    pub(crate) async fn write(&self, conn: &mut SqliteConnection, now_ms: i64) -> Result<(), StoreError> {
        if self.is_empty() {
            return Ok(());
        }
        let cells: Vec<_> = self.cells.iter().map(|(id, d)| (id, d.total, d.done, d.failed)).collect();
        sqlx::query(COUNT_CELLS).bind(to_json(&cells)).execute(&mut *conn).await?;
        let row = |(id, d)| {
            let (id, d): (&SweepId, &SweepDelta) = (id, d);
            (*id, d.total, d.new, d.cached, d.done, d.failed, d.cancelled)
        };
        let sweeps: Vec<_> = self.sweeps.iter().map(row).collect();
        sqlx::query(COUNT_SWEEPS).bind(to_json(&sweeps)).execute(&mut *conn).await?;
        let ids = to_json(&self.sweeps.keys().collect::<Vec<_>>());
        sqlx::query(SETTLE_SWEEPS).bind(ids).bind(now_ms).execute(&mut *conn).await?;
        self.write_moments(conn).await
    }

    async fn write_moments(&self, conn: &mut SqliteConnection) -> Result<(), StoreError> {
        let touched: Vec<_> = self.cells.iter().filter(|(_, d)| !d.metrics.is_empty()).map(|(id, _)| id).collect();
        if touched.is_empty() {
            return Ok(());
        }
        let mut stored = load(conn, &to_json(&touched)).await?;
        let mut rows = Vec::new();
        for (cell, delta) in &self.cells {
            for (metric, added) in &delta.metrics {
                let mut moments = stored.remove(&(*cell, metric.clone())).unwrap_or_default();
                moments.merge(added);
                rows.push((cell, metric, hex(&moments.to_bytes())));
            }
        }
        sqlx::query(KEEP_MOMENTS).bind(to_json(&rows)).execute(conn).await?;
        Ok(())
    }

    fn count(&mut self, cell: CellId, sweep: SweepId, moved: &Moved<'_>) {
        let change = |state: JobState| i64::from(moved.to == state) - i64::from(moved.from == state);
        let (done, failed) = (change(JobState::Done), change(JobState::Failed));
        let delta = self.cells.entry(cell).or_default();
        delta.done += done;
        delta.failed += failed;
        delta.add(moved.metrics);
        let delta = self.sweep(sweep);
        delta.done += done;
        delta.failed += failed;
        delta.cancelled += change(JobState::Cancelled);
        delta.recorded += u64::from(done > 0);
    }
}

impl CellDelta {
    fn add(&mut self, metrics: Option<&Metrics>) {
        for (metric, value) in metrics.into_iter().flatten() {
            match self.metrics.get_mut(metric) {
                Some(moments) => moments.add(*value),
                None => self.metrics.entry(metric.clone()).or_default().add(*value),
            }
        }
    }
}

async fn load(conn: &mut SqliteConnection, cells: &str) -> Result<HashMap<(CellId, String), Moments>, StoreError> {
    let rows: Vec<(i64, String, Vec<u8>)> = sqlx::query_as(MOMENTS).bind(cells).fetch_all(conn).await?;
    let entry = |(cell, metric, bytes): (i64, String, Vec<u8>)| {
        let moments = moments(&metric, &bytes)?;
        Ok(((CellId(cell), metric), moments))
    };
    rows.into_iter().map(entry).collect()
}

/// Stored moments.
pub(crate) fn moments(metric: &str, bytes: &[u8]) -> Result<Moments, StoreError> {
    Moments::from_bytes(bytes).ok_or_else(|| StoreError::Damaged(format!("the moments of `{metric}`")))
}

#[cfg(test)]
mod tests {
    use crate::testing::{Bench, done, sweep};

    /// The cells after results came in the given order, in reports of the given size.
    async fn cells_after(order: &[usize], at_a_time: usize) -> Vec<crate::CellSummary> {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop", "rg"], 16)).await.id;
        let worker = bench.worker().await;
        let jobs = worker.claim(32).await;
        let run = |at: &usize| {
            let job = &jobs[*at];
            let ended = done(0.1 * (job.job.0 as f64).powi(9) - 1e7);
            furrow_schema::protocol::RunReport { job: job.job, attempt: job.attempt, ended }
        };
        for chunk in order.chunks(at_a_time) {
            worker.report(chunk.iter().map(run).collect()).await;
        }
        bench.assert_consistent().await;
        bench.cells(id).await
    }

    #[tokio::test]
    async fn moments_do_not_depend_on_the_order_of_arrival() {
        let forward: Vec<_> = (0..32).collect();
        let backward: Vec<_> = (0..32).rev().collect();
        let scattered: Vec<_> = (0..32).map(|i| i * 13 % 32).collect();
        let reference = cells_after(&forward, 1).await;
        assert!(reference.iter().all(|cell| cell.metrics["distance_m"].n() == 16));
        assert_eq!(cells_after(&backward, 5).await, reference);
        assert_eq!(cells_after(&scattered, 32).await, reference);
    }
}
