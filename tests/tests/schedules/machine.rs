//! A machine with one worker on it: the real worker in simulated time with its real spool, which is killed, stopped,
//! cut off and started again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use furrow_schema::job::RunRecord;
use furrow_schema::protocol::LeasedJob;
use furrow_worker::{Config, Order, Pace, Runner, Spool, Worker};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::ENGINE;
use super::jobs::{Jobs, Nature, record};
use super::ledger::Lease;
use super::server::Server;
use super::wire::Wire;
use super::world::World;

/// A spool's place in a test is as good as a small one.
const SPOOL_BYTES: u64 = 1 << 20;

/// Runs that end are in the spool after so long.
const GATHERED_MS: i64 = 1_050;
/// Begins every record of a spool, and the content of a run's.
const MARK: &[u8] = b"\xF7run";
const RUN_ENDED: &[u8] = br#"{"ended":"#;

/// See the module.
pub(super) struct Machine {
    world: Arc<World>,
    jobs: Arc<Jobs>,
    wire: Wire,
    threads: usize,
    folder: PathBuf,
    /// Runs that go on, by scenario and seed.
    begun: Mutex<BTreeMap<(String, u64), Lease>>,
    /// Runs that this folder's spool keeps, and when they ended.
    ended: Mutex<BTreeMap<Lease, i64>>,
    killed: Notify,
}

impl Machine {
    /// Switches it on.
    pub(super) fn start(
        world: &Arc<World>,
        jobs: &Arc<Jobs>,
        server: &Arc<Server>,
        number: usize,
        folder: PathBuf,
    ) -> Arc<Self> {
        let cut_until_ms = Arc::new(AtomicI64::new(0));
        let wire = Wire { world: world.clone(), server: server.clone(), worker: number, cut_until_ms };
        let machine = Arc::new(Self {
            world: world.clone(),
            jobs: jobs.clone(),
            wire,
            threads: world.draw(1..world.size.threads + 1) as usize,
            folder,
            begun: Mutex::default(),
            ended: Mutex::default(),
            killed: Notify::new(),
        });
        tokio::spawn(machine.clone().go_on());
        machine
    }

    /// Nothing goes to it or from it for so long.
    pub(super) fn cut(&self, for_ms: u64) {
        self.world.say(format_args!("worker {} is cut off for {for_ms} ms", self.wire.worker));
        self.wire.cut_until_ms.store(self.world.now_ms() + for_ms as i64, Ordering::SeqCst);
    }

    /// Everything goes through again.
    pub(super) fn join(&self) {
        self.wire.cut_until_ms.store(0, Ordering::SeqCst);
    }

    /// Its worker dies.
    pub(super) fn kill(&self) {
        self.killed.notify_one();
    }

    async fn go_on(self: Arc<Self>) {
        loop {
            self.live().await;
            if self.world.fault(50) {
                self.lose_folder();
            }
            self.world.pause(1..15_000).await;
        }
    }

    /// From the start of the worker's process to its end.
    async fn live(self: &Arc<Self>) {
        let number = self.wire.worker;
        let spool = Arc::new(Mutex::new(Spool::open(&self.folder, ENGINE, SPOOL_BYTES).expect("the folder is free")));
        let coordinator = self.wire.server.id();
        self.world.say(format_args!(
            "worker {number} starts with {} runs in its spool",
            spool.lock().unwrap().waiting().len()
        ));
        let stop = CancellationToken::new();
        let config = Config { name: format!("machine-{number}"), threads: self.threads, engine: ENGINE };
        let worker = Worker::with_runner(Arc::new(self.wire.clone()), config, Runs(self.clone()));
        let worker = worker.spooling(spool, &coordinator).paced(self.pace());
        let mut life = tokio::spawn(worker.run(stop.clone()));
        let stopped = async {
            self.world.pause(10_000..120_000).await;
            if self.world.is_calm() {
                std::future::pending().await
            }
        };
        tokio::select! {
            biased;
            ended = &mut life => return self.world.fail(format_args!("worker {number} ended by itself: {ended:?}")),
            () = self.killed.notified() => {
                self.world.say(format_args!("worker {number} is killed"));
                life.abort();
            }
            () = stopped => {
                self.world.say(format_args!("worker {number} is told to stop"));
                stop.cancel();
            }
        }
        let _ = life.await;
        self.begun.lock().unwrap().clear();
        self.close_books();
    }

