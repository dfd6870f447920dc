//! What the coordinator said so far, and what must never be said after that.

use std::collections::{BTreeMap, BTreeSet};

use furrow_schema::id::{Digest, JobId, RequestId, ScenarioId, WorkerId};
use furrow_schema::protocol::{
    Call, Claim, LEASE_MS, LeasedJob, Leases, Recorded, Renew, Renewed, Report, RunEnd, RunReport,
};

use super::jobs::Wish;

/// A lease may be so much older than the last renewal.
const GRAIN_MS: i64 = 5_000;

/// A handing-out: job and attempt.
pub(super) type Lease = (JobId, u32);

/// How a handing-out ended, as far as it was told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Told {
    Done,
    Panicked,
    HandedBack,
}

#[derive(Debug)]
struct Held {
    worker: WorkerId,
    /// When it was handed out or renewed last.
    heard_ms: i64,
    /// Whether its worker said that it runs.
    runs: bool,
    told: Option<Told>,
    /// Whether a user may have cancelled it.
    cancelled: bool,
    /// Whether another process took the place of the one that held it.
    left: bool,
}

/// What a user asked for, and whether jobs may be handed out for it, as far as is known.
#[derive(Debug)]
struct Asked {
    wish: Wish,
    may_run: bool,
    is_cancelled: bool,
}

/// See the module. Each method says what is broken.
#[derive(Debug, Default)]
pub(super) struct Ledger {
    /// By the number of the wish.
    asked: BTreeMap<usize, Asked>,
    held: BTreeMap<Lease, Held>,
    newest: BTreeMap<JobId, u32>,
    granted: BTreeMap<RequestId, BTreeSet<Lease>>,
    /// First claims of processes.
    began: BTreeSet<RequestId>,
    on_record: BTreeMap<JobId, Digest>,
    /// Jobs that a user may have removed.
    removed: BTreeSet<JobId>,
    /// Times in which no lease may end: after, before [ms].
    grace: Vec<(i64, i64)>,
    /// Runs that ended and were spooled.
    finished: BTreeSet<Lease>,
    /// Runs whose end was told.
    told: BTreeSet<Lease>,
    pub(super) scenarios: BTreeMap<ScenarioId, String>,
}

impl Ledger {
    /// A process claims for the first time: what an earlier one of the worker held is free. The same claim that comes again
    /// later must not take anything from the process that made it.
    pub(super) fn begins(&mut self, call: &Call<Claim>) {
        if self.began.insert(call.request.clone()) {
            let of_it = self.held.values_mut().filter(|held| held.worker == call.worker);
            of_it.for_each(|held| held.left = true);
        }
    }

    pub(super) fn claimed(&mut self, call: &Call<Claim>, leases: &Leases, now_ms: i64) -> Vec<String> {
        for text in &leases.scenarios {
            self.scenarios.insert(text.id, text.json.clone());
        }
        let mut broken = Vec::new();
        let granted: BTreeSet<Lease> = leases.jobs.iter().map(|job| (job.job, job.attempt)).collect();
        if let Some(before) = self.granted.get(&call.request).filter(|before| !granted.is_subset(before)) {
            broken.push(format!("a claim that came again got {granted:?} after {before:?}"));
        }
        for job in &leases.jobs {
            broken.extend(self.leased(call, job, now_ms));
        }
        if !granted.is_empty() {
            self.granted.entry(call.request.clone()).or_insert(granted);
        }
        broken
    }

    fn leased(&mut self, call: &Call<Claim>, job: &LeasedJob, now_ms: i64) -> Vec<String> {
        let lease = (job.job, job.attempt);
        let mut broken = Vec::new();
        if self.on_record.contains_key(&job.job) {
            broken.push(format!("{lease:?} is handed out although its result was acknowledged"));
        }
        if let Some(held) = self.held.get(&lease) {
            if held.worker != call.worker {
                broken.push(format!("{lease:?} is handed to a second worker"));
            }
            return broken;
        }
        let text = self.scenarios.get(&job.scenario).map_or("", String::as_str);
        if !self.asked.values().any(|asked| asked.may_run && asked.wish.covers(text, job.seed)) {
            broken.push(format!("{lease:?} is handed out although nobody wants it now"));
        }
        let before = self.newest.insert(job.job, job.attempt).unwrap_or(0);
        if job.attempt != before + 1 {
            broken.push(format!("{lease:?} comes after attempt {before}"));
        }
        if self.held.get(&(job.job, before)).is_some_and(|held| !held.is_over(now_ms)) {
            broken.push(format!("{lease:?} is handed out while attempt {before} is alive"));
        }
        let worker = call.worker.clone();
        let held = Held { worker, heard_ms: now_ms, runs: false, told: None, cancelled: false, left: false };
        self.held.insert(lease, held);
        broken
    }

    pub(super) fn renewed(&mut self, call: &Call<Renew>, renewed: &Renewed, now_ms: i64) -> Vec<String> {
        let mut broken = Vec::new();
        let asked: BTreeSet<Lease> = call.body.held.iter().map(|held| (held.job, held.attempt)).collect();
        for held in call.body.held.iter().filter(|held| !renewed.lost.contains(&held.job)) {
            let newest = self.newest.get(&held.job).copied();
            let stale = newest != Some(held.attempt);
            // The answer names jobs: what is not lost may be the newest attempt, if this worker has it, too.
            if stale && newest.is_some_and(|newest| asked.contains(&(held.job, newest))) {
                continue;
            }
            if stale || self.on_record.contains_key(&held.job) {
                broken.push(format!("the stale attempt {} of job {} was renewed", held.attempt, held.job));
            } else if let Some(known) = self.held.get_mut(&(held.job, held.attempt)) {
                (known.heard_ms, known.runs) = (now_ms, held.running);
                if known.worker != call.worker || known.told.is_some() {
                    broken.push(format!("attempt {} of job {} was renewed after its end", held.attempt, held.job));
                }
            }
        }
        broken
    }

