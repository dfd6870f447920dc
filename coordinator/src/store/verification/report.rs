//! What workers say of jobs that they verify.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::id::{Digest, JobId};
use furrow_schema::job::RunRecord;
use furrow_schema::protocol::{RunEnd, RunReport};
use sqlx::SqliteConnection;

use super::judge::{Opinion, Verdict, judge};
use super::{MOST_FRUITLESS, given_up};
use crate::error::StoreError;
use crate::store::incident::Other;
use crate::store::{hash, to_json, unsigned};
use crate::view::VerificationState;

/// Verifications of jobs, who holds them, and what is on record.
const CASES: &str = "select verification.job_id, since_ms, fruitless, verification.attempt, holder.worker_id,
        recorder.worker_id, result.digest, worker.barred_ms is not null
    from json_each(?1) as wanted join verification on verification.job_id = wanted.value
        join result on result.job_id = verification.job_id join claim recorder on recorder.id = result.claim_id
        join worker on worker.id = recorder.worker_id
        left join claim holder on holder.id = verification.claim_id";

/// Opinions on jobs.
const OPINIONS: &str = "select job_id, attempt, worker_id, digest, worker.barred_ms is not null
    from json_each(?1) as wanted join opinion on job_id = wanted.value join worker on worker.id = worker_id";

/// Keeps opinions: job, attempt, worker, digest. The first of a handing-out stays.
const OPINE: &str = "insert into opinion (job_id, attempt, worker_id, digest, given_ms)
    select value ->> 0, value ->> 1, value ->> 2, unhex(value ->> 3), ?2 from json_each(?1) where true
    on conflict (job_id, attempt) do nothing";

/// Handings-out that ended: job, state, since, fruitless.
const SETTLE: &str = "update verification
    set state = value ->> 1, since_ms = value ->> 2, fruitless = value ->> 3,
        attempt = null, claim_id = null, lease_until_ms = null, running = 0
    from json_each(?1) where job_id = value ->> 0";

#[cfg(test)]
pub(in crate::store) const STATEMENTS: &[&str] = &[CASES, OPINIONS, OPINE, SETTLE];

/// The verifications that a batch of reports speaks of.
#[derive(Debug, Default)]
pub(crate) struct Cases(HashMap<JobId, Case>);

#[derive(Debug)]
struct Case {
    job: JobId,
    since_ms: i64,
    fruitless: i64,
    /// The present holder: attempt and worker.
    holder: Option<(u32, i64)>,
    on_record: Opinion,
    /// By attempt.
    later: BTreeMap<u32, Opinion>,
}

/// What is to be written and done.
#[derive(Debug, Default)]
pub(crate) struct Findings<'a> {
    opinions: Vec<(JobId, u32, i64, Digest)>,
    /// State, since when, and handings-out in vain, by job.
    ended: BTreeMap<JobId, (&'static str, i64, i64)>,
    /// Opinions that differ from what is on record.
    pub(crate) incidents: Vec<Other<'a>>,
    /// Workers to bar, by row, with the job that speaks against them.
    pub(crate) wrong: BTreeMap<i64, JobId>,
    /// Whether any waits again.
    pub(crate) waits: bool,
}

impl Cases {
    /// Reads the verifications of `jobs`.
    pub(crate) async fn load(conn: &mut SqliteConnection, jobs: &[JobId]) -> Result<Self, StoreError> {
        if jobs.is_empty() {
            return Ok(Self::default());
        }
        let jobs = to_json(&jobs);
        let rows: Vec<CaseRow> = sqlx::query_as(CASES).bind(&jobs).fetch_all(&mut *conn).await?;
        let case = |row: CaseRow| row.read().map(|case| (case.job, case));
        let mut cases = rows.into_iter().map(case).collect::<Result<HashMap<_, _>, StoreError>>()?;
        let rows: Vec<(i64, i64, i64, Vec<u8>, bool)> = sqlx::query_as(OPINIONS).bind(&jobs).fetch_all(conn).await?;
        for (job, attempt, worker, digest, barred) in rows {
            if let Some(case) = cases.get_mut(&JobId(job)) {
                let digest = Digest(hash("a digest", &digest)?);
                case.later.insert(unsigned("an attempt", attempt)?, Opinion { worker, digest, barred });
            }
        }
        Ok(Self(cases))
    }

