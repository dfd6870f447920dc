//! What the tests need of the other side: a queue in memory behind the real trait, and runs of real arithmetic.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Barrier, Mutex};
use std::time::Duration;

use async_trait::async_trait;
use furrow_schema::id::{Digest, JobId, RequestId, ScenarioId, WorkerId};
use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::protocol::{
    Call, Claim, Hello, LeasedJob, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, RunEnd, RunReport,
    ScenarioText, Welcome,
};
use tokio::sync::{Notify, watch};
use tokio::time::timeout;

use crate::link::{Link, LinkError};
use crate::runner::{Order, Runner};

/// What takes longer than this will never come.
const HANGS_AFTER: Duration = Duration::from_secs(60);

/// A queue in memory, with the faults that a test asks for.
#[derive(Default)]
pub(crate) struct Queue {
    state: Mutex<State>,
    changed: Notify,
    submitted: watch::Sender<u64>,
}

/// What a test may set and look at.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) queue: VecDeque<LeasedJob>,
    pub(crate) texts: BTreeMap<ScenarioId, String>,
    /// All ends that were recorded, in order.
    pub(crate) ended: Vec<RunReport>,
    pub(crate) hellos: Vec<Hello>,
    /// Who said hello, in order.
    pub(crate) workers: Vec<WorkerId>,
    pub(crate) claims: Vec<Claim>,
    pub(crate) renewals: Vec<Renew>,
    /// Texts of scenarios that were sent.
    pub(crate) texts_sent: usize,
    /// Reports by request: how often each came.
    pub(crate) reports: HashMap<RequestId, u32>,
    /// This many next reports are recorded, but the answer is lost.
    pub(crate) lost_answers: u32,
    /// The next questions but a hello are from an unknown worker.
    pub(crate) forgot_workers: bool,
    /// Every question is refused so.
    pub(crate) refusal: Option<Refusal>,
    /// An idle worker shall ask again after this long; 5 ms if not set.
    pub(crate) retry_after_ms: Option<u64>,
    /// Nobody answers.
    pub(crate) away: bool,
    /// Reports have no answer, and are not recorded.
    pub(crate) deaf_to_reports: bool,
    /// Another coordinator is in its place.
    pub(crate) replaced_by: Option<String>,
    /// Results of this job are malformed.
    pub(crate) unreadable_results_of: Option<JobId>,
    /// Renewals say that these are lost.
    pub(crate) lost: Vec<JobId>,
    answered_claims: HashMap<RequestId, Leases>,
}

impl Queue {
    pub(crate) fn with(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state.lock().unwrap());
        self.changed.notify_waiters();
    }

    /// Adds jobs 1, 2, .. of one scenario, with their numbers as seeds.
    pub(crate) fn submit(&self, scenario: &str, jobs: std::ops::RangeInclusive<i64>) {
        self.submit_as(scenario, jobs, |job| job);
    }

    /// The same, with changes to the leases.
    pub(crate) fn submit_as(
        &self,
        scenario: &str,
        jobs: std::ops::RangeInclusive<i64>,
        change: impl Fn(LeasedJob) -> LeasedJob,
    ) {
        self.with(|state| {
            let scenario_id = ScenarioId(state.texts.len() as i64 + 1);
            state.texts.insert(scenario_id, scenario.to_owned());
            state.queue.extend(jobs.map(|job| change(lease(job, scenario_id))));
        });
        self.submitted.send_modify(|n| *n += 1);
    }

    /// Waits until the state is as it should be, and takes something from it.
    pub(crate) async fn until<T>(&self, look: impl Fn(&State) -> Option<T>) -> T {
        timeout(HANGS_AFTER, self.seen(look)).await.expect("the worker did not do what was expected of it")
    }

    async fn seen<T>(&self, look: impl Fn(&State) -> Option<T>) -> T {
        loop {
            let changed = self.changed.notified();
            let seen = look(&self.state.lock().unwrap());
            match seen {
                Some(seen) => return seen,
                None => changed.await,
            }
        }
    }

    /// Waits until so many runs ended, and takes their ends by job.
    pub(crate) async fn ends(&self, n: usize) -> BTreeMap<JobId, RunEnd> {
        let ends = |state: &State| state.ended.iter().map(|run| (run.job, run.ended.clone())).collect();
        self.until(|state| (state.ended.len() >= n).then(|| ends(state))).await
    }

    fn answer<Q, A>(&self, call: Call<Q>, answer: impl FnOnce(&mut State, Call<Q>) -> Reply<A>) -> LinkResult<A> {
        let mut state = self.state.lock().unwrap();
        let answer = if state.away {
            Err(LinkError::NoAnswer("away".to_owned()))
        } else if let Some(other) = state.replaced_by.clone() {
            Err(LinkError::OtherCoordinator(other))
        } else if let Some(refusal) = state.refusal.clone() {
            Ok(Reply::Refused(refusal))
        } else if state.forgot_workers {
            Ok(Reply::Refused(Refusal::UnknownWorker))
        } else {
            Ok(answer(&mut state, call))
        };
        drop(state);
        self.changed.notify_waiters();
        answer
    }
}

type LinkResult<A> = Result<Reply<A>, LinkError>;

fn lease(job: i64, scenario: ScenarioId) -> LeasedJob {
    LeasedJob { job: JobId(job), attempt: 1, scenario, seed: job as u64, record: false, alone: false }
}

