//! `/v1/sweeps`: submitting, and where it stands.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::LOCATION;
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::{NewSweep, Sweep};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::{JsonBody, Params};
use super::parameters::SubmissionKey;
use super::problem::Problem;
use super::whole::{whole, whole_or_null};
use crate::plan::{self, CustomField, Expansion, NotApplied, PlanSource, Request};

const DEFAULT_LIMIT: u32 = 50;
const MAX_LIMIT: u32 = 1_000;

/// What to run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(example = json!({"plan": "guyonneau2022/bounds", "only": {"field": ["crop-1"]}, "seeds": 2}))]
#[serde(deny_unknown_fields)]
pub struct SweepRequest {
    /// A plan's name, or an object that is a plan.
    #[schema(value_type = PlanGiven)]
    pub plan: Value,
    /// Levels to keep, by factor.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub only: BTreeMap<String, Vec<String>>,
    /// Values by dotted path in the scenario, applied after the levels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schema(value_type = Object)]
    pub set: BTreeMap<String, Value>,
    /// Further factors: the values that a dotted path takes.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schema(value_type = BTreeMap<String, Vec<Value>>)]
    pub vary: BTreeMap<String, Vec<Value>>,
    /// The user's own field in place of the plan's fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Object>)]
    pub field: Option<Value>,
    /// Seeds 1 to this in place of the plan's number.
    #[serde(default, skip_serializing_if = "Option::is_none", deserialize_with = "whole_or_null")]
    #[schema(minimum = 1, maximum = 1_000_000)]
    pub seeds: Option<u64>,
    /// Higher goes first; 0 if not given.
    #[serde(default, deserialize_with = "whole")]
    pub priority: i64,
    /// A name for it; the plan's if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 200)]
    pub name: Option<String>,
    /// Whether trajectories are stored.
    #[serde(default)]
    pub record: bool,
    /// Whether it measures times: no cached result counts, and workers run one job at a time.
    #[serde(default)]
    pub timing: bool,
}

/// A plan's name, or a plan.
#[derive(utoipa::ToSchema)]
#[schema(as = PlanGiven)]
#[serde(untagged)]
#[expect(dead_code, reason = "it stands in the description only")]
enum PlanGiven {
    Name(String),
    Plan(serde_json::Map<String, Value>),
}

/// What a submission came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SweepCreated {
    /// The sweep.
    pub id: SweepId,
    /// All its jobs.
    pub total: u64,
    /// Jobs that no sweep had asked for before.
    pub new: u64,
    /// Jobs whose result was there already.
    pub cached: u64,
    /// Paths of `set` and `vary` that some of the scenarios do not have.
    pub not_applied: Vec<NotApplied>,
}

/// Some sweeps of a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Sweeps {
    /// Newest first.
    pub items: Vec<Sweep>,
    /// What to give as `after` for the next page; null at the end.
    pub next: Option<SweepId>,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_sweeps, post_sweep)).routes(routes!(get_sweep))
}

