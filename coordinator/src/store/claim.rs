//! Claims: which jobs a worker gets next.
//!
//! By priority, then fair between sweeps: a job's turn is its place within its sweep, counted on from where its
//! priority's queue stood when the sweep came, so that sweeps of equal priority take turns.

use std::collections::BTreeMap;

use furrow_schema::id::{JobId, RequestId, ScenarioId};
use furrow_schema::protocol::{Claim, LEASE_MS, LeasedJob, Leases};
use sqlx::SqliteConnection;

use crate::config::Verify;
use crate::error::StoreError;
use crate::store::{scenario, to_json, unsigned, verification};

/// A worker that found nothing asks again after this long \[ms\], unless it hears sooner that there may be something.
const RETRY_AFTER_MS: u64 = 1_000;

/// While others are there, a claim gets an even share of what is left over this, so that all end at about one time.
const PART_OF_SHARE: u32 = 2;
/// A claim has its price: it gets what it asks for over this at least, as far as there is so much.
const LEAST_PART: u32 = 8;
/// With so many jobs in the queue or more nothing is shared out.
const MUCH: u32 = 4_096;

/// An earlier claim of the same request.
const FIND: &str = "select id from claim where worker_id = ?1 and request = ?2";

/// A claim, if it is to be known again anyway (?5) or there is anything to grant in the queue.
const ADD: &str = "insert into claim (worker_id, request, claimed_ms)
    select ?1, ?2, ?3
    where ?5 or exists (select 1 from job
        where state = 'queued' and held = 0 and engine_id = ?4 and not_before_ms <= ?3)
    returning id";

/// Hands out the first of the queue to claim ?1 until ?2.
const TAKE: &str = "update job
    set state = 'leased', attempt = attempt + 1, claim_id = ?1, lease_until_ms = ?2, running = 0
    where id in (
        select id from job where state = 'queued' and held = 0 and engine_id = ?3 and not_before_ms <= ?4
        order by priority desc, turn limit ?5 + 0)
    returning id, attempt, scenario_id, seed, record, alone, priority, turn";

/// How many jobs there are to take, up to ?3.
const COUNT: &str = "select count(*) from (
    select 1 from job where state = 'queued' and held = 0 and engine_id = ?1 and not_before_ms <= ?2 limit ?3 + 0)";

/// What a claim still holds.
const HELD: &str = "select id, attempt, scenario_id, seed, record, alone, priority, turn
    from job where state = 'leased' and claim_id = ?1";

/// How far the queues of priorities have got: priority, turn.
const ADVANCE: &str = "insert into virtual_time (priority, turn)
    select value ->> 0, value ->> 1 from json_each(?1) where true
    on conflict (priority) do update set turn = max(turn, excluded.turn)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[FIND, ADD, TAKE, COUNT, HELD, ADVANCE];

/// A job that is handed out: id, attempt, scenario, seed, record, alone, priority, turn.
#[derive(sqlx::FromRow)]
pub(crate) struct Row(pub(super) i64, pub(super) i64, i64, i64, bool, bool, i64, i64);

/// How claims are granted now.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms {
    pub(crate) engine_id: i64,
    pub(crate) now_ms: i64,
    /// Whether verifications may wait, and whose they are.
    pub(crate) verify: Option<Verify>,
    /// How many workers were heard of lately.
    pub(crate) workers: u32,
}

/// Whether this claim of `worker` came before.
pub(crate) async fn is_repeated(
    conn: &mut SqliteConnection,
    worker: i64,
    request: &RequestId,
) -> Result<bool, StoreError> {
    Ok(earlier(conn, worker, request).await?.is_some())
}

async fn earlier(conn: &mut SqliteConnection, worker: i64, request: &RequestId) -> Result<Option<i64>, StoreError> {
    Ok(sqlx::query_scalar(FIND).bind(worker).bind(request.as_str()).fetch_optional(conn).await?)
}

/// Grants a claim of `worker`, or repeats what was granted for the same request.
pub(crate) async fn claim(
    conn: &mut SqliteConnection,
    worker: i64,
    request: &RequestId,
    claim: &Claim,
    terms: Terms,
) -> Result<Leases, StoreError> {
    let rows = match earlier(conn, worker, request).await? {
        Some(id) => {
            let mut rows = verification::held(conn, id).await?;
            rows.extend(sqlx::query_as::<_, Row>(HELD).bind(id).fetch_all(&mut *conn).await?);
            rows
        }
        None => grant(conn, worker, request, claim, terms).await?,
    };
    leases(conn, rows, &claim.known_scenarios).await
}

