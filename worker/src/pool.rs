//! Empties the board on all cores: one simulation a thread, never parallel inside.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use furrow_schema::protocol::{LeasedJob, RunEnd};
use tokio::sync::Notify;
use tokio_util::sync::{CancellationToken, DropGuard};

use crate::board::{Board, Work};
use crate::pace::{self, Pace};
use crate::runner::{Order, Runner};

/// A panic's message is cut to this many characters.
const MAX_MESSAGE: usize = 2_000;

/// The board, and bells that ring when it changes.
pub(crate) struct Shared<S> {
    board: Mutex<Board<S>>,
    /// Rings when there may be room for more jobs.
    pub(crate) room: Notify,
    /// Rings when a report may be due, or the board became idle.
    pub(crate) ended: Notify,
    /// Rings when the spool may have something to do now, or the board became idle.
    pub(crate) spool: Notify,
}

impl<S> Shared<S> {
    /// An empty board, whose ended runs pass through a spool or not.
    pub(crate) fn new(threads: usize, spooling: bool) -> Self {
        let board = Mutex::new(Board::new(threads, spooling));
        Self { board, room: Notify::new(), ended: Notify::new(), spool: Notify::new() }
    }

    /// The next run for a taker, as the board gives it. Rings only where that makes room: a bell costs more than a short run.
    pub(crate) fn take(&self) -> Option<Work<S>> {
        let mut board = self.board();
        let work = board.take()?;
        let room = board.want() > 0;
        drop(board);
        if room {
            self.room.notify_one();
        }
        Some(work)
    }

    /// A run ended. Says how many more takers should begin.
    pub(crate) fn finish(&self, job: &LeasedJob, ended: RunEnd, took: Duration) -> usize {
        let mut board = self.board();
        board.finish(job, ended, took);
        let (more, news) = (board.engage(), board.has_news());
        drop(board);
        if news {
            self.ring_ended();
        }
        more
    }

    /// A run ended, or there will be no more of them.
    pub(crate) fn ring_ended(&self) {
        self.ended.notify_one();
        self.spool.notify_one();
    }

    /// The board. No code panics while it holds the lock, so a poisoned one is as good.
    pub(crate) fn board(&self) -> MutexGuard<'_, Board<S>> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Who takes work from the board.
enum Takers {
    Threads(rayon::ThreadPool),
    /// Tasks in simulated time, which go when the guard does.
    Tasks(Pace, DropGuard),
}

/// Empties the board.
pub(crate) struct Pool<R: Runner> {
    takers: Takers,
    shared: Arc<Shared<R::Scenario>>,
    runner: Arc<R>,
}

impl<R: Runner> Pool<R> {
    /// Starts `threads` threads.
    ///
    /// # Errors
    /// The operating system gives no more threads.
    pub(crate) fn new(
        threads: usize,
        shared: Arc<Shared<R::Scenario>>,
        runner: Arc<R>,
    ) -> Result<Self, rayon::ThreadPoolBuildError> {
        let named = rayon::ThreadPoolBuilder::new().num_threads(threads.max(1)).thread_name(|i| format!("run-{i}"));
        Ok(Self { takers: Takers::Threads(named.build()?), shared, runner })
    }

    /// Tasks of the current tokio runtime in place of threads.
    pub(crate) fn paced(shared: Arc<Shared<R::Scenario>>, runner: Arc<R>, pace: &Pace) -> Self {
        Self { takers: Takers::Tasks(pace.clone(), CancellationToken::new().drop_guard()), shared, runner }
    }

    /// Sets as many takers to work as there is work for. Called whenever the board got jobs.
    pub(crate) fn kick(&self) {
        let more = self.shared.board().engage();
        for _ in 0..more {
            let (shared, runner) = (Arc::clone(&self.shared), Arc::clone(&self.runner));
            match &self.takers {
                Takers::Threads(threads) => threads.spawn(move || take_all(&shared, &runner)),
                Takers::Tasks(pace, guard) => pace::begin(shared, runner, pace.clone(), guard.token().clone()),
            }
        }
    }
}

fn take_all<R: Runner>(shared: &Arc<Shared<R::Scenario>>, runner: &Arc<R>) {
    loop {
        let Some(work) = shared.take() else { return };
        let began = Instant::now();
        let ended = run(runner.as_ref(), &work);
        let more = shared.finish(&work.lease, ended, began.elapsed());
        for _ in 0..more {
            let (shared, runner) = (Arc::clone(shared), Arc::clone(runner));
            rayon::spawn(move || take_all(&shared, &runner));
        }
    }
}

/// One run, whatever it does.
pub(crate) fn run<R: Runner>(runner: &R, work: &Work<R::Scenario>) -> RunEnd {
    let order = Order { seed: work.lease.seed, record: work.lease.record, alone: work.lease.alone };
    let whole_run = || {
        let scenario = work.scenario.read_by(|json| runner.read(json))?;
        Ok::<_, &str>(runner.run(scenario, order, &work.stop))
    };
    // The run's own state is dropped by the panic; the scenario is only read.
    match catch_unwind(AssertUnwindSafe(whole_run)) {
        Ok(Ok(Some(record))) => RunEnd::Done(record),
        Ok(Ok(None)) => RunEnd::HandedBack,
        Ok(Err(message)) => RunEnd::Panicked { message: cut(message) },
        Err(panic) => RunEnd::Panicked { message: panic_message(panic.as_ref()) },
    }
}

/// The text of a caught panic.
pub(crate) fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    cut(text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message"))
}

fn cut(message: &str) -> String {
    message.chars().take(MAX_MESSAGE).collect()
}