impl State {
    fn lease_out(&mut self, claim: &Claim) -> Leases {
        let n = self.queue.len().min(claim.want as usize);
        let jobs: Vec<LeasedJob> = self.queue.drain(..n).collect();
        let mut scenarios: Vec<ScenarioText> = Vec::new();
        for id in jobs.iter().map(|job| job.scenario) {
            let known = claim.known_scenarios.contains(&id) || scenarios.iter().any(|text| text.id == id);
            if let (false, Some(json)) = (known, self.texts.get(&id)) {
                scenarios.push(ScenarioText { id, json: json.clone() });
            }
        }
        self.texts_sent += scenarios.len();
        Leases { jobs, scenarios, retry_after_ms: self.retry_after_ms.unwrap_or(5) }
    }

    fn record(&mut self, report: Report) -> Recorded {
        let recorded = report.runs.iter().map(|run| run.job).collect();
        self.ended.extend(report.runs);
        Recorded { recorded, ignored: Vec::new() }
    }

    fn cannot_read(&self, report: &Report) -> bool {
        let bad = |run: &RunReport| Some(run.job) == self.unreadable_results_of && matches!(run.ended, RunEnd::Done(_));
        report.runs.iter().any(bad)
    }
}

#[async_trait]
impl Link for Queue {
    async fn hello(&self, call: Call<Hello>) -> LinkResult<Welcome> {
        self.with(|state| state.forgot_workers = false);
        self.answer(call, |state, call| {
            state.hellos.push(call.body);
            state.workers.push(call.worker);
            Reply::Ok(Welcome { lease_ms: 30_000, renew_every_ms: 1 })
        })
    }

    async fn claim(&self, call: Call<Claim>) -> LinkResult<Leases> {
        self.answer(call, |state, call| {
            if let Some(leases) = state.answered_claims.get(&call.request) {
                return Reply::Ok(leases.clone());
            }
            let leases = state.lease_out(&call.body);
            state.answered_claims.insert(call.request, leases.clone());
            state.claims.push(call.body);
            Reply::Ok(leases)
        })
    }

    async fn result(&self, call: Call<Report>) -> LinkResult<Recorded> {
        if self.state.lock().unwrap().deaf_to_reports {
            return Err(LinkError::NoAnswer("lost on the way there".to_owned()));
        }
        let mut lost = false;
        let answer = self.answer(call, |state, call| {
            if state.cannot_read(&call.body) {
                return Reply::Refused(Refusal::Malformed { detail: "as the test asks".to_owned() });
            }
            lost = state.lost_answers > 0;
            state.lost_answers = state.lost_answers.saturating_sub(1);
            let times = state.reports.entry(call.request).or_default();
            *times += 1;
            if *times > 1 {
                return Reply::Ok(Recorded {
                    recorded: call.body.runs.iter().map(|run| run.job).collect(),
                    ignored: vec![],
                });
            }
            Reply::Ok(state.record(call.body))
        });
        if lost { Err(LinkError::NoAnswer("lost on the way back".to_owned())) } else { answer }
    }

    async fn renew(&self, call: Call<Renew>) -> LinkResult<Renewed> {
        self.answer(call, |state, call| {
            state.renewals.push(call.body);
            Reply::Ok(Renewed { lost: state.lost.clone() })
        })
    }

    fn changes(&self) -> Option<watch::Receiver<u64>> {
        Some(self.submitted.subscribe())
    }
}

/// A run that adds up numbers, panics, waits to be stopped, or meets another.
#[derive(Debug, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Task {
    Sum(u64),
    Panic,
    Endless,
    Meet,
}

/// Runs [`Task`]s, and watches that those that must be alone are.
pub(crate) struct Arithmetic {
    meeting: Barrier,
    going: AtomicUsize,
    pub(crate) disturbed: AtomicBool,
}

impl Arithmetic {
    pub(crate) fn new() -> Self {
        Self { meeting: Barrier::new(2), going: AtomicUsize::new(0), disturbed: AtomicBool::new(false) }
    }

    /// Meets the run that waits for another.
    pub(crate) fn meet(&self) {
        self.meeting.wait();
    }
}

/// An alone run counts for this many others.
const ALONE: usize = 1_000;

impl Runner for std::sync::Arc<Arithmetic> {
    type Scenario = Task;

    fn read(&self, scenario_json: &str) -> Result<Task, String> {
        serde_json::from_str(scenario_json).map_err(|error| error.to_string())
    }

    fn run(&self, task: &Task, order: Order, stop: &AtomicBool) -> Option<RunRecord> {
        let weight = if order.alone { ALONE } else { 1 };
        let others = self.going.fetch_add(weight, Ordering::SeqCst);
        if others >= ALONE || (order.alone && others > 0) {
            self.disturbed.store(true, Ordering::SeqCst);
        }
        let record = perform(task, order, stop, &self.meeting);
        self.going.fetch_sub(weight, Ordering::SeqCst);
        record
    }
}

fn perform(task: &Task, order: Order, stop: &AtomicBool, meeting: &Barrier) -> Option<RunRecord> {
    let n = match task {
        Task::Sum(n) => *n,
        Task::Panic => panic!("seed {} is unlucky", order.seed),
        Task::Endless => loop {
            if stop.load(Ordering::Relaxed) {
                return None;
            }
            std::thread::yield_now();
        },
        Task::Meet => {
            meeting.wait();
            1
        }
    };
    let sum = (1..=n).fold(order.seed, |sum, i| sum.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(i));
    Some(record_of(sum))
}

/// A record whose digest says `sum`.
pub(crate) fn record_of(sum: u64) -> RunRecord {
    let mut digest = [0; 32];
    digest[..8].copy_from_slice(&sum.to_le_bytes());
    RunRecord {
        digest: Digest(digest),
        outcome: "success".to_owned(),
        metrics: BTreeMap::new(),
        timings: Timings::default(),
        trajectory: None,
    }
}
