//! Renewals: a worker says that it is still at its jobs, and which of them run.

use std::collections::HashSet;

use furrow_schema::protocol::{LEASE_MS, Renew, Renewed};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{to_json, verification};

/// A lease that is younger than this is not written again \[ms\].
const GRAIN_MS: i64 = 5_000;

/// Those of the jobs (job, attempt, running) that are worker ?2's, with how the database has them.
const HELD: &str = "select job.id, job.lease_until_ms, job.running, held.value ->> 2
    from json_each(?1) as held join job on job.id = held.value ->> 0 join claim on claim.id = job.claim_id
    where job.state = 'leased' and job.attempt = held.value ->> 1 and claim.worker_id = ?2";

/// Moves leases to ?2 and notes which jobs run: job, running.
const EXTEND: &str = "update job set lease_until_ms = ?2, running = value ->> 1
    from json_each(?1) where job.id = value ->> 0";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[HELD, EXTEND];

/// A job that a worker holds: until when, whether it ran as far as was known, and whether it runs.
#[derive(sqlx::FromRow)]
pub(crate) struct HeldRow(i64, i64, i64, i64);

/// Renews what is still `worker`'s and tells it the rest.
pub(crate) async fn renew(
    conn: &mut SqliteConnection,
    worker: i64,
    renew: &Renew,
    now_ms: i64,
) -> Result<Renewed, StoreError> {
    if renew.held.is_empty() {
        return Ok(Renewed::default());
    }
    let held: Vec<_> = renew.held.iter().map(|held| (held.job, held.attempt, i64::from(held.running))).collect();
    let rows: Vec<HeldRow> = sqlx::query_as(HELD).bind(to_json(&held)).bind(worker).fetch_all(&mut *conn).await?;
    let until_ms = now_ms + LEASE_MS;
    let overdue = due(&rows, until_ms);
    if !overdue.is_empty() {
        sqlx::query(EXTEND).bind(to_json(&overdue)).bind(until_ms).execute(&mut *conn).await?;
    }
    let mut still: HashSet<i64> = rows.iter().map(|row| row.0).collect();
    if renew.held.iter().any(|held| !still.contains(&held.job.0)) {
        let verified = verification::held_by(conn, worker, &renew.held).await?;
        verification::extend(conn, &due(&verified, until_ms), until_ms).await?;
        still.extend(verified.iter().map(|row| row.0));
    }
    let lost = renew.held.iter().map(|held| held.job).filter(|job| !still.contains(&job.0)).collect();
    Ok(Renewed { lost })
}

/// Those to be written: job, running.
fn due(rows: &[HeldRow], until_ms: i64) -> Vec<(i64, i64)> {
    let is_due = |HeldRow(_, until, was, is): &&HeldRow| *until < until_ms - GRAIN_MS || was != is;
    rows.iter().filter(is_due).map(|HeldRow(job, .., is)| (*job, *is)).collect()
}

#[cfg(test)]
mod tests {
    use furrow_schema::id::JobId;
    use furrow_schema::protocol::{LeasedJob, RunEnd};

    use super::*;
    use crate::testing::{Bench, sweep};

    #[tokio::test]
    async fn a_renewed_lease_outlives_the_first_one() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 2)).await;
        let worker = bench.worker().await;
        let jobs = worker.claim(2).await;
        let other = bench.worker().await;
        for _ in 0..4 {
            bench.pass(LEASE_MS / 2).await;
            assert_eq!(worker.renew(&jobs, true).await, Renewed::default());
        }
        assert!(other.claim(2).await.is_empty());
    }

    #[tokio::test]
    async fn a_lease_renewed_every_second_never_runs_out() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let worker = bench.worker().await;
        let jobs = worker.claim(1).await;
        for _ in 0..90 {
            bench.pass(1_000).await;
            assert_eq!(worker.renew(&jobs, true).await, Renewed::default());
        }
        bench.pass(LEASE_MS - GRAIN_MS - 1).await;
        assert_eq!(worker.renew(&jobs, true).await, Renewed::default());
    }

    #[tokio::test]
    async fn a_stale_attempt_cannot_renew() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let worker = bench.worker().await;
        let stale = worker.claim(1).await.remove(0);
        worker.ended(&stale, RunEnd::HandedBack).await;
        let lease = worker.claim(1).await.remove(0);
        assert_eq!((lease.job, lease.attempt), (stale.job, 2));

        assert_eq!(worker.renew(std::slice::from_ref(&stale), true).await.lost, [stale.job]);
        assert!(worker.renew(&[lease], true).await.lost.is_empty());
    }

    #[tokio::test]
    async fn nobody_renews_the_jobs_of_another_or_none_at_all() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let (worker, other) = (bench.worker().await, bench.worker().await);
        let job = worker.claim(1).await.remove(0);
        let unknown = LeasedJob { job: JobId(404), ..job.clone() };
        assert_eq!(other.renew(&[job.clone(), unknown], true).await.lost, [job.job, JobId(404)]);
        assert!(other.renew(&[], true).await.lost.is_empty());
    }
}
