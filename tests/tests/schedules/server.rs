//! The coordinator's process: a mailbox in front of the real coordinator, which dies and comes back.

use std::ops::Range;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use furrow_coordinator::{Config, Coordinator, Failure, Store, StoreError};
use furrow_schema::protocol::{Refusal, Reply};
use futures::future::join_all;
use tokio::sync::Notify;

use super::ENGINE;
use super::database::Database;
use super::letter::{Answer, Letter, Question, held, jobs, runs};
use super::world::World;

/// No lease ends so soon after the start, a standstill or an outage. The coordinator's own housekeeping waits as long, in
/// real time, which is for ever: it is done here, in simulated time.
const GRACE: Duration = Config::WORKERS_ARE_BACK_WITHIN;
const GRACE_MS: i64 = GRACE.as_millis() as i64;
/// Often enough for it not to seem that the coordinator stood still [ms].
const HOUSE_EVERY_MS: Range<u64> = 2_000..4_900;
/// Housekeeping that is so late tells the coordinator that it stood still [ms].
const LATE_MS: i64 = 5_000;
/// How long a killed coordinator stays away [ms].
const AWAY_MS: Range<u64> = 0..40_000;

#[derive(Default)]
struct State {
    /// None while the process is dead.
    life: Option<Coordinator>,
    /// When housekeeping was last done, or is to be done first.
    kept_house_ms: i64,
    stands_still_until_ms: i64,
    mailbox: Vec<Letter>,
}

/// See the module.
pub(super) struct Server {
    world: Arc<World>,
    database: Arc<Database>,
    state: Mutex<State>,
    arrived: Notify,
}

/// What goes wrong with a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mishap {
    None,
    NotWritten(Failure),
    DiesOf(Failure),
    DiesAfterCommit,
}

impl Mishap {
    fn draw(world: &World) -> Self {
        let failure = || match world.draw(0..2) {
            0 => Failure::AtCommit,
            _ => Failure::AfterRows(world.draw(0..12) as u32),
        };
        match world.draw(0..1_000) {
            _ if world.is_calm() => Self::None,
            n if n < world.mood.fatal => Self::DiesAfterCommit,
            n if n < 2 * world.mood.fatal => Self::DiesOf(failure()),
            n if n < 2 * (world.mood.fatal + world.mood.unwritable) => Self::NotWritten(failure()),
            _ => Self::None,
        }
    }

    fn failure(self) -> Option<Failure> {
        match self {
            Self::None | Self::DiesAfterCommit => None,
            Self::NotWritten(failure) | Self::DiesOf(failure) => Some(failure),
        }
    }

    fn is_fatal(self) -> bool {
        matches!(self, Self::DiesOf(_) | Self::DiesAfterCommit)
    }
}

impl Server {
    /// Starts the process with its loops.
    pub(super) fn start(world: &Arc<World>, database: &Arc<Database>) -> Arc<Self> {
        let (state, arrived) = (Mutex::default(), Notify::new());
        let server = Arc::new(Self { world: world.clone(), database: database.clone(), state, arrived });
        server.begin();
        tokio::spawn(server.clone().answer_letters());
        tokio::spawn(server.clone().keep_house());
        server
    }

    fn begin(&self) {
        let config = Config { clock: self.world.clock(), leases_hold_for: GRACE, ..Config::new(ENGINE) };
        self.world.show_time();
        let store = self.database.store.clone();
        let life = self.database.wait(async {
            store.undo_unfinished().await.expect("the store is open");
            Coordinator::start(store, config)
        });
        let since_ms = self.world.now_ms();
        self.world.ledger().grant_grace(since_ms, GRACE_MS);
        let mut state = self.state.lock().unwrap();
        *state = State { life: Some(life), kept_house_ms: since_ms + GRACE_MS, ..State::default() };
    }

    pub(super) fn store(&self) -> Store {
        self.database.store.clone()
    }

