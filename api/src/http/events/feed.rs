//! What one listener was told, and what there is to tell it since.
//!
//! Nothing is kept for a slow reader: the next look is taken when the last events are gone, and tells of the newest state
//! only. A listener therefore costs the same few kilobytes whatever happens.

use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::time::Duration;

use axum::response::sse::Event;
use furrow_coordinator::StoreError;
use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};
use futures::Stream;
use tokio::sync::{OwnedSemaphorePermit, watch};
use tokio::time::{Instant, sleep_until, timeout_at};
use tokio_util::sync::CancellationToken;

use super::forecast;
use super::{CellCount, CellsChanged, Ended, IncidentsChanged, Progress, SweepsChanged, Told, Workforce};
use crate::http::App;
use crate::http::incidents::IncidentLine;
use crate::http::workers::{self, WorkerState};

/// From one look to the next at least.
const LOOK_EVERY: Duration = Duration::from_millis(500);
/// From one look to the next at least so many times as long as a look takes: of a sweep with very many cells.
const LOOK_SHARE: u32 = 10;
/// Rates and times left change without a commit: a look is taken this often at least.
const LOOK_ANYWAY: Duration = Duration::from_secs(5);
/// A listener is sent away after this long, so that its token is looked at again; it may come back at once.
const LONGEST: Duration = Duration::from_secs(15 * 60);
/// Cells told of at a time; of more it is said that there are.
const CELLS: usize = 200;
/// Sweeps looked at, the newest ones.
const SWEEPS: u32 = 50;

/// One listener's state.
pub(super) struct Feed {
    app: App,
    /// The sweep it listens to; all of them without.
    sweep: Option<SweepId>,
    changed: watch::Receiver<u64>,
    stop: CancellationToken,
    _seat: OwnedSemaphorePermit,
    until: Instant,
    looked: Option<Instant>,
    pause: Duration,
    known: Known,
    waiting: VecDeque<Event>,
    ended: bool,
}

/// What the listener knows already.
#[derive(Default)]
struct Known {
    sweeps: BTreeMap<SweepId, Sweep>,
    cells: Option<Vec<(u64, u64)>>,
    workforce: Option<Workforce>,
    incidents: Option<IncidentsChanged>,
}

impl Feed {
    pub(super) fn new(
        app: App,
        sweep: Option<SweepId>,
        seat: OwnedSemaphorePermit,
        stop: Option<CancellationToken>,
    ) -> Self {
        Self {
            changed: app.coordinator().changed(),
            app,
            sweep,
            stop: stop.unwrap_or_default(),
            _seat: seat,
            until: Instant::now() + LONGEST,
            looked: None,
            pause: LOOK_EVERY,
            known: Known::default(),
            waiting: VecDeque::new(),
            ended: false,
        }
    }

    /// The events, one look after the other.
    pub(super) fn into_stream(self) -> impl Stream<Item = Result<Event, Infallible>> + Send {
        futures::stream::unfold(self, |mut feed| async {
            loop {
                if let Some(event) = feed.waiting.pop_front() {
                    return Some((Ok(event), feed));
                }
                if feed.ended || !feed.wait().await {
                    return None;
                }
                if let Err(error) = feed.look().await {
                    tracing::warn!(%error, "a stream of events ends");
                    return None;
                }
            }
        })
    }

    /// Waits until there may be something new; false when it is time to go.
    async fn wait(&mut self) -> bool {
        let (looked, stop, changed) = (self.looked, self.stop.clone(), &mut self.changed);
        let (pause, anyway) = (self.pause, self.pause.max(LOOK_ANYWAY));
        let waiting = async {
            if let Some(looked) = looked {
                sleep_until(looked + pause).await;
                let _ = timeout_at(looked + anyway, changed.changed()).await;
            }
        };
        let waited = stop.run_until_cancelled(waiting).await.is_some();
        self.looked = Some(Instant::now());
        waited && Instant::now() < self.until
    }

    async fn look(&mut self) -> Result<(), StoreError> {
        self.changed.borrow_and_update();
        self.look_at_workers().await?;
        self.look_at_incidents().await?;
        match self.sweep {
            Some(id) => self.look_at_sweep(id).await?,
            None => self.look_at_sweeps().await?,
        }
        self.pause = self.looked.map_or(LOOK_EVERY, |looked| LOOK_EVERY.max(looked.elapsed() * LOOK_SHARE));
        Ok(())
    }