    /// What is in the spool for good, now that its worker is dead. What ended right now may be, or not.
    fn close_books(&self) {
        let now_ms = self.world.now_ms();
        let mut ended = self.ended.lock().unwrap();
        let unsure = ended.values().any(|ended_ms| ended_ms + GATHERED_MS >= now_ms);
        if !unsure && self.world.fault(300) {
            self.lose_power();
        }
        ended.retain(|_, ended_ms| *ended_ms + GATHERED_MS < now_ms);
        ended.keys().for_each(|lease| self.world.ledger().spooled(*lease));
        ended.clear();
    }

    /// Of the spool's file only that stays for certain which was synced: all up to the last run.
    fn lose_power(&self) {
        let path = self.folder.join("1").join("runs");
        let bytes = std::fs::read(&path).expect("the worker had a spool");
        let ended = bytes.windows(RUN_ENDED.len()).rposition(|word| word == RUN_ENDED);
        let synced = ended.map_or(0, |at| {
            bytes[at..].windows(MARK.len()).position(|word| word == MARK).map_or(bytes.len(), |next| at + next)
        });
        let left = self.world.draw(synced as u64..bytes.len() as u64 + 1);
        self.world.say(format_args!("worker {} loses {} unsynced bytes", self.wire.worker, bytes.len() as u64 - left));
        std::fs::File::options().write(true).open(&path).and_then(|file| file.set_len(left)).expect("it can be cut");
    }

    fn lose_folder(&self) {
        self.world.say(format_args!("the disk of worker {} is lost", self.wire.worker));
        let spool = Spool::open(&self.folder, ENGINE, SPOOL_BYTES).expect("the folder is free");
        let lost: BTreeSet<Lease> = spool.waiting().map(|(_, job, attempt)| (job, attempt)).collect();
        drop(spool);
        self.world.ledger().spool_lost(&lost);
        std::fs::remove_dir_all(&self.folder).expect("the folder is there");
    }

    fn pace(self: &Arc<Self>) -> Pace {
        let (machine, world) = (self.clone(), self.world.clone());
        Pace {
            lasts: Arc::new(move |job| machine.begin(job)),
            shares: Arc::new(move || world.draw(500..1_001) as f64 / 1_000.0),
        }
    }

    /// A run begins: says how long it lasts. Some kill their worker meanwhile.
    fn begin(self: &Arc<Self>, job: &LeasedJob) -> Duration {
        let text = self.world.ledger().scenarios.get(&job.scenario).cloned().unwrap_or_default();
        self.begun.lock().unwrap().insert((text.clone(), job.seed), (job.job, job.attempt));
        if self.jobs.next(Nature::Kills, &text, job.seed) {
            let machine = self.clone();
            tokio::spawn(async move {
                machine.world.pause(5_000..8_000).await;
                machine.kill();
            });
            return Duration::from_secs(10);
        }
        Duration::from_millis(self.world.draw(100..6_000))
    }

    /// A run ended by itself.
    fn end(&self, scenario: &str, seed: u64) {
        let lease = self.begun.lock().unwrap().remove(&(scenario.to_owned(), seed));
        let now_ms = self.world.now_ms();
        lease.map(|lease| self.ended.lock().unwrap().insert(lease, now_ms));
        if self.world.fault(20) {
            self.kill();
        }
    }
}

/// What the worker does with a job.
struct Runs(Arc<Machine>);

impl Runner for Runs {
    type Scenario = String;

    fn read(&self, scenario_json: &str) -> Result<String, String> {
        Ok(scenario_json.to_owned())
    }

    fn run(&self, scenario: &String, order: Order, _stop: &AtomicBool) -> Option<RunRecord> {
        self.0.end(scenario, order.seed);
        if self.0.jobs.next(Nature::Panics, scenario, order.seed) {
            // Unlike `panic!` it prints nothing.
            std::panic::resume_unwind(Box::new("as the schedule has it".to_owned()));
        }
        Some(record(scenario, order.seed))
    }
}
