//! Jobs in pages.

use furrow_schema::id::{CellId, Digest, JobId, JobKey, SweepId};
use furrow_schema::job::JobState;

use crate::error::StoreError;
use crate::store::worker::worker_id;
use crate::store::{Store, from_json, hash, to_json, unsigned};
use crate::view::{JobCursor, JobFilter, JobItem, JobPage};

pub(crate) use crate::store::job_detail::get;

/// Jobs by cell, then job, behind (?3, ?4): of sweep ?1 (its cells are neighbours), in state ?2, with labels ?5.
const LIST: &str = "select job.id, job.key, cell.sweep_id, cell.id, job.state, cell.factors, job.seed, job.attempt,
        worker.uid, result.outcome, result.digest
    from cell cross join cell_job on cell_job.cell_id = cell.id cross join job on job.id = cell_job.job_id
        left join result on result.job_id = job.id
        left join claim on claim.id = coalesce(result.claim_id, job.claim_id)
        left join worker on worker.id = claim.worker_id
    where cell.id between max(?3, coalesce((select min(id) from cell where sweep_id = ?1), 0))
            and coalesce((select max(id) from cell where sweep_id = ?1), iif(?1 is null, 9223372036854775807, 0))
        and (cell.id > ?3 or job.id > ?4)
        and (?2 is null or job.state = ?2)
        and not exists (
            select 1 from json_each(?5) as wanted where not exists (
                select 1 from json_each(cell.factors) as label
                where label.key = wanted.key and label.value = wanted.value))
    order by cell.id, cell_job.job_id limit ?6";

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
