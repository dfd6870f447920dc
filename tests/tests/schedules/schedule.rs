//! One schedule: a seed, a coordinator, a few machines, users, faults for a while; then peace, and the final account.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use furrow_coordinator::moments::Moments;
use furrow_coordinator::{AttemptEnd, CellSummary, Coordinator, JobDetail, JobFilter, JobItem, JobRef};
use furrow_schema::id::{JobId, SweepId, WorkerId};
use furrow_schema::job::JobState;
use furrow_schema::sweep::{Sweep, SweepState};
use tokio::time::sleep;

use super::database::Database;
use super::jobs::{Jobs, scenario, value};
use super::machine::Machine;
use super::server::Server;
use super::users::Users;
use super::world::World;

/// After the last fault everything ends within this time [ms].
const ENDS_WITHIN_MS: i64 = 400_000;
/// With its faults no schedule takes longer.
const NO_LONGER_THAN: Duration = Duration::from_secs(3_600);
/// So many panics, or deaths, make a job fail.
const CHANCES: usize = 3;

/// A schedule that broke a claim.
#[derive(Debug)]
pub(super) struct Broken {
    pub(super) seed: u64,
    pub(super) claim: String,
    pub(super) trace: Vec<String>,
}

/// Runs the schedule of this seed; its trace, if every claim holds.
pub(super) fn run(seed: u64, database: &Arc<Database>, folder: &Path) -> Result<Vec<String>, Broken> {
    let store = database.store.clone();
    database.wait(async move {
        store.undo_unfinished().await.unwrap();
        store.empty().await.unwrap();
    });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_time().start_paused(true).build().unwrap();
    let world = runtime.block_on(async {
        let schedule = Schedule::begin(seed, database, folder);
        let course = async {
            schedule.rage().await;
            schedule.settle().await;
            schedule.account().await;
        };
        tokio::select! {
            biased;
            () = schedule.world.gave_up() => {}
            () = course => {}
            () = sleep(NO_LONGER_THAN) => schedule.world.fail("it goes on and on"),
        }
        schedule.server.die();
        schedule.world.clone()
    });
    drop(runtime);
    let trace = world.trace();
    match world.broken() {
        None => Ok(trace),
        Some(claim) => Err(Broken { seed, claim, trace }),
    }
}

struct Schedule {
    world: Arc<World>,
    jobs: Arc<Jobs>,
    server: Arc<Server>,
    machines: Vec<Arc<Machine>>,
    users: Arc<Users>,
}

impl Schedule {
    fn begin(seed: u64, database: &Arc<Database>, folder: &Path) -> Self {
        let world = Arc::new(World::new(seed));
        let jobs = Arc::new(Jobs::draw(&world));
        let server = Server::start(&world, database);
        let machines = 0..world.draw(1..world.size.machines + 1) as usize;
        let place = |number: usize| folder.join(number.to_string());
        let machines = machines.map(|number| Machine::start(&world, &jobs, &server, number, place(number))).collect();
        let users = Users::new(&world, &server);
        Self { world, jobs, server, machines, users }
    }

    /// The time of faults. A new kind of fault is one more arm.
    async fn rage(&self) {
        self.users.submit().await;
        for _ in 0..self.world.draw(0..self.world.size.events) {
            self.world.pause(0..9_000).await;
            let machine = &self.machines[self.world.draw(0..self.machines.len() as u64) as usize];
            match self.world.draw(0..9) {
                0 => self.server.crash(),
                1 => self.server.stand_still(self.world.draw(0..50_000)),
                2 | 3 => machine.kill(),
                4 => machine.cut(self.world.draw(0..50_000)),
                _ => self.users.act().await,
            }
        }
    }

    /// Nothing goes wrong any more: all ends, and once more where jobs failed.
    async fn settle(&self) {
        self.world.calm_down();
        self.machines.iter().for_each(|machine| machine.join());
        self.users.resume_all().await;
        self.all_ended().await;
        for sweep in self.users.sweeps().await {
            if sweep.failed > 0 && sweep.state == SweepState::Done {
                self.users.retry(sweep.id).await;
            }
        }
        self.all_ended().await;
    }

    async fn all_ended(&self) {
        let until_ms = self.world.now_ms() + ENDS_WITHIN_MS;
        while self.world.broken().is_none() {
            let ended = |sweep: &Sweep| matches!(sweep.state, SweepState::Done | SweepState::Cancelled);
            let sweeps = self.users.sweeps().await;
            let unreported = self.world.ledger().unreported();
            if sweeps.iter().all(ended) && unreported.is_empty() {
                return;
            }
            if self.world.now_ms() > until_ms {
                return self.world.fail(format_args!("it never ends: {unreported:?} unreported, {sweeps:?}"));
            }
            self.world.pause(3_000..8_000).await;
        }
    }

    /// What must be true in the end.
    async fn account(&self) {
        if self.world.broken().is_some() {
            return;
        }
        let jobs = self.jobs().await;
        self.check_jobs(&jobs).await;
        self.check_sweeps(&jobs).await;
        let store = self.server.store();
        let broken = self.server.wait(async move { store.broken_rules().await.unwrap() });
        broken.iter().for_each(|rule| self.world.fail(format_args!("the books are wrong: {rule}")));
        let on_record = self.world.ledger().on_record().len();
        self.world.say(format_args!("ends with {} jobs, {on_record} on record", jobs.len()));
    }

