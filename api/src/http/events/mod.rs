//! `/v1/sweeps/{sweep}/events` and `/v1/events`: what changes, as server-sent events.

mod feed;
mod forecast;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use axum::Extension;
use axum::extract::{Path, State};
use axum::http::HeaderValue;
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::CellSummary;
use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};
use serde::Serialize;
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::incidents::{IncidentLine, Verified};
use super::problem::Problem;
use feed::Feed;

/// Listeners at a time.
const SEATS: usize = 64;
/// A comment is sent when nothing else was for so long.
const BEAT_EVERY: Duration = Duration::from_secs(10);

/// Room for listeners.
pub(super) struct Seats(Arc<Semaphore>);

impl Default for Seats {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(SEATS)))
    }
}

/// Cancelled when the service is to end.
#[derive(Debug, Clone)]
pub(super) struct Stopping(pub(super) CancellationToken);

/// The data of an event, by its name.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum Told {
    /// `event: progress`
    Progress(Box<Progress>),
    /// `event: cells`
    Cells(CellsChanged),
    /// `event: sweeps`
    Sweeps(SweepsChanged),
    /// `event: workers`
    Workers(Workforce),
    /// `event: incidents`
    Incidents(Box<IncidentsChanged>),
    /// `event: end`
    End(Ended),
}

impl Told {
    /// The event's name.
    const fn name(&self) -> &'static str {
        match self {
            Self::Progress(_) => "progress",
            Self::Cells(_) => "cells",
            Self::Sweeps(_) => "sweeps",
            Self::Workers(_) => "workers",
            Self::Incidents(_) => "incidents",
            Self::End(_) => "end",
        }
    }
}

/// Where a sweep stands.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct Progress {
    /// The sweep.
    #[serde(flatten)]
    pub sweep: Sweep,
    /// The 95 % interval of `eta_s` \[s\], if results go on coming as they did in the last 30 s; null while nothing is known.
    pub eta_ci95_s: Option<[f64; 2]>,
}

/// Cells with other counts than before.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct CellsChanged {
    /// The cells, at most 200.
    pub items: Vec<CellCount>,
    /// Whether there are more.
    pub more: bool,
}

/// How far a cell is.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct CellCount {
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// All its runs.
    pub total: u64,
    /// Runs with a result.
    pub done: u64,
    /// Runs given up on.
    pub failed: u64,
}

/// Sweeps that changed, of the newest 50.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct SweepsChanged {
    /// Those that are new or changed.
    pub items: Vec<Progress>,
    /// Those that are no more among them.
    pub gone: Vec<SweepId>,
}

/// The workers together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Workforce {
    /// Every worker there ever was.
    pub known: u64,
    /// Those that work.
    pub live: u64,
    /// Runs at a time of these.
    pub threads: u64,
    /// Jobs that workers hold.
    pub leased: u64,
    /// Results per second over the last 30 s [1/s].
    pub rate_per_s: f64,
}

/// The newest incident, and how many results were compared.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct IncidentsChanged {
    /// The newest result that differs from the one on record.
    pub newest: Option<IncidentLine>,
    /// How many results were computed again.
    pub verified: Verified,
}

/// The sweep has ended, and with it the stream.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
pub struct Ended {
    /// `done` or `cancelled`; null if it was removed.
    pub state: Option<SweepState>,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_events)).routes(routes!(get_sweep_events))
}

/// What changes anywhere: events `sweeps`, `workers` and `incidents`, each at first with how it stands.
///
/// Events come twice a second at most; who reads slowly is told of the newest state only. A comment is sent after 10 s of
/// silence. After 15 minutes the stream ends, and may be asked for again. 503 where 64 streams are open.
#[utoipa::path(get, path = "/v1/events", tag = "events",
    responses(
        (status = 200, body = Told, content_type = "text/event-stream"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_events(
    State(app): State<App>,
    stop: Option<Extension<Stopping>>,
    params: Params,
) -> Result<Response, Problem> {
    params.finish()?;
    listen(app, None, stop)
}

/// What changes about a sweep: events `progress`, `cells`, `workers` and `incidents`, each at first with how it stands.
///
/// When the sweep is done or cancelled comes the event `end`, then the stream ends. Otherwise as `/v1/events`.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/events", tag = "events",
    params(("sweep" = SweepId, Path, description = "its number")),
    responses(
        (status = 200, body = Told, content_type = "text/event-stream"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_sweep_events(
    State(app): State<App>,
    Path(name): Path<String>,
    stop: Option<Extension<Stopping>>,
    params: Params,
) -> Result<Response, Problem> {
    params.finish()?;
    let sweep = app.sweep_named(&name).await?.id;
    listen(app, Some(sweep), stop)
}

fn listen(app: App, sweep: Option<SweepId>, stop: Option<Extension<Stopping>>) -> Result<Response, Problem> {
    let full = |_| Problem::unavailable(format!("{SEATS} streams of events are open"));
    let seat = Arc::clone(&app.seats().0).try_acquire_owned().map_err(full)?;
    let feed = Feed::new(app, sweep, seat, stop.map(|Extension(Stopping(token))| token));
    let beat = KeepAlive::new().interval(BEAT_EVERY).text("beat");
    let mut response = Sse::new(feed.into_stream()).keep_alive(beat).into_response();
    // A proxy in front hands every event on at once.
    response.headers_mut().insert("x-accel-buffering", HeaderValue::from_static("no"));
    Ok(response)
}

impl From<&CellSummary> for CellCount {
    fn from(cell: &CellSummary) -> Self {
        Self { factors: cell.factors.clone(), total: cell.total, done: cell.done, failed: cell.failed }
    }
}