/// Submits a sweep, all of it or nothing. Jobs whose result is known are not run again.
#[utoipa::path(post, path = "/v1/sweeps", tag = "sweeps", request_body = SweepRequest,
    params(("Idempotency-Key" = inline(SubmissionKey), Header, description = "the same key with the same body gives the same sweep")),
    responses(
        (status = 201, body = SweepCreated, headers(("Location" = String, description = "the sweep"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn post_sweep(
    State(app): State<App>,
    headers: HeaderMap,
    params: Params,
    JsonBody(body): JsonBody<SweepRequest>,
) -> Result<Response, Problem> {
    params.finish()?;
    let key = idempotency_key(&headers)?;
    let (priority, name, record, timing) = (body.priority, checked_name(body.name.clone())?, body.record, body.timing);
    // Multiplying a large plan out takes a while: not on a thread that serves others.
    let expanding = tokio::task::spawn_blocking(move || plan::expand(&request(body)?).map_err(Problem::from));
    let expansion = expanding.await.map_err(|error| Problem::internal(&error))??;
    let not_applied = expansion.not_applied.clone();
    let request_json = asked(&expansion.request, priority, name.as_deref(), record, timing);
    let sweep = new_sweep(expansion, name);
    let sweep = NewSweep { priority, record, timing, request_json, idempotency_key: key, ..sweep };
    let sent = app.coordinator().submit(sweep).await?;
    let location = HeaderValue::from_str(&format!("/v1/sweeps/{}", sent.id)).expect("a number is plain ASCII");
    let created = SweepCreated { id: sent.id, total: sent.total, new: sent.new, cached: sent.cached, not_applied };
    Ok((StatusCode::CREATED, [(LOCATION, location)], Json(created)).into_response())
}

/// All that a request asks for, by which the same key with another body is told. What is not asked for is not in it.
fn asked(plan: &Value, priority: i64, name: Option<&str>, record: bool, timing: bool) -> String {
    let mut asked = plan.clone();
    let further = [
        ("priority", (priority != 0).then(|| json!(priority))),
        ("name", name.map(|name| json!(name))),
        ("record", record.then_some(Value::Bool(true))),
        ("timing", timing.then_some(Value::Bool(true))),
    ];
    for (key, value) in further {
        if let Some(value) = value {
            asked[key] = value;
        }
    }
    asked.to_string()
}

fn idempotency_key(headers: &HeaderMap) -> Result<Option<String>, Problem> {
    let Some(value) = headers.get("Idempotency-Key") else { return Ok(None) };
    let text = value.to_str().ok().filter(|text| (1..=200).contains(&text.len()));
    let wrong = || Problem::bad_request("Idempotency-Key must be 1 to 200 printable ASCII characters");
    text.map(|text| Some(text.to_owned())).ok_or_else(|| wrong().at("Idempotency-Key"))
}

fn checked_name(name: Option<String>) -> Result<Option<String>, Problem> {
    let good = |name: &String| !name.trim().is_empty() && name.len() <= 200 && !name.chars().any(char::is_control);
    match name {
        Some(name) if !good(&name) => {
            Err(Problem::unprocessable("name: must be 1 to 200 printable characters").at("name"))
        }
        name => Ok(name),
    }
}

fn request(body: SweepRequest) -> Result<Request, Problem> {
    Ok(Request {
        plan: PlanSource::from_json(body.plan)?,
        only: body.only,
        set: body.set,
        vary: body.vary,
        field: body.field.map(CustomField::from_json).transpose()?,
        seeds: body.seeds,
    })
}

/// A sweep as the coordinator takes it, with neither priority nor wishes.
pub(crate) fn new_sweep(expansion: Expansion, name: Option<String>) -> NewSweep {
    NewSweep {
        name: name.unwrap_or_else(|| expansion.plan.name.clone()),
        plan: expansion.plan.name,
        request_json: expansion.request.to_string(),
        engine: crate::engine(),
        priority: 0,
        record: false,
        timing: false,
        seeds: expansion.seeds,
        factors: expansion.factors,
        cells: expansion.cells,
        idempotency_key: None,
    }
}

/// Sweeps, newest first, page by page.
#[utoipa::path(get, path = "/v1/sweeps", tag = "sweeps",
    params(
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 1_000, description = "sweeps a page, 1 to 1000; 50 if not given"),
        ("after" = Option<SweepId>, Query, description = "`next` of the page before"),
    ),
    responses((status = 200, body = Sweeps), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_sweeps(State(app): State<App>, mut params: Params) -> Result<Json<Sweeps>, Problem> {
    let limit = params.limit(DEFAULT_LIMIT, MAX_LIMIT)?;
    let after = params.parsed("after")?;
    params.finish()?;
    let mut items = app.coordinator().sweeps(after, limit + 1).await?;
    let more = items.len() > limit as usize;
    items.truncate(limit as usize);
    let next = items.last().filter(|_| more).map(|sweep| sweep.id);
    Ok(Json(Sweeps { items, next }))
}

/// Where a sweep stands.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}", tag = "sweeps",
    params(("sweep" = SweepId, Path, description = "its number")),
    responses((status = 200, body = Sweep), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_sweep(State(app): State<App>, Path(name): Path<String>, params: Params) -> Result<Json<Sweep>, Problem> {
    params.finish()?;
    app.sweep_named(&name).await.map(Json)
}

impl App {
    /// The sweep of that number.
    pub(super) async fn sweep(&self, id: SweepId) -> Result<Sweep, Problem> {
        self.coordinator().sweep(id).await?.ok_or_else(|| Problem::not_found("sweep", id))
    }

    /// The sweep that a path names.
    pub(super) async fn sweep_named(&self, name: &str) -> Result<Sweep, Problem> {
        self.sweep(sweep_id(name)?).await
    }
}

/// The number that a path holds.
pub(super) fn sweep_id(name: &str) -> Result<SweepId, Problem> {
    name.parse().map_err(|_| Problem::not_found("sweep", name.chars().take(80).collect::<String>()))
}
