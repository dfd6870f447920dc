//! A time in which the database cannot be written, or in which this process stood still: not held against workers. A
//! damaged file ends it all.

use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::time::Duration;

use crate::config::Config;
use crate::error::StoreError;

/// When housekeeping is so late, this process was stopped or its machine slept: nobody could renew meanwhile \[ms\].
const STANDSTILL_MS: i64 = 5_000;

/// Whether the database can be written.
#[derive(Debug, Default)]
pub(super) struct Outage {
    lasts: AtomicBool,
    for_good: AtomicBool,
    /// Until then no lease runs out: those who hold one could not renew it [ms since 1970].
    leases_hold_until_ms: AtomicI64,
    /// When housekeeping was last done, or is to be done first [ms since 1970].
    kept_house_ms: AtomicI64,
}

impl Outage {
    /// Housekeeping begins at `first_ms`. Later is a standstill, too.
    pub(super) fn keeping_house_from(first_ms: i64) -> Self {
        Self { kept_house_ms: AtomicI64::new(first_ms), ..Self::default() }
    }

    /// Something could not be written.
    pub(super) fn note(&self, error: &StoreError, now_ms: i64) {
        if !error.concerns_all() {
            return tracing::error!(%error, "could not write");
        }
        if matches!(error, StoreError::Broken(_)) && !self.for_good.swap(true, Ordering::Relaxed) {
            return tracing::error!(%error, "the coordinator stops: serve a backup of the database");
        }
        let back_within_ms = Config::WORKERS_ARE_BACK_WITHIN.as_millis() as i64;
        self.leases_hold_until_ms.store(now_ms + back_within_ms, Ordering::Relaxed);
        if self.lasts.swap(true, Ordering::Relaxed) {
            tracing::debug!(%error, "still cannot write");
        } else {
            tracing::error!(%error, "cannot write; whoever asks is refused until it works again");
        }
    }

    /// Housekeeping is done. After a standstill no lease ends for `hold`, in which workers renew.
    pub(super) fn keeps_house(&self, hold: Duration, now_ms: i64) {
        let last_ms = self.kept_house_ms.swap(now_ms, Ordering::Relaxed);
        if now_ms - last_ms > STANDSTILL_MS && !hold.is_zero() {
            tracing::warn!("this process stood still: no lease ends before its workers had time to renew");
            self.leases_hold_until_ms.fetch_max(now_ms + hold.as_millis() as i64, Ordering::Relaxed);
        }
    }

    /// Something was written.
    pub(super) fn over(&self) {
        if self.lasts.swap(false, Ordering::Relaxed) {
            tracing::info!("the database can be written again");
        }
    }

    /// Whether there is no use in going on.
    pub(super) fn is_for_good(&self) -> bool {
        self.for_good.load(Ordering::Relaxed)
    }

