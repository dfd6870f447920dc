//! Users: they submit sweeps that share jobs, and change, cancel and retry them, until they were heard.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

use furrow_coordinator::{Coordinator, StoreError, SweepChange};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};

use super::jobs::{LABELS, Wish, sweep};
use super::server::Server;
use super::world::World;

/// See the module.
pub(super) struct Users {
    world: Arc<World>,
    server: Arc<Server>,
    submitted: Mutex<usize>,
    /// Sweeps that are there, each with the number of its wish.
    sweeps: Mutex<Vec<(SweepId, usize)>>,
    removals: Mutex<usize>,
    /// Sweeps that were cancelled, and not retried since.
    cancelled: Mutex<Vec<SweepId>>,
}

impl Users {
    pub(super) fn new(world: &Arc<World>, server: &Arc<Server>) -> Arc<Self> {
        Arc::new(Self {
            world: world.clone(),
            server: server.clone(),
            submitted: Mutex::default(),
            sweeps: Mutex::default(),
            removals: Mutex::default(),
            cancelled: Mutex::default(),
        })
    }

    /// Asks until there is an answer; now and then it is lost.
    pub(super) async fn ask<T, F>(&self, question: impl Fn(Coordinator) -> F) -> T
    where
        T: Send + 'static,
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        loop {
            match self.server.ask_life(&question) {
                Some(Ok(answer)) if !self.world.fault(self.world.mood.lost) => return answer,
                Some(Err(error)) => self.world.fail(format_args!("a user is refused: {error}")),
                _ => {}
            }
            self.world.pause(100..2_000).await;
        }
    }

    /// Has something changed, until it is said to be; now and then it cannot be written, or the coordinator dies of it.
    async fn tell<T, F>(&self, order: impl Fn(Coordinator) -> F) -> T
    where
        T: Send + 'static,
        F: Future<Output = Result<T, StoreError>> + Send + 'static,
    {
        loop {
            match self.server.tell_life(&order) {
                Some(answer) if !self.world.fault(self.world.mood.lost) => return answer,
                _ => self.world.pause(100..2_000).await,
            }
        }
    }

    /// Submits a sweep.
    pub(super) async fn submit(&self) {
        let (draw, size) = (|most| self.world.draw(1..most + 1), self.world.size);
        let (labels, seeds) = (draw(size.labels.min(LABELS.len() as u64)) as usize, draw(size.seeds));
        let key = {
            let mut submitted = self.submitted.lock().unwrap();
            *submitted += 1;
            *submitted
        };
        let (priority, generation) = (self.world.draw(0..2) as i64, *self.removals.lock().unwrap());
        let wish = Wish { labels, seeds, priority, generation, key };
        self.world.ledger().asking(wish);
        let submitted = self.tell(|life| async move { life.submit(sweep(wish)).await }).await;
        self.world.say(format_args!("a user submits {wish:?}: {submitted:?}"));
        self.sweeps.lock().unwrap().push((submitted.id, key));
    }

    /// Does something to one of the sweeps, or submits another one.
    pub(super) async fn act(&self) {
        let sweeps = self.sweeps.lock().unwrap().clone();
        let Some((sweep, _)) = sweeps.get(self.world.draw(0..self.world.size.sweeps) as usize).copied() else {
            return self.submit().await;
        };
        match self.world.draw(0..7) {
            0 => self.change(sweep, SweepChange { priority: None, paused: Some(true) }).await,
            1 | 2 => self.change(sweep, SweepChange { priority: None, paused: Some(false) }).await,
            3 => self.change(sweep, SweepChange { priority: Some(self.world.draw(0..3) as i64), paused: None }).await,
            4 => self.cancel(sweep).await,
            5 => self.remove(sweep).await,
            _ => self.retry(sweep).await,
        }
    }

    async fn change(&self, sweep: SweepId, change: SweepChange) {
        if self.cancelled.lock().unwrap().contains(&sweep) {
            return;
        }
        self.world.say(format_args!("a user changes sweep {sweep}: {change:?}"));
        if change.paused == Some(false) {
            self.world.ledger().resuming(self.key(sweep));
        }
        let changed = self.tell(move |life| async move { life.change(sweep, change).await }).await;
        self.note(changed);
    }

    /// Notes that a sweep is halted, if it is.
    fn note(&self, answered: Option<Sweep>) {
        let halted = answered.filter(|sweep| matches!(sweep.state, SweepState::Paused | SweepState::Cancelled));
        if let Some(Sweep { id, state, .. }) = halted {
            self.world.ledger().halted(self.key(id), state == SweepState::Cancelled);
        }
    }

    /// The number of the wish that a sweep came from.
    fn key(&self, sweep: SweepId) -> usize {
        let sweeps = self.sweeps.lock().unwrap();
        sweeps.iter().find(|(there, _)| *there == sweep).expect("users know their sweeps").1
    }

    async fn cancel(&self, sweep: SweepId) {
        self.world.say(format_args!("a user cancels sweep {sweep}"));
        self.cancelled.lock().unwrap().push(sweep);
        let cancelled = self.tell(|life| {
            self.world.ledger().cancelling();
            async move { life.cancel(sweep).await }
        });
        self.note(cancelled.await);
    }

    async fn remove(&self, sweep: SweepId) {
        self.world.say(format_args!("a user removes sweep {sweep}"));
        *self.removals.lock().unwrap() += 1;
        self.tell(|life| {
            self.world.ledger().removing();
            async move { life.remove(sweep).await }
        })
        .await;
        self.world.ledger().halted(self.key(sweep), true);
        self.sweeps.lock().unwrap().retain(|(there, _)| *there != sweep);
    }

    pub(super) async fn retry(&self, sweep: SweepId) {
        self.world.say(format_args!("a user retries sweep {sweep}"));
        self.world.ledger().resuming(self.key(sweep));
        self.tell(move |life| async move { life.retry(sweep).await }).await;
        self.cancelled.lock().unwrap().retain(|cancelled| *cancelled != sweep);
    }

    /// Lets go on what is paused.
    pub(super) async fn resume_all(&self) {
        for sweep in self.sweeps().await {
            if sweep.state == SweepState::Paused {
                self.change(sweep.id, SweepChange { priority: None, paused: Some(false) }).await;
            }
        }
    }

    /// All sweeps as they stand.
    pub(super) async fn sweeps(&self) -> Vec<Sweep> {
        self.ask(|life| async move { life.sweeps(None, 100).await }).await
    }

    /// The sweeps that must be there.
    pub(super) fn expected(&self) -> BTreeSet<SweepId> {
        self.sweeps.lock().unwrap().iter().map(|(sweep, _)| *sweep).collect()
    }

    /// Whether this sweep was cancelled by a user, and not brought back.
    pub(super) fn is_cancelled(&self, sweep: SweepId) -> bool {
        self.cancelled.lock().unwrap().contains(&sweep)
    }
}
