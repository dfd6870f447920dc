//! Whatever submissions, users, workers and time do, in any order: counts, moments and states stay true, nothing that
//! was acknowledged changes unless it is removed, and every sweep and every verification can be brought to its end.

use std::collections::HashMap;
use std::sync::LazyLock;

use furrow_schema::id::{JobId, SweepId};
use furrow_schema::protocol::{LeasedJob, RunEnd};
use furrow_schema::sweep::{NewSweep, SweepState};
use proptest::prelude::*;
use tokio::runtime::Runtime;

use crate::moments::Moments;
use crate::testing::{Bench, Worker, done, panicked, record, sweep};
use crate::view::{JobRef, SweepChange};

const LABELS: [&str; 3] = ["rgop", "rg", "lsq"];
const WORKERS: usize = 3;
/// This share of the results is verified.
const VERIFIED: f64 = 0.5;
/// From so many leases a worker's next report is drawn.
const LATEST: usize = 3;

#[derive(Debug, Clone)]
enum Event {
    Submit {
        labels: usize,
        seeds: u64,
        priority: i64,
    },
    Claim {
        worker: usize,
        want: u32,
    },
    /// One of the latest leases that the worker was given ends, stale or not.
    End {
        worker: usize,
        lease: usize,
        how: usize,
    },
    Renew {
        worker: usize,
        running: bool,
    },
    /// The worker falls silent, and its leases end.
    Die {
        worker: usize,
    },
    Pass {
        ms: i64,
    },
    /// A user does something to one of the sweeps.
    Control {
        sweep: usize,
        what: What,
    },
}

#[derive(Debug, Clone)]
enum What {
    Change(SweepChange),
    Cancel,
    Retry,
    Remove,
}

fn what() -> impl Strategy<Value = What> {
    let change = |(priority, paused)| What::Change(SweepChange { priority, paused });
    prop_oneof![
        4 => (proptest::option::of(0..3i64), proptest::option::of(any::<bool>())).prop_map(change),
        2 => Just(What::Cancel),
        2 => Just(What::Retry),
        1 => Just(What::Remove),
    ]
}

fn event() -> impl Strategy<Value = Event> {
    let worker = 0..WORKERS;
    prop_oneof![
        1 => (1..=LABELS.len(), 1..3u64, 0..2i64)
            .prop_map(|(labels, seeds, priority)| Event::Submit { labels, seeds, priority }),
        3 => (worker.clone(), 1..4u32).prop_map(|(worker, want)| Event::Claim { worker, want }),
        5 => (worker.clone(), any::<usize>(), 0..8usize)
            .prop_map(|(worker, lease, how)| Event::End { worker, lease, how }),
        1 => (worker.clone(), any::<bool>()).prop_map(|(worker, running)| Event::Renew { worker, running }),
        1 => worker.prop_map(|worker| Event::Die { worker }),
        2 => prop_oneof![Just(1_500), Just(31_000)].prop_map(|ms| Event::Pass { ms }),
        3 => (any::<usize>(), what()).prop_map(|(sweep, what)| Event::Control { sweep, what }),
    ]
}

struct History {
    bench: Bench,
    workers: Vec<(Worker, Vec<LeasedJob>)>,
    /// Jobs whose result was acknowledged, with its value.
    acknowledged: HashMap<JobId, f64>,
}

impl History {
    async fn begin() -> Self {
        let bench = Bench::verifying(VERIFIED).await;
        let mut workers = Vec::new();
        for _ in 0..WORKERS {
            workers.push((bench.worker().await, Vec::new()));
        }
        Self { bench, workers, acknowledged: HashMap::new() }
    }

    async fn take(&mut self, event: Event) {
        match event {
            Event::Submit { labels, seeds, priority } => {
                let sweep = NewSweep { priority, ..sweep(&LABELS[..labels], seeds) };
                self.bench.submit(sweep).await;
            }
            Event::Claim { worker, want } => {
                let (worker, leases) = self.worker(worker).await;
                leases.extend(worker.claim(want).await);
            }
            Event::End { worker, lease, how } => self.end(worker, lease, how).await,
            Event::Renew { worker, running } => {
                let (worker, leases) = self.worker(worker).await;
                worker.renew(leases, running).await;
            }
            Event::Die { worker } => self.die(worker).await,
            Event::Pass { ms } => self.bench.pass(ms).await,
            Event::Control { sweep, what } => self.control(sweep, what).await,
        }
    }

    /// The worker, or another in its place if it was barred.
    async fn worker(&mut self, at: usize) -> &mut (Worker, Vec<LeasedJob>) {
        if self.workers[at].0.is_barred().await {
            self.workers[at] = (self.bench.worker().await, Vec::new());
        }
        &mut self.workers[at]
    }

    async fn die(&mut self, worker: usize) {
        let worker = self.worker(worker).await.0.id.clone();
        let gone_ms = self.bench.coordinator.now_ms();
        self.bench.clock.advance(2_000);
        assert_eq!(self.bench.coordinator.worker_gone(worker, gone_ms).await.unwrap(), None);
        self.bench.assert_consistent().await;
    }

