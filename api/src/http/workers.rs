//! `/v1/workers`: who works, and who may; `/v1/join-secrets`: what lets a new one in.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::CACHE_CONTROL;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::{SecretTerms, WorkerChange, WorkerInfo};
use furrow_schema::id::{EngineId, WorkerId};
use furrow_schema::protocol::LEASE_MS;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::{JsonBody, Params};
use super::problem::Problem;
use super::whole::whole_or_null;

/// All workers, the latest seen first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Workers {
    /// The workers.
    pub items: Vec<WorkerLine>,
}

/// A worker, live or past.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WorkerLine {
    /// The name it goes by here.
    pub id: WorkerId,
    /// A name for people.
    pub name: String,
    /// Whether it works.
    pub state: WorkerState,
    /// The simulation code it ran when it last presented itself.
    #[schema(value_type = String)]
    pub engine: EngineId,
    /// Runs at a time.
    pub threads: u32,
    /// How it was let in.
    pub enrolled_by: EnrolledBy,
    /// Jobs it holds now.
    pub leased: u64,
    /// Results of it that were recorded.
    pub results: u64,
    /// Results per second over the last 30 s [1/s]; null while nothing is known.
    pub rate_per_s: Option<f64>,
    /// When it was first heard of [ms since 1970].
    pub first_seen_ms: i64,
    /// When it was last heard of, to within 5 s [ms since 1970].
    pub last_seen_ms: i64,
    /// When its certificate ends [ms since 1970]; it asks for another one before. Null without one.
    pub certificate_until_ms: Option<i64>,
    /// Until when it is let in [ms since 1970]; null for good.
    pub until_ms: Option<i64>,
    /// When it was turned away [ms since 1970].
    pub revoked_ms: Option<i64>,
    /// Why it gets no more jobs, if a result of it turned out wrong.
    pub barred: Option<WorkerBar>,
}

/// A worker that computed something wrong gets no more jobs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WorkerBar {
    /// Since when [ms since 1970].
    pub since_ms: i64,
    /// What speaks against it.
    pub reason: String,
}

/// Whether a worker works.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum WorkerState {
    /// It was heard of within the length of a lease.
    Live,
    /// It was not.
    Away,
    /// It was let in for a time that is over.
    Expired,
    /// It was turned away for good.
    Revoked,
    /// A result of it turned out wrong.
    Barred,
}

/// How a worker was let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EnrolledBy {
    /// By its first hello, on the coordinator's own machine.
    Hello,
    /// With a join secret.
    JoinSecret,
}

/// What to change about a worker.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkerPatch {
    /// Until when it is let in [ms since 1970]; null for good.
    // With a function of its own a key must be there, though it may be null.
    #[serde(deserialize_with = "whole_or_null")]
    #[schema(required = true)]
    pub until_ms: Option<i64>,
}

/// The terms of a new join secret.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewJoinSecret {
    /// It can be used for so many seconds: 1 to a year of them; a day if not given.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_or_null")]
    #[schema(minimum = 1, maximum = 31_622_400)]
    pub valid_s: Option<u64>,
    /// So many workers may enrol with it: 1 to 10,000; 100 if not given.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_or_null")]
    #[schema(minimum = 1, maximum = 10_000)]
    pub uses: Option<u32>,
    /// The workers are let in for so many seconds: 1 to ten years of them; for good if not given.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_or_null")]
    #[schema(minimum = 1, maximum = 316_224_000)]
    pub workers_s: Option<u64>,
}

/// A new join secret. It is told once.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CreatedJoinSecret {
    /// The secret: what `furrow work --join` reads.
    pub secret: String,
    /// When it ends [ms since 1970].
    pub until_ms: i64,
    /// So many workers may enrol with it.
    pub uses: u32,
}

const YEAR_S: u64 = 366 * 24 * 60 * 60;
const MOST_USES: u32 = 10_000;

impl NewJoinSecret {
    /// The terms, with what was not given filled in.
    ///
    /// # Errors
    /// The problem names the key and its range.
    pub fn terms(&self) -> Result<SecretTerms, Problem> {
        let seconds = |key: &str, given: u64, most: u64| match given {
            1.. if given <= most => Ok(i64::try_from(given * 1_000).expect("ten years in ms fit")),
            _ => Err(Problem::unprocessable(format!("`{key}` is {given}, not 1 to {most}")).at(key)),
        };
        let uses = self.uses.unwrap_or(100);
        if !(1..=MOST_USES).contains(&uses) {
            return Err(Problem::unprocessable(format!("`uses` is {uses}, not 1 to {MOST_USES}")).at("uses"));
        }
        let valid_ms = seconds("valid_s", self.valid_s.unwrap_or(24 * 60 * 60), YEAR_S)?;
        let workers_ms = self.workers_s.map(|given| seconds("workers_s", given, 10 * YEAR_S)).transpose()?;
        Ok(SecretTerms { valid_ms, uses, workers_ms })
    }
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(list_workers))
        .routes(routes!(get_worker, patch_worker, delete_worker))
        .routes(routes!(allow_worker))
        .routes(routes!(create_join_secret))
}

