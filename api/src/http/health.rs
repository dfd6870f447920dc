//! `/healthz` and `/readyz`: whether the process lives, and whether it can work.

use std::time::{Duration, Instant};

use axum::extract::State;
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use tokio::sync::Mutex;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::access::Trusted;
use super::problem::Problem;

/// The database is written for the sake of an answer this often at most.
const BEAT_EVERY: Duration = Duration::from_secs(1);

/// A writer that takes longer is not ready.
const BEAT_WITHIN: Duration = Duration::from_secs(5);

/// How the service is. Who sends no token where one is needed gets the first word only.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Health {
    /// `ok`.
    pub status: String,
    /// Of what.
    #[serde(flatten, default, skip_serializing_if = "Option::is_none")]
    pub about: Option<About>,
}

/// What runs here.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct About {
    /// The program's version.
    pub version: String,
    /// The simulation code whose sweeps it takes.
    pub engine: String,
    /// The name under which workers find the coordinator.
    pub coordinator: String,
}

/// When the writer last wrote for the sake of an answer, and whether it could.
#[derive(Debug, Default)]
pub(super) struct Beat(Mutex<Option<(Instant, bool)>>);

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(healthz)).routes(routes!(readyz))
}

/// The process answers.
#[utoipa::path(get, path = "/healthz", tag = "health", 
    responses((status = 200, body = Health), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn healthz(State(app): State<App>, trusted: Option<Extension<Trusted>>) -> Json<Health> {
    Json(health(&app, trusted.is_some()))
}

/// The writer answers, and the disk takes what it writes.
#[utoipa::path(get, path = "/readyz", tag = "health",
    responses((status = 200, body = Health), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn readyz(State(app): State<App>, trusted: Option<Extension<Trusted>>) -> Result<Json<Health>, Problem> {
    if beats(&app).await {
        return Ok(Json(health(&app, trusted.is_some())));
    }
    Err(Problem::unavailable("the database cannot be written"))
}

/// Whoever asks meanwhile waits for the same answer.
async fn beats(app: &App) -> bool {
    let mut last = app.beat().0.lock().await;
    if let Some((at, good)) = *last
        && at.elapsed() < BEAT_EVERY
    {
        return good;
    }
    let good = match tokio::time::timeout(BEAT_WITHIN, app.coordinator().beat()).await {
        Ok(Ok(())) => true,
        Ok(Err(error)) => {
            tracing::error!(%error, "not ready");
            false
        }
        Err(_) => {
            tracing::error!(within_s = BEAT_WITHIN.as_secs(), "not ready: the writer does not answer");
            false
        }
    };
    *last = Some((Instant::now(), good));
    good
}

fn health(app: &App, trusted: bool) -> Health {
    let about = || About {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        engine: app.coordinator().engine().to_string(),
        coordinator: app.coordinator().id().to_owned(),
    };
    Health { status: "ok".to_owned(), about: trusted.then(about) }
}
