//! The HTTP service: a file per resource.
//!
//! [`router`] puts the resources together and surrounds them with limits (`layers`); a handler reads the
//! request (`extract`), asks the coordinator, and answers; whatever goes wrong is a [`problem`]. The OpenAPI
//! document at `/openapi.json` is made from the handlers themselves.

mod extract;
pub mod health;
pub mod incidents;
pub mod jobs;
mod layers;
mod negotiate;
pub mod plans;
pub mod problem;
pub mod publications;
mod refusals;
mod replays;
pub mod sweep_control;
pub mod sweeps;
pub mod tables;
pub mod trajectories;
pub mod workers;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use axum::response::IntoResponse;
use axum::{Json, Router, routing};
use furrow_coordinator::{Coordinator, Gate};
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

pub use layers::{BODY_LIMIT, TIMEOUT};
use replays::Replays;

/// What the handlers share.
#[derive(Clone)]
pub struct App(Arc<Shared>);

struct Shared {
    coordinator: Coordinator,
    gate: Option<Gate>,
    replays: Replays,
}

impl App {
    /// The service of `coordinator`.
    #[must_use]
    pub fn new(coordinator: Coordinator) -> Self {
        Self(Arc::new(Shared { coordinator, gate: None, replays: Replays::default() }))
    }

    /// The same with who lets workers in, where a local network is served.
    #[must_use]
    pub fn with_gate(self, gate: Option<Gate>) -> Self {
        let coordinator = self.coordinator().clone();
        Self(Arc::new(Shared { coordinator, gate, replays: Replays::default() }))
    }

    fn coordinator(&self) -> &Coordinator {
        &self.0.coordinator
    }

    fn gate(&self) -> Option<&Gate> {
        self.0.gate.as_ref()
    }

    fn replays(&self) -> &Replays {
        &self.0.replays
    }
}

#[derive(OpenApi)]
#[openapi(info(title = "Furrow", description = "Submits sweeps of closed-loop experiments and serves their tables."))]
struct Document;

fn resources() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi())
        .merge(sweeps::routes())
        .merge(sweep_control::routes())
        .merge(tables::routes())
        .merge(jobs::routes())
        .merge(trajectories::routes())
        .merge(incidents::routes())
        .merge(publications::routes())
        .merge(workers::routes())
        .merge(plans::routes())
        .merge(health::routes())
}

/// The whole service.
pub fn router(app: App) -> Router {
    let (router, document) = resources().split_for_parts();
    let document = Arc::new(document);
    let openapi = move || {
        let document = Arc::clone(&document);
        async move { Json(&*document).into_response() }
    };
    layers::surround(router.route("/openapi.json", routing::get(openapi)).with_state(app), TIMEOUT)
}

/// Serves `app` on `listener` until `stop` is cancelled; requests under way are answered first.
///
/// # Errors
/// The listener fails for good.
pub async fn serve(listener: TcpListener, app: App, stop: CancellationToken) -> std::io::Result<()> {
    axum::serve(listener, router(app)).with_graceful_shutdown(stop.cancelled_owned()).await
}