/// Verifications go first, but few wait as a rule. A process's first claim is noted even if it gets nothing: a late copy of
/// it must not free what the process was given since.
async fn grant(
    conn: &mut SqliteConnection,
    worker: i64,
    request: &RequestId,
    claim: &Claim,
    terms: Terms,
) -> Result<Vec<Row>, StoreError> {
    let Terms { engine_id, now_ms, verify, .. } = terms;
    let want = claim.want;
    let verified = match verify {
        Some(verify) => verification::candidates(conn, worker, want, &verify, engine_id, now_ms).await?,
        None => Vec::new(),
    };
    let add = sqlx::query_scalar(ADD).bind(worker).bind(request.as_str()).bind(now_ms).bind(engine_id);
    let add = add.bind(claim.first || !verified.is_empty());
    let Some(id): Option<i64> = add.fetch_optional(&mut *conn).await? else { return Ok(Vec::new()) };
    let mut rows = verification::lease(conn, id, &verified, now_ms).await?;
    let more = want.saturating_sub(u32::try_from(rows.len()).unwrap_or(want));
    if more > 0 {
        let fair = fair_part(conn, more, terms).await?;
        rows.extend(take(conn, id, fair, engine_id, now_ms).await?);
    }
    Ok(rows)
}

/// How many of the `want` jobs leave enough for the other workers.
async fn fair_part(conn: &mut SqliteConnection, want: u32, terms: Terms) -> Result<u32, StoreError> {
    if terms.workers < 2 || want < 2 {
        return Ok(want);
    }
    let parts = PART_OF_SHARE.saturating_mul(terms.workers);
    let enough = want.saturating_mul(parts).min(MUCH);
    let count = sqlx::query_scalar(COUNT).bind(terms.engine_id).bind(terms.now_ms).bind(enough);
    let left: u32 = count.fetch_one(conn).await?;
    let least = want.div_ceil(LEAST_PART);
    Ok(if left >= enough { want } else { left.div_ceil(parts).clamp(least, want) })
}

