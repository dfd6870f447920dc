//! Submissions: a sweep is expanded into jobs, a chunk at a time, in one transaction.
//!
//! A job that is known already is shared: with a result it counts at once, queued or leased it keeps its place
//! or moves up, failed or cancelled it is queued again.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use furrow_schema::id::{CellId, EngineId, JobId, JobKey, ScenarioHash, ScenarioId, SweepId};
use furrow_schema::job::JobState;
use furrow_schema::sweep::{NewCell, NewSweep, Submitted};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::job::state_of;
use crate::store::tally::{Metrics, Moved, Tally};
use crate::store::{from_json, scenario, to_json, unsigned};

/// Jobs are written in chunks of this size, so that memory does not grow with the sweep.
const CHUNK: usize = 2_000;
/// A sweep has at most this many jobs.
const MAX_JOBS: u64 = 20_000_000;
const MAX_NAME_BYTES: usize = 200;

/// The submission that a key stands for.
const FIND_BY_KEY: &str = "select id, total, new, cached, request_json from sweep where idempotency_key = ?1";

/// A sweep without jobs yet; the counts follow with them.
const ADD_SWEEP: &str = "insert into sweep
        (name, plan, request_json, engine_id, state, priority, record, timing, seeds, factors, idempotency_key, created_ms)
    values (?1, ?2, ?3, ?4, 'active', ?5, ?6, ?7, ?8, ?9, ?10, ?11)
    returning id";

/// Cells of sweep ?2: position, factors.
const ADD_CELLS: &str = "insert into cell (sweep_id, position, factors)
    select ?2, value ->> 0, value -> 1 from json_each(?1)";

/// The cells of a sweep in their order.
const CELLS: &str = "select id from cell where sweep_id = ?1 order by position";

/// Where the queue of a priority has got to.
const VIRTUAL_TIME: &str = "select coalesce((select turn from virtual_time where priority = ?1), 0)";

/// Which of the keys are jobs already, by the key's place in the list.
const EXISTING: &str = "select wanted.key, job.id, job.state
    from json_each(?1) as wanted join job on job.key = unhex(wanted.value)";

/// New jobs: key, scenario, seed, turn.
const ADD_JOBS: &str = "insert into job
        (key, engine_id, scenario_id, seed, state, priority, turn, record, alone, created_ms)
    select unhex(value ->> 0), ?2, value ->> 1, value ->> 2, 'queued', ?3, value ->> 3, ?4, ?5, ?6
    from json_each(?1) where true
    on conflict (key) do nothing";

/// Failed and cancelled jobs start anew: job, turn.
const REVIVE: &str = "update job
    set state = 'queued', ended_ms = null, not_before_ms = 0, panics = 0, deaths = 0,
        priority = ?2, turn = value ->> 1, record = max(record, ?3)
    from json_each(?1) where job.id = value ->> 0";

/// Jobs that wait or run move up as far as the new sweep would place them: job, turn.
const RAISE: &str = "update job
    set priority = max(priority, ?2), record = max(record, ?3),
        turn = case when priority < ?2 then value ->> 1
                    when priority = ?2 then min(turn, value ->> 1) else turn end
    from json_each(?1) where job.id = value ->> 0";

/// Which cell wants which job: cell, key.
const JOIN_CELLS: &str = "insert into cell_job (cell_id, job_id)
    select value ->> 0, job.id from json_each(?1) join job on job.key = unhex(value ->> 1)";

/// Metrics of results on record.
const CACHED: &str = "select job_id, metrics from result where job_id in (select value from json_each(?1))";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] =
    &[FIND_BY_KEY, ADD_SWEEP, ADD_CELLS, CELLS, VIRTUAL_TIME, EXISTING, ADD_JOBS, REVIVE, RAISE, JOIN_CELLS, CACHED];

