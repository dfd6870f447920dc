//! Jobs in pages.

use furrow_schema::id::{CellId, Digest, JobId, JobKey, SweepId};
use furrow_schema::job::JobState;

use crate::error::StoreError;
use crate::store::worker::worker_id;
use crate::store::{Store, from_json, hash, to_json, unsigned};
use crate::view::{JobCursor, JobFilter, JobItem, JobPage};

pub(crate) use crate::store::job_detail::get;

/// Jobs by cell, then job, behind (?3, ?4): of sweep ?1 (its cells are neighbours), in state ?2, with labels ?5.
pub(super) const LIST: &str =
    "select job.id, job.key, cell.sweep_id, cell.id, job.state, cell.factors, job.seed, job.attempt,
        worker.uid, result.outcome, result.digest
    from cell cross join cell_job on cell_job.cell_id = cell.id and cell_job.job_id > iif(cell.id = ?3, ?4, 0)
        cross join job on job.id = cell_job.job_id
        left join result on result.job_id = job.id
        left join claim on claim.id = coalesce(result.claim_id, job.claim_id)
        left join worker on worker.id = claim.worker_id
    where cell.id between max(?3, coalesce((select min(id) from cell where sweep_id = ?1), 0))
            and coalesce((select max(id) from cell where sweep_id = ?1), iif(?1 is null, 9223372036854775807, 0))
        and (?2 is null or job.state = ?2)
        and cell.sweep_id not in (select sweep_id from unlisted)
        and not exists (
            select 1 from json_each(?5) as wanted where not exists (
                select 1 from json_each(cell.factors) as label
                where label.key = wanted.key and label.value = wanted.value))
    order by cell.id, cell_job.job_id limit ?6 + 0";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[LIST];

#[derive(sqlx::FromRow)]
struct Row(i64, Vec<u8>, i64, i64, String, String, i64, i64, Option<String>, Option<String>, Option<Vec<u8>>);

/// A page of jobs.
pub(crate) async fn list(store: &Store, filter: &JobFilter) -> Result<JobPage, StoreError> {
    let limit = match filter.limit {
        0 => JobFilter::DEFAULT_LIMIT,
        limit => limit.min(JobFilter::MAX_LIMIT),
    };
    let after = filter.after.unwrap_or(JobCursor { cell: CellId(0), job: JobId(0) });
    let list = sqlx::query_as(LIST)
        .bind(filter.sweep.map(|sweep| sweep.0))
        .bind(filter.state.map(JobState::as_str))
        .bind(after.cell.0)
        .bind(after.job.0)
        .bind(to_json(&filter.factors))
        .bind(limit + 1);
    let rows: Vec<Row> = list.fetch_all(store.readers()).await?;
    let mut items = rows.into_iter().map(Row::read).collect::<Result<Vec<_>, _>>()?;
    let more = items.len() > limit as usize;
    items.truncate(limit as usize);
    let next = items.last().filter(|_| more).map(|item| JobCursor { cell: item.cell, job: item.id });
    Ok(JobPage { items, next })
}

impl Row {
    fn read(self) -> Result<JobItem, StoreError> {
        let Self(id, key, sweep, cell, state, factors, seed, attempt, worker, outcome, digest) = self;
        Ok(JobItem {
            id: JobId(id),
            key: JobKey(hash("a job's key", &key)?),
            sweep: SweepId(sweep),
            cell: CellId(cell),
            state: state_of(&state)?,
            factors: from_json("a cell's factors", &factors)?,
            seed: unsigned("a seed", seed)?,
            attempts: unsigned("an attempt", attempt)?,
            worker: worker.map(worker_id).transpose()?,
            outcome,
            digest: digest.map(|digest| hash("a digest", &digest).map(Digest)).transpose()?,
        })
    }
}