async fn take(
    conn: &mut SqliteConnection,
    id: i64,
    want: u32,
    engine_id: i64,
    now_ms: i64,
) -> Result<Vec<Row>, StoreError> {
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

#[cfg(test)]
mod tests {
    use furrow_schema::id::{Credential, EngineId};
    use furrow_schema::protocol::{Call, Hello, Refusal, Reply};
    use furrow_schema::sweep::NewSweep;

    use super::*;
    use crate::testing::{Bench, ENGINE, Worker, done, sweep};

    #[tokio::test]
    async fn a_claim_hands_out_each_job_once_with_its_scenario() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop", "rg"], 2)).await;
        let worker = bench.worker().await;

        let first = worker.leases(3).await;
        let second = worker.leases(3).await;
        let third = worker.leases(3).await;

        let seeds: Vec<_> = first.jobs.iter().chain(&second.jobs).map(|job| (job.scenario.0, job.seed)).collect();
        assert_eq!(seeds, [(1, 1), (1, 2), (2, 1), (2, 2)]);
        assert!(first.jobs.iter().all(|job| job.attempt == 1 && !job.alone && !job.record));
        let texts: Vec<_> = first.scenarios.iter().map(|s| s.json.as_str()).collect();
        assert_eq!(texts, [r#"{"algorithm":"rgop"}"#, r#"{"algorithm":"rg"}"#]);
        assert!(third.jobs.is_empty() && third.retry_after_ms > 0);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_known_scenario_is_not_sent_again() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 2)).await;
        let worker = bench.worker().await;
        let known = worker.leases(1).await.scenarios[0].id;
        let mut call = worker.claim_call(1);
        call.body.known_scenarios = vec![known];
        let leases = bench.coordinator.claim(call).await.into_result().unwrap();
        assert_eq!((leases.jobs.len(), leases.scenarios.len()), (1, 0));
    }

    #[tokio::test]
    async fn a_repeated_claim_gets_the_same_jobs() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 5)).await;
        let worker = bench.worker().await;
        let call = worker.claim_call(2);
        let first = bench.coordinator.claim(call.clone()).await;
        worker.claim(1).await;
        assert_eq!(bench.coordinator.claim(call.clone()).await, first);

        let jobs = first.into_result().unwrap().jobs;
        worker.ended(&jobs[0], done(1.0)).await;
        let again = bench.coordinator.claim(call).await.into_result().unwrap();
        assert_eq!(again.jobs, jobs[1..]);
    }

    #[tokio::test]
    async fn two_workers_may_use_the_same_request_id() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 2)).await;
        let (a, b) = (bench.worker().await, bench.worker().await);
        let of_a = a.claim_call(1);
        let of_b = Call { request: of_a.request.clone(), ..b.claim_call(1) };
        let of_a = bench.coordinator.claim(of_a).await.into_result().unwrap();
        let of_b = bench.coordinator.claim(of_b).await.into_result().unwrap();
        assert_ne!(of_a.jobs[0].job, of_b.jobs[0].job);
    }

    #[tokio::test]
    async fn a_higher_priority_goes_first() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["low"], 2)).await;
        bench.submit(NewSweep { priority: 5, ..sweep(&["high"], 2) }).await;
        let scenarios: Vec<_> = bench.worker().await.claim(4).await.into_iter().map(|job| job.scenario.0).collect();
        assert_eq!(scenarios, [2, 2, 1, 1]);
    }

    #[tokio::test]
    async fn sweeps_of_equal_priority_take_turns_from_where_the_queue_stands() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["early"], 100)).await;
        let worker = bench.worker().await;
        worker.claim(50).await;
        bench.submit(sweep(&["late"], 100)).await;
        let late = worker.claim(40).await.into_iter().filter(|job| job.scenario.0 == 2).count();
        assert!((19..=21).contains(&late), "{late} of 40");
    }

    #[tokio::test]
    async fn the_last_jobs_are_shared_out_in_ever_smaller_parts() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 100)).await;
        let (a, b) = (bench.worker().await, bench.worker().await);
        let mut granted = Vec::new();
        for worker in [&a, &b, &a, &b, &a, &b] {
            granted.push(worker.claim(16).await.len());
        }
        assert_eq!(granted, [16, 16, 16, 13, 10, 8]);
        while granted.iter().sum::<usize>() < 100 {
            granted.push(a.claim(16).await.len());
        }
        assert!(
            granted.is_sorted_by(|one, next| one >= next) && granted[10..].iter().all(|part| *part <= 3),
            "{granted:?}"
        );
    }

    #[tokio::test]
    async fn a_worker_that_is_alone_gets_what_it_asks_for() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 20)).await;
        let (gone, worker) = (bench.worker().await, bench.worker().await);
        assert_eq!(gone.claim(8).await.len(), 5);
        bench.clock.advance(4_000);
        assert_eq!(worker.claim(16).await.len(), 15);
    }

    #[tokio::test]
    async fn jobs_of_another_engine_stay_where_they_are() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let newer = EngineId([8; 32]);
        let config = crate::Config::new(newer);
        let after_the_upgrade = crate::Coordinator::start(bench.store.clone(), config);
        let worker = Worker::new(&after_the_upgrade);
        let hello = Hello { name: "new".to_owned(), engine: newer, threads: 1 };
        after_the_upgrade.hello(worker.call(hello)).await.into_result().unwrap();
        let claim = Claim { engine: newer, want: 8, known_scenarios: vec![], first: false };
        let leases = after_the_upgrade.claim(worker.call(claim)).await.into_result().unwrap();
        assert!(leases.jobs.is_empty());
    }

    #[tokio::test]
    async fn only_known_workers_with_their_own_credential_and_engine_are_served() {
        let bench = Bench::new().await;
        let stranger = Worker::new(&bench.coordinator);
        let refused = |reply: Reply<Leases>| reply.into_result().unwrap_err();
        assert_eq!(refused(bench.coordinator.claim(stranger.claim_call(1)).await), Refusal::UnknownWorker);

        let worker = bench.worker().await;
        let forged = Call { credential: stranger.credential.clone(), ..worker.claim_call(1) };
        assert_eq!(refused(bench.coordinator.claim(forged).await), Refusal::BadCredential);

        let mut foreign = worker.claim_call(1);
        foreign.body.engine = EngineId([9; 32]);
        let expected = Refusal::OtherEngine { coordinator: ENGINE, worker: EngineId([9; 32]) };
        assert_eq!(refused(bench.coordinator.claim(foreign).await), expected);
    }

    #[tokio::test]
    async fn a_second_hello_cannot_take_over_a_worker() {
        let bench = Bench::new().await;
        let worker = bench.worker().await;
        let hello = Hello { name: "thief".to_owned(), engine: ENGINE, threads: 1 };
        let forged = Call { credential: Credential::random(), ..worker.call(hello) };
        let refused = bench.coordinator.hello(forged).await.into_result().unwrap_err();
        assert_eq!(refused, Refusal::BadCredential);
        worker.hello().await;
        let names: Vec<_> = bench.coordinator.workers().await.unwrap().into_iter().map(|w| w.name).collect();
        assert_eq!(names, ["tester"]);
    }
}
