//! Many worker sessions at once, each with a lease that it renews as often as it is asked to.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use furrow_schema::id::EngineId;
use furrow_schema::protocol::{HeldJob, LeasedJob, Renew};
use furrow_worker::{Link, ZenohLink};
use futures::{StreamExt, TryStreamExt, stream};
use serde::{Deserialize, Serialize};
use tokio::sync::{Semaphore, watch};
use tokio::time::{Instant, MissedTickBehavior, interval};

use super::worker::{Myself, Trouble, connect};
use crate::cli::error::CliError;

/// So many of a process's sessions come in at a time.
const AT_A_TIME: usize = 16;

/// What sessions saw.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Seen {
    /// Sessions that were open at once.
    pub sessions: u64,
    /// Renewals that were answered.
    pub renewals: u64,
    /// Renewals that had no answer, or were not even asked, when the next one was due.
    pub missed: u64,
    /// Leases that the coordinator took back.
    pub lost: u64,
    /// The longest that a renewal took, with or without an answer \[ms\].
    pub slowest_ms: u64,
}

impl Seen {
    /// Both together, which were at the same time.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            sessions: self.sessions + other.sessions,
            renewals: self.renewals + other.renewals,
            missed: self.missed + other.missed,
            lost: self.lost + other.lost,
            slowest_ms: self.slowest_ms.max(other.slowest_ms),
        }
    }
}

/// A session that holds a job.
struct Session {
    link: ZenohLink,
    myself: Myself,
    job: LeasedJob,
    renew_every: Duration,
}

/// Opens `sessions` sessions, each of which claims a job, renews its lease until all have been open for `time`, and reports
/// it.
///
/// # Errors
/// There is no coordinator, it refuses, or it has too few jobs.
pub async fn hold(endpoint: &str, engine: EngineId, sessions: usize, time: Duration) -> Result<Seen, CliError> {
    let turns = Semaphore::new(AT_A_TIME);
    let (open, until) = (AtomicUsize::new(0), watch::Sender::new(None));
    let whole = async |_| {
        let turn = turns.acquire().await.expect("never closed");
        let session = Session::open(endpoint, engine).await?;
        drop(turn);
        if open.fetch_add(1, Ordering::Relaxed) + 1 == sessions {
            until.send_replace(Some(Instant::now() + time));
        }
        let seen = session.hold(&until, engine).await.map_err(CliError::failed("a session"))?;
        session.link.close().await;
        Ok(seen)
    };
    let all = stream::iter(0..sessions).map(whole).buffer_unordered(sessions.max(1));
    all.try_fold(Seen::default(), async |all, one| Ok(all.and(one))).await
}

impl Session {
    async fn open(endpoint: &str, engine: EngineId) -> Result<Self, CliError> {
        let link = connect(endpoint).await?;
        let myself = Myself::new();
        let job = async {
            let welcome = myself.introduce(&link, engine).await?;
            let leases = myself.claim_one(&link, engine, Vec::new()).await?;
            Ok::<_, Trouble>((leases.jobs.into_iter().next(), Duration::from_millis(welcome.renew_every_ms)))
        };
        let (job, renew_every) = job.await.map_err(CliError::failed("a session"))?;
        let job = job.ok_or_else(|| CliError::Failed("there are fewer jobs than sessions".to_owned()))?;
        Ok(Self { link, myself, job, renew_every })
    }

    async fn hold(&self, until: &watch::Sender<Option<Instant>>, engine: EngineId) -> Result<Seen, Trouble> {
        let mut seen = Seen { sessions: 1, ..Seen::default() };
        let mut ticks = interval(self.renew_every);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        while until.borrow().is_none_or(|until| Instant::now() < until) {
            ticks.tick().await;
            self.renew(&mut seen).await?;
        }
        self.myself.report(&self.link, engine, &self.job).await?;
        Ok(seen)
    }

    async fn renew(&self, seen: &mut Seen) -> Result<(), Trouble> {
        let held = vec![HeldJob { job: self.job.job, attempt: self.job.attempt, running: true }];
        let asked = Instant::now();
        let answer = self.link.renew(self.myself.call(Renew { held })).await;
        let took = asked.elapsed();
        let due = took.as_nanos() / self.renew_every.as_nanos().max(1);
        seen.slowest_ms = seen.slowest_ms.max(took.as_millis() as u64);
        match answer {
            Ok(reply) => {
                seen.renewals += 1;
                seen.missed += due as u64;
                seen.lost += reply.into_result()?.lost.len() as u64;
            }
            Err(_) => seen.missed += 1 + due as u64,
        }
        Ok(())
    }
}
