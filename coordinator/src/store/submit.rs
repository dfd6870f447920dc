//! Submissions: a sweep is expanded into jobs, a chunk at a time.
//!
//! A small sweep comes in one transaction. A large one takes a transaction a chunk, so that workers are served in
//! between; until the last it is unlisted: nobody sees it, and if it breaks off it is removed. Its first jobs may run
//! meanwhile.
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
use crate::store::removal::UNLIST;
use crate::store::rows::{self, ByRows, by_rows};
use crate::store::settle::{Turns, settle};
use crate::store::tally::{Metrics, Tally};
use crate::store::{from_json, scenario, to_json, unsigned};

/// Jobs are written in chunks of this size, so that memory does not grow with the sweep.
const CHUNK: usize = 2_000;
/// A sweep has at most this many jobs.
const MAX_JOBS: u64 = 20_000_000;
const MAX_NAME_BYTES: usize = 200;

/// The submission that a key stands for.
const FIND_BY_KEY: &str = "select id, total, new, cached, request_json from sweep
    where idempotency_key = ?1 and id not in (select sweep_id from unlisted)";

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

/// Everybody sees the sweep from now on.
const LIST: &str = "delete from unlisted where sweep_id = ?1";

/// Which of the keys are jobs already, by the key's place in the list.
const EXISTING: &str = "select wanted.key, job.id, job.state
    from json_each(?1) as wanted join job on job.key = unhex(wanted.value)";

/// The next number for a job: no number is given twice.
const NEXT_JOB: &str = "select max(job, coalesce((select max(id) from job), 0)) + 1 from last_number";

/// New jobs.
const ADD_JOBS: ByRows = by_rows!(
    "insert into job (id, key, engine_id, scenario_id, seed, state, priority, turn, record, alone, created_ms) values ",
    "(?, ?, ?, ?, ?, 'queued', ?, ?, ?, ?, ?)",
    ""
);

/// Jobs whose trajectory is wanted, too.
const RECORD: &str = "update job set record = 1 where id in (select value from json_each(?1)) and record = 0";

/// Which cell wants which job.
const JOIN_CELLS: ByRows = by_rows!("insert into cell_job (cell_id, job_id) values ", "(?, ?)", "");

/// Metrics of results on record.
const CACHED: &str = "select job_id, metrics from result where job_id in (select value from json_each(?1))";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] =
    &[FIND_BY_KEY, ADD_SWEEP, ADD_CELLS, CELLS, LIST, EXISTING, NEXT_JOB, RECORD, CACHED];

#[cfg(test)]
pub(super) const BY_ROWS: &[ByRows] = &[ADD_JOBS, JOIN_CELLS];

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

/// Whether a sweep comes in one transaction.
pub(crate) fn is_small(sweep: &NewSweep) -> bool {
    let scenarios: u64 = sweep.cells.iter().map(|cell| cell.scenarios.len() as u64).sum();
    scenarios.saturating_mul(sweep.seeds) <= CHUNK as u64
}

