//! Users: they submit sweeps that share jobs, and change, cancel and retry them, until they were heard.

use std::sync::{Arc, Mutex};

use furrow_coordinator::{Coordinator, StoreError, SweepChange};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};

use super::jobs::{LABELS, SEEDS, sweep};
use super::server::Server;
use super::world::World;

/// At most so many sweeps.
const SWEEPS: usize = 3;

/// See the module.
pub(super) struct Users {
    world: Arc<World>,
    server: Arc<Server>,
    sweeps: Mutex<Vec<SweepId>>,
    /// Sweeps that were cancelled, and not retried since.
    cancelled: Mutex<Vec<SweepId>>,
}

impl Users {
    pub(super) fn new(world: &Arc<World>, server: &Arc<Server>) -> Arc<Self> {
        let (sweeps, cancelled) = (Mutex::default(), Mutex::default());
        Arc::new(Self { world: world.clone(), server: server.clone(), sweeps, cancelled })
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

    /// Submits a sweep.
    pub(super) async fn submit(&self) {
        let key = self.sweeps.lock().unwrap().len() as u64;
        let (labels, seeds) = (self.world.draw(1..LABELS.len() as u64 + 1) as usize, self.world.draw(1..SEEDS + 1));
        let priority = self.world.draw(0..2) as i64;
        let submitted = self.ask(|life| async move { life.submit(sweep(labels, seeds, priority, key)).await }).await;
        self.world.say(format_args!("a user submits {labels} labels x {seeds} seeds: {submitted:?}"));
        self.sweeps.lock().unwrap().push(submitted.id);
    }

    /// Does something to one of the sweeps, or submits another one.
    pub(super) async fn act(&self) {
        let sweeps = self.sweeps.lock().unwrap().clone();
        let Some(sweep) = sweeps.get(self.world.draw(0..SWEEPS as u64) as usize).copied() else {
            return self.submit().await;
        };
        match self.world.draw(0..6) {
            0 => self.change(sweep, SweepChange { priority: None, paused: Some(true) }).await,
            1 | 2 => self.change(sweep, SweepChange { priority: None, paused: Some(false) }).await,
            3 => self.change(sweep, SweepChange { priority: Some(self.world.draw(0..3) as i64), paused: None }).await,
            4 => self.cancel(sweep).await,
            _ => self.retry(sweep).await,
        }
    }

    async fn change(&self, sweep: SweepId, change: SweepChange) {
        if self.cancelled.lock().unwrap().contains(&sweep) {
            return;
        }
        self.world.say(format_args!("a user changes sweep {sweep}: {change:?}"));
        self.ask(move |life| async move { life.change(sweep, change).await }).await;
    }

    async fn cancel(&self, sweep: SweepId) {
        self.world.say(format_args!("a user cancels sweep {sweep}"));
        self.cancelled.lock().unwrap().push(sweep);
        let world = self.world.clone();
        self.ask(move |life| {
            world.ledger().cancelling();
            async move { life.cancel(sweep).await }
        })
        .await;
    }

    pub(super) async fn retry(&self, sweep: SweepId) {
        self.world.say(format_args!("a user retries sweep {sweep}"));
        self.ask(move |life| async move { life.retry(sweep).await }).await;
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

    /// Whether this sweep was cancelled by a user, and not brought back.
    pub(super) fn is_cancelled(&self, sweep: SweepId) -> bool {
        self.cancelled.lock().unwrap().contains(&sweep)
    }
}