    async fn control(&mut self, sweep: usize, what: What) {
        let coordinator = &self.bench.coordinator;
        let sweeps = coordinator.sweeps(None, 1_000).await.unwrap();
        let Some(sweep) = sweeps.get(sweep % sweeps.len().max(1)) else { return };
        match what {
            What::Change(change) => {
                let refused = sweep.state == SweepState::Cancelled && change.paused == Some(false);
                assert_eq!(coordinator.change(sweep.id, change).await.is_err(), refused);
            }
            What::Cancel => {
                let cancelled = coordinator.cancel(sweep.id).await.unwrap().unwrap();
                assert!(matches!(cancelled.state, SweepState::Cancelled | SweepState::Done));
            }
            What::Retry => {
                let retried = coordinator.retry(sweep.id).await.unwrap().unwrap();
                assert_eq!((retried.failed, retried.cancelled), (0, 0));
            }
            What::Remove => self.remove(sweep.id).await,
        }
        self.bench.assert_consistent().await;
    }

    /// A result goes with the last sweep that lists its job, and only then.
    async fn remove(&mut self, sweep: SweepId) {
        let mut gone = Vec::new();
        for job in self.acknowledged.keys() {
            let detail = self.bench.coordinator.job(JobRef::Id(*job)).await.unwrap().unwrap();
            if detail.cells.iter().all(|cell| cell.sweep == sweep) {
                gone.push(*job);
            }
        }
        assert!(self.bench.coordinator.remove(sweep).await.unwrap());
        for job in gone {
            assert_eq!(self.bench.coordinator.job(JobRef::Id(job)).await.unwrap(), None);
            self.acknowledged.remove(&job);
        }
    }

    async fn end(&mut self, worker: usize, lease: usize, how: usize) {
        // Liars do not agree with each other.
        let lie = -1.0 - worker as f64;
        let (worker, leases) = self.worker(worker).await;
        let Some(lease) = leases.iter().rev().nth(lease % leases.len().clamp(1, LATEST)).cloned() else { return };
        let value = if how == 7 { lie } else { honest(&lease) };
        let ended = match how {
            0..4 => panicked("no"),
            4 => RunEnd::HandedBack,
            _ => done(value),
        };
        let is_result = matches!(ended, RunEnd::Done(_));
        if worker.ended(&lease, ended).await && is_result {
            let first = self.acknowledged.entry(lease.job).or_insert(value);
            assert_eq!(*first, value, "two results of a job were acknowledged");
        }
    }

    /// All jobs are asked for again, and a patient worker does what is left.
    async fn finish(&mut self) {
        self.bench.pass(100_000).await;
        self.bench.submit(sweep(&LABELS, 3)).await;
        let worker = self.bench.worker().await;
        // One claim for the jobs, then one for each opinion that a verification may need.
        for _ in 0..5 {
            for job in worker.claim(100).await {
                let on_record = *self.acknowledged.entry(job.job).or_insert(honest(&job));
                assert_eq!(worker.ended(&job, done(honest(&job))).await, on_record == honest(&job));
            }
            self.bench.pass(61_000).await;
        }
        assert_eq!(self.bench.coordinator.verifications().await.unwrap().open, 0);
    }

    async fn check(&self) {
        self.bench.assert_consistent().await;
        for (job, value) in &self.acknowledged {
            let result = self.bench.coordinator.job(JobRef::Id(*job)).await.unwrap().unwrap().result.unwrap();
            assert_eq!(result.digest, record(*value).digest);
        }
        for sweep in self.bench.coordinator.sweeps(None, 1_000).await.unwrap() {
            let cells = self.bench.cells(sweep.id).await;
            let values = self.bench.coordinator.values(sweep.id, None).await.unwrap();
            for (cell, values) in cells.iter().zip(values) {
                let mut expected = Moments::default();
                values.metrics.get("distance_m").into_iter().flatten().flatten().for_each(|v| expected.add(*v));
                assert_eq!(cell.metrics.get("distance_m").cloned().unwrap_or_default(), expected);
            }
        }
    }
}

/// What comes out of a job.
fn honest(job: &LeasedJob) -> f64 {
    job.job.0 as f64 / 3.0
}

static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_history_keeps_the_books_right(events in proptest::collection::vec(event(), 0..80)) {
        RUNTIME.block_on(async {
            let mut history = History::begin().await;
            for event in events {
                history.take(event).await;
            }
            history.check().await;
            history.finish().await;
            history.check().await;
            let sweeps = history.bench.coordinator.sweeps(None, 1_000).await.unwrap();
            let ended = |state| matches!(state, SweepState::Done | SweepState::Cancelled);
            assert!(sweeps.iter().all(|sweep| ended(sweep.state) && sweep.done == sweep.total), "{sweeps:?}");
        });
    }
}
