//! How much there is of everything, and the mark that the database can be written.

use std::collections::BTreeMap;
use std::path::Path;

use furrow_schema::protocol::LEASE_MS;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{Store, unsigned};
use crate::view::Census;

/// Sweeps by state.
const SWEEPS: &str = "select state, count(*) from sweep where id not in (select sweep_id from unlisted) group by state";

/// Jobs by state, as sweeps list them.
const JOBS: &str = "select coalesce(sum(total), 0), coalesce(sum(done), 0), coalesce(sum(failed), 0),
        coalesce(sum(cancelled), 0), (select count(*) from job join cell_job on cell_job.job_id = job.id
            join cell on cell.id = cell_job.cell_id where job.state = 'leased'
                and cell.sweep_id not in (select sweep_id from unlisted))
    from sweep where id not in (select sweep_id from unlisted)";

/// Workers heard of since ?1, and incidents.
const OTHERS: &str = "select (select count(*) from worker where last_seen_ms >= ?1), (select count(*) from incident)";

/// Where the database is; empty in memory.
const FILE: &str = "select coalesce(file, '') from pragma_database_list where name = 'main'";

/// Writes the time.
const BEAT: &str = "update heartbeat set beat_ms = ?1";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[SWEEPS, JOBS, OTHERS, FILE, BEAT];

/// Writes the mark that the database can be written.
pub(crate) async fn beat(conn: &mut SqliteConnection, now_ms: i64) -> Result<(), StoreError> {
    sqlx::query(BEAT).bind(now_ms).execute(conn).await?;
    Ok(())
}

/// Counts.
pub(crate) async fn take(store: &Store, now_ms: i64) -> Result<Census, StoreError> {
    let mut conn = store.readers().acquire().await?;
    let sweeps: Vec<(String, i64)> = sqlx::query_as(SWEEPS).fetch_all(&mut *conn).await?;
    let jobs: (i64, i64, i64, i64, i64) = sqlx::query_as(JOBS).fetch_one(&mut *conn).await?;
    let (live, incidents): (i64, i64) = sqlx::query_as(OTHERS).bind(now_ms - LEASE_MS).fetch_one(&mut *conn).await?;
    let file: String = sqlx::query_scalar(FILE).fetch_one(&mut *conn).await?;
    drop(conn);
    let count = |number| unsigned::<u64>("a count", number);
    let sweeps = sweeps.into_iter().map(|(state, n)| Ok((state, count(n)?)));
    Ok(Census {
        sweeps: sweeps.collect::<Result<_, StoreError>>()?,
        jobs: by_state(jobs)?,
        workers_live: count(live)?,
        incidents: count(incidents)?,
        database_bytes: length(&file),
        wal_bytes: length(&format!("{file}-wal")),
    })
}

fn by_state(
    (total, done, failed, cancelled, leased): (i64, i64, i64, i64, i64),
) -> Result<BTreeMap<String, u64>, StoreError> {
    let queued = total - done - failed - cancelled - leased;
    let states = [("queued", queued), ("leased", leased), ("done", done), ("failed", failed), ("cancelled", cancelled)];
    states.into_iter().map(|(state, n)| Ok((state.to_owned(), unsigned("a count of jobs", n)?))).collect()
}

/// A file that is not there has none.
fn length(file: &str) -> u64 {
    std::fs::metadata(Path::new(file)).map_or(0, |metadata| metadata.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Bench, done, sweep};

    #[tokio::test]
    async fn everything_is_counted() {
        let folder = tempfile::tempdir().unwrap();
        let bench = Bench::over(Store::open(&folder.path().join("furrow.db")).await.unwrap());
        bench.submit(sweep(&["rgop", "rg"], 3)).await;
        let worker = bench.worker().await;
        let jobs = worker.claim(2).await;
        worker.ended(&jobs[0], done(1.0)).await;
        let census = bench.coordinator.census().await.unwrap();
        assert_eq!(census.sweeps, BTreeMap::from([("active".to_owned(), 1)]));
        let count = |state: &str| census.jobs[state];
        assert_eq!((count("queued"), count("leased"), count("done"), count("failed")), (4, 1, 1, 0));
        assert_eq!((census.workers_live, census.incidents), (1, 0));
        assert!(census.database_bytes > 0 && census.wal_bytes > 0, "{census:?}");
        assert_eq!(bench.coordinator.figures().recorded(), 1);
        assert!(bench.coordinator.figures().commits.snapshot().count >= 4);
        bench.clock.advance(LEASE_MS + 1);
        assert_eq!(bench.coordinator.census().await.unwrap().workers_live, 0);
        bench.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn a_beat_is_written_and_a_disk_that_takes_nothing_is_noticed() {
        let bench = Bench::new().await;
        bench.coordinator.beat().await.unwrap();
        let beaten: i64 =
            sqlx::query_scalar("select beat_ms from heartbeat").fetch_one(bench.store.readers()).await.unwrap();
        assert!(beaten > 0);
        sqlx::query("create trigger full before update on heartbeat begin select raise(abort, 'disk full'); end")
            .execute(bench.store.writer())
            .await
            .unwrap();
        assert!(matches!(bench.coordinator.beat().await, Err(StoreError::NotWritten(_))));
        bench.coordinator.shutdown().await;
        assert!(matches!(bench.coordinator.beat().await, Err(StoreError::Closed)));
    }
}
