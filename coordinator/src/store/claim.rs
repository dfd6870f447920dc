//! Claims: which jobs a worker gets next.
//!
//! By priority, then fair between sweeps: a job's turn is its place within its sweep, counted on from where its
//! priority's queue stood when the sweep came, so that sweeps of equal priority take turns.

use std::collections::BTreeMap;

use furrow_schema::id::{JobId, RequestId, ScenarioId};
use furrow_schema::protocol::{Claim, LEASE_MS, LeasedJob, Leases};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{scenario, to_json, unsigned};

/// A worker that found nothing asks again after this long [ms].
const RETRY_AFTER_MS: u64 = 250;

/// An earlier claim of the same request.
const FIND: &str = "select id from claim where worker_id = ?1 and request = ?2";

/// A claim, if there is anything to grant.
const ADD: &str = "insert into claim (worker_id, request, claimed_ms)
    select ?1, ?2, ?3
    where exists (select 1 from job where state = 'queued' and engine_id = ?4 and not_before_ms <= ?3)
    returning id";

/// Hands out the first of the queue to claim ?1 until ?2.
const TAKE: &str = "update job
    set state = 'leased', attempt = attempt + 1, claim_id = ?1, lease_until_ms = ?2, running = 0
    where id in (
        select id from job where state = 'queued' and engine_id = ?3 and not_before_ms <= ?4
        order by priority desc, turn limit ?5)
    returning id, attempt, scenario_id, seed, record, alone, priority, turn";

/// What a claim still holds.
const HELD: &str = "select id, attempt, scenario_id, seed, record, alone, priority, turn
    from job where state = 'leased' and claim_id = ?1";

/// How far the queues of priorities have got: priority, turn.
const ADVANCE: &str = "insert into virtual_time (priority, turn)
    select value ->> 0, value ->> 1 from json_each(?1) where true
    on conflict (priority) do update set turn = max(turn, excluded.turn)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[FIND, ADD, TAKE, HELD, ADVANCE];

#[derive(sqlx::FromRow)]
struct Row(i64, i64, i64, i64, bool, bool, i64, i64);

/// Grants a claim of `worker`, or repeats what was granted for the same request.
pub(crate) async fn claim(
    conn: &mut SqliteConnection,
    worker: i64,
    request: &RequestId,
    claim: &Claim,
    engine_id: i64,
    now_ms: i64,
) -> Result<Leases, StoreError> {
    let earlier: Option<i64> =
        sqlx::query_scalar(FIND).bind(worker).bind(request.as_str()).fetch_optional(&mut *conn).await?;
    let rows = match earlier {
        Some(id) => sqlx::query_as(HELD).bind(id).fetch_all(&mut *conn).await?,
        None => take(conn, worker, request, claim.want, engine_id, now_ms).await?,
    };
    leases(conn, rows, &claim.known_scenarios).await
}

async fn take(
    conn: &mut SqliteConnection,
    worker: i64,
    request: &RequestId,
    want: u32,
    engine_id: i64,
    now_ms: i64,
) -> Result<Vec<Row>, StoreError> {
    let add = sqlx::query_scalar(ADD).bind(worker).bind(request.as_str()).bind(now_ms).bind(engine_id);
    let Some(id): Option<i64> = add.fetch_optional(&mut *conn).await? else { return Ok(Vec::new()) };
    let take = sqlx::query_as(TAKE).bind(id).bind(now_ms + LEASE_MS).bind(engine_id).bind(now_ms).bind(want);
    let rows: Vec<Row> = take.fetch_all(&mut *conn).await?;
    let mut reached = BTreeMap::new();
    for Row(.., priority, turn) in &rows {
        let turn_reached = reached.entry(priority).or_insert(turn);
        *turn_reached = turn.max(turn_reached);
    }
    let reached: Vec<_> = reached.into_iter().collect();
    sqlx::query(ADVANCE).bind(to_json(&reached)).execute(conn).await?;
    Ok(rows)
}

async fn leases(conn: &mut SqliteConnection, mut rows: Vec<Row>, known: &[ScenarioId]) -> Result<Leases, StoreError> {
    rows.sort_unstable_by_key(|Row(id, .., priority, turn)| (std::cmp::Reverse(*priority), *turn, *id));
    let jobs = rows.iter().map(Row::read).collect::<Result<Vec<_>, _>>()?;
    let mut unknown: Vec<_> = jobs.iter().map(|job| job.scenario).filter(|id| !known.contains(id)).collect();
    unknown.sort_unstable();
    unknown.dedup();
    let scenarios = scenario::texts(conn, &unknown).await?;
    let retry_after_ms = if jobs.is_empty() { RETRY_AFTER_MS } else { 0 };
    Ok(Leases { jobs, scenarios, retry_after_ms })
}

impl Row {
    fn read(&self) -> Result<LeasedJob, StoreError> {
        let Self(id, attempt, scenario, seed, record, alone, ..) = self;
        Ok(LeasedJob {
            job: JobId(*id),
            attempt: unsigned("an attempt", *attempt)?,
            scenario: ScenarioId(*scenario),
            seed: unsigned("a seed", *seed)?,
            record: *record,
            alone: *alone,
        })
    }
}
