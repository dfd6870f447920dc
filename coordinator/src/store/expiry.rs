//! Expiry: leases that nobody renewed, and those of a worker that fell silent, ended before their time.

use furrow_schema::id::JobId;
use sqlx::SqliteConnection;

use crate::batch::Absence;
use crate::error::StoreError;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::{unsigned, verification};
use crate::view::AttemptEnd;

/// At most this many leases are expired in one transaction; the rest follow in the next.
const MOST: i64 = 10_000;

/// Jobs whose lease ran out.
const OVERDUE: &str = "select id, attempt, claim_id, running, panics, deaths
    from job where state = 'leased' and lease_until_ms <= ?1 limit ?2 + 0";

/// Jobs that a worker holds, by name or row.
const HELD_BY: &str = "select job.id, job.attempt, claim_id, running, panics, deaths
    from job join claim on claim.id = job.claim_id
    where job.state = 'leased' and claim.worker_id = coalesce(?2, (select id from worker where uid = ?1))";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[OVERDUE, HELD_BY];

type Row = (i64, i64, i64, bool, i64, i64);

/// What ended leases.
struct Cause {
    /// As the attempts tell it.
    why: &'static str,
    /// After so many deaths a job is given up on; none if nobody is charged.
    max_deaths: Option<u32>,
}

const RAN_OUT: &str = "the lease ran out: the worker did not renew it";
const FELL_SILENT: &str = "the worker was gone: its connection broke and nothing was heard of it any more";
const BARRED: &str = "the worker was barred";

/// Takes back every job whose lease ran out. One that ran there is charged with the worker's death and given up
/// on after `max_deaths` of them; one that was merely prefetched is not charged. Returns how many there were.
pub(crate) async fn expire(
    conn: &mut SqliteConnection,
    max_deaths: u32,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(OVERDUE).bind(now_ms).bind(MOST).fetch_all(&mut *conn).await?;
    let cause = Cause { why: RAN_OUT, max_deaths: Some(max_deaths) };
    let verified = verification::expire(conn, now_ms).await?;
    Ok(verified + take_back(conn, &rows, &cause, engine_id, now_ms, tally).await?)
}

/// The same for all jobs of a worker that fell silent. It may come back: its results still count.
pub(crate) async fn fell_silent(
    conn: &mut SqliteConnection,
    absence: &Absence,
    max_deaths: u32,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let held_by = sqlx::query_as(HELD_BY).bind(absence.worker.as_str()).bind(None::<i64>);
    let rows: Vec<Row> = held_by.fetch_all(&mut *conn).await?;
    let cause = Cause { why: FELL_SILENT, max_deaths: Some(max_deaths) };
    let verified = verification::fell_silent(conn, absence).await?;
    Ok(verified + take_back(conn, &rows, &cause, engine_id, now_ms, tally).await?)
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

async fn take_back(
    conn: &mut SqliteConnection,
    rows: &[Row],
    cause: &Cause,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let mut changes = Changes::default();
    for (id, attempt, claim, running, panics, deaths) in rows {
        let (job, attempt) = (JobId(*id), unsigned("an attempt", *attempt)?);
        let max_deaths = cause.max_deaths.filter(|_| *running);
        let deaths: u32 = unsigned("deaths", *deaths)?;
        let deaths = deaths + u32::from(max_deaths.is_some());
        let charges = Charges { panics: unsigned("panics", *panics)?, deaths };
        let end = if max_deaths.is_some() { AttemptEnd::Died } else { AttemptEnd::Expired };
        changes.archive(job, attempt, *claim, end, Some(cause.why.to_owned()));
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
    async fn prefetched_jobs_are_not_charged() {
        let bench = one_job().await;
        for attempt in 1..=6 {
            let worker = bench.worker().await;
            let job = worker.claim(1).await.remove(0);
            assert_eq!(job.attempt, attempt);
            worker.renew(&[job], false).await;
            bench.pass(LEASE_MS).await;
        }
        let job = bench.worker().await.claim(1).await.remove(0);
        let detail = bench.job(&job).await;
        assert!(detail.attempts[..6].iter().all(|attempt| attempt.end == AttemptEnd::Expired));
        assert_eq!(detail.attempts[6].end, AttemptEnd::Open);
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn a_worker_that_fell_silent_loses_its_jobs_at_once() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 2)).await;
        let (dead, other) = (bench.worker().await, bench.worker().await);
        let jobs = dead.claim(2).await;
        dead.renew(&jobs[..1], true).await;
        let gone_ms = bench.coordinator.now_ms();
        bench.clock.advance(2_000);

        assert_eq!(bench.coordinator.worker_gone(dead.id.clone(), gone_ms).await.unwrap(), None);

        let ends = |detail: crate::JobDetail| (detail.attempts[0].end, detail.attempts[0].reason.clone());
        let silent = Some(super::FELL_SILENT.to_owned());
        assert_eq!(ends(bench.job(&jobs[0]).await), (AttemptEnd::Died, silent.clone()));
        assert_eq!(ends(bench.job(&jobs[1]).await), (AttemptEnd::Expired, silent));
        assert_eq!(other.claim(2).await.len(), 2);
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
        assert_eq!(bench.job(&job).await.attempts[0].end, AttemptEnd::Expired);
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
