//! All runs of a sweep, page by page, each with all that was measured: what an export is made of.

use furrow_schema::id::{Digest, JobId, JobKey, SweepId};
use furrow_schema::job::Timings;

use crate::error::StoreError;
use crate::store::job::state_of;
use crate::store::tally::Metrics;
use crate::store::{Store, from_json, hash, unsigned};
use crate::view::{RunCursor, RunRow};

/// Runs of sweep ?1 by cell and job, behind job ?3 of the cell at ?2; at most ?4. Wall-clock figures only where the sweep
/// measures times.
const PAGE: &str = "select cell.position, job.id, job.key, job.seed, job.state, job.attempt,
        result.outcome, result.digest, result.metrics, iif(sweep.timing, result.timings, null)
    from sweep cross join cell on cell.sweep_id = sweep.id
        cross join cell_job on cell_job.cell_id = cell.id and cell_job.job_id > iif(cell.position = ?2, ?3, 0)
        cross join job on job.id = cell_job.job_id left join result on result.job_id = job.id
    where sweep.id = ?1 and cell.position >= ?2
    order by cell.position, cell_job.job_id limit ?4";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[PAGE];

type Row = (i64, i64, Vec<u8>, i64, String, i64, Option<String>, Option<Vec<u8>>, Option<String>, Option<String>);

/// A page of runs.
pub(crate) async fn page(
    store: &Store,
    sweep: SweepId,
    after: RunCursor,
    limit: u32,
) -> Result<Vec<RunRow>, StoreError> {
    let position = i64::try_from(after.position).unwrap_or(i64::MAX);
    let page = sqlx::query_as(PAGE).bind(sweep.0).bind(position).bind(after.job.0).bind(limit);
    let rows: Vec<Row> = page.fetch_all(store.readers()).await?;
    rows.into_iter().map(read).collect()
}

fn read(row: Row) -> Result<RunRow, StoreError> {
    let (position, job, key, seed, state, attempts, outcome, digest, metrics, timings) = row;
    let metrics: Option<Metrics> = metrics.map(|metrics| from_json("a result's metrics", &metrics)).transpose()?;
    let timings: Option<Timings> = timings.map(|timings| from_json("a result's timings", &timings)).transpose()?;
    let timings = timings.filter(|timings| timings.alone).map(|timings| timings.metrics).unwrap_or_default();
    let mut metrics = metrics.unwrap_or_default();
    metrics.extend(timings);
    Ok(RunRow {
        position: unsigned("a cell's position", position)?,
        job: JobId(job),
        key: JobKey(hash("a job's key", &key)?),
        seed: unsigned("a seed", seed)?,
        state: state_of(&state)?,
        attempts: unsigned("a job's attempts", attempts)?,
        outcome,
        digest: digest.map(|digest| hash("a digest", &digest).map(Digest)).transpose()?,
        metrics,
    })
}

#[cfg(test)]
mod tests {
    use furrow_schema::job::JobState;

    use super::*;
    use crate::testing::{Bench, done, panicked, sweep};

    #[tokio::test]
    async fn pages_of_any_length_hold_every_run_once_and_failed_ones_too() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["other"], 2)).await;
        let id = bench.submit(sweep(&["rgop", "rg", "ruby"], 3)).await.id;
        let worker = bench.worker().await;
        for job in worker.claim(11).await {
            let ended = if job.seed == 3 { panicked("on purpose") } else { done(job.seed as f64) };
            worker.ended(&job, ended).await;
        }
        let all = bench.coordinator.run_rows(id, RunCursor::default(), 100).await.unwrap();
        assert_eq!(all.iter().map(|run| run.position).collect::<Vec<_>>(), [0, 0, 0, 1, 1, 1, 2, 2, 2]);
        assert_eq!(all.iter().map(|run| run.seed).collect::<Vec<_>>(), [1, 2, 3, 1, 2, 3, 1, 2, 3]);
        assert_eq!((all[1].metrics["distance_m"], all[1].outcome.as_deref()), (2.0, Some("success")));
        let waits = &all[2];
        assert_eq!((waits.state, waits.attempts, waits.metrics.len()), (JobState::Queued, 1, 0));
        assert!(waits.digest.is_none() && all[1].digest.is_some());
        for limit in 1..=4 {
            let (mut seen, mut after) = (Vec::new(), RunCursor::default());
            loop {
                let page = bench.coordinator.run_rows(id, after, limit).await.unwrap();
                let Some(last) = page.last() else { break };
                after = RunCursor { position: last.position, job: last.job };
                seen.extend(page);
            }
            assert_eq!(seen, all, "pages of {limit}");
        }
    }

    #[tokio::test]
    async fn a_page_begins_with_a_seek_however_many_jobs_of_the_cell_are_before_it() {
        let bench = Bench::new().await;
        for statement in [PAGE, crate::store::job::LIST] {
            let explain = sqlx::AssertSqlSafe(format!("explain query plan {statement}"));
            let steps: Vec<(i64, i64, i64, String)> =
                sqlx::query_as(explain).fetch_all(bench.store.readers()).await.unwrap();
            let steps: Vec<String> = steps.into_iter().map(|(.., step)| step).collect();
            assert!(steps.iter().any(|step| step.contains("(cell_id=? AND job_id>?)")), "{steps:?}");
            assert!(steps.iter().all(|step| !step.contains("TEMP B-TREE")), "{steps:?}");
        }
    }
}