/// Refuses a sweep that breaks a rule, before it meets the queue.
pub(crate) fn check(sweep: &NewSweep, coordinator: EngineId) -> Result<(), StoreError> {
    if sweep.engine != coordinator {
        return Err(StoreError::OtherEngine { coordinator, sweep: sweep.engine });
    }
    let invalid = |text: String| Err(StoreError::Invalid(text));
    if sweep.name.len() > MAX_NAME_BYTES || sweep.plan.len() > MAX_NAME_BYTES {
        return invalid(format!("`name` or `plan` is longer than {MAX_NAME_BYTES} bytes"));
    }
    if sweep.idempotency_key.as_ref().is_some_and(|key| key.is_empty() || key.len() > MAX_NAME_BYTES) {
        return invalid(format!("the idempotency key is empty or longer than {MAX_NAME_BYTES} bytes"));
    }
    check_cells(sweep).or_else(invalid)
}

fn check_cells(sweep: &NewSweep) -> Result<(), String> {
    let scenarios: u64 = sweep.cells.iter().map(|cell| cell.scenarios.len() as u64).sum();
    let jobs = scenarios.saturating_mul(sweep.seeds);
    if !(1..=MAX_JOBS).contains(&jobs) {
        return Err(format!("the sweep has {jobs} jobs; 1 to {MAX_JOBS} are possible"));
    }
    let mut labels = HashSet::new();
    for cell in &sweep.cells {
        if cell.scenarios.is_empty() {
            return Err(format!("the cell {:?} has no scenario", cell.factors));
        }
        if cell.factors.len() != sweep.factors.len() || sweep.factors.iter().any(|f| !cell.factors.contains_key(f)) {
            return Err(format!("the cell {:?} does not have the factors {:?}", cell.factors, sweep.factors));
        }
        if !labels.insert(&cell.factors) {
            return Err(format!("the cell {:?} is there twice", cell.factors));
        }
    }
    Ok(())
}

/// Takes a checked sweep in. A refusal leaves the database as it was.
pub(crate) async fn submit(
    conn: &mut SqliteConnection,
    sweep: &NewSweep,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<Submitted, StoreError>, StoreError> {
    if let Some(key) = &sweep.idempotency_key
        && let Some(earlier) = earlier(conn, key, &sweep.request_json).await?
    {
        return Ok(earlier);
    }
    let mut expansion = Expansion::begin(conn, sweep, engine_id, now_ms).await?;
    expansion.run(conn).await?;
    Ok(Ok(expansion.submitted))
}

async fn earlier(
    conn: &mut SqliteConnection,
    key: &str,
    request_json: &str,
) -> Result<Option<Result<Submitted, StoreError>>, StoreError> {
    let row: Option<(i64, i64, i64, i64, String)> = sqlx::query_as(FIND_BY_KEY).bind(key).fetch_optional(conn).await?;
    let Some((id, total, new, cached, earlier_json)) = row else { return Ok(None) };
    if earlier_json != request_json {
        return Ok(Some(Err(StoreError::Conflict { key: key.to_owned() })));
    }
    let count = |number| unsigned("a sweep's count", number);
    Ok(Some(Ok(Submitted { id: SweepId(id), total: count(total)?, new: count(new)?, cached: count(cached)? })))
}

/// A job that the sweep wants.
struct Planned {
    cell: CellId,
    scenario: ScenarioHash,
    seed: u64,
    key: JobKey,
    turn: i64,
}

/// A sweep on its way into the database.
struct Expansion<'a> {
    sweep: &'a NewSweep,
    engine_id: i64,
    now_ms: i64,
    submitted: Submitted,
    cells: Vec<CellId>,
    next_turn: i64,
    /// The scenarios of the chunk in the order of their jobs.
    texts: Vec<(ScenarioHash, Arc<str>)>,
    chunk: Vec<Planned>,
}

impl<'a> Expansion<'a> {
    async fn begin(
        conn: &mut SqliteConnection,
        sweep: &'a NewSweep,
        engine_id: i64,
        now_ms: i64,
    ) -> Result<Self, StoreError> {
        let id = add_sweep(conn, sweep, engine_id, now_ms).await?;
        let cells = add_cells(conn, id, &sweep.cells).await?;
        let next_turn = sqlx::query_scalar(VIRTUAL_TIME).bind(sweep.priority).fetch_one(conn).await?;
        let submitted = Submitted { id, total: 0, new: 0, cached: 0 };
        let (texts, chunk) = (Vec::new(), Vec::with_capacity(CHUNK));
        Ok(Self { sweep, engine_id, now_ms, submitted, cells, next_turn, texts, chunk })
    }

