//! Expiry: leases that nobody renewed, and those of a worker that is gone, ended before their time.
//!
//! A worker's death is charged to the jobs that ran there. What the last renewal told may be old or missing: of a
//! worker with threads to spare, the first of its other jobs may have begun since, and one that kills its worker at once
//! is never told to run. So these are charged, too, in the order in which they were handed out, one a thread.

use furrow_schema::id::{JobId, RequestId, WorkerId};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::{claim, unsigned, verification};
use crate::view::AttemptEnd;

/// At most this many leases are expired in one transaction; the rest follow in the next.
const MOST: i64 = 10_000;

/// Jobs whose lease ran out, worker by worker, as they were handed out.
const OVERDUE: &str = "select job.id, attempt, claim_id, running, panics, deaths, worker_id, threads
    from job indexed by job_leased cross join claim on claim.id = claim_id cross join worker on worker.id = worker_id
    where job.state = 'leased' and lease_until_ms <= ?1
    order by worker_id, claim_id, priority desc, turn, job.id limit ?2 + 0";

/// Jobs that a worker holds, by name or row, as they were handed out.
const HELD_BY: &str = "select job.id, attempt, claim_id, running, panics, deaths, worker_id, threads
    from job join claim on claim.id = claim_id join worker on worker.id = worker_id
    where job.state = 'leased' and worker_id = coalesce(?2, (select id from worker where uid = ?1))
    order by claim_id, priority desc, turn, job.id";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[OVERDUE, HELD_BY];

/// A lease that ends.
#[derive(sqlx::FromRow)]
struct Row {
    id: i64,
    attempt: i64,
    claim_id: i64,
    running: bool,
    panics: i64,
    deaths: i64,
    worker_id: i64,
    threads: i64,
}

/// What ended leases.
struct Cause {
    /// As the attempts tell it.
    why: &'static str,
    /// After so many deaths a job is given up on; none if nobody is charged.
    max_deaths: Option<u32>,
}

const RAN_OUT: &str = "the lease ran out: the worker did not renew it";
const FELL_SILENT: &str = "the worker was gone: its connection broke and nothing was heard of it any more";
const BEGAN_ANEW: &str = "the worker was gone: its process ended, and another one took its place";
const BARRED: &str = "the worker was barred";

/// Where a transaction stands that ends leases.
pub(crate) struct Ending<'a> {
    pub(crate) engine_id: i64,
    pub(crate) now_ms: i64,
    /// After so many deaths of workers a job is given up on.
    pub(crate) max_deaths: u32,
    pub(crate) tally: &'a mut Tally,
}

/// Takes back every job whose lease ran out. One that may have run there is charged with the worker's death and given
/// up on after too many of them; one that was merely prefetched is not charged. Returns how many there were.
pub(crate) async fn expire(conn: &mut SqliteConnection, ending: &mut Ending<'_>) -> Result<usize, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(OVERDUE).bind(ending.now_ms).bind(MOST).fetch_all(&mut *conn).await?;
    let verified = verification::expire(conn, ending.now_ms).await?;
    Ok(verified + take_back_of_the_dead(conn, &rows, RAN_OUT, ending).await?)
}

/// The same for all jobs of a worker that fell silent. It may come back: its results still count.
pub(crate) async fn fell_silent(
    conn: &mut SqliteConnection,
    worker: &WorkerId,
    ending: &mut Ending<'_>,
) -> Result<usize, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(HELD_BY).bind(worker.as_str()).bind(None::<i64>).fetch_all(&mut *conn).await?;
    let verified = verification::worker_gone(conn, worker).await?;
    Ok(verified + take_back_of_the_dead(conn, &rows, FELL_SILENT, ending).await?)
}

