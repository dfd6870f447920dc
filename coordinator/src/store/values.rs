//! The values behind a sweep's cells, as columns: what medians, quantiles and bootstrap are made of.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use furrow_schema::id::{Digest, JobId, ScenarioId, SweepId};
use furrow_schema::job::Timings;
use futures::TryStreamExt;

use crate::error::StoreError;
use crate::store::tally::Metrics;
use crate::store::{Store, from_json, hash, unsigned};
use crate::view::CellValues;

/// The cells of a sweep and whether it measures times.
const CELLS: &str = "select position, cell.factors, timing from cell join sweep on sweep.id = cell.sweep_id
    where sweep_id = ?1 order by position";

/// The results in a sweep's cells; wall-clock figures only where they are wanted.
const RESULTS: &str = "select cell.position, job.id, job.seed, job.scenario_id, scenario.hash,
        result.outcome, result.digest, result.metrics, iif(?2, result.timings, null)
    from cell join cell_job on cell_job.cell_id = cell.id join result on result.job_id = cell_job.job_id
        join job on job.id = cell_job.job_id join scenario on scenario.id = job.scenario_id
    where cell.sweep_id = ?1 order by cell.position";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[CELLS, RESULTS];

type Row = (i64, i64, i64, i64, Vec<u8>, String, Vec<u8>, String, Option<String>);

/// One run, before it is spread over the columns.
struct Run {
    seed: u64,
    scenario_hash: Vec<u8>,
    scenario: ScenarioId,
    job: JobId,
    outcome: Arc<str>,
    digest: Digest,
    metrics: Metrics,
    timings: Metrics,
}

/// The values of a sweep by cell, of all metrics or of those named.
pub(crate) async fn by_cell(
    store: &Store,
    sweep: SweepId,
    wanted: Option<&[&str]>,
) -> Result<Vec<CellValues>, StoreError> {
    let mut conn = store.readers().acquire().await?;
    let cells: Vec<(i64, String, bool)> = sqlx::query_as(CELLS).bind(sweep.0).fetch_all(&mut *conn).await?;
    let timing = cells.first().is_some_and(|(.., timing)| *timing);
    let mut runs: Vec<Vec<Run>> = cells.iter().map(|_| Vec::new()).collect();
    let mut outcomes = HashMap::new();
    let mut rows = sqlx::query_as::<_, Row>(RESULTS).bind(sweep.0).bind(timing).fetch(&mut *conn);
    while let Some(row) = rows.try_next().await? {
        let position: usize = unsigned("a cell's position", row.0)?;
        let run = read(row, wanted, &mut outcomes)?;
        // A cell that came with a later submission is not in the list; its runs are none of this answer's.
        if let Some(runs) = runs.get_mut(position) {
            runs.push(run);
        }
    }
    let spread = |((position, factors, _), runs): ((i64, String, bool), Vec<Run>)| {
        let position = unsigned("a cell's position", position)?;
        Ok(columns(
            CellValues { position, factors: from_json("a cell's factors", &factors)?, ..Default::default() },
            runs,
        ))
    };
    cells.into_iter().zip(runs).map(spread).collect()
}

fn read(
    (_, job, seed, scenario, scenario_hash, outcome, digest, metrics, timings): Row,
    wanted: Option<&[&str]>,
    outcomes: &mut HashMap<String, Arc<str>>,
) -> Result<Run, StoreError> {
    let mut metrics: Metrics = from_json("a result's metrics", &metrics)?;
    let timings: Option<Timings> = timings.map(|timings| from_json("a result's timings", &timings)).transpose()?;
    let mut timings = timings.filter(|timings| timings.alone).map(|timings| timings.metrics).unwrap_or_default();
    if let Some(wanted) = wanted {
        metrics.retain(|metric, _| wanted.contains(&metric.as_str()));
        timings.retain(|metric, _| wanted.contains(&metric.as_str()));
    }
    let outcome = outcomes.entry(outcome).or_insert_with_key(|word| word.as_str().into()).clone();
    Ok(Run {
        seed: unsigned("a seed", seed)?,
        scenario_hash,
        scenario: ScenarioId(scenario),
        job: JobId(job),
        outcome,
        digest: Digest(hash("a digest", &digest)?),
        metrics,
        timings,
    })
}

