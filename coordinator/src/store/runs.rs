//! The runs behind a part of a sweep, one by one: what a verdict cites.

use std::collections::BTreeMap;

use furrow_schema::id::{JobKey, SweepId};
use furrow_schema::job::Timings;

use crate::error::StoreError;
use crate::store::tally::Metrics;
use crate::store::{Store, from_json, hash, to_json, unsigned};
use crate::view::RunValue;

/// The results in those cells of sweep ?1 that have all labels ?2; wall-clock figures only where it measures times.
const RUNS: &str = "select job.key, job.seed, result.outcome, result.metrics, iif(sweep.timing, result.timings, null)
    from sweep join cell on cell.sweep_id = sweep.id join cell_job on cell_job.cell_id = cell.id
        join job on job.id = cell_job.job_id join result on result.job_id = job.id
    where sweep.id = ?1 and not exists (
        select 1 from json_each(?2) as wanted where not exists (
            select 1 from json_each(cell.factors) as label
            where label.key = wanted.key and label.value = wanted.value))
    order by job.seed, job.key";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[RUNS];

type Row = (Vec<u8>, i64, String, String, Option<String>);

/// The runs with `labels` by seed, then key, each with its value of `metric`.
pub(crate) async fn with_labels(
    store: &Store,
    sweep: SweepId,
    labels: &BTreeMap<String, String>,
    metric: &str,
) -> Result<Vec<RunValue>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(RUNS).bind(sweep.0).bind(to_json(labels)).fetch_all(store.readers()).await?;
    rows.into_iter().map(|row| read(row, metric)).collect()
}

fn read((key, seed, outcome, metrics, timings): Row, metric: &str) -> Result<RunValue, StoreError> {
    let metrics: Metrics = from_json("a result's metrics", &metrics)?;
    let timings: Option<Timings> = timings.map(|timings| from_json("a result's timings", &timings)).transpose()?;
    let time = || timings.filter(|timings| timings.alone)?.metrics.get(metric).copied();
    Ok(RunValue {
        key: JobKey(hash("a job's key", &key)?),
        seed: unsigned("a seed", seed)?,
        outcome,
        value: metrics.get(metric).copied().or_else(time),
    })
}

#[cfg(test)]
mod tests {
    use furrow_schema::protocol::RunEnd;
    use furrow_schema::sweep::NewSweep;

    use super::*;
    use crate::testing::{Bench, done, record, sweep};

    fn label(word: &str) -> BTreeMap<String, String> {
        BTreeMap::from([("algorithm".to_owned(), word.to_owned())])
    }

    #[tokio::test]
    async fn runs_stand_by_seed_with_key_outcome_and_value() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop", "rg"], 3)).await.id;
        let worker = bench.worker().await;
        let mut jobs = worker.claim(6).await;
        jobs.reverse();
        for job in jobs.iter().filter(|job| job.seed < 3) {
            worker.ended(job, done(1.5 - job.seed as f64)).await;
        }
        let runs = bench.coordinator.runs(id, &label("rg"), "distance_m").await.unwrap();
        let seen: Vec<_> = runs.iter().map(|run| (run.seed, run.outcome.as_str(), run.value)).collect();
        assert_eq!(seen, [(1, "success", Some(0.5)), (2, "lost", Some(-0.5))]);
        let job = bench.coordinator.job(crate::JobRef::Key(runs[0].key)).await.unwrap().unwrap();
        assert_eq!((job.seed, &job.cells[0].factors), (1, &label("rg")));
        assert_eq!(bench.coordinator.runs(id, &BTreeMap::new(), "x_m").await.unwrap().len(), 4);
        assert!(bench.coordinator.runs(id, &label("xyz"), "distance_m").await.unwrap().is_empty());
    }

    #[tokio::test]
    async fn only_runs_that_ran_alone_have_times() {
        let bench = Bench::new().await;
        let id = bench.submit(NewSweep { timing: true, ..sweep(&["rgop"], 2) }).await.id;
        let worker = bench.worker().await;
        for job in worker.claim(2).await {
            let mut record = record(1.0);
            record.timings.alone = job.seed == 1;
            record.timings.metrics.insert("line_finding_time_ms".to_owned(), 0.25);
            worker.ended(&job, RunEnd::Done(record)).await;
        }
        let runs = bench.coordinator.runs(id, &label("rgop"), "line_finding_time_ms").await.unwrap();
        assert_eq!(runs.iter().map(|run| run.value).collect::<Vec<_>>(), [Some(0.25), None]);
    }
}
