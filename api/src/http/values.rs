//! `/v1/sweeps/{sweep}/values`: single runs' values of a few metrics, cell by cell, for plots.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Path, State};
use furrow_coordinator::view::CellValues;
use furrow_schema::id::{JobId, SweepId};
use serde::Serialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::parameters::{Labels, Name};
use super::problem::Problem;

/// A plot of more runs shows no single ones.
const MOST_RUNS: u64 = 20_000;
/// Metrics at a time.
const MOST_METRICS: usize = 8;

/// The values behind a sweep's cells.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct SweepValues {
    /// The sweep.
    pub sweep: SweepId,
    /// Its cells, in the plan's order.
    pub cells: Vec<ValuesOfCell>,
}

/// The values of a cell's runs, in columns: by seed, then scenario.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ValuesOfCell {
    /// Label by factor.
    pub factors: BTreeMap<String, String>,
    /// The runs' jobs.
    pub jobs: Vec<JobId>,
    /// Their seeds.
    pub seeds: Vec<u64>,
    /// How they ended.
    pub outcomes: Vec<String>,
    /// A column by metric; null where it is undefined for a run.
    pub metrics: BTreeMap<String, Vec<Option<f64>>>,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_values))
}

/// The values of single runs, by cell. A sweep with more than 20,000 results is refused.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/values", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("metric" = inline(Vec<Name>), Query, explode = false, min_items = 1, max_items = 8, description = "metrics of runs, with commas, at most 8"),
        ("labels" = inline(Option<Labels>), Query, explode, description = "only cells with these labels: `factor.NAME=LABEL` each, such as `factor.algorithm=rgop`"),
    ),
    responses((status = 200, body = SweepValues), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_values(
    State(app): State<App>,
    Path(name): Path<String>,
    mut params: Params,
) -> Result<Json<SweepValues>, Problem> {
    let metrics = metrics(params.text("metric")?)?;
    let labels = params.prefixed("factor.", "factor.NAME");
    params.finish()?;
    let sweep = app.sweep_named(&name).await?;
    if sweep.done > MOST_RUNS {
        let detail =
            format!("sweep {} has {} results; single values are told of up to {MOST_RUNS}", sweep.id, sweep.done);
        return Err(Problem::unprocessable(detail));
    }
    let names: Vec<&str> = metrics.iter().map(String::as_str).collect();
    let cells = app.coordinator().values(sweep.id, Some(&names)).await?;
    let wanted = |cell: &CellValues| labels.iter().all(|(factor, label)| cell.factors.get(factor) == Some(label));
    Ok(Json(SweepValues { sweep: sweep.id, cells: cells.into_iter().filter(wanted).map(ValuesOfCell::from).collect() }))
}

fn metrics(given: Option<String>) -> Result<Vec<String>, Problem> {
    let given = given.ok_or_else(|| Problem::bad_request("`metric` is missing").at("metric"))?;
    let names: Vec<String> = given.split(',').map(str::to_owned).collect();
    if names.len() > MOST_METRICS || names.iter().any(String::is_empty) {
        return Err(Problem::bad_request(format!("`metric` takes 1 to {MOST_METRICS} names")).at("metric"));
    }
    Ok(names)
}

impl From<CellValues> for ValuesOfCell {
    fn from(values: CellValues) -> Self {
        let mut metrics = values.metrics;
        metrics.extend(values.timings);
        Self {
            factors: values.factors,
            jobs: values.jobs,
            seeds: values.seeds,
            outcomes: values.outcomes.iter().map(|outcome| outcome.to_string()).collect(),
            metrics,
        }
    }
}
