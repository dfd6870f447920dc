//! Results: what workers say became of their jobs.
//!
//! The decision on each run is a plain function of where the job stands and who says it; the database is read
//! before and written after. The first valid result from anyone who was ever handed the job is recorded, once;
//! panics and hand-backs are heard only from the present holder.

use std::collections::HashMap;

use furrow_schema::id::{Digest, JobId};
use furrow_schema::job::{JobState, RunRecord};
use furrow_schema::protocol::{Recorded, Report, RunEnd, RunReport};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::incident::Other;
use crate::store::job::state_of;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::{hash, to_json, unsigned};
use crate::validate::PANIC_CHARS_KEPT;
use crate::view::AttemptEnd;

/// After so many panics a job is given up on.
pub(crate) const MAX_PANICS: u32 = 3;
/// After the first panic a job waits so long \[ms\], after each further one twice as long.
const BACK_OFF_MS: i64 = 1_000;

/// Where jobs stand, who holds them, and what is on record.
const STANDINGS: &str = "select job.id, job.state, job.attempt, job.panics, job.deaths, job.claim_id, holder.worker_id,
        result.digest, result.attempt, recorder.worker_id
    from json_each(?1) as wanted join job on job.id = wanted.value
        left join claim holder on holder.id = job.claim_id
        left join result on result.job_id = job.id left join claim recorder on recorder.id = result.claim_id
    where job.engine_id = ?2";

/// Past handings-out of jobs.
const PAST: &str = "select attempt.job_id, attempt.attempt, attempt.claim_id, claim.worker_id, attempt.ended
    from json_each(?1) as wanted join attempt on attempt.job_id = wanted.value
        join claim on claim.id = attempt.claim_id";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[STANDINGS, PAST];

/// A handing-out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Holding {
    attempt: u32,
    worker: i64,
    claim: i64,
    end: AttemptEnd,
}

/// Where a job stands.
#[derive(Debug)]
struct Standing {
    job: JobId,
    state: JobState,
    charges: Charges,
    /// The present holder, while leased.
    holder: Option<Holding>,
    /// The result on record, with its attempt and worker.
    on_record: Option<(Digest, u32, i64)>,
    past: Vec<Holding>,
}

/// What a worker is to a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standpoint {
    /// It holds the job under this attempt.
    Holder(Holding),
    /// It held the job under this attempt.
    Past(Holding),
    /// Its result of this attempt is on record.
    Recorder,
    /// It was never handed this attempt.
    Stranger,
}

/// Takes in the reports of a batch: each with the worker that sent it. Answers in the same order.
pub(crate) async fn record(
    conn: &mut SqliteConnection,
    reports: &[(i64, &Report)],
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<Vec<Recorded>, StoreError> {
    let mut standings = standings(conn, reports, engine_id).await?;
    let mut changes = Changes::default();
    let mut answers = Vec::with_capacity(reports.len());
    for (worker, report) in reports {
        let mut answer = Recorded::default();
        for run in &report.runs {
            let standing = standings.get_mut(&run.job);
            let accepted = standing.is_some_and(|standing| standing.decide(run, *worker, now_ms, &mut changes));
            if accepted { answer.recorded.push(run.job) } else { answer.ignored.push(run.job) }
        }
        answers.push(answer);
    }
    changes.write(conn, engine_id, now_ms, tally).await?;
    Ok(answers)
}

impl Standing {
    /// Decides on one run as `worker` tells it; true if what it tells is now on record or was already.
    fn decide<'a>(&mut self, run: &'a RunReport, worker: i64, now_ms: i64, changes: &mut Changes<'a>) -> bool {
        match (&run.ended, self.standpoint(worker, run.attempt)) {
            (_, Standpoint::Stranger) => false,
            (RunEnd::Done(record), standpoint) => self.done(record, worker, run.attempt, standpoint, changes),
            (RunEnd::Panicked { message }, Standpoint::Holder(holding)) => {
                self.panicked(holding, message, now_ms, changes);
                true
            }
            (RunEnd::HandedBack, Standpoint::Holder(holding)) => {
                self.release(holding, AttemptEnd::HandedBack, None, changes);
                changes.requeue(self.job, 0, self.charges);
                self.state = JobState::Queued;
                true
            }
            (RunEnd::Panicked { .. }, Standpoint::Past(past)) => past.end == AttemptEnd::Panicked,
            (RunEnd::HandedBack, Standpoint::Past(past)) => past.end == AttemptEnd::HandedBack,
            (RunEnd::Panicked { .. } | RunEnd::HandedBack, Standpoint::Recorder) => false,
        }
    }

    fn standpoint(&self, worker: i64, attempt: u32) -> Standpoint {
        let same = |holding: &&Holding| holding.worker == worker && holding.attempt == attempt;
        if let Some(holding) = self.holder.as_ref().filter(same) {
            return Standpoint::Holder(*holding);
        }
        if self.on_record.is_some_and(|(_, by_attempt, by_worker)| (by_worker, by_attempt) == (worker, attempt)) {
            return Standpoint::Recorder;
        }
        self.past.iter().find(same).map_or(Standpoint::Stranger, |past| Standpoint::Past(*past))
    }

    fn done<'a>(
        &mut self,
        record: &'a RunRecord,
        worker: i64,
        attempt: u32,
        standpoint: Standpoint,
        changes: &mut Changes<'a>,
    ) -> bool {
        if let Some((digest, ..)) = self.on_record {
            if digest != record.digest {
                let RunRecord { digest, outcome, metrics, .. } = record;
                changes.incident(Other(self.job, worker, attempt, *digest, outcome, metrics));
            }
            return digest == record.digest;
        }
        let claim = match standpoint {
            Standpoint::Holder(holding) => {
                self.holder = None;
                holding.claim
            }
            Standpoint::Past(past) => past.claim,
            Standpoint::Recorder | Standpoint::Stranger => return false,
        };
        if let Some(other) = self.holder {
            self.release(other, AttemptEnd::Superseded, None, changes);
        }
        changes.record(self.job, self.state, claim, attempt, record);
        self.state = JobState::Done;
        self.on_record = Some((record.digest, attempt, worker));
        true
    }

    fn panicked(&mut self, holding: Holding, message: &str, now_ms: i64, changes: &mut Changes<'_>) {
        let reason = message.chars().take(PANIC_CHARS_KEPT).collect();
        self.release(holding, AttemptEnd::Panicked, Some(reason), changes);
        self.charges.panics += 1;
        if self.charges.panics >= MAX_PANICS {
            changes.fail(self.job, self.charges);
            self.state = JobState::Failed;
        } else {
            let wait_ms = BACK_OFF_MS << (self.charges.panics - 1);
            changes.requeue(self.job, now_ms + wait_ms, self.charges);
            self.state = JobState::Queued;
        }
    }

    /// The present holder becomes a past one.
    fn release(&mut self, holding: Holding, end: AttemptEnd, reason: Option<String>, changes: &mut Changes<'_>) {
        changes.archive(self.job, holding.attempt, holding.claim, end, reason);
        self.past.push(Holding { end, ..holding });
        self.holder = None;
    }
}