/// The same for what an earlier process of worker `id`, row `worker`, held, when another one claims for the first time.
/// The claim repeated changes nothing.
pub(crate) async fn began_anew(
    conn: &mut SqliteConnection,
    (id, worker): (&WorkerId, i64),
    request: &RequestId,
    ending: &mut Ending<'_>,
) -> Result<usize, StoreError> {
    if claim::is_repeated(conn, worker, request).await? {
        return Ok(0);
    }
    let rows: Vec<Row> = sqlx::query_as(HELD_BY).bind(None::<&str>).bind(worker).fetch_all(&mut *conn).await?;
    let verified = verification::worker_gone(conn, id).await?;
    Ok(verified + take_back_of_the_dead(conn, &rows, BEGAN_ANEW, ending).await?)
}

/// The same, free of charge, for the jobs of a worker that may have none.
pub(crate) async fn free(
    conn: &mut SqliteConnection,
    worker: i64,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(HELD_BY).bind(None::<&str>).bind(worker).fetch_all(&mut *conn).await?;
    take_back(conn, &rows, &Cause { why: BARRED, max_deaths: None }, engine_id, now_ms, tally).await
}

async fn take_back_of_the_dead(
    conn: &mut SqliteConnection,
    rows: &[Row],
    why: &'static str,
    ending: &mut Ending<'_>,
) -> Result<usize, StoreError> {
    let cause = Cause { why, max_deaths: Some(ending.max_deaths) };
    take_back(conn, rows, &cause, ending.engine_id, ending.now_ms, ending.tally).await
}

async fn take_back(
    conn: &mut SqliteConnection,
    rows: &[Row],
    cause: &Cause,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let mut changes = Changes::default();
    for (row, may_have_run) in rows.iter().zip(which_may_have_run(rows)) {
        let (job, attempt) = (JobId(row.id), unsigned("an attempt", row.attempt)?);
        let max_deaths = cause.max_deaths.filter(|_| may_have_run);
        let deaths: u32 = unsigned("deaths", row.deaths)?;
        let deaths = deaths + u32::from(max_deaths.is_some());
        let charges = Charges { panics: unsigned("panics", row.panics)?, deaths };
        let end = if max_deaths.is_some() { AttemptEnd::Died } else { AttemptEnd::Expired };
        changes.archive(job, attempt, row.claim_id, end, Some(cause.why.to_owned()));
        if max_deaths.is_some_and(|max_deaths| deaths >= max_deaths.max(1)) {
            changes.fail(job, charges);
        } else {
            changes.requeue(job, 0, charges);
        }
    }
    if !rows.is_empty() {
        tracing::info!(jobs = rows.len(), why = cause.why, "leases ended");
        changes.write(conn, engine_id, now_ms, tally).await?;
    }
    Ok(rows.len())
}

/// Those that ran as far as was known, and as many of the others as the worker had threads to spare, the first.
fn which_may_have_run(rows: &[Row]) -> impl Iterator<Item = bool> {
    rows.chunk_by(|a, b| a.worker_id == b.worker_id).flat_map(|of_one_worker| {
        let running = of_one_worker.iter().filter(|row| row.running).count() as i64;
        let mut spare = of_one_worker[0].threads - running;
        of_one_worker.iter().map(move |row| {
            let may_have_begun = !row.running && spare > 0;
            spare -= i64::from(may_have_begun);
            row.running || may_have_begun
        })
    })
}

#[cfg(test)]
mod tests {
    use furrow_schema::job::JobState;
    use furrow_schema::protocol::LEASE_MS;

    use crate::testing::{Bench, sweep};
    use crate::view::AttemptEnd;

    async fn one_job() -> Bench {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        bench
    }