    pub(super) fn wait<T: Send + 'static>(&self, work: impl Future<Output = T> + Send + 'static) -> T {
        self.database.wait(work)
    }

    /// The coordinator's name.
    pub(super) fn id(&self) -> String {
        self.database.store.coordinator_id().to_owned()
    }

    /// Kills the process; it comes back.
    pub(super) fn crash(self: &Arc<Self>) {
        if !self.die() {
            return;
        }
        self.world.say("the coordinator dies");
        let server = self.clone();
        tokio::spawn(async move {
            server.world.pause(AWAY_MS).await;
            server.begin();
            server.world.say("the coordinator is back");
        });
    }

    /// Its machine sleeps.
    pub(super) fn stand_still(&self, for_ms: u64) {
        self.world.say(format_args!("the coordinator stands still for {for_ms} ms"));
        self.state.lock().unwrap().stands_still_until_ms = self.world.now_ms() + for_ms as i64;
    }

    /// How long it stands still [ms].
    fn stands_still_ms(&self) -> u64 {
        let until_ms = self.state.lock().unwrap().stands_still_until_ms;
        u64::try_from(until_ms - self.world.now_ms()).unwrap_or(0)
    }

    /// Kills the process for good; false if it was dead.
    pub(super) fn die(&self) -> bool {
        let mut state = self.state.lock().unwrap();
        state.mailbox.clear();
        state.life.take().map(|life| life.kill()).is_some()
    }

    /// A question arrives; whoever is dead does not hear it.
    pub(super) fn deliver(&self, letter: Letter) {
        let mut state = self.state.lock().unwrap();
        if state.life.is_some() {
            state.mailbox.push(letter);
            self.arrived.notify_one();
        }
    }

    async fn answer_letters(self: Arc<Self>) {
        loop {
            self.arrived.notified().await;
            let still_ms = self.stands_still_ms();
            self.world.pause(still_ms..still_ms + 4).await;
            self.answer_batch();
        }
    }

    fn answer_batch(self: &Arc<Self>) {
        let (life, letters) = {
            let mut state = self.state.lock().unwrap();
            (state.life.clone(), std::mem::take(&mut state.mailbox))
        };
        let Some(life) = life.filter(|_| !letters.is_empty()) else { return };
        let mishap = Mishap::draw(&self.world);
        let questions: Vec<_> = letters.iter().map(|letter| letter.question.clone()).collect();
        let ask = async move { join_all(questions.into_iter().map(|question| question.put(&life))).await };
        let answers = self.wait_during(mishap, ask);
        self.note(&letters, &answers);
        self.suffer(mishap, answers.iter().any(Answer::is_not_written));
        if mishap.is_fatal() {
            return;
        }
        for (letter, answer) in letters.into_iter().zip(answers) {
            let _ = letter.answer.send(answer);
        }
    }

    fn wait_during<T: Send + 'static>(&self, mishap: Mishap, work: impl Future<Output = T> + Send + 'static) -> T {
        self.world.show_time();
        match mishap.failure() {
            Some(failure) => self.database.wait_during(failure, work),
            None => self.database.wait(work),
        }
    }

    /// What comes of a mishap, apart from the answers.
    fn suffer(self: &Arc<Self>, mishap: Mishap, not_written: bool) {
        if mishap != Mishap::None {
            let outcome = if not_written { "nothing is written" } else { "all is written" };
            self.world.say(format_args!("{mishap:?}: {outcome}"));
        }
        if matches!(mishap, Mishap::NotWritten(Failure::AfterRows(_))) && not_written {
            self.world.ledger().grant_grace(self.world.now_ms(), GRACE_MS);
        }
        if mishap.is_fatal() {
            self.crash();
        }
    }

    /// Holds the answers against what was said before, in the order in which a batch is applied.
    fn note(&self, letters: &[Letter], answers: &[Answer]) {
        let now_ms = self.world.now_ms();
        let mut broken = Vec::new();
        for kind in 0..5 {
            for (letter, answer) in letters.iter().zip(answers) {
                let mut ledger = self.world.ledger();
                match (kind, &letter.question, answer) {
                    (0, Question::Hello(_), Answer::Hello(reply)) => self.say(letter.from, "says hello", reply),
                    (1, Question::Result(call), Answer::Result(reply)) => {
                        self.say(letter.from, &format!("reports {}", runs(&call.body)), reply);
                        let Reply::Ok(recorded) = reply else { continue };
                        broken.extend(ledger.reported(call, recorded));
                    }
                    (2, Question::Renew(call), Answer::Renew(reply)) => {
                        self.say(letter.from, &format!("renews {}", held(&call.body)), reply);
                        let Reply::Ok(renewed) = reply else { continue };
                        broken.extend(ledger.renewed(call, renewed, now_ms));
                    }
                    (3, Question::Claim(call), Answer::Claim(Reply::Ok(_))) if call.body.first => ledger.begins(call),
                    (4, Question::Claim(call), Answer::Claim(reply)) => {
                        let Reply::Ok(leases) = reply else { continue };
                        self.say(letter.from, &format!("claims {}", jobs(leases)), &Reply::Ok(()));
                        broken.extend(ledger.claimed(call, leases, now_ms));
                    }
                    _ => {}
                }
            }
        }
        broken.iter().for_each(|text| self.world.fail(text));
    }

    fn say<T: std::fmt::Debug>(&self, from: usize, what: &str, reply: &Reply<T>) {
        let answer = match reply {
            Reply::Ok(answer) => format!("{answer:?}"),
            Reply::Refused(Refusal::Unavailable { .. }) => "not written".to_owned(),
            Reply::Refused(refusal) => format!("refused: {refusal}"),
        };
        self.world.say(format_args!("worker {from} {what}: {answer}"));
    }

    async fn keep_house(self: Arc<Self>) {
        loop {
            self.world.pause(HOUSE_EVERY_MS).await;
            if self.is_to_keep_house() {
                let _ = self.tell_life(|life| async move { life.keep_house().await });
            }
        }
    }

    /// Whether it is time, which is noted, and what follows if it is late.
    fn is_to_keep_house(&self) -> bool {
        if self.stands_still_ms() > 0 {
            return false;
        }
        let now_ms = self.world.now_ms();
        let mut state = self.state.lock().unwrap();
        if state.life.is_none() || now_ms < state.kept_house_ms {
            return false;
        }
        let last_ms = std::mem::replace(&mut state.kept_house_ms, now_ms);
        if now_ms - last_ms > LATE_MS {
            self.world.say("the coordinator finds that it stood still");
            self.world.ledger().grant_grace(now_ms, GRACE_MS);
        }
        true
    }

    fn life(&self) -> Option<Coordinator> {
        if self.stands_still_ms() > 0 {
            return None;
        }
        self.world.show_time();
        self.state.lock().unwrap().life.clone()
    }

    /// What the living coordinator answers to a user; none if it is dead, or stands still.
    pub(super) fn ask_life<T, F>(&self, question: impl FnOnce(Coordinator) -> F) -> Option<Result<T, StoreError>>
    where
        T: Send + 'static,
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        Some(self.database.wait(question(self.life()?)))
    }

    /// What it answers to an order that it follows; none if it cannot, or dies of it.
    pub(super) fn tell_life<T, F>(self: &Arc<Self>, order: impl FnOnce(Coordinator) -> F) -> Option<T>
    where
        T: Send + 'static,
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        let life = self.life()?;
        let mishap = Mishap::draw(&self.world);
        let done = self.wait_during(mishap, order(life));
        self.suffer(mishap, done.is_err());
        if let (Err(error), Mishap::None) = (&done, mishap) {
            self.world.fail(format_args!("an order is refused: {error}"));
        }
        done.ok().filter(|_| !mishap.is_fatal())
    }
}
