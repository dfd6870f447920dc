//! What all parts of a schedule share: the one generator, simulated time, the trace, and whether a claim was broken.

use std::fmt::Display;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use furrow_coordinator::Clock;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use tokio::sync::Notify;
use tokio::time::{Instant, sleep};

use super::ledger::Ledger;

/// Simulated time begins here [ms since 1970].
const BEGIN_MS: i64 = 1_700_000_000_000;

/// How often each fault comes in a schedule [of 1000].
#[derive(Debug, Clone, Copy)]
pub(super) struct Mood {
    /// A message is lost, on its way there or back.
    pub(super) lost: u64,
    /// A question comes once more, up to 45 s later.
    pub(super) twice: u64,
    /// A message takes up to 3 s.
    pub(super) slow: u64,
    /// The coordinator dies of a batch, before or after its commit.
    pub(super) fatal: u64,
    /// A batch cannot be written.
    pub(super) unwritable: u64,
}

/// How much there is in a schedule, at most.
#[derive(Debug, Clone, Copy)]
pub(super) struct Size {
    pub(super) machines: u64,
    pub(super) threads: u64,
    pub(super) sweeps: u64,
    pub(super) labels: u64,
    pub(super) seeds: u64,
    /// Things that happen while there are faults.
    pub(super) events: u64,
}

/// Most schedules are small: there are the more of them.
const SMALL: Size = Size { machines: 2, threads: 1, sweeps: 2, labels: 2, seeds: 3, events: 6 };
const USUAL: Size = Size { machines: 3, threads: 2, sweeps: 3, labels: 3, seeds: 6, events: 12 };
const LARGE: Size = Size { machines: 5, threads: 4, sweeps: 4, labels: 3, seeds: 16, events: 24 };

impl Size {
    fn of(percentile: u64) -> Self {
        match percentile {
            0..80 => SMALL,
            80..98 => USUAL,
            _ => LARGE,
        }
    }
}

/// See the module.
pub(super) struct World {
    random: Mutex<ChaCha8Rng>,
    began: Instant,
    /// What the coordinator's clock shows, as of the last question.
    shown_ms: std::sync::Arc<AtomicI64>,
    trace: Mutex<Vec<String>>,
    broken: Mutex<Option<String>>,
    gave_up: Notify,
    calm: AtomicBool,
    ledger: Mutex<Ledger>,
    pub(super) mood: Mood,
    pub(super) size: Size,
}

impl World {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut up_to = |most: u64| random.next_u64() % (most + 1);
        let mood =
            Mood { lost: up_to(120), twice: up_to(120), slow: up_to(200), fatal: up_to(25), unwritable: up_to(25) };
        let size = Size::of(up_to(99));
        Self {
            random: Mutex::new(random),
            began: Instant::now(),
            shown_ms: std::sync::Arc::new(AtomicI64::new(BEGIN_MS)),
            trace: Mutex::default(),
            broken: Mutex::default(),
            gave_up: Notify::new(),
            calm: AtomicBool::new(false),
            ledger: Mutex::default(),
            mood,
            size,
        }
    }

    pub(super) fn draw(&self, range: Range<u64>) -> u64 {
        range.start + self.random.lock().unwrap().next_u64() % (range.end - range.start)
    }

    /// True `of_1000` times of 1000, as long as there are faults.
    pub(super) fn fault(&self, of_1000: u64) -> bool {
        self.draw(0..1_000) < of_1000 && !self.is_calm()
    }

    pub(super) async fn pause(&self, ms: Range<u64>) {
        sleep(Duration::from_millis(self.draw(ms))).await;
    }

    pub(super) fn now_ms(&self) -> i64 {
        BEGIN_MS + i64::try_from(self.began.elapsed().as_millis()).expect("a schedule takes minutes")
    }

    /// The coordinator's clock, which [`World::show_time`] sets.
    pub(super) fn clock(&self) -> Clock {
        let shown_ms = self.shown_ms.clone();
        Clock::from_fn(move || shown_ms.load(Ordering::SeqCst))
    }

    pub(super) fn show_time(&self) {
        self.shown_ms.store(self.now_ms(), Ordering::SeqCst);
    }

    /// No fault comes from now on.
    pub(super) fn calm_down(&self) {
        self.say("no more faults");
        self.calm.store(true, Ordering::SeqCst);
    }

    pub(super) fn is_calm(&self) -> bool {
        self.calm.load(Ordering::SeqCst)
    }

    pub(super) fn ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap()
    }

    /// Adds a line to the trace.
    pub(super) fn say(&self, text: impl Display) {
        let s = self.began.elapsed().as_secs_f64();
        self.trace.lock().unwrap().push(format!("{s:8.3} {text}"));
    }

    /// A claim does not hold. The first one counts.
    pub(super) fn fail(&self, text: impl Display) {
        self.say(format_args!("BROKEN: {text}"));
        self.broken.lock().unwrap().get_or_insert_with(|| text.to_string());
        self.gave_up.notify_one();
    }

    /// Waits until a claim does not hold: whoever asks on may wait for ever then.
    pub(super) async fn gave_up(&self) {
        self.gave_up.notified().await;
    }

    pub(super) fn broken(&self) -> Option<String> {
        self.broken.lock().unwrap().clone()
    }

    pub(super) fn trace(&self) -> Vec<String> {
        self.trace.lock().unwrap().clone()
    }
}
