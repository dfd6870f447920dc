//! The worker's memory: which runs wait, which go on, which ended and are not acknowledged yet.
//!
//! A plain state machine without threads, clocks or network. The pool takes work from it and says how runs ended;
//! the three conversations fill it, empty it and ask what is held. With a spool, ended runs pass through it on their
//! way to a report, and it is told of what is acknowledged.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use furrow_schema::id::JobId;
use furrow_schema::protocol::{HeldJob, LeasedJob, MAX_CLAIM, RunEnd, RunReport};

use crate::scenarios::HeldScenario;

/// A claim asks for as much work as this takes.
const BATCH: Duration = Duration::from_secs(2);
/// A worker holds at most this many jobs, besides those that run.
const MAX_HELD: usize = 4 * MAX_CLAIM as usize;
/// Weight of the latest run in the mean duration.
const NEWEST_WEIGHT: f64 = 0.2;
/// A report grows no longer than this by its trajectories [bytes].
pub(crate) const MAX_REPORT_BYTES: usize = 4 << 20;

/// One leased job with what it takes to run it.
#[derive(Debug)]
pub(crate) struct Work<S> {
    pub(crate) lease: LeasedJob,
    pub(crate) scenario: Arc<HeldScenario<S>>,
    /// Raised when the run is to stop.
    pub(crate) stop: Arc<AtomicBool>,
}

/// A lease: the job and which handing out of it.
pub(crate) type Lease = (JobId, u32);

fn lease_of(job: &LeasedJob) -> Lease {
    (job.job, job.attempt)
}

/// Where a held job stands.
#[derive(Debug)]
enum Stage {
    Waits,
    Runs { stop: Arc<AtomicBool> },
    Ended,
}

/// What is for the spool to do, and what it could not.
#[derive(Debug, Default)]
struct SpoolSide {
    /// Ended runs to keep before they are reported.
    unkept: Vec<RunReport>,
    /// How many the spool is about to keep.
    underway: usize,
    /// Runs that it keeps for nothing.
    acknowledged: Vec<Lease>,
    /// Runs that are in memory only, since the spool did not take them.
    refused: BTreeSet<Lease>,
    reports_ended: bool,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Board<S> {
    threads: usize,
    held: BTreeMap<Lease, Stage>,
    queue: VecDeque<Work<S>>,
    outbox: VecDeque<RunReport>,
    spool: Option<SpoolSide>,
    /// Runs that go on now.
    running: usize,
    /// Whether the one that goes on must be alone.
    alone: bool,
    /// Threads that take work until there is none.
    takers: usize,
    mean_s: Option<f64>,
    /// Whether the last claim got less than it asked for: others need what is left, too.
    scarce: bool,
    closed: bool,
    claims_ended: bool,
}

impl<S> Board<S> {
    /// An empty board; its ended runs pass through a spool, or not.
    pub(crate) fn new(threads: usize, spooling: bool) -> Self {
        Self {
            threads: threads.max(1),
            held: BTreeMap::new(),
            queue: VecDeque::new(),
            outbox: VecDeque::new(),
            spool: spooling.then(SpoolSide::default),
            running: 0,
            alone: false,
            takers: 0,
            mean_s: None,
            scarce: false,
            closed: false,
            claims_ended: false,
        }
    }

    /// How many jobs to claim now: one batch as soon as less than one waits, or less than one job a thread where they are
    /// scarce; nothing otherwise. Nothing either while too many runs wait for their acknowledgement, or any that the spool
    /// did not take.
    pub(crate) fn want(&self) -> u32 {
        let batch = self.batch();
        let ahead = if self.scarce { self.threads.min(batch) } else { batch };
        let full = self.queue.len() >= ahead || self.held.len() + batch > MAX_HELD + self.threads;
        let at_risk = self.spool.as_ref().is_some_and(|spool| !spool.refused.is_empty());
        if self.closed || full || at_risk { 0 } else { u32::try_from(batch).unwrap_or(MAX_CLAIM) }
    }

    /// A claim of `asked` jobs got so many.
    pub(crate) fn note_grant(&mut self, asked: u32, got: usize) {
        self.scarce = got < asked as usize;
    }

    fn batch(&self) -> usize {
        let most = MAX_CLAIM as usize;
        let least = self.threads.min(most);
        let Some(mean_s) = self.mean_s else { return least };
        let batch = BATCH.as_secs_f64() * self.threads as f64 / mean_s.max(1e-9);
        (batch.min(most as f64) as usize).clamp(least, most)
    }

