//! Sweeps as users see them.

use furrow_schema::id::{EngineId, SweepId};
use furrow_schema::sweep::{Sweep, SweepState};

use crate::error::StoreError;
use crate::store::{Store, from_json, hash, unsigned};

/// One sweep (?1), or the latest below ?2, of those that are seen. Disputed results are few and a sweep's jobs many: the
/// cross joins begin with the few.
const SELECT: &str = "with held as materialized (
        select cell.sweep_id, count(*) as jobs
        from job join cell_job on cell_job.job_id = job.id join cell on cell.id = cell_job.cell_id
        where job.state = 'leased' group by cell.sweep_id)
    select sweep.id, name, plan, state, priority, total, done, failed, cancelled, cached, coalesce(held.jobs, 0) as leased,
        (select count(*) from verification
            cross join cell_job on cell_job.job_id = verification.job_id cross join cell on cell.id = cell_job.cell_id
            where verification.state in ('overruled', 'undecided') and cell.sweep_id = sweep.id) as disputed,
        engine.hash as engine, seeds, factors, record, timing, created_ms, finished_ms
    from sweep join engine on engine.id = sweep.engine_id left join held on held.sweep_id = sweep.id
    where (?1 is null or sweep.id = ?1) and (?2 is null or sweep.id < ?2)
        and sweep.id not in (select sweep_id from unlisted)
    order by sweep.id desc limit ?3 + 0";

const REQUEST: &str = "select request_json from sweep where id = ?1 and id not in (select sweep_id from unlisted)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[SELECT, REQUEST];

#[derive(sqlx::FromRow)]
struct Row {
    id: i64,
    name: String,
    plan: String,
    state: String,
    priority: i64,
    total: i64,
    done: i64,
    failed: i64,
    cancelled: i64,
    cached: i64,
    leased: i64,
    disputed: i64,
    engine: Vec<u8>,
    seeds: i64,
    factors: String,
    record: bool,
    timing: bool,
    created_ms: i64,
    finished_ms: Option<i64>,
}

/// One sweep, without its rate.
pub(crate) async fn get(store: &Store, id: SweepId) -> Result<Option<Sweep>, StoreError> {
    Ok(select(store, Some(id), None, 1).await?.pop())
}

/// What was asked for, as JSON.
pub(crate) async fn request(store: &Store, id: SweepId) -> Result<Option<String>, StoreError> {
    Ok(sqlx::query_scalar(REQUEST).bind(id.0).fetch_optional(store.readers()).await?)
}

/// Sweeps older than `after`, newest first, without their rates.
pub(crate) async fn list(store: &Store, after: Option<SweepId>, limit: u32) -> Result<Vec<Sweep>, StoreError> {
    select(store, None, after, limit).await
}

async fn select(
    store: &Store,
    id: Option<SweepId>,
    below: Option<SweepId>,
    limit: u32,
) -> Result<Vec<Sweep>, StoreError> {
    let select = sqlx::query_as(SELECT).bind(id.map(|id| id.0)).bind(below.map(|id| id.0)).bind(limit);
    let rows: Vec<Row> = select.fetch_all(store.readers()).await?;
    rows.into_iter().map(Row::read).collect()
}

impl Row {
    fn read(self) -> Result<Sweep, StoreError> {
        let count = |number| unsigned::<u64>("a sweep's count", number);
        let ended = self.done + self.failed + self.cancelled;
        Ok(Sweep {
            id: SweepId(self.id),
            name: self.name,
            plan: self.plan,
            state: state(&self.state)?,
            priority: self.priority,
            total: count(self.total)?,
            done: count(self.done)?,
            failed: count(self.failed)?,
            queued: count(self.total - ended - self.leased)?,
            leased: count(self.leased)?,
            cancelled: count(self.cancelled)?,
            cached: count(self.cached)?,
            disputed: count(self.disputed)?,
            rate_per_s: None,
            eta_s: None,
            engine: EngineId(hash("an engine", &self.engine)?),
            seeds: count(self.seeds)?,
            factors: from_json("a sweep's factors", &self.factors)?,
            record: self.record,
            timing: self.timing,
            created_ms: self.created_ms,
            finished_ms: self.finished_ms,
        })
    }
}

/// A stored state.
pub(crate) fn state(word: &str) -> Result<SweepState, StoreError> {
    match word {
        "active" => Ok(SweepState::Active),
        "paused" => Ok(SweepState::Paused),
        "done" => Ok(SweepState::Done),
        "cancelled" => Ok(SweepState::Cancelled),
        other => Err(StoreError::Damaged(format!("a sweep's state is `{other}`"))),
    }
}