    /// Hears what `worker` says of a run; nothing if that was no verification of its, otherwise whether its result is
    /// the one on record.
    pub(crate) fn hear<'a>(
        &mut self,
        run: &'a RunReport,
        worker: i64,
        now_ms: i64,
        findings: &mut Findings<'a>,
    ) -> Option<bool> {
        let case = self.0.get_mut(&run.job)?;
        let earlier = case.later.get(&run.attempt).filter(|opinion| opinion.worker == worker).map(|it| it.digest);
        if earlier.is_none() && case.holder != Some((run.attempt, worker)) {
            return None;
        }
        match &run.ended {
            RunEnd::Done(RunRecord { digest, outcome, metrics, .. }) => {
                match earlier {
                    None => {
                        case.holder = None;
                        case.opine(worker, run.attempt, *digest, now_ms, findings);
                    }
                    // The first opinion of a handing-out stays; who has two is wrong in one.
                    Some(earlier) if earlier != *digest => _ = findings.wrong.insert(worker, run.job),
                    Some(_) => {}
                }
                let differs = *digest != case.on_record.digest;
                let other = || Other(run.job, worker, run.attempt, *digest, outcome, metrics);
                findings.incidents.extend(differs.then(other));
                Some(!differs)
            }
            _ if earlier.is_some() => Some(false),
            RunEnd::Panicked { message } => {
                tracing::warn!(job = %run.job, worker, message, "a run that has a result panicked when it was verified");
                case.holder = None;
                case.in_vain(findings);
                Some(true)
            }
            RunEnd::HandedBack => {
                case.holder = None;
                case.end(VerificationState::Waits, findings);
                Some(true)
            }
        }
    }
}

/// A result that differs from the one on record and came unasked: from a past holder, or from the recorder itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Dispute {
    pub(crate) job: JobId,
    pub(crate) attempt: u32,
    pub(crate) worker: i64,
    pub(crate) digest: Digest,
}

impl Cases {
    /// Takes such results for opinions on jobs whose verification is open, or was.
    pub(crate) fn dispute(&mut self, disputes: &[Dispute], now_ms: i64, findings: &mut Findings<'_>) {
        for Dispute { job, attempt, worker, digest } in disputes {
            if let Some(case) = self.0.get_mut(job)
                && !case.later.contains_key(attempt)
            {
                case.opine(*worker, *attempt, *digest, now_ms, findings);
            }
        }
    }
}

impl Findings<'_> {
    /// Writes opinions, and how they leave the verifications.
    pub(crate) async fn write(&self, conn: &mut SqliteConnection, now_ms: i64) -> Result<(), StoreError> {
        if !self.opinions.is_empty() {
            sqlx::query(OPINE).bind(to_json(&self.opinions)).bind(now_ms).execute(&mut *conn).await?;
        }
        if !self.ended.is_empty() {
            let rows: Vec<_> = self.ended.iter().map(|(job, (state, since, vain))| (job, state, since, vain)).collect();
            sqlx::query(SETTLE).bind(to_json(&rows)).execute(conn).await?;
        }
        Ok(())
    }
}

impl Case {
    fn opine(&mut self, worker: i64, attempt: u32, digest: Digest, now_ms: i64, findings: &mut Findings<'_>) {
        self.later.insert(attempt, Opinion { worker, digest, barred: false });
        findings.opinions.push((self.job, attempt, worker, digest));
        let later: Vec<_> = self.later.values().copied().collect();
        let Verdict { state, wrong } = judge(self.on_record, &later);
        self.since_ms = now_ms;
        findings.wrong.extend(wrong.into_iter().map(|worker| (worker, self.job)));
        if state == VerificationState::Undecided {
            tracing::error!(job = %self.job, "its results differ and no digest has a majority: undecided");
        }
        // Somebody who verifies it meanwhile goes on with that.
        if state != VerificationState::Waits || self.holder.is_none() {
            self.end(state, findings);
        }
    }

    fn in_vain(&mut self, findings: &mut Findings<'_>) {
        self.fruitless += 1;
        let differ = self.later.values().any(|opinion| opinion.digest != self.on_record.digest);
        let state = match (self.fruitless < MOST_FRUITLESS, differ) {
            (true, _) => VerificationState::Waits,
            (false, true) => VerificationState::Undecided,
            (false, false) => VerificationState::GivenUp,
        };
        if state != VerificationState::Waits {
            given_up(self.job, state.as_str());
        }
        self.end(state, findings);
    }

    fn end(&mut self, state: VerificationState, findings: &mut Findings<'_>) {
        findings.waits |= state == VerificationState::Waits;
        findings.ended.insert(self.job, (state.as_str(), self.since_ms, self.fruitless));
    }
}

#[derive(sqlx::FromRow)]
struct CaseRow(i64, i64, i64, Option<i64>, Option<i64>, i64, Vec<u8>, bool);

impl CaseRow {
    fn read(self) -> Result<Case, StoreError> {
        let Self(job, since_ms, fruitless, attempt, holder, recorder, digest, barred) = self;
        let attempt = attempt.map(|attempt| unsigned("an attempt", attempt)).transpose()?;
        Ok(Case {
            job: JobId(job),
            since_ms,
            fruitless,
            holder: attempt.zip(holder),
            on_record: Opinion { worker: recorder, digest: Digest(hash("a digest", &digest)?), barred },
            later: BTreeMap::new(),
        })
    }
}