/// Takes a checked sweep in. A refusal leaves the database as it was.
pub(crate) async fn submit(
    conn: &mut SqliteConnection,
    sweep: &NewSweep,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<Submitted, StoreError>, StoreError> {
    if let Some(answer) = earlier(conn, sweep).await? {
        return Ok(answer);
    }
    let mut expansion = Expansion::begin(conn, sweep, engine_id, now_ms).await?;
    while !expansion.step(conn, sweep).await? {}
    Ok(Ok(expansion.submitted))
}

/// Begins to take a checked sweep in, out of sight: [`Expansion::step`] and at last [`Expansion::list`] are to follow.
/// An answer instead of an expansion ends it.
pub(crate) async fn begin(
    conn: &mut SqliteConnection,
    sweep: &NewSweep,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<Expansion, Result<Submitted, StoreError>>, StoreError> {
    if let Some(answer) = earlier(conn, sweep).await? {
        return Ok(Err(answer));
    }
    let expansion = Expansion::begin(conn, sweep, engine_id, now_ms).await?;
    sqlx::query(UNLIST).bind(expansion.submitted.id.0).execute(conn).await?;
    Ok(Ok(expansion))
}

/// What was answered to the same submission before, if it has a key.
async fn earlier(
    conn: &mut SqliteConnection,
    sweep: &NewSweep,
) -> Result<Option<Result<Submitted, StoreError>>, StoreError> {
    let Some(key) = &sweep.idempotency_key else { return Ok(None) };
    let row: Option<(i64, i64, i64, i64, String)> = sqlx::query_as(FIND_BY_KEY).bind(key).fetch_optional(conn).await?;
    let Some((id, total, new, cached, earlier_json)) = row else { return Ok(None) };
    if earlier_json != sweep.request_json {
        return Ok(Some(Err(StoreError::Conflict { key: key.clone() })));
    }
    let count = |number| unsigned("a sweep's count", number);
    Ok(Some(Ok(Submitted { id: SweepId(id), total: count(total)?, new: count(new)?, cached: count(cached)? })))
}

/// A job that the sweep wants.
#[derive(Debug)]
struct Planned {
    cell: CellId,
    scenario: ScenarioHash,
    seed: u64,
    key: JobKey,
    turn: i64,
}

/// Jobs that are known already, by their place in the chunk.
type Existing = HashMap<usize, (JobId, JobState)>;

/// Where an expansion is: cell by cell, scenario by scenario, seed by seed.
#[derive(Debug, Default)]
struct Position {
    cell: usize,
    scenario: usize,
    /// Seeds of the scenario that are planned.
    seeds: u64,
    /// Scenarios of the cell so far: a repeated one counts once.
    seen: HashSet<ScenarioHash>,
}

/// A sweep on its way into the database.
#[derive(Debug)]
pub(crate) struct Expansion {
    engine_id: i64,
    now_ms: i64,
    pub(crate) submitted: Submitted,
    cells: Vec<CellId>,
    turns: Turns,
    at: Position,
    /// The scenarios of the chunk in the order of their jobs.
    texts: Vec<(ScenarioHash, Arc<str>)>,
    chunk: Vec<Planned>,
}

impl Expansion {
    async fn begin(
        conn: &mut SqliteConnection,
        sweep: &NewSweep,
        engine_id: i64,
        now_ms: i64,
    ) -> Result<Self, StoreError> {
        let id = add_sweep(conn, sweep, engine_id, now_ms).await?;
        let cells = add_cells(conn, id, &sweep.cells).await?;
        Ok(Self {
            engine_id,
            now_ms,
            submitted: Submitted { id, total: 0, new: 0, cached: 0 },
            cells,
            turns: Turns::load(conn, 0).await?,
            at: Position::default(),
            texts: Vec::new(),
            chunk: Vec::with_capacity(CHUNK),
        })
    }

    /// Writes the next chunk of `sweep`; true if it was the last.
    pub(crate) async fn step(&mut self, conn: &mut SqliteConnection, sweep: &NewSweep) -> Result<bool, StoreError> {
        self.plan_chunk(sweep);
        if !self.chunk.is_empty() {
            self.write_chunk(conn, sweep).await?;
        }
        Ok(self.at.cell == sweep.cells.len())
    }

    /// Lets everybody see the sweep.
    pub(crate) async fn list(&self, conn: &mut SqliteConnection) -> Result<(), StoreError> {
        sqlx::query(LIST).bind(self.submitted.id.0).execute(conn).await?;
        Ok(())
    }

    fn plan_chunk(&mut self, sweep: &NewSweep) {
        while let Some(cell) = sweep.cells.get(self.at.cell) {
            let Some(text) = cell.scenarios.get(self.at.scenario) else {
                self.at = Position { cell: self.at.cell + 1, ..Position::default() };
                continue;
            };
            let exhausted = self.at.seeds == sweep.seeds;
            if !exhausted && self.chunk.len() == CHUNK {
                return;
            }
            let scenario = ScenarioHash::of(text);
            if exhausted || (self.at.seeds == 0 && !self.at.seen.insert(scenario)) {
                (self.at.scenario, self.at.seeds) = (self.at.scenario + 1, 0);
            } else {
                self.plan_seeds(sweep, scenario, text);
            }
        }
    }

    /// Plans seeds of one scenario, as many as fit.
    fn plan_seeds(&mut self, sweep: &NewSweep, scenario: ScenarioHash, text: &Arc<str>) {
        let timing = sweep.timing.then_some(self.submitted.id);
        self.texts.push((scenario, text.clone()));
        while self.at.seeds < sweep.seeds && self.chunk.len() < CHUNK {
            self.at.seeds += 1;
            let seed = self.at.seeds;
            let key = JobKey::new(sweep.engine, text, seed, timing);
            let turn = self.turns.take(sweep.priority);
            self.chunk.push(Planned { cell: self.cells[self.at.cell], scenario, seed, key, turn });
        }
    }

    async fn write_chunk(&mut self, conn: &mut SqliteConnection, sweep: &NewSweep) -> Result<(), StoreError> {
        let scenarios = scenario::intern(conn, &self.texts).await?;
        let mut tally = Tally::default();
        let existing = self.existing(conn).await?;
        let (new, memberships) = self.number(conn, &existing).await?;
        self.add_jobs(conn, sweep, &new, &scenarios).await?;
        rows::write(conn, &JOIN_CELLS, &memberships, |join, (cell, job)| join.bind(cell.0).bind(job.0)).await?;
        let new = new.len() as u64;
        self.count(conn, &existing, &mut tally, new).await?;
        self.share(conn, sweep, &existing, &mut tally).await?;
        tally.write(conn, self.now_ms).await?;
        self.chunk.clear();
        self.texts.clear();
        Ok(())
    }

    /// Jobs of the chunk that are known, by place.
    async fn existing(&self, conn: &mut SqliteConnection) -> Result<Existing, StoreError> {
        let keys: Vec<_> = self.chunk.iter().map(|planned| planned.key).collect();
        let rows: Vec<(i64, i64, String)> = sqlx::query_as(EXISTING).bind(to_json(&keys)).fetch_all(conn).await?;
        let entry =
            |(at, id, state): (i64, i64, String)| Ok((unsigned("a place", at)?, (JobId(id), state_of(&state)?)));
        rows.into_iter().map(entry).collect()
    }

    /// Gives the new jobs of the chunk their numbers, and says which cell wants which job.
    async fn number(
        &self,
        conn: &mut SqliteConnection,
        existing: &Existing,
    ) -> Result<(Vec<(JobId, &Planned)>, Vec<(CellId, JobId)>), StoreError> {
        let next: i64 = sqlx::query_scalar(NEXT_JOB).fetch_one(conn).await?;
        let (mut new, mut numbers) = (Vec::new(), HashMap::new());
        let mut memberships = Vec::with_capacity(self.chunk.len());
        for (at, planned) in self.chunk.iter().enumerate() {
            let known = existing.get(&at).map(|(job, _)| *job).or_else(|| numbers.get(&planned.key).copied());
            let job = known.unwrap_or_else(|| {
                let job = JobId(next + numbers.len() as i64);
                numbers.insert(planned.key, job);
                new.push((job, planned));
                job
            });
            memberships.push((planned.cell, job));
        }
        Ok((new, memberships))
    }

    async fn add_jobs(
        &self,
        conn: &mut SqliteConnection,
        sweep: &NewSweep,
        new: &[(JobId, &Planned)],
        scenarios: &HashMap<ScenarioHash, ScenarioId>,
    ) -> Result<(), StoreError> {
        let NewSweep { priority, record, timing, .. } = sweep;
        rows::write(conn, &ADD_JOBS, new, |add, (id, Planned { scenario, seed, key, turn, .. })| {
            let scenario = scenarios.get(scenario).map(|id| id.0);
            let add = add.bind(id.0).bind(key.0.as_slice()).bind(self.engine_id).bind(scenario).bind(*seed as i64);
            add.bind(priority).bind(turn).bind(record).bind(timing).bind(self.now_ms)
        })
        .await
    }

    async fn count(
        &mut self,
        conn: &mut SqliteConnection,
        existing: &Existing,
        tally: &mut Tally,
        new: u64,
    ) -> Result<(), StoreError> {
        let done: Vec<_> =
            existing.values().filter(|(_, state)| *state == JobState::Done).map(|(job, _)| job).collect();
        let cached = if done.is_empty() { HashMap::new() } else { cached(conn, &to_json(&done)).await? };
        let id = self.submitted.id;
        for (at, planned) in self.chunk.iter().enumerate() {
            let (job, state) = existing.get(&at).map_or((None, JobState::Queued), |(job, state)| (Some(job), *state));
            let metrics = job.and_then(|job| cached.get(job));
            tally.joined(planned.cell, id, state, metrics);
            self.submitted.total += 1;
            self.submitted.cached += u64::from(metrics.is_some());
        }
        self.submitted.new += new;
        tally.sweep(id).new += i64::try_from(new).unwrap_or(i64::MAX);
        Ok(())
    }

    /// Brings the known jobs in line with one more sweep that wants them.
    async fn share(
        &mut self,
        conn: &mut SqliteConnection,
        sweep: &NewSweep,
        existing: &Existing,
        tally: &mut Tally,
    ) -> Result<(), StoreError> {
        let mut places: Vec<_> = existing.iter().filter(|(_, (_, state))| *state != JobState::Done).collect();
        places.sort_unstable_by_key(|(at, _)| **at);
        let jobs: Vec<JobId> = places.into_iter().map(|(_, (job, _))| *job).collect();
        let ahead = self.turns.ahead;
        self.turns.ahead -= i64::try_from(self.chunk.len()).unwrap_or(0);
        settle(conn, &jobs, true, &mut self.turns, self.engine_id, self.now_ms, tally).await?;
        self.turns.ahead = ahead;
        if sweep.record && !jobs.is_empty() {
            sqlx::query(RECORD).bind(to_json(&jobs)).execute(conn).await?;
        }
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
