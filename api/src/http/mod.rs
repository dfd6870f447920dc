//! The HTTP service: a file per resource.
//!
//! [`serve`] takes connections (`listen`, with [`tls`]); [`router`] puts the resources together and surrounds them with
//! limits (`layers`, `heavy`, `answers`) and the question who may ask ([`access`], with the `limiter`); a handler reads the
//! request (`extract`), asks the coordinator, and answers; whatever goes wrong is a [`problem`]. The OpenAPI
//! document at `/openapi.json` is made from the handlers themselves.

pub mod access;
mod answers;
pub mod catalogue;
pub mod comparisons;
mod etag;
pub mod events;
mod extract;
pub mod health;
mod heavy;
pub mod incidents;
pub mod job_replay;
pub mod jobs;
mod layers;
mod limiter;
mod listen;
mod metrics;
mod negotiate;
mod page;
mod parameters;
pub mod plans;
pub mod problem;
pub mod publications;
mod recordings;
mod refusals;
mod replays;
pub mod reports;
pub mod results;
pub mod sweep_control;
pub mod sweeps;
pub mod tables;
pub mod tls;
pub mod trajectories;
pub mod values;
mod whole;
pub mod workers;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use axum::middleware::from_fn_with_state;
use axum::response::IntoResponse;
use axum::{Json, Router, routing};
use furrow_coordinator::{Coordinator, Gate};
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::{Modify, OpenApi};
use utoipa_axum::router::OpenApiRouter;

pub use access::Access;
pub use layers::{BODY_LIMIT, TIMEOUT};
use limiter::Limiter;
pub use listen::serve;
use recordings::Recordings;
use replays::Replays;

/// What the handlers share.
#[derive(Clone)]
pub struct App(Arc<Shared>);

struct Shared {
    coordinator: Coordinator,
    gate: Option<Gate>,
    replays: Replays,
    recordings: Recordings,
    seats: events::Seats,
    access: Access,
    limiter: Limiter,
    requests: metrics::Requests,
    beat: health::Beat,
}

impl App {
    /// The service of `coordinator`, for this machine.
    #[must_use]
    pub fn new(coordinator: Coordinator) -> Self {
        Self::with_access(coordinator, Access::default())
    }

    /// The service of `coordinator`, for those whom `access` lets in.
    #[must_use]
    pub fn with_access(coordinator: Coordinator, access: Access) -> Self {
        let (replays, limiter) = (Replays::default(), Limiter::default());
        let (requests, beat, seats, recordings) = Default::default();
        let gate = None;
        Self(Arc::new(Shared { coordinator, gate, replays, recordings, seats, access, limiter, requests, beat }))
    }

    /// The same with who lets workers in, where a local network is served.
    #[must_use]
    pub fn with_gate(mut self, gate: Option<Gate>) -> Self {
        let shared = Arc::get_mut(&mut self.0).expect("nobody else has a handle on it yet");
        shared.gate = gate;
        self
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

    fn recordings(&self) -> &Recordings {
        &self.0.recordings
    }

    fn seats(&self) -> &events::Seats {
        &self.0.seats
    }

    fn access(&self) -> &Access {
        &self.0.access
    }

    fn limiter(&self) -> &Limiter {
        &self.0.limiter
    }

    fn requests(&self) -> &metrics::Requests {
        &self.0.requests
    }

    fn beat(&self) -> &health::Beat {
        &self.0.beat
    }
}

#[derive(OpenApi)]
#[openapi(info(title = "Furrow", description = "Submits sweeps of closed-loop experiments and serves their tables."), modifiers(&Tokens))]
struct Document;

/// Says in the document that a token may be needed, and for what.
struct Tokens;

impl Modify for Tokens {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let text = "A token of `furrow token create`, needed unless the service is for its own machine only. `read` is for \
            GET, `submit` for submitting, pausing, cancelling and retrying sweeps, `admin` for every other change. The \
            probes need none.";
        let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(text)).build();
        let components = document.components.get_or_insert_default();
        components.add_security_scheme("token", SecurityScheme::Http(bearer));
        let (none, token) = (SecurityRequirement::default(), SecurityRequirement::new("token", <[&str; 0]>::default()));
        document.security = Some(vec![none, token]);
    }
}

fn resources() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi())
        .merge(sweeps::routes())
        .merge(sweep_control::routes())
        .merge(tables::routes())
        .merge(comparisons::routes())
        .merge(results::routes())
        .merge(reports::routes())
        .merge(jobs::routes())
        .merge(trajectories::routes())
        .merge(job_replay::routes())
        .merge(values::routes())
        .merge(events::routes())
        .merge(incidents::routes())
        .merge(publications::routes())
        .merge(workers::routes())
        .merge(plans::routes())
        .merge(catalogue::routes())
        .merge(health::routes())
        .merge(metrics::routes())
}

/// The whole service.
pub fn router(app: App) -> Router {
    let (router, mut document) = resources().split_for_parts();
    parameters::leave_headers_out(&mut document);
    let document = Arc::new(document);
    let openapi = move || {
        let document = Arc::clone(&document);
        async move { Json(&*document).into_response() }
    };
    let router = router.route("/openapi.json", routing::get(openapi)).merge(page::routes()).with_state(app.clone());
    let router = router.layer(from_fn_with_state(heavy::Turns::default(), heavy::in_turn));
    let router = router.layer(from_fn_with_state((app.clone(), answers::Answers::default()), answers::remembered));
    let router = layers::surround(router, TIMEOUT, app.access().tls.is_some(), |router| {
        router.layer(from_fn_with_state(app.clone(), access::admit))
    });
    router.layer(from_fn_with_state(app, metrics::count))
}
