//! The runs of a sweep that have no result: what a comparison must not pass over in silence.

use furrow_schema::id::{ScenarioId, SweepId};

use crate::error::StoreError;
use crate::store::job::state_of;
use crate::store::{Store, unsigned};
use crate::view::UnfinishedRun;

/// The jobs in a sweep's cells that are not done.
const UNFINISHED: &str = "select cell.position, job.seed, job.scenario_id, job.state
    from cell join cell_job on cell_job.cell_id = cell.id join job on job.id = cell_job.job_id
    where cell.sweep_id = ?1 and job.state <> 'done' order by cell.position, job.id";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[UNFINISHED];

/// The runs without a result, by cell.
pub(crate) async fn list(store: &Store, sweep: SweepId) -> Result<Vec<UnfinishedRun>, StoreError> {
    let rows: Vec<(i64, i64, i64, String)> =
        sqlx::query_as(UNFINISHED).bind(sweep.0).fetch_all(store.readers()).await?;
    let read = |(position, seed, scenario, state): (i64, i64, i64, String)| {
        Ok(UnfinishedRun {
            position: unsigned("a cell's position", position)?,
            seed: unsigned("a seed", seed)?,
            scenario: ScenarioId(scenario),
            state: state_of(&state)?,
        })
    };
    rows.into_iter().map(read).collect()
}

#[cfg(test)]
mod tests {
    use furrow_schema::job::JobState;

    use crate::testing::{Bench, done, panicked, sweep};

    #[tokio::test]
    async fn what_has_no_result_is_listed_with_its_state() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop", "rg"], 1)).await.id;
        let worker = bench.worker().await;
        let job = worker.claim_one().await;
        worker.ended(&job, done(1.0)).await;
        for _ in 0..3 {
            let job = worker.claim_one().await;
            worker.ended(&job, panicked("on purpose")).await;
            bench.pass(60_000).await;
        }
        let left = bench.coordinator.unfinished(id).await.unwrap();
        let seen: Vec<_> = left.iter().map(|run| (run.position, run.seed, run.state)).collect();
        assert_eq!(seen, [(1, 1, JobState::Failed)]);
        let texts = bench.coordinator.scenario_texts(&[left[0].scenario]).await.unwrap();
        assert_eq!(texts[&left[0].scenario], r#"{"algorithm":"rg"}"#);
    }
}