    #[tokio::test]
    async fn a_lease_that_nobody_renews_is_taken_back() {
        let bench = one_job().await;
        let (silent, other) = (bench.worker().await, bench.worker().await);
        let job = silent.claim(1).await.remove(0);
        bench.pass(LEASE_MS - 1).await;
        assert!(other.claim(1).await.is_empty(), "the lease still holds");
        bench.pass(1).await;
        assert_eq!(other.claim(1).await[0].attempt, 2);
        assert_eq!(silent.renew(std::slice::from_ref(&job), true).await.lost, [job.job]);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn workers_that_die_of_a_job_are_charged_to_it() {
        let bench = one_job().await;
        let mut last = None;
        for _ in 0..3 {
            let worker = bench.worker().await;
            let job = worker.claim(1).await.remove(0);
            worker.renew(std::slice::from_ref(&job), true).await;
            bench.pass(LEASE_MS).await;
            last = Some(job);
        }
        let detail = bench.job(&last.unwrap()).await;
        assert_eq!(detail.state, JobState::Failed);
        assert!(detail.attempts.iter().all(|attempt| attempt.end == AttemptEnd::Died));
        assert!(detail.attempts.iter().all(|attempt| attempt.reason.as_deref() == Some(super::RAN_OUT)));
        assert_eq!(detail.attempts.len(), 3);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_job_that_kills_its_workers_before_they_say_that_it_runs_is_given_up_on() {
        let bench = one_job().await;
        let mut last = None;
        for attempt in 1..=3 {
            let worker = bench.worker().await;
            let job = worker.claim(1).await.remove(0);
            assert_eq!(job.attempt, attempt);
            bench.coordinator.worker_gone(worker.id.clone(), bench.coordinator.now_ms()).await.unwrap();
            last = Some(job);
        }
        let detail = bench.job(&last.unwrap()).await;
        assert_eq!(detail.state, JobState::Failed);
        assert!(detail.attempts.iter().all(|attempt| attempt.end == AttemptEnd::Died));
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn prefetched_jobs_are_not_charged() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 4)).await;
        let mut jobs = Vec::new();
        for _ in 0..3 {
            let worker = bench.worker().await;
            jobs = worker.claim(4).await;
            assert_eq!(jobs.len(), 4, "nothing was given up on before the third death");
            worker.renew(&jobs[..1], true).await;
            worker.renew(&jobs[1..], false).await;
            bench.pass(LEASE_MS).await;
        }
        let ends = async |job| bench.job(job).await.attempts.iter().map(|attempt| attempt.end).collect::<Vec<_>>();
        // A worker has two threads: one runs the first job, the other may have begun the second.
        for died in &jobs[..2] {
            assert_eq!(ends(died).await, [AttemptEnd::Died; 3]);
        }
        for waited in &jobs[2..] {
            assert_eq!(ends(waited).await, [AttemptEnd::Expired; 3]);
            assert_eq!(bench.job(waited).await.state, JobState::Queued);
        }
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_process_in_the_place_of_another_frees_what_that_one_held() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 3)).await;
        let worker = bench.worker().await;
        let held = worker.claim(2).await;
        worker.renew(&held, true).await;

        let mut first = worker.claim_call(1);
        first.body.first = true;
        let leases = bench.coordinator.claim(first.clone()).await.into_result().unwrap();
        assert_eq!((leases.jobs[0].job, leases.jobs[0].attempt), (held[0].job, 2));
        let attempt = &bench.job(&held[1]).await.attempts[0];
        assert_eq!((attempt.end, attempt.reason.as_deref()), (AttemptEnd::Died, Some(super::BEGAN_ANEW)));

        let again = bench.coordinator.claim(first).await.into_result().unwrap();
        assert_eq!(again.jobs, leases.jobs, "the claim repeated frees nothing");
        assert!(worker.renew(&leases.jobs, true).await.lost.is_empty());
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_late_copy_of_a_first_claim_that_got_nothing_frees_nothing() {
        let bench = Bench::new().await;
        let worker = bench.worker().await;
        let mut first = worker.claim_call(1);
        first.body.first = true;
        assert!(bench.coordinator.claim(first.clone()).await.into_result().unwrap().jobs.is_empty());
        bench.submit(sweep(&["rgop"], 1)).await;
        let jobs = worker.claim(1).await;
        bench.coordinator.claim(first).await.into_result().unwrap();
        assert!(worker.renew(&jobs, true).await.lost.is_empty());
        assert_eq!(bench.job(&jobs[0]).await.attempts.len(), 1);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_worker_that_fell_silent_loses_its_jobs_at_once() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 3)).await;
        let dead = bench.worker().await;
        let jobs = dead.claim(3).await;
        dead.renew(&jobs[..2], true).await;
        let other = bench.worker().await;
        let gone_ms = bench.coordinator.now_ms();
        bench.clock.advance(2_000);

        assert_eq!(bench.coordinator.worker_gone(dead.id.clone(), gone_ms).await.unwrap(), None);

        let ends = |detail: crate::JobDetail| (detail.attempts[0].end, detail.attempts[0].reason.clone());
        let silent = Some(super::FELL_SILENT.to_owned());
        assert_eq!(ends(bench.job(&jobs[1]).await), (AttemptEnd::Died, silent.clone()));
        assert_eq!(ends(bench.job(&jobs[2]).await), (AttemptEnd::Expired, silent));
        assert_eq!(other.claim(3).await.len(), 3);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_worker_that_was_heard_of_meanwhile_keeps_its_jobs() {
        let bench = one_job().await;
        let worker = bench.worker().await;
        let job = worker.claim(1).await;
        let gone_ms = bench.coordinator.now_ms();
        bench.clock.advance(900);
        worker.renew(&job, true).await;
        bench.clock.advance(1_100);
        let heard_ms = bench.coordinator.worker_gone(worker.id.clone(), gone_ms).await.unwrap();
        assert_eq!(heard_ms, Some(gone_ms + 900));
        assert!(worker.renew(&job, true).await.lost.is_empty());
    }

    #[tokio::test]
    async fn nobody_keeps_a_dead_worker_alive_without_its_credential() {
        let bench = one_job().await;
        let (dead, forger) = (bench.worker().await, crate::testing::Worker::new(&bench.coordinator));
        let job = dead.claim(1).await.remove(0);
        let gone_ms = bench.coordinator.now_ms();
        bench.clock.advance(2_000);
        let forged = furrow_schema::protocol::Call { worker: dead.id.clone(), ..forger.claim_call(1) };
        assert!(bench.coordinator.claim(forged).await.into_result().is_err());
        assert_eq!(bench.coordinator.worker_gone(dead.id.clone(), gone_ms).await.unwrap(), None);
        assert_eq!(bench.job(&job).await.attempts[0].end, AttemptEnd::Died);
    }

    #[tokio::test]
    async fn a_worker_that_comes_back_loses_its_jobs_but_its_result_counts_if_it_is_the_first() {
        let bench = one_job().await;
        let (asleep, other) = (bench.worker().await, bench.worker().await);
        let job = asleep.claim(1).await.remove(0);
        let gone_ms = bench.coordinator.now_ms();
        bench.clock.advance(2_000);
        bench.coordinator.worker_gone(asleep.id.clone(), gone_ms).await.unwrap();
        assert_eq!(other.claim(1).await[0].attempt, 2);

        assert_eq!(asleep.renew(std::slice::from_ref(&job), true).await.lost, [job.job]);
        assert!(asleep.ended(&job, crate::testing::done(1.0)).await);
        assert_eq!(bench.job(&job).await.result.unwrap().worker, asleep.id);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn idle_workers_are_called_when_there_is_work_again_and_not_otherwise() {
        let bench = Bench::new().await;
        let mut work = bench.coordinator.work();
        let worker = bench.worker().await;
        worker.claim(1).await;
        assert!(!work.has_changed().unwrap());
        bench.submit(sweep(&["rgop"], 3)).await;
        assert!(work.has_changed().unwrap());
        work.mark_unchanged();
        let jobs = worker.claim(3).await;
        worker.ended(&jobs[0], crate::testing::done(1.0)).await;
        assert!(!work.has_changed().unwrap(), "a result makes no work");
        worker.ended(&jobs[1], furrow_schema::protocol::RunEnd::HandedBack).await;
        assert!(work.has_changed().unwrap());
        work.mark_unchanged();
        bench.pass(LEASE_MS).await;
        assert!(work.has_changed().unwrap());
    }
}