    async fn look_at_sweep(&mut self, id: SweepId) -> Result<(), StoreError> {
        let Some(sweep) = self.app.coordinator().sweep(id).await? else {
            self.tell(&Told::End(Ended { state: None }));
            self.ended = true;
            return Ok(());
        };
        let counts = |sweep: &Sweep| (sweep.total, sweep.done, sweep.failed);
        let known = self.known.sweeps.get(&id);
        if known.map(counts) != Some(counts(&sweep)) {
            self.look_at_cells(id).await?;
        }
        self.tell_sweep(&sweep);
        if matches!(sweep.state, SweepState::Done | SweepState::Cancelled) {
            self.tell(&Told::End(Ended { state: Some(sweep.state) }));
            self.ended = true;
        }
        Ok(())
    }

    fn tell_sweep(&mut self, sweep: &Sweep) {
        if self.known.sweeps.insert(sweep.id, sweep.clone()).as_ref() != Some(sweep) {
            let progress = Progress::of(sweep.clone(), self.app.coordinator().now_ms());
            self.tell(&Told::Progress(Box::new(progress)));
        }
    }

    /// Tells which cells have other counts than before; of all that have any, at first.
    async fn look_at_cells(&mut self, id: SweepId) -> Result<(), StoreError> {
        let cells = self.app.coordinator().cells(id).await?;
        let before = self.known.cells.take().unwrap_or_default();
        let mut items = Vec::new();
        let mut more = false;
        for (cell, counts) in cells.iter().zip(before.into_iter().chain(std::iter::repeat((0, 0)))) {
            if (cell.done, cell.failed) != counts {
                more |= items.len() == CELLS;
                if items.len() < CELLS {
                    items.push(CellCount::from(cell));
                }
            }
        }
        self.known.cells = Some(cells.iter().map(|cell| (cell.done, cell.failed)).collect());
        if !items.is_empty() {
            self.tell(&Told::Cells(CellsChanged { items, more }));
        }
        Ok(())
    }

    async fn look_at_sweeps(&mut self) -> Result<(), StoreError> {
        let (sweeps, now_ms) = (self.app.coordinator().sweeps(None, SWEEPS).await?, self.app.coordinator().now_ms());
        let known = std::mem::take(&mut self.known.sweeps);
        let gone: Vec<SweepId> =
            known.keys().filter(|id| !sweeps.iter().any(|sweep| sweep.id == **id)).copied().collect();
        let new = |sweep: &&Sweep| known.get(&sweep.id) != Some(*sweep);
        let items: Vec<Progress> = sweeps.iter().filter(new).map(|sweep| Progress::of(sweep.clone(), now_ms)).collect();
        self.known.sweeps = sweeps.into_iter().map(|sweep| (sweep.id, sweep)).collect();
        if !items.is_empty() || !gone.is_empty() {
            self.tell(&Told::Sweeps(SweepsChanged { items, gone }));
        }
        Ok(())
    }

    async fn look_at_workers(&mut self) -> Result<(), StoreError> {
        let known = self.app.coordinator().workers().await?;
        let mut force = Workforce::default();
        for worker in known.into_iter().map(|worker| workers::line(&self.app, worker)) {
            force.known += 1;
            force.leased += worker.leased;
            if worker.state == WorkerState::Live {
                force.live += 1;
                force.threads += u64::from(worker.threads);
                force.rate_per_s += worker.rate_per_s.unwrap_or(0.0);
            }
        }
        if self.known.workforce != Some(force) {
            self.tell(&Told::Workers(force));
            self.known.workforce = Some(force);
        }
        Ok(())
    }

    async fn look_at_incidents(&mut self) -> Result<(), StoreError> {
        let newest = self.app.coordinator().incidents(1).await?.pop().map(IncidentLine::from);
        let verified = self.app.coordinator().verifications().await?.into();
        let incidents = IncidentsChanged { newest, verified };
        if self.known.incidents.as_ref() != Some(&incidents) {
            self.tell(&Told::Incidents(Box::new(incidents.clone())));
            self.known.incidents = Some(incidents);
        }
        Ok(())
    }

    fn tell(&mut self, told: &Told) {
        let text = serde_json::to_string(told).expect("plain data becomes JSON");
        self.waiting.push_back(Event::default().event(told.name()).data(text));
    }
}

impl Progress {
    fn of(sweep: Sweep, now_ms: i64) -> Self {
        let age_s = (now_ms - sweep.created_ms) as f64 / 1e3;
        let rate_per_s = sweep.rate_per_s.filter(|_| sweep.state == SweepState::Active);
        let eta_ci95_s = rate_per_s.and_then(|rate| forecast::interval_s(rate, age_s, sweep.queued + sweep.leased));
        Self { sweep, eta_ci95_s }
    }
}
