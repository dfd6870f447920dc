//! Results: what workers say became of their jobs.
//!
//! The decision on each run is a plain function of where the job stands and who says it; the database is read
//! before and written after. The first valid result from anyone who was ever handed the job is recorded, once;
//! panics and hand-backs are heard only from the present holder.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::id::{Digest, JobId, JobKey};
use furrow_schema::job::{JobState, RunRecord};
use furrow_schema::protocol::{Recorded, Report, RunEnd, RunReport};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::back_off::back_off_ms;
use crate::store::incident::Other;
use crate::store::job::state_of;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::verification::{self, Cases, Dispute, Findings, is_chosen};
use crate::store::{expiry, hash, to_json, unsigned, worker};
use crate::validate::PANIC_CHARS_KEPT;
use crate::view::AttemptEnd;

/// After so many panics a job is given up on.
pub(crate) const MAX_PANICS: u32 = 3;

/// Where jobs stand, who holds them, and what is on record.
const STANDINGS: &str =
    "select job.id, job.key, job.alone, job.state, job.attempt, job.panics, job.deaths, job.claim_id, holder.worker_id,
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
    key: JobKey,
    /// Whether it measures times.
    alone: bool,
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

/// What reports changed beside jobs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Aftermath {
    /// A worker was barred.
    pub(crate) barred: bool,
    /// There is something to verify.
    pub(crate) to_verify: bool,
}