    pub(super) fn reported(&mut self, call: &Call<Report>, recorded: &Recorded) -> Vec<String> {
        let (taken, ignored) = (&recorded.recorded, &recorded.ignored);
        let mut broken = Vec::new();
        for run in &call.body.runs {
            let lease = (run.job, run.attempt);
            self.told.insert(lease);
            match (taken.contains(&run.job), ignored.contains(&run.job)) {
                (true, false) => broken.extend(self.recorded(run, call)),
                (false, true) if matches!(run.ended, RunEnd::Done(_)) && !self.removed.contains(&run.job) => {
                    broken.push(format!("the result of {lease:?} was turned away"));
                }
                // The answer names jobs, and this report has two attempts of one: either may be meant.
                (true, true) => _ = self.recorded(run, call),
                (false, false) => broken.push(format!("{lease:?} was not answered")),
                _ => {}
            }
        }
        broken
    }

    fn recorded(&mut self, run: &RunReport, call: &Call<Report>) -> Option<String> {
        let lease = (run.job, run.attempt);
        let told = match &run.ended {
            RunEnd::Done(record) => {
                let first = self.on_record.entry(run.job).or_insert(record.digest);
                if *first != record.digest {
                    return Some(format!("two results of job {} were acknowledged", run.job));
                }
                Told::Done
            }
            RunEnd::Panicked { .. } => Told::Panicked,
            RunEnd::HandedBack => Told::HandedBack,
        };
        let newest = self.newest.get(&run.job) == Some(&run.attempt);
        let Some(held) = self.held.get_mut(&lease).filter(|held| held.worker == call.worker) else {
            return Some(format!("{lease:?} was taken from one who never held it"));
        };
        let again = held.told == Some(told);
        held.told.get_or_insert(told);
        (told != Told::Done && !newest && !again).then(|| format!("the stale {lease:?} counted as {told:?}"))
    }

    /// A run ended and is in its worker's spool.
    pub(super) fn spooled(&mut self, lease: Lease) {
        self.finished.insert(lease);
    }

    /// A spool was lost with everything in it.
    pub(super) fn spool_lost(&mut self, runs: &BTreeSet<Lease>) {
        self.finished.retain(|lease| !runs.contains(lease));
    }

    /// Runs that ended and were never reported.
    pub(super) fn unreported(&self) -> Vec<Lease> {
        self.finished.difference(&self.told).copied().collect()
    }

    /// A user asks for a sweep: jobs of others may go on for it.
    pub(super) fn asking(&mut self, wish: Wish) {
        self.asked.entry(wish.key).or_insert(Asked { wish, may_run: true, is_cancelled: false });
        self.resume_all();
    }

    /// A user has jobs of a sweep go on, also after it was cancelled.
    pub(super) fn resuming(&mut self, key: usize) {
        self.asked.get_mut(&key).into_iter().for_each(|asked| asked.is_cancelled = false);
        self.resume_all();
    }

    /// What ended while it was paused goes on with jobs that another sweep brings back.
    fn resume_all(&mut self) {
        self.asked.values_mut().for_each(|asked| asked.may_run = !asked.is_cancelled);
    }

    /// Nothing is to be handed out for a sweep from now on.
    pub(super) fn halted(&mut self, key: usize, is_cancelled: bool) {
        self.asked.get_mut(&key).into_iter().for_each(|asked| {
            (asked.may_run, asked.is_cancelled) = (false, asked.is_cancelled || is_cancelled);
        });
    }

    /// A user cancels something.
    pub(super) fn cancelling(&mut self) {
        self.held.values_mut().for_each(|held| held.cancelled = true);
    }

    /// A user removes something.
    pub(super) fn removing(&mut self) {
        self.cancelling();
        self.removed.extend(self.newest.keys());
    }

    /// Nobody could renew: no lease may end so soon after.
    pub(super) fn grant_grace(&mut self, from_ms: i64, for_ms: i64) {
        self.grace.push((from_ms, from_ms + for_ms));
    }

    /// Results that were acknowledged.
    pub(super) fn on_record(&self) -> &BTreeMap<JobId, Digest> {
        &self.on_record
    }

    /// Jobs that must be known for ever, since their results were acknowledged.
    pub(super) fn to_be_kept(&self) -> BTreeSet<JobId> {
        self.on_record.keys().filter(|job| !self.removed.contains(job)).copied().collect()
    }

    /// Whether a lease may have run out at this time.
    pub(super) fn may_have_run_out(&self, lease: Lease, ended_ms: i64) -> bool {
        let in_grace = self.grace.iter().any(|(after_ms, before_ms)| (after_ms + 1..*before_ms).contains(&ended_ms));
        let is_old = |held: &Held| ended_ms - held.heard_ms >= LEASE_MS - GRAIN_MS;
        self.held.get(&lease).is_some_and(|held| held.left || (is_old(held) && !in_grace))
    }

    /// Whether its worker said last that it runs.
    pub(super) fn is_said_to_run(&self, lease: Lease) -> bool {
        self.held.get(&lease).is_some_and(|held| held.runs)
    }
}

impl Held {
    fn is_over(&self, now_ms: i64) -> bool {
        self.told.is_some() || self.cancelled || self.left || now_ms - self.heard_ms >= LEASE_MS - GRAIN_MS
    }
}