    /// Cell by cell, scenario by scenario, seed by seed.
    async fn run(&mut self, conn: &mut SqliteConnection) -> Result<(), StoreError> {
        let timing = self.sweep.timing.then_some(self.submitted.id);
        for (at, cell) in self.sweep.cells.iter().enumerate() {
            let mut seen = HashSet::new();
            for text in &cell.scenarios {
                let scenario = ScenarioHash::of(text);
                if !seen.insert(scenario) {
                    continue;
                }
                for seed in 1..=self.sweep.seeds {
                    if self.texts.last().is_none_or(|(last, _)| *last != scenario) {
                        self.texts.push((scenario, text.clone()));
                    }
                    let key = JobKey::new(self.sweep.engine, text, seed, timing);
                    self.chunk.push(Planned { cell: self.cells[at], scenario, seed, key, turn: self.next_turn });
                    self.next_turn += 1;
                    if self.chunk.len() == CHUNK {
                        self.write_chunk(conn).await?;
                    }
                }
            }
        }
        self.write_chunk(conn).await
    }

    async fn write_chunk(&mut self, conn: &mut SqliteConnection) -> Result<(), StoreError> {
        if self.chunk.is_empty() {
            return Ok(());
        }
        let scenarios = scenario::intern(conn, &self.texts).await?;
        let mut tally = Tally::default();
        let existing = self.existing(conn).await?;
        self.revive(conn, &existing, &mut tally).await?;
        self.raise(conn, &existing).await?;
        let new = self.add_jobs(conn, &existing, &scenarios).await?;
        let memberships: Vec<_> = self.chunk.iter().map(|planned| (planned.cell, planned.key)).collect();
        sqlx::query(JOIN_CELLS).bind(to_json(&memberships)).execute(&mut *conn).await?;
        self.count(conn, &existing, &mut tally, new).await?;
        tally.write(conn, self.now_ms).await?;
        self.chunk.clear();
        self.texts.clear();
        Ok(())
    }

    /// Jobs of the chunk that are known, by place.
    async fn existing(&self, conn: &mut SqliteConnection) -> Result<HashMap<usize, (JobId, JobState)>, StoreError> {
        let keys: Vec<_> = self.chunk.iter().map(|planned| planned.key).collect();
        let rows: Vec<(i64, i64, String)> = sqlx::query_as(EXISTING).bind(to_json(&keys)).fetch_all(conn).await?;
        let entry =
            |(at, id, state): (i64, i64, String)| Ok((unsigned("a place", at)?, (JobId(id), state_of(&state)?)));
        rows.into_iter().map(entry).collect()
    }

    async fn revive(
        &self,
        conn: &mut SqliteConnection,
        existing: &HashMap<usize, (JobId, JobState)>,
        tally: &mut Tally,
    ) -> Result<(), StoreError> {
        let mut moved = HashMap::new();
        for (at, (job, state)) in existing {
            if matches!(state, JobState::Failed | JobState::Cancelled) {
                let change = Moved { job: *job, from: *state, to: JobState::Queued, metrics: None };
                moved.insert(*job, (change, self.chunk[*at].turn));
            }
        }
        self.place(conn, REVIVE, moved.iter().map(|(job, (_, turn))| (*job, *turn)).collect()).await?;
        let moved: Vec<_> = moved.into_values().map(|(change, _)| change).collect();
        tally.moved(conn, &moved).await
    }

    async fn raise(
        &self,
        conn: &mut SqliteConnection,
        existing: &HashMap<usize, (JobId, JobState)>,
    ) -> Result<(), StoreError> {
        let waiting = existing.iter().filter(|(_, (_, state))| matches!(state, JobState::Queued | JobState::Leased));
        self.place(conn, RAISE, waiting.map(|(at, (job, _))| (*job, self.chunk[*at].turn)).collect()).await
    }

