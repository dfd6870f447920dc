//! `/healthz` and `/readyz`: whether the process lives, and whether it can work.

use axum::Json;
use axum::extract::State;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::problem::Problem;

/// How the service is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Health {
    /// `ok`.
    pub status: String,
    /// The program's version.
    pub version: String,
    /// The simulation code whose sweeps it takes.
    pub engine: String,
    /// The name under which workers find the coordinator.
    pub coordinator: String,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(healthz)).routes(routes!(readyz))
}

/// The process answers.
#[utoipa::path(get, path = "/healthz", tag = "health", responses((status = 200, body = Health)))]
async fn healthz(State(app): State<App>) -> Json<Health> {
    Json(health(&app))
}

/// The database answers too.
#[utoipa::path(get, path = "/readyz", tag = "health",
    responses((status = 200, body = Health), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn readyz(State(app): State<App>) -> Result<Json<Health>, Problem> {
    app.coordinator().sweeps(None, 1).await.map_err(|error| {
        tracing::error!(%error, "not ready");
        Problem::unavailable("the database does not answer")
    })?;
    Ok(Json(health(&app)))
}

fn health(app: &App) -> Health {
    Health {
        status: "ok".to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        engine: app.coordinator().engine().to_string(),
        coordinator: app.coordinator().id().to_owned(),
    }
}
