//! `/v1/sweeps/{sweep}`: pausing, cancelling, retrying and removing. Doing any of it again changes nothing more.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::SweepChange;
use furrow_schema::id::SweepId;
use furrow_schema::sweep::Sweep;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::{JsonBody, Params};
use super::problem::Problem;
use super::sweeps::sweep_id;
use super::whole::whole_or_null;

/// What to change about a sweep: one of the two, or both.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SweepPatch {
    /// Higher goes first.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_or_null")]
    pub priority: Option<i64>,
    /// Whether its jobs wait until it is resumed. Those that run may end, and their results count.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub paused: Option<bool>,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(patch_sweep, delete_sweep)).routes(routes!(retry_sweep))
}

/// Changes a sweep's priority, pauses or resumes it; answers with where it stands then.
///
/// A job that several sweeps want has the highest priority among those not paused. A sweep that is done has nothing to
/// pause; one that is cancelled cannot be resumed (409), but retried.
#[utoipa::path(patch, path = "/v1/sweeps/{sweep}", tag = "sweeps", request_body = SweepPatch,
    params(("sweep" = SweepId, Path, description = "its number")),
    responses((status = 200, body = Sweep), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn patch_sweep(
    State(app): State<App>,
    Path(name): Path<String>,
    params: Params,
    JsonBody(patch): JsonBody<SweepPatch>,
) -> Result<Json<Sweep>, Problem> {
    params.finish()?;
    let SweepPatch { priority, paused } = patch;
    if priority.is_none() && paused.is_none() {
        return Err(Problem::unprocessable("nothing to change").allowing(["priority", "paused"]));
    }
    let id = sweep_id(&name)?;
    let changed = app.coordinator().change(id, SweepChange { priority, paused }).await?;
    changed.map(Json).ok_or_else(|| Problem::not_found("sweep", id))
}

/// Cancels a sweep, and answers with where it stands then; or removes it, and answers nothing.
///
/// Cancelling gives up the jobs that no other live sweep wants; workers stop those that run. A sweep that is done stays
/// so. Removing takes away its cells, too, and the jobs, results and scenarios that no other sweep lists.
#[utoipa::path(delete, path = "/v1/sweeps/{sweep}", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("purge" = Option<bool>, Query, description = "whether to remove it; false if not given"),
    ),
    responses(
        (status = 200, body = Sweep, description = "it is cancelled"),
        (status = 204, description = "it is removed"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn delete_sweep(
    State(app): State<App>,
    Path(name): Path<String>,
    mut params: Params,
) -> Result<Response, Problem> {
    let purge = params.parsed("purge")?.unwrap_or(false);
    params.finish()?;
    let id = sweep_id(&name)?;
    let none = || Problem::not_found("sweep", id);
    if purge {
        let removed = app.coordinator().remove(id).await?;
        return removed.then(|| StatusCode::NO_CONTENT.into_response()).ok_or_else(none);
    }
    Ok(Json(app.coordinator().cancel(id).await?.ok_or_else(none)?).into_response())
}

/// Queues a sweep's failed and cancelled jobs again, and answers with where it stands then. Attempts go on counting.
#[utoipa::path(post, path = "/v1/sweeps/{sweep}/retry", tag = "sweeps",
    params(("sweep" = SweepId, Path, description = "its number")),
    responses((status = 200, body = Sweep), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn retry_sweep(State(app): State<App>, Path(name): Path<String>, params: Params) -> Result<Json<Sweep>, Problem> {
    params.finish()?;
    let id = sweep_id(&name)?;
    app.coordinator().retry(id).await?.map(Json).ok_or_else(|| Problem::not_found("sweep", id))
}
