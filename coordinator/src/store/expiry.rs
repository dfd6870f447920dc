//! Expiry: leases that nobody renewed.

use furrow_schema::id::JobId;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::unsigned;
use crate::view::AttemptEnd;

/// At most this many leases are expired in one transaction; the rest follow in the next.
const MOST: i64 = 10_000;

/// Jobs whose lease ran out.
const OVERDUE: &str = "select id, attempt, claim_id, running, panics, deaths
    from job where state = 'leased' and lease_until_ms <= ?1 limit ?2";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[OVERDUE];

type Row = (i64, i64, i64, bool, i64, i64);

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
    let mut changes = Changes::default();
    for (id, attempt, claim, running, panics, deaths) in &rows {
        let (job, attempt) = (JobId(*id), unsigned("an attempt", *attempt)?);
        let deaths: u32 = unsigned("deaths", *deaths)?;
        let charges = Charges { panics: unsigned("panics", *panics)?, deaths: deaths + u32::from(*running) };
        let end = if *running { AttemptEnd::Died } else { AttemptEnd::Expired };
        changes.archive(job, attempt, *claim, end, None);
        if *running && charges.deaths >= max_deaths.max(1) {
            changes.fail(job, charges);
        } else {
            changes.requeue(job, 0, charges);
        }
    }
    if !rows.is_empty() {
        tracing::info!(jobs = rows.len(), "leases ran out");
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
}
