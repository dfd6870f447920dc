//! What tests of faults need of the database, in this crate and in others: whether its books are right, a database that
//! fails, and an empty one without opening another.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, LazyLock};

use crate::error::StoreError;
use crate::store::Store;
use crate::store::transaction::ROLL_BACK;

/// Each counts what must not be.
const RULES: &[&str] = &[
    "select count(*) from job where (state = 'done') <> exists (select 1 from result where job_id = job.id)",
    "select count(*) from sweep where (total, done, failed, cancelled) is not (
        select count(*), count(*) filter (where job.state = 'done'), count(*) filter (where job.state = 'failed'),
            count(*) filter (where job.state = 'cancelled')
        from cell join cell_job on cell_id = cell.id join job on job.id = job_id where sweep_id = sweep.id)",
    "select count(*) from cell where (total, done, failed) is not (
        select count(*), count(*) filter (where job.state = 'done'), count(*) filter (where job.state = 'failed')
        from cell_job join job on job.id = job_id where cell_id = cell.id)",
    "select count(*) from sweep
        where state <> 'cancelled' and (state = 'done') <> (done + failed + cancelled = total)",
    "select count(*) from sweep where state <> 'cancelled' and cancelled > 0",
    // A job is held, or has the highest priority of the sweeps that are neither paused nor cancelled.
    "select count(*) from job where state in ('queued', 'leased') and (held, iif(held, 0, priority)) is not (
        select count(*) = 0, coalesce(max(sweep.priority), 0)
        from cell_job join cell on cell.id = cell_id join sweep on sweep.id = sweep_id
        where job_id = job.id and sweep.state not in ('paused', 'cancelled'))",
    // It is cancelled exactly when no live sweep wants it.
    "select count(*) from job where state in ('queued', 'leased', 'cancelled') and (state = 'cancelled') = exists (
        select 1 from cell_job join cell on cell.id = cell_id join sweep on sweep.id = sweep_id
        where job_id = job.id and sweep.state <> 'cancelled')",
    // Nothing is half done, and nothing is left of what was removed.
    "select (select count(*) from settling) + (select count(*) from unlisted)",
    "select count(*) from job where not exists (select 1 from cell_job where job_id = job.id)",
    "select count(*) from scenario where not exists (select 1 from job where scenario_id = scenario.id)",
    "select count(*) from attempt join job on job.id = job_id where attempt.attempt > job.attempt
        or (job.state = 'leased' and attempt.attempt = job.attempt)",
    // Verification is about results only, gives a number no second time, and a barred worker has nothing.
    "select count(*) from verification join job on job.id = verification.job_id
        where job.state <> 'done' or verification.attempt > job.attempt",
    "select count(*) from opinion join job on job.id = job_id where opinion.attempt > job.attempt",
    "select count(*) from opinion join attempt using (job_id, attempt)
        where (select worker_id from claim where claim.id = attempt.claim_id) <> opinion.worker_id",
    "select count(*) from claim join worker on worker.id = claim.worker_id where barred_ms is not null and (
        exists (select 1 from job where job.claim_id = claim.id)
        or exists (select 1 from verification where verification.claim_id = claim.id))",
    // An incident of a job that is verified is an opinion on it.
    "select count(*) from verification where state in ('upheld', 'overruled', 'undecided')
        and not exists (select 1 from opinion join result using (job_id)
            where opinion.job_id = verification.job_id and opinion.digest <> result.digest)",
    "select count(*) from verification where state = 'agreed'
        and exists (select 1 from opinion join result using (job_id)
            where opinion.job_id = verification.job_id and opinion.digest <> result.digest)",
    "select count(*) from pragma_foreign_key_check",
];

/// The counts in one statement.
static ALL_RULES: LazyLock<String> = LazyLock::new(|| RULES.join(" union all "));