fn columns(mut cell: CellValues, mut runs: Vec<Run>) -> CellValues {
    runs.sort_by(|a, b| (a.seed, &a.scenario_hash).cmp(&(b.seed, &b.scenario_hash)));
    let all = runs.len();
    for (row, run) in runs.into_iter().enumerate() {
        cell.seeds.push(run.seed);
        cell.scenarios.push(run.scenario);
        cell.jobs.push(run.job);
        cell.outcomes.push(run.outcome);
        cell.digests.push(run.digest);
        place(&mut cell.metrics, run.metrics, row, all);
        place(&mut cell.timings, run.timings, row, all);
    }
    cell
}

fn place(columns: &mut BTreeMap<String, Vec<Option<f64>>>, values: Metrics, row: usize, all: usize) {
    for (metric, value) in values {
        columns.entry(metric).or_insert_with(|| vec![None; all])[row] = Some(value);
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::protocol::RunEnd;
    use furrow_schema::sweep::NewSweep;

    use super::*;
    use crate::testing::{Bench, done, record, sweep};

    #[tokio::test]
    async fn values_stand_by_seed_whatever_the_order_of_arrival() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop", "rg"], 3)).await.id;
        let worker = bench.worker().await;
        let mut jobs = worker.claim(6).await;
        jobs.reverse();
        for job in &jobs[1..] {
            worker.ended(job, done(job.seed as f64)).await;
        }
        let cells = bench.coordinator.values(id, None).await.unwrap();
        assert_eq!((cells[0].seeds.as_slice(), cells[1].seeds.as_slice()), (&[1, 2, 3][..], &[1, 2][..]));
        assert_eq!(cells[0].metrics["distance_m"], [Some(1.0), Some(2.0), Some(3.0)]);
        assert!(cells[0].outcomes.iter().all(|outcome| &**outcome == "success"));
        let only = bench.coordinator.values(id, Some(&["success"])).await.unwrap();
        assert_eq!(only[0].metrics.keys().collect::<Vec<_>>(), ["success"]);
    }

    #[tokio::test]
    async fn a_metric_that_a_run_lacks_leaves_a_gap() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop"], 3)).await.id;
        let worker = bench.worker().await;
        for job in worker.claim(3).await {
            let mut record = record(1.0);
            if job.seed == 2 {
                record.metrics.insert("trajectory_error_mean_m".to_owned(), 0.5);
            }
            worker.ended(&job, RunEnd::Done(record)).await;
        }
        let cells = bench.coordinator.values(id, None).await.unwrap();
        assert_eq!(cells[0].metrics["trajectory_error_mean_m"], [None, Some(0.5), None]);
        assert_eq!(bench.cells(id).await[0].metrics["trajectory_error_mean_m"].n(), 1);
    }

    #[tokio::test]
    async fn only_runs_that_ran_alone_have_times() {
        let bench = Bench::new().await;
        let timing = bench.submit(NewSweep { timing: true, ..sweep(&["rgop"], 2) }).await.id;
        let worker = bench.worker().await;
        for job in worker.claim(2).await {
            let mut record = record(1.0);
            record.timings.alone = job.seed == 1;
            record.timings.metrics.insert("line_finding_time_ms".to_owned(), 0.25);
            worker.ended(&job, RunEnd::Done(record)).await;
        }
        let cells = bench.coordinator.values(timing, None).await.unwrap();
        assert_eq!(cells[0].timings["line_finding_time_ms"], [Some(0.25), None]);
        let plain = bench.submit(sweep(&["rgop"], 2)).await.id;
        assert!(bench.coordinator.values(plain, None).await.unwrap()[0].timings.is_empty());
        assert!(bench.coordinator.values(SweepId(99), None).await.unwrap().is_empty());
    }
}