/// Takes in the reports of a batch: each with the worker that sent it. Answers in the same order. A `share` of the
/// results is to be verified.
pub(crate) async fn record(
    conn: &mut SqliteConnection,
    reports: &[(i64, &Report)],
    share: f64,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<(Vec<Recorded>, Aftermath), StoreError> {
    let (mut standings, mut cases) = standings(conn, reports, engine_id).await?;
    let (mut changes, mut findings, mut doubts) = (Changes::default(), Findings::default(), Doubts::default());
    let mut answers = Vec::with_capacity(reports.len());
    for (worker, report) in reports {
        let mut answer = Recorded::default();
        for run in &report.runs {
            let accepted = match standings.get_mut(&run.job) {
                None => false,
                Some(standing) if standing.standpoint(*worker, run.attempt) == Standpoint::Stranger => {
                    cases.hear(run, *worker, now_ms, &mut findings).unwrap_or(false)
                }
                Some(standing) => {
                    let was = standing.state;
                    let accepted = standing.decide(run, *worker, now_ms, &mut changes);
                    standing.doubt(run, *worker, was, share, &mut doubts);
                    accepted
                }
            };
            if accepted { answer.recorded.push(run.job) } else { answer.ignored.push(run.job) }
        }
        answers.push(answer);
    }
    findings.incidents.drain(..).for_each(|other| changes.incident(other));
    changes.write(conn, engine_id, now_ms, tally).await?;
    let aftermath = doubts.follow(conn, findings, engine_id, now_ms, tally).await?;
    Ok((answers, aftermath))
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

    /// Notes what is to be verified after a run was decided on; the job was in state `was` before.
    fn doubt(&self, run: &RunReport, worker: i64, was: JobState, share: f64, doubts: &mut Doubts) {
        let RunEnd::Done(record) = &run.ended else { return };
        let Some((digest, ..)) = self.on_record.filter(|_| share > 0.0 && !self.alone) else { return };
        if digest != record.digest {
            let (job, attempt, digest) = (run.job, run.attempt, record.digest);
            doubts.disputes.push(Dispute { job, attempt, worker, digest });
        } else if was != JobState::Done && is_chosen(&self.key, share) {
            doubts.chosen.push(run.job);
        }
    }

    fn panicked(&mut self, holding: Holding, message: &str, now_ms: i64, changes: &mut Changes<'_>) {
        let reason = message.chars().take(PANIC_CHARS_KEPT).collect();
        self.release(holding, AttemptEnd::Panicked, Some(reason), changes);
        self.charges.panics += 1;
        if self.charges.panics >= MAX_PANICS {
            changes.fail(self.job, self.charges);
            self.state = JobState::Failed;
        } else {
            let wait_ms = back_off_ms(&self.key, holding.attempt, self.charges.panics);
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

/// Results to be verified.
#[derive(Debug, Default)]
struct Doubts {
    /// By their keys.
    chosen: Vec<JobId>,
    /// Because another result came.
    disputes: Vec<Dispute>,
}

impl Doubts {
    /// Writes what was found, opens new verifications, and bars workers that were wrong.
    async fn follow(
        self,
        conn: &mut SqliteConnection,
        mut findings: Findings<'_>,
        engine_id: i64,
        now_ms: i64,
        tally: &mut Tally,
    ) -> Result<Aftermath, StoreError> {
        findings.write(conn, now_ms).await?;
        let disputed: Vec<_> = self.disputes.iter().map(|dispute| dispute.job).collect();
        verification::open(conn, &[self.chosen.as_slice(), &disputed].concat(), now_ms).await?;
        if !disputed.is_empty() {
            let mut further = Findings::default();
            Cases::load(conn, &disputed).await?.dispute(&self.disputes, now_ms, &mut further);
            further.write(conn, now_ms).await?;
            findings.wrong.append(&mut further.wrong);
            findings.waits |= further.waits;
        }
        let barred = bar(conn, &findings.wrong, engine_id, now_ms, tally).await?;
        let to_verify = barred || findings.waits || !self.chosen.is_empty();
        Ok(Aftermath { barred, to_verify })
    }
}

/// Bars workers, each for what it said of a job: what they hold goes to others, and all their results are doubted.
/// True if one of them was not barred before.
async fn bar(
    conn: &mut SqliteConnection,
    wrong: &BTreeMap<i64, JobId>,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<bool, StoreError> {
    if wrong.is_empty() {
        return Ok(false);
    }
    let reason = |job| format!("its result of job {job} is not the one that others have, or that it had before");
    let rows: Vec<_> = wrong.iter().map(|(worker, job)| (*worker, reason(job))).collect();
    let barred = worker::bar(conn, &rows, now_ms).await?;
    for worker in &barred {
        expiry::free(conn, *worker, engine_id, now_ms, tally).await?;
        verification::doubt(conn, *worker, now_ms).await?;
    }
    Ok(!barred.is_empty())
}

async fn standings(
    conn: &mut SqliteConnection,
    reports: &[(i64, &Report)],
    engine_id: i64,
) -> Result<(HashMap<JobId, Standing>, Cases), StoreError> {
    let mut jobs: Vec<JobId> = reports.iter().flat_map(|(_, report)| &report.runs).map(|run| run.job).collect();
    jobs.sort_unstable();
    jobs.dedup();
    if jobs.is_empty() {
        return Ok((HashMap::new(), Cases::default()));
    }
    let rows: Vec<StandingRow> =
        sqlx::query_as(STANDINGS).bind(to_json(&jobs)).bind(engine_id).fetch_all(&mut *conn).await?;
    let standing = |row: StandingRow| row.read().map(|standing| (standing.job, standing));
    let mut standings = rows.into_iter().map(standing).collect::<Result<HashMap<_, _>, _>>()?;
    let strangers = of_strangers(&standings, reports);
    add_past(conn, &mut standings, &strangers).await?;
    let cases = Cases::load(conn, &strangers).await?;
    Ok((standings, cases))
}

/// The jobs that somebody else than the present holder speaks of: few, as a rule.
fn of_strangers(standings: &HashMap<JobId, Standing>, reports: &[(i64, &Report)]) -> Vec<JobId> {
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
    wanted
}

/// Reads past handings-out of jobs.
async fn add_past(
    conn: &mut SqliteConnection,
    standings: &mut HashMap<JobId, Standing>,
    wanted: &[JobId],
) -> Result<(), StoreError> {
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
struct StandingRow(
    i64,
    Vec<u8>,
    bool,
    String,
    i64,
    i64,
    i64,
    Option<i64>,
    Option<i64>,
    Option<Vec<u8>>,
    Option<i64>,
    Option<i64>,
);

impl StandingRow {
    fn read(self) -> Result<Standing, StoreError> {
        let Self(job, key, alone, state, attempt, panics, deaths, claim, worker, digest, by_attempt, by_worker) = self;
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
            key: JobKey(hash("a job's key", &key)?),
            alone,
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