/// Removes all that came of users and workers, whoever refers to another first: without a check of foreign keys by pragma,
/// which would have every statement prepared anew.
const EMPTY: &str = "begin;
    delete from opinion; delete from verification; delete from trajectory; delete from result; delete from incident;
    delete from attempt; delete from cell_metric; delete from cell_job; delete from cell; delete from settling;
    delete from unlisted; delete from sweep; delete from job; delete from claim; delete from enrolment;
    delete from join_secret; delete from worker; delete from scenario; delete from engine; delete from virtual_time;
    delete from token; delete from sqlite_sequence; update last_number set job = 0, scenario = 0;
    update heartbeat set beat_ms = 0;
    commit";

/// How a database fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// No transaction can be committed, which is held against its statements.
    AtCommit,
    /// In the middle of a transaction, as a disk: once so many rows were changed, the next statement that takes a step fails.
    AfterRows(u32),
}

impl Store {
    /// The rules of the database's books that are broken: every count of sweeps and cells is what the jobs say, and
    /// jobs, leases and results fit together. None in a database that only this program wrote.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn broken_rules(&self) -> Result<Vec<&'static str>, StoreError> {
        let counts: Vec<i64> = sqlx::query_scalar(ALL_RULES.as_str()).fetch_all(self.readers()).await?;
        Ok(RULES.iter().zip(counts).filter_map(|(rule, times)| (times > 0).then_some(*rule)).collect())
    }

    /// From now on the database fails so, or works again.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn fail(&self, failure: Option<Failure>) -> Result<(), StoreError> {
        let mut conn = self.writer().acquire().await?;
        let mut handle = conn.lock_handle().await?;
        handle.remove_commit_hook();
        handle.remove_update_hook();
        handle.remove_progress_handler();
        match failure {
            Some(Failure::AtCommit) => handle.set_commit_hook(|| false),
            Some(Failure::AfterRows(rows)) => {
                let changed = Arc::new(AtomicU32::new(0));
                let (counted, mut failed) = (Arc::clone(&changed), false);
                handle.set_update_hook(move |_| _ = counted.fetch_add(1, Ordering::Relaxed));
                handle.set_progress_handler(1, move || {
                    let well = failed || changed.load(Ordering::Relaxed) < rows;
                    failed |= !well;
                    well
                });
            }
            None => {}
        }
        Ok(())
    }

    /// Undoes what a killed coordinator had begun and not committed, as the next process does that opens the file.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn undo_unfinished(&self) -> Result<(), StoreError> {
        let mut conn = self.writer().acquire().await?;
        // An error says that nothing was begun.
        let _ = sqlx::query(ROLL_BACK).execute(&mut *conn).await;
        Ok(())
    }

    /// Removes everything but the coordinator's name, so that the database is as after its creation.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn empty(&self) -> Result<(), StoreError> {
        sqlx::raw_sql(EMPTY).execute(self.writer()).await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use sqlx::AssertSqlSafe;

    use crate::testing::{Bench, done, sweep};

    const TABLES: &str = "select name from sqlite_schema where type = 'table'
        and name not in ('coordinator', 'heartbeat', 'last_number', '_sqlx_migrations')
        and (name not like 'sqlite!_%' escape '!' or name = 'sqlite_sequence')";

    #[tokio::test]
    async fn an_emptied_database_is_as_after_its_creation() {
        let bench = Bench::new().await;
        let store = bench.store.clone();
        let numbers = async || {
            let tables: Vec<String> = sqlx::query_scalar(TABLES).fetch_all(store.readers()).await.unwrap();
            let rows: Vec<String> = tables.iter().map(|table| format!("(select count(*) from {table})")).collect();
            let all = format!(
                "select sum(column1) + (select job + scenario from last_number) from (values ({}))",
                rows.join("), (")
            );
            sqlx::query_scalar::<_, i64>(AssertSqlSafe(all)).fetch_one(store.readers()).await.unwrap()
        };
        bench.submit(sweep(&["rgop"], 3)).await;
        let worker = bench.worker().await;
        let job = worker.claim(1).await.remove(0);
        worker.ended(&job, done(1.0)).await;
        assert!(numbers().await > 10);
        store.empty().await.unwrap();
        assert_eq!(numbers().await, 0);
        assert_eq!(bench.submit(sweep(&["rgop"], 3)).await.id.0, 1);
    }
}