    async fn place(
        &self,
        conn: &mut SqliteConnection,
        statement: &'static str,
        jobs: Vec<(JobId, i64)>,
    ) -> Result<(), StoreError> {
        if !jobs.is_empty() {
            let NewSweep { priority, record, .. } = self.sweep;
            sqlx::query(statement).bind(to_json(&jobs)).bind(priority).bind(record).execute(conn).await?;
        }
        Ok(())
    }

    async fn add_jobs(
        &self,
        conn: &mut SqliteConnection,
        existing: &HashMap<usize, (JobId, JobState)>,
        scenarios: &HashMap<ScenarioHash, ScenarioId>,
    ) -> Result<u64, StoreError> {
        let new = self.chunk.iter().enumerate().filter(|(at, _)| !existing.contains_key(at));
        let rows: Vec<_> = new.map(|(_, job)| (job.key, scenarios.get(&job.scenario), job.seed, job.turn)).collect();
        if rows.is_empty() {
            return Ok(0);
        }
        let NewSweep { priority, record, timing, .. } = self.sweep;
        let add = sqlx::query(ADD_JOBS).bind(to_json(&rows)).bind(self.engine_id).bind(priority);
        Ok(add.bind(record).bind(timing).bind(self.now_ms).execute(conn).await?.rows_affected())
    }

    async fn count(
        &mut self,
        conn: &mut SqliteConnection,
        existing: &HashMap<usize, (JobId, JobState)>,
        tally: &mut Tally,
        new: u64,
    ) -> Result<(), StoreError> {
        let done: Vec<_> =
            existing.values().filter(|(_, state)| *state == JobState::Done).map(|(job, _)| job).collect();
        let cached = if done.is_empty() { HashMap::new() } else { cached(conn, &to_json(&done)).await? };
        let id = self.submitted.id;
        for (at, planned) in self.chunk.iter().enumerate() {
            let metrics = existing.get(&at).and_then(|(job, _)| cached.get(job));
            tally.joined(planned.cell, id, metrics);
            self.submitted.total += 1;
            self.submitted.cached += u64::from(metrics.is_some());
        }
        self.submitted.new += new;
        tally.sweep(id).new += i64::try_from(new).unwrap_or(i64::MAX);
        Ok(())
    }
}

async fn add_sweep(
    conn: &mut SqliteConnection,
    sweep: &NewSweep,
    engine_id: i64,
    now_ms: i64,
) -> Result<SweepId, StoreError> {
    let seeds = i64::try_from(sweep.seeds).map_err(|_| StoreError::Invalid("too many `seeds`".to_owned()))?;
    let add = sqlx::query_scalar(ADD_SWEEP)
        .bind(&sweep.name)
        .bind(&sweep.plan)
        .bind(&sweep.request_json)
        .bind(engine_id)
        .bind(sweep.priority)
        .bind(sweep.record)
        .bind(sweep.timing)
        .bind(seeds)
        .bind(to_json(&sweep.factors))
        .bind(&sweep.idempotency_key)
        .bind(now_ms);
    Ok(SweepId(add.fetch_one(conn).await?))
}

async fn add_cells(conn: &mut SqliteConnection, sweep: SweepId, cells: &[NewCell]) -> Result<Vec<CellId>, StoreError> {
    let placed: Vec<_> = cells.iter().enumerate().map(|(at, cell)| (at, &cell.factors)).collect();
    for chunk in placed.chunks(CHUNK) {
        sqlx::query(ADD_CELLS).bind(to_json(&chunk)).bind(sweep.0).execute(&mut *conn).await?;
    }
    let ids: Vec<i64> = sqlx::query_scalar(CELLS).bind(sweep.0).fetch_all(conn).await?;
    Ok(ids.into_iter().map(CellId).collect())
}

async fn cached(conn: &mut SqliteConnection, jobs: &str) -> Result<HashMap<JobId, Metrics>, StoreError> {
    let rows: Vec<(i64, String)> = sqlx::query_as(CACHED).bind(jobs).fetch_all(conn).await?;
    rows.into_iter().map(|(job, metrics)| Ok((JobId(job), from_json("a result's metrics", &metrics)?))).collect()
}

#[cfg(test)]
mod tests;