/// Lists all workers, live and past, the latest seen first.
#[utoipa::path(get, path = "/v1/workers", tag = "workers",
    responses((status = 200, body = Workers), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_workers(State(app): State<App>, params: Params) -> Result<Json<Workers>, Problem> {
    params.finish()?;
    let workers = app.coordinator().workers().await?;
    Ok(Json(Workers { items: workers.into_iter().map(|worker| line(&app, worker)).collect() }))
}

/// Shows one worker.
#[utoipa::path(get, path = "/v1/workers/{worker}", tag = "workers",
    params(("worker" = WorkerId, Path, description = "its id")),
    responses((status = 200, body = WorkerLine), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_worker(
    State(app): State<App>,
    Path(name): Path<String>,
    params: Params,
) -> Result<Json<WorkerLine>, Problem> {
    params.finish()?;
    let worker = app.coordinator().worker(&worker_id(&name)?).await?;
    shown(&app, &name, worker)
}

/// Lets a worker in until a time, or for good. One whose time is over loses what it holds at once, and ends.
#[utoipa::path(patch, path = "/v1/workers/{worker}", tag = "workers", request_body = WorkerPatch,
    params(("worker" = WorkerId, Path, description = "its id")),
    responses((status = 200, body = WorkerLine), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn patch_worker(
    State(app): State<App>,
    Path(name): Path<String>,
    params: Params,
    JsonBody(patch): JsonBody<WorkerPatch>,
) -> Result<Json<WorkerLine>, Problem> {
    params.finish()?;
    let changed = app.coordinator().change_worker(&worker_id(&name)?, WorkerChange::Until(patch.until_ms)).await?;
    shown(&app, &name, changed)
}

/// Revokes a worker: it loses what it holds at once, is refused from then on, and ends. Doing it again changes nothing.
#[utoipa::path(delete, path = "/v1/workers/{worker}", tag = "workers",
    params(("worker" = WorkerId, Path, description = "its id")),
    responses((status = 200, body = WorkerLine), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn delete_worker(
    State(app): State<App>,
    Path(name): Path<String>,
    params: Params,
) -> Result<Json<WorkerLine>, Problem> {
    params.finish()?;
    let revoked = app.coordinator().change_worker(&worker_id(&name)?, WorkerChange::Revoke).await?;
    shown(&app, &name, revoked)
}

/// Lets a barred worker have jobs again, once it is known that it was not at fault or has been mended.
#[utoipa::path(post, path = "/v1/workers/{worker}/allow", tag = "workers",
    params(("worker" = WorkerId, Path, description = "its id")),
    responses((status = 200, body = WorkerLine), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn allow_worker(
    State(app): State<App>,
    Path(name): Path<String>,
    params: Params,
) -> Result<Json<WorkerLine>, Problem> {
    params.finish()?;
    let worker = worker_id(&name)?;
    app.coordinator().allow(worker.clone()).await?;
    shown(&app, &name, app.coordinator().worker(&worker).await?)
}

/// Makes a join secret, with which new workers enrol on the local network. It is told once, and kept nowhere.
///
/// 409 from a server that does not serve a local network.
#[utoipa::path(post, path = "/v1/join-secrets", tag = "workers", request_body = NewJoinSecret,
    responses((status = 201, body = CreatedJoinSecret), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn create_join_secret(
    State(app): State<App>,
    params: Params,
    JsonBody(wanted): JsonBody<NewJoinSecret>,
) -> Result<Response, Problem> {
    params.finish()?;
    let terms = wanted.terms()?;
    let Some(gate) = app.gate() else {
        let detail = "this server does not serve a local network: `furrow serve --lan` does";
        return Err(Problem::new(StatusCode::CONFLICT, detail));
    };
    let secret = gate.new_secret(terms).await?;
    let created = CreatedJoinSecret { secret: secret.to_string(), until_ms: secret.until_ms, uses: terms.uses };
    Ok((StatusCode::CREATED, [(CACHE_CONTROL, "no-store")], Json(created)).into_response())
}

fn worker_id(name: &str) -> Result<WorkerId, Problem> {
    WorkerId::try_from(name.to_owned()).map_err(|error| Problem::bad_request(error.to_string()).at("worker"))
}

fn shown(app: &App, name: &str, worker: Option<WorkerInfo>) -> Result<Json<WorkerLine>, Problem> {
    worker.map(|worker| Json(line(app, worker))).ok_or_else(|| Problem::not_found("worker", name))
}

/// A worker as a line of the list.
pub(super) fn line(app: &App, worker: WorkerInfo) -> WorkerLine {
    let now_ms = app.coordinator().now_ms();
    let state = match worker {
        WorkerInfo { revoked_ms: Some(_), .. } => WorkerState::Revoked,
        WorkerInfo { barred: Some(_), .. } => WorkerState::Barred,
        WorkerInfo { until_ms: Some(until_ms), .. } if until_ms <= now_ms => WorkerState::Expired,
        WorkerInfo { last_seen_ms, .. } if last_seen_ms > now_ms - LEASE_MS => WorkerState::Live,
        _ => WorkerState::Away,
    };
    WorkerLine {
        state,
        enrolled_by: if worker.enrolled_ms.is_some() { EnrolledBy::JoinSecret } else { EnrolledBy::Hello },
        id: worker.id,
        name: worker.name,
        engine: worker.engine,
        threads: worker.threads,
        leased: worker.leased,
        results: worker.results,
        rate_per_s: worker.rate_per_s,
        first_seen_ms: worker.first_seen_ms,
        last_seen_ms: worker.last_seen_ms,
        certificate_until_ms: worker.certificate_until_ms,
        until_ms: worker.until_ms,
        revoked_ms: worker.revoked_ms,
        barred: worker.barred.map(|bar| WorkerBar { since_ms: bar.since_ms, reason: bar.reason }),
    }
}