    /// Takes in a leased job. On a closed board it is handed back; a lease that is held already is ignored.
    pub(crate) fn add(&mut self, lease: LeasedJob, scenario: Option<Arc<HeldScenario<S>>>) {
        if self.held.contains_key(&lease_of(&lease)) {
            return;
        }
        let Some(scenario) = scenario else {
            let message = format!("the coordinator did not send scenario {}", lease.scenario);
            return self.end(lease_of(&lease), RunEnd::Panicked { message });
        };
        if self.closed {
            return self.end(lease_of(&lease), RunEnd::HandedBack);
        }
        self.held.insert(lease_of(&lease), Stage::Waits);
        self.queue.push_back(Work { lease, scenario, stop: Arc::default() });
    }

    /// How many more threads should begin to take work; they count as takers from now on.
    pub(crate) fn engage(&mut self) -> usize {
        let useful = match self.queue.front() {
            Some(front) if self.may_start(front.lease.alone) => {
                if front.lease.alone {
                    1
                } else {
                    self.queue.len()
                }
            }
            _ => 0,
        };
        let more = useful.min(self.threads.saturating_sub(self.takers));
        self.takers += more;
        more
    }

    /// The next run for a taker. With nothing to start now, it stops being one.
    pub(crate) fn take(&mut self) -> Option<Work<S>> {
        let startable = self.queue.front().is_some_and(|front| self.may_start(front.lease.alone));
        let Some(work) = startable.then(|| self.queue.pop_front()).flatten() else {
            self.takers = self.takers.saturating_sub(1);
            return None;
        };
        self.running += 1;
        self.alone = work.lease.alone;
        self.held.insert(lease_of(&work.lease), Stage::Runs { stop: Arc::clone(&work.stop) });
        Some(work)
    }

    fn may_start(&self, alone: bool) -> bool {
        if alone { self.running == 0 } else { !self.alone }
    }

    /// A run ended after `took`; one that was stopped counts as handed back.
    pub(crate) fn finish(&mut self, job: &LeasedJob, ended: RunEnd, took: Duration) {
        if !matches!(self.held.get(&lease_of(job)), Some(Stage::Runs { .. })) {
            return;
        }
        self.running -= 1;
        self.alone = false;
        if !matches!(ended, RunEnd::HandedBack) {
            let newest_s = took.as_secs_f64();
            self.mean_s = Some(self.mean_s.map_or(newest_s, |mean_s| mean_s + NEWEST_WEIGHT * (newest_s - mean_s)));
        }
        self.end(lease_of(job), ended);
    }

    fn end(&mut self, lease: Lease, ended: RunEnd) {
        self.held.insert(lease, Stage::Ended);
        let run = RunReport { job: lease.0, attempt: lease.1, ended };
        match &mut self.spool {
            Some(spool) if run.ended != RunEnd::HandedBack => spool.unkept.push(run),
            _ => self.outbox.push_back(run),
        }
    }

    /// Whether it is worth waiting for more runs to end before the spool keeps those that have.
    pub(crate) fn gathers_for_spool(&self) -> bool {
        self.spool.as_ref().is_some_and(|spool| self.gathers(spool.unkept.len()))
    }

    /// Whether it is worth waiting for more runs to end before those that have are reported. What passes through the spool
    /// was gathered there.
    pub(crate) fn gathers_for_report(&self) -> bool {
        self.spool.is_none() && self.gathers(self.outbox.len())
    }

    /// Whether the run that ended last has to be looked at: it is the first to be kept or reported, or nothing is waited for,
    /// since a lot is full, no run goes on, the board is closed, or a run was handed back.
    pub(crate) fn has_news(&self) -> bool {
        let (gathering, ended) = match &self.spool {
            Some(spool) => (self.gathers_for_spool() && self.outbox.is_empty(), spool.unkept.len()),
            None => (self.gathers_for_report(), self.outbox.len()),
        };
        !gathering || ended == 1
    }

    fn gathers(&self, ended: usize) -> bool {
        !self.closed && (self.running > 0 || !self.queue.is_empty()) && ended > 0 && ended < MAX_CLAIM as usize
    }

    /// What the spool is to keep now, and what to forget; nothing if it has nothing to do at the moment.
    pub(crate) fn take_for_spool(&mut self) -> Option<(Vec<RunReport>, Vec<Lease>)> {
        let spool = self.spool.as_mut()?;
        let round = (std::mem::take(&mut spool.unkept), std::mem::take(&mut spool.acknowledged));
        spool.underway += round.0.len();
        let idle = round.0.is_empty() && round.1.is_empty();
        (!idle).then_some(round)
    }

    /// The spool took the first `kept` of these runs. All of them may be reported.
    pub(crate) fn spooled(&mut self, runs: Vec<RunReport>, kept: usize) {
        if let Some(spool) = &mut self.spool {
            spool.underway -= runs.len();
            spool.refused.extend(runs[kept..].iter().map(|run| (run.job, run.attempt)));
        }
        self.outbox.extend(runs);
    }