/// A stored state.
pub(crate) fn state_of(word: &str) -> Result<JobState, StoreError> {
    JobState::from_word(word).ok_or_else(|| StoreError::Damaged(format!("a job's state is `{word}`")))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use furrow_schema::sweep::NewSweep;

    use super::*;
    use crate::testing::{Bench, done, sweep};
    use crate::view::JobRef;

    async fn keys(bench: &Bench, filter: &JobFilter) -> Vec<(i64, u64)> {
        let page = bench.coordinator.jobs(filter).await.unwrap();
        page.items.iter().map(|item| (item.cell.0, item.seed)).collect()
    }

    #[tokio::test]
    async fn pages_follow_each_other_without_gap_or_repetition() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 3)).await;
        let id = bench.submit(sweep(&["rg", "rgop", "lsq"], 7)).await.id;
        let mut filter = JobFilter { sweep: Some(id), limit: 4, ..JobFilter::default() };
        let mut seen = Vec::new();
        loop {
            let page = bench.coordinator.jobs(&filter).await.unwrap();
            assert!(page.items.len() <= 4);
            seen.extend(page.items.iter().map(|item| (item.factors["algorithm"].clone(), item.seed)));
            let Some(next) = page.next else { break };
            filter.after = Some(next.to_string().parse().unwrap());
        }
        let expected: Vec<_> =
            ["rg", "rgop", "lsq"].iter().flat_map(|label| (1..=7).map(|seed| ((*label).to_owned(), seed))).collect();
        assert_eq!(seen, expected);
    }

    #[tokio::test]
    async fn filters_select_by_sweep_state_and_label() {
        let bench = Bench::new().await;
        let first = bench.submit(sweep(&["rgop", "rg"], 2)).await.id;
        bench.submit(NewSweep { priority: -1, ..sweep(&["lsq"], 2) }).await;
        let worker = bench.worker().await;
        let job = worker.claim(1).await.remove(0);
        worker.ended(&job, done(1.0)).await;

        let all = JobFilter::default();
        assert_eq!(keys(&bench, &all).await.len(), 6);
        assert_eq!(keys(&bench, &JobFilter { sweep: Some(first), ..all.clone() }).await.len(), 4);
        assert!(keys(&bench, &JobFilter { sweep: Some(SweepId(99)), ..all.clone() }).await.is_empty());
        assert_eq!(keys(&bench, &JobFilter { state: Some(JobState::Done), ..all.clone() }).await, [(1, 1)]);
        let label = |label: &str| BTreeMap::from([("algorithm".to_owned(), label.to_owned())]);
        assert_eq!(keys(&bench, &JobFilter { factors: label("rg"), ..all.clone() }).await, [(2, 1), (2, 2)]);
        assert!(keys(&bench, &JobFilter { factors: label("xyz"), ..all }).await.is_empty());
    }

    #[tokio::test]
    async fn a_line_shows_who_did_what() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 2)).await;
        let worker = bench.worker().await;
        let jobs = worker.claim(2).await;
        worker.ended(&jobs[0], done(-1.0)).await;
        let items = bench.coordinator.jobs(&JobFilter::default()).await.unwrap().items;
        assert_eq!((items[0].state, items[0].outcome.as_deref()), (JobState::Done, Some("lost")));
        assert!(items[0].digest.is_some() && items[1].digest.is_none());
        assert!(items.iter().all(|item| item.worker.as_ref() == Some(&worker.id) && item.attempts == 1));
    }

    #[tokio::test]
    async fn a_job_is_found_by_number_and_by_key() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let item = bench.coordinator.jobs(&JobFilter::default()).await.unwrap().items.remove(0);
        for text in [item.id.to_string(), item.key.to_string()] {
            let job = bench.coordinator.job(text.parse::<JobRef>().unwrap()).await.unwrap().unwrap();
            assert_eq!((job.id, job.key, job.state), (item.id, item.key, JobState::Queued));
            assert_eq!(job.scenario_json, r#"{"algorithm":"rgop"}"#);
            assert_eq!(job.cells[0].factors, item.factors);
        }
        assert_eq!(bench.coordinator.job(JobRef::Id(JobId(5))).await.unwrap(), None);
        assert!("x".parse::<JobRef>().is_err() && "1.x".parse::<JobCursor>().is_err());
    }

    #[tokio::test]
    async fn the_first_digits_of_a_key_find_its_job_unless_they_find_several() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 3)).await;
        for (id, key) in [(1, "ab12345600"), (2, "ab12345601"), (3, "0000000200")] {
            let key = key.to_owned() + &"7".repeat(54);
            sqlx::query("update job set key = unhex(?2) where id = ?1")
                .bind(id)
                .bind(key)
                .execute(bench.store.writer())
                .await
                .unwrap();
        }
        let find = |text: &str| {
            let job = text.parse::<JobRef>().unwrap();
            let coordinator = bench.coordinator.clone();
            async move { coordinator.job(job).await.map(|job| job.map(|job| job.id.0)) }
        };
        assert_eq!(find("AB12345601").await.unwrap(), Some(2));
        assert_eq!(find("ab123456007").await.unwrap(), Some(1));
        assert_eq!(find("ab123457").await.unwrap(), None);
        let error = find("ab123456").await.unwrap_err();
        assert_eq!(error.to_string(), "the keys of several jobs begin with `ab123456`: give more digits");
        assert_eq!(find("000000020").await.unwrap(), Some(3));
        assert_eq!(find("00000002").await.unwrap(), Some(2), "a number is a number, whatever keys begin so");
        assert!("ab12345".parse::<JobRef>().is_err());
    }
}