    /// Whether leases hold, whatever the clock says.
    pub(super) fn leases_hold(&self, now_ms: i64) -> bool {
        now_ms < self.leases_hold_until_ms.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use furrow_schema::protocol::{
        HeldJob, LEASE_MS, LeasedJob, Recorded, Refusal, Renew, Reply, Report, RunEnd, RunReport,
    };
    use furrow_schema::sweep::SweepState;
    use futures::future::join_all;

    use super::*;
    use crate::store::Store;
    use crate::testing::{Bench, ENGINE, Worker, done, sweep};
    use crate::view::SweepChange;

    /// Lets the database grow by no page, as on a full disk, or again without end.
    async fn fill_disk(bench: &Bench, full: bool) {
        let mut conn = bench.store.writer().acquire().await.unwrap();
        let pages: i64 = sqlx::query_scalar("pragma page_count").fetch_one(&mut *conn).await.unwrap();
        let most = if full { pages } else { 1 << 30 };
        let limit = sqlx::AssertSqlSafe(format!("pragma max_page_count = {most}"));
        sqlx::query(limit).execute(&mut *conn).await.unwrap();
    }

    async fn finish(worker: &Worker, bench: &Bench, job: &LeasedJob) -> Reply<Recorded> {
        // Large enough to need new pages.
        let RunEnd::Done(mut record) = done(job.seed as f64) else { unreachable!() };
        record.trajectory = Some("5a".repeat(40_000));
        let ended = RunEnd::Done(record);
        let runs = vec![RunReport { job: job.job, attempt: job.attempt, ended }];
        bench.coordinator.result(worker.call(Report { engine: ENGINE, runs })).await
    }

    #[test]
    fn no_lease_ends_right_after_a_standstill() {
        let (outage, hold) = (Outage::keeping_house_from(1_000), Duration::from_secs(10));
        for now_ms in [1_000, 2_000, 6_900] {
            outage.keeps_house(hold, now_ms);
            assert!(!outage.leases_hold(now_ms), "{now_ms}");
        }
        outage.keeps_house(hold, 40_000);
        assert!(outage.leases_hold(49_999) && !outage.leases_hold(50_000));
    }

    #[test]
    fn a_standstill_is_one_before_the_first_housekeeping_too() {
        let (outage, hold) = (Outage::keeping_house_from(10_000), Duration::from_secs(10));
        outage.keeps_house(hold, 40_000);
        assert!(outage.leases_hold(49_999) && !outage.leases_hold(50_000));
    }

    async fn goes_through_a_full_disk(bench: Bench) {
        let id = bench.submit(sweep(&["rgop"], 40)).await.id;
        let worker = bench.worker().await;
        let jobs = worker.claim(20).await;
        fill_disk(&bench, true).await;
        for _ in 0..3 {
            // A renewal alone would need no room: it is of the same batch.
            let held = jobs.iter().map(|job| HeldJob { job: job.job, attempt: job.attempt, running: true }).collect();
            let renewal = bench.coordinator.renew(worker.call(Renew { held }));
            let reports = join_all(jobs.iter().map(|job| finish(&worker, &bench, job)));
            let (answers, renewed) = tokio::join!(reports, renewal);
            assert!(matches!(renewed, Reply::Refused(Refusal::Unavailable { .. })), "{renewed:?}");
            for answer in answers {
                let refused = answer.into_result().unwrap_err();
                assert!(matches!(&refused, Refusal::Unavailable { detail } if detail.contains("full")), "{refused:?}");
            }
        }
        let submitted = bench.coordinator.submit(sweep(&["rg"], 1_900)).await;
        assert!(matches!(submitted, Err(StoreError::Full)), "{submitted:?}");
        let submitted = bench.coordinator.submit(sweep(&["rg"], 9_000)).await;
        assert!(matches!(submitted, Err(StoreError::Full)), "{submitted:?}");
        assert_eq!(bench.sweep(id).await.done, 0);

        fill_disk(&bench, false).await;
        let answers = join_all(jobs.iter().map(|job| finish(&worker, &bench, job))).await;
        assert!(answers.into_iter().all(|answer| answer.into_result().unwrap().recorded.len() == 1));
        bench.coordinator.keep_house().await.unwrap();
        let paused = SweepChange { priority: None, paused: Some(true) };
        assert_eq!(bench.coordinator.change(id, paused).await.unwrap().unwrap().state, SweepState::Paused);
        assert_eq!((bench.sweep(id).await.done, bench.sweep(id).await.queued), (20, 20));
        bench.assert_consistent().await;
    }

    #[tokio::test]
    async fn all_are_refused_while_the_disk_is_full_and_it_goes_on_by_itself() {
        goes_through_a_full_disk(Bench::new().await).await;
    }

    #[tokio::test]
    async fn a_file_goes_through_a_full_disk() {
        let folder = tempfile::tempdir().unwrap();
        let bench = Bench::over(Store::open(&folder.path().join("furrow.db")).await.unwrap());
        goes_through_a_full_disk(bench).await;
    }

    #[tokio::test]
    async fn no_lease_runs_out_because_it_could_not_be_renewed() {
        let bench = Bench::new().await;
        let id = bench.submit(sweep(&["rgop"], 1)).await.id;
        let worker = bench.worker().await;
        let jobs = worker.claim(1).await;
        fill_disk(&bench, true).await;
        bench.clock.advance(LEASE_MS + 1_000);
        assert!(finish(&worker, &bench, &jobs[0]).await.into_result().is_err());
        fill_disk(&bench, false).await;
        bench.pass(9_000).await;
        assert_eq!(bench.sweep(id).await.leased, 1);
        bench.pass(1_001).await;
        assert_eq!(bench.sweep(id).await.queued, 1);
    }

    #[tokio::test]
    async fn a_file_that_is_damaged_while_in_use_stops_the_coordinator() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let bench = Bench::over(Store::open(&path).await.unwrap());
        bench.submit(sweep(&["rgop"], 500)).await;
        let worker = bench.worker().await;
        // All of it goes into the file, and nothing is kept in memory.
        for pragma in ["pragma wal_checkpoint(truncate)", "pragma shrink_memory"] {
            sqlx::query(pragma).execute(bench.store.writer()).await.unwrap();
        }
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        let bytes = file.metadata().unwrap().len() as usize - 4_096;
        std::os::unix::fs::FileExt::write_all_at(&file, &vec![0xff; bytes], 4_096).unwrap();
        let refused = bench.coordinator.claim(worker.claim_call(1)).await.into_result().unwrap_err();
        assert!(matches!(&refused, Refusal::Unavailable { detail } if detail.contains("damaged")), "{refused:?}");
        bench.coordinator.ended().await;
        assert!(matches!(bench.coordinator.keep_house().await, Err(StoreError::Closed)));
        let again = Store::open(&path).await.unwrap_err();
        assert!(matches!(again, StoreError::Corrupt { .. }), "{again}");
    }
}