    /// No run is reported any more.
    pub(crate) fn reports_ended(&mut self) {
        if let Some(spool) = &mut self.spool {
            spool.reports_ended = true;
        }
    }

    /// Whether the spool has and will have nothing to do.
    pub(crate) fn is_spooled(&self) -> bool {
        let nothing =
            |spool: &SpoolSide| spool.reports_ended && spool.unkept.is_empty() && spool.acknowledged.is_empty();
        self.spool.as_ref().is_none_or(|spool| self.is_idle() && nothing(spool))
    }

    /// The next report's runs: all that fit, from those that ended first. They stay held until acknowledged.
    pub(crate) fn take_ended(&mut self) -> Vec<RunReport> {
        let mut bytes = 0;
        let fits = |run: &&RunReport| {
            bytes += report_bytes(run);
            bytes <= MAX_REPORT_BYTES
        };
        let n = self.outbox.iter().take(MAX_CLAIM as usize).take_while(fits).count();
        let at_least_one = n.max(1).min(self.outbox.len());
        self.outbox.drain(..at_least_one).collect()
    }

    /// The coordinator has these on record, or wants to hear no more of them.
    pub(crate) fn forget(&mut self, runs: &[RunReport]) {
        for run in runs {
            let lease = (run.job, run.attempt);
            self.held.remove(&lease);
            if let Some(spool) = &mut self.spool
                && run.ended != RunEnd::HandedBack
                && !spool.refused.remove(&lease)
            {
                spool.acknowledged.push(lease);
            }
        }
    }

    /// All leases to renew.
    pub(crate) fn held(&self) -> Vec<HeldJob> {
        let held = |(&(job, attempt), stage): (&Lease, &Stage)| {
            let running = matches!(stage, Stage::Runs { .. });
            HeldJob { job, attempt, running }
        };
        self.held.iter().map(held).collect()
    }

    /// These jobs are no longer the worker's: the waiting ones are dropped, the running ones told to stop.
    ///
    /// Their end is still reported: the coordinator ignores a stale attempt that is handed back, and records a
    /// result that came all the same. Returns how many were not ended yet: a renewal that crosses a report names
    /// jobs that are done.
    pub(crate) fn lose(&mut self, lost: &[JobId]) -> usize {
        self.give_up(|lease| lost.contains(&lease.0))
    }

    /// Takes no more work: what waits is handed back, what runs is told to stop.
    pub(crate) fn close(&mut self) {
        self.closed = true;
        self.give_up(|_| true);
    }

    fn give_up(&mut self, which: impl Fn(&Lease) -> bool) -> usize {
        let (gone, kept) = self.queue.drain(..).partition::<VecDeque<_>, _>(|work| which(&lease_of(&work.lease)));
        self.queue = kept;
        let mut given_up = gone.len();
        for work in gone {
            self.end(lease_of(&work.lease), RunEnd::HandedBack);
        }
        for (lease, stage) in &self.held {
            if let (Stage::Runs { stop }, true) = (stage, which(lease)) {
                stop.store(true, Ordering::Relaxed);
                given_up += 1;
            }
        }
        given_up
    }

    /// Hands back the runs that go on although they were told to stop: the worker is leaving.
    pub(crate) fn abandon(&mut self) {
        let runs = |(lease, stage): (&Lease, &Stage)| matches!(stage, Stage::Runs { .. }).then_some(*lease);
        for lease in self.held.iter().filter_map(runs).collect::<Vec<_>>() {
            self.running -= 1;
            self.end(lease, RunEnd::HandedBack);
        }
    }

    /// No claim is on its way any more.
    pub(crate) fn claims_ended(&mut self) {
        self.claims_ended = true;
    }

    /// Whether nothing waits or runs, and nothing will come.
    pub(crate) fn is_idle(&self) -> bool {
        self.closed && self.claims_ended && self.queue.is_empty() && self.running == 0
    }

    /// Whether it is idle and every end was handed to a report.
    pub(crate) fn is_drained(&self) -> bool {
        let spooled = self.spool.as_ref().is_none_or(|spool| spool.underway == 0 && spool.unkept.is_empty());
        self.is_idle() && self.outbox.is_empty() && spooled
    }
}

fn report_bytes(run: &RunReport) -> usize {
    match &run.ended {
        RunEnd::Done(record) => record.trajectory.as_ref().map_or(0, String::len),
        RunEnd::Panicked { message } => message.len(),
        RunEnd::HandedBack => 0,
    }
}

#[cfg(test)]
mod tests;