    /// All jobs, by number.
    async fn jobs(&self) -> BTreeMap<JobId, JobItem> {
        let filter = JobFilter { limit: JobFilter::MAX_LIMIT, ..JobFilter::default() };
        let list = |life: Coordinator| {
            let filter = filter.clone();
            async move { life.jobs(&filter).await }
        };
        let page = self.users.ask(list).await;
        assert!(page.next.is_none(), "a schedule has few jobs");
        page.items.into_iter().map(|job| (job.id, job)).collect()
    }

    async fn check_jobs(&self, jobs: &BTreeMap<JobId, JobItem>) {
        let kept = self.world.ledger().to_be_kept();
        for lost in kept.iter().filter(|id| !jobs.contains_key(id)) {
            self.world.fail(format_args!("job {lost} is lost with its acknowledged result"));
        }
        let mut details = Vec::new();
        for job in jobs.values() {
            let acknowledged = self.world.ledger().on_record().get(&job.id).copied();
            if acknowledged.is_some() && acknowledged != job.digest {
                self.world.fail(format_args!("the acknowledged result of a job is lost: {job:?}"));
            }
            // Nothing happened to the others.
            if job.state != JobState::Done || job.attempts > 1 {
                let id = JobRef::Id(job.id);
                let detail = self.users.ask(move |life| async move { life.job(id).await }).await;
                details.push(detail.expect("a listed job is there"));
            }
        }
        details.iter().for_each(|job| self.check_job(job));
        self.check_deaths(&details).await;
        let incidents = self.users.ask(|life| async move { life.incidents(1).await }).await;
        if !incidents.is_empty() {
            self.world.fail(format_args!("a job has two results: {incidents:?}"));
        }
    }

    fn check_job(&self, job: &JobDetail) {
        let fail = |text: &str| self.world.fail(format_args!("job {}: {text}: {job:?}", job.id));
        let ends = |end: AttemptEnd| job.attempts.iter().filter(|attempt| attempt.end == end).count();
        match job.state {
            JobState::Done => {}
            JobState::Failed if !self.jobs.is_hopeless(job.seed) => fail("it failed although it can be run"),
            JobState::Failed if ends(AttemptEnd::Panicked).max(ends(AttemptEnd::Died)) >= CHANCES => {}
            JobState::Cancelled if job.cells.iter().all(|cell| self.users.is_cancelled(cell.sweep)) => {}
            _ => fail("it did not end as it should"),
        }
        for attempt in &job.attempts {
            let (lease, ended_ms) = ((job.id, attempt.attempt), attempt.ended_ms.unwrap_or_default());
            let ran_out = self.world.ledger().may_have_run_out(lease, ended_ms);
            if matches!(attempt.end, AttemptEnd::Died | AttemptEnd::Expired) && !ran_out {
                fail("a lease ran out too soon");
            }
        }
    }

    /// A death is charged to what the worker said to run, and else to no more jobs than it had threads: the others only
    /// waited.
    async fn check_deaths(&self, details: &[JobDetail]) {
        let mut unsaid = BTreeMap::<(WorkerId, Option<i64>), u32>::new();
        for job in details {
            for attempt in job.attempts.iter().filter(|attempt| attempt.end == AttemptEnd::Died) {
                if !self.world.ledger().is_said_to_run((job.id, attempt.attempt)) {
                    *unsaid.entry((attempt.worker.clone(), attempt.ended_ms)).or_default() += 1;
                }
            }
        }
        let workers = self.users.ask(|life| async move { life.workers().await }).await;
        let threads: BTreeMap<_, _> = workers.into_iter().map(|worker| (worker.id, worker.threads)).collect();
        for ((worker, ended_ms), charged) in unsaid {
            if threads.get(&worker).is_none_or(|threads| charged > *threads) {
                self.world.fail(format_args!(
                    "{charged} jobs that did not run are charged with {worker}'s death at {ended_ms:?}"
                ));
            }
        }
    }

    async fn check_sweeps(&self, jobs: &BTreeMap<JobId, JobItem>) {
        let sweeps = self.users.sweeps().await;
        let found: BTreeSet<SweepId> = sweeps.iter().map(|sweep| sweep.id).collect();
        let expected = self.users.expected();
        if found != expected {
            self.world.fail(format_args!("there are sweeps {found:?}, not {expected:?}"));
        }
        for sweep in sweeps {
            if sweep.state == SweepState::Cancelled && !self.users.is_cancelled(sweep.id) {
                self.world.fail(format_args!("nobody cancelled sweep {}", sweep.id));
            }
            let cells = self.users.ask(move |life| async move { life.cells(sweep.id).await }).await;
            cells.iter().for_each(|cell| self.check_cell(cell, sweep.seeds, jobs));
        }
    }

    /// A cell's moments are those of an undisturbed run.
    fn check_cell(&self, cell: &CellSummary, seeds: u64, jobs: &BTreeMap<JobId, JobItem>) {
        let scenario = scenario(&cell.factors);
        let mut expected = Moments::default();
        for seed in 1..=seeds {
            match jobs.values().find(|job| job.factors == cell.factors && job.seed == seed) {
                None => self.world.fail(format_args!("{scenario} with seed {seed} is lost")),
                Some(job) if job.state == JobState::Done => expected.add(value(&scenario, seed)),
                Some(_) => {}
            }
        }
        let found = cell.metrics.get("distance_m").cloned().unwrap_or_default();
        if found != expected {
            self.world.fail(format_args!("cell {:?} has {found:?}, not {expected:?}", cell.factors));
        }
    }
}