async fn standings(
    conn: &mut SqliteConnection,
    reports: &[(i64, &Report)],
    engine_id: i64,
) -> Result<HashMap<JobId, Standing>, StoreError> {
    let mut jobs: Vec<JobId> = reports.iter().flat_map(|(_, report)| &report.runs).map(|run| run.job).collect();
    jobs.sort_unstable();
    jobs.dedup();
    if jobs.is_empty() {
        return Ok(HashMap::new());
    }
    let rows: Vec<StandingRow> =
        sqlx::query_as(STANDINGS).bind(to_json(&jobs)).bind(engine_id).fetch_all(&mut *conn).await?;
    let standing = |row: StandingRow| row.read().map(|standing| (standing.job, standing));
    let mut standings = rows.into_iter().map(standing).collect::<Result<HashMap<_, _>, _>>()?;
    add_past(conn, &mut standings, reports).await?;
    Ok(standings)
}

/// Reads past handings-out of the jobs that somebody else than the present holder speaks of: few, as a rule.
async fn add_past(
    conn: &mut SqliteConnection,
    standings: &mut HashMap<JobId, Standing>,
    reports: &[(i64, &Report)],
) -> Result<(), StoreError> {
    let runs = reports.iter().flat_map(|(worker, report)| report.runs.iter().map(|run| (*worker, run)));
    let mut wanted: Vec<JobId> = runs
        .filter(|(worker, run)| {
            let standing = standings.get(&run.job);
            standing.is_some_and(|standing| standing.standpoint(*worker, run.attempt) == Standpoint::Stranger)
        })
        .map(|(_, run)| run.job)
        .collect();
    wanted.sort_unstable();
    wanted.dedup();
    if wanted.is_empty() {
        return Ok(());
    }
    let rows: Vec<(i64, i64, i64, i64, String)> = sqlx::query_as(PAST).bind(to_json(&wanted)).fetch_all(conn).await?;
    for (job, attempt, claim, worker, ended) in rows {
        let attempt = unsigned("an attempt", attempt)?;
        let end =
            AttemptEnd::from_word(&ended).ok_or_else(|| StoreError::Damaged(format!("an attempt ended `{ended}`")))?;
        if let Some(standing) = standings.get_mut(&JobId(job)) {
            standing.past.push(Holding { attempt, worker, claim, end });
        }
    }
    Ok(())
}

#[derive(sqlx::FromRow)]
struct StandingRow(i64, String, i64, i64, i64, Option<i64>, Option<i64>, Option<Vec<u8>>, Option<i64>, Option<i64>);

impl StandingRow {
    fn read(self) -> Result<Standing, StoreError> {
        let Self(job, state, attempt, panics, deaths, claim, worker, digest, by_attempt, by_worker) = self;
        let attempt = unsigned("an attempt", attempt)?;
        let holder = claim.zip(worker).map(|(claim, worker)| Holding { attempt, worker, claim, end: AttemptEnd::Open });
        let on_record = match (digest, by_attempt, by_worker) {
            (Some(digest), Some(by_attempt), Some(by_worker)) => {
                Some((Digest(hash("a digest", &digest)?), unsigned("an attempt", by_attempt)?, by_worker))
            }
            _ => None,
        };
        Ok(Standing {
            job: JobId(job),
            state: state_of(&state)?,
            charges: Charges { panics: unsigned("panics", panics)?, deaths: unsigned("deaths", deaths)? },
            holder,
            on_record,
            past: Vec::new(),
        })
    }
}

#[cfg(test)]
mod tests;
