//! `/v1/sweeps/{sweep}/compare`: two levels of a factor, or two sweeps, in pairs of runs.

use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::{Coordinator, StoreError};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::Sweep;
use serde::Serialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::choose;
use super::parameters::{Name, TableForm};
use super::problem::Problem;
use super::sweeps::sweep_id;
use super::tables::FORMS;
use crate::paired::{Comparison, Outline, Question, Resolved, SweepRuns, compare};
use crate::table::Format;

/// A comparison of a sweep, as JSON.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct ComparisonOfSweep {
    /// The sweep of side a.
    pub sweep: SweepId,
    /// The sweep of side b, where that is another one.
    pub other: Option<SweepId>,
    /// What comes out.
    #[serde(flatten)]
    pub comparison: Comparison,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_comparison))
}

/// Two levels of a factor compared in pairs of runs with the same seed and the same labels of all other factors; or two
/// sweeps, in the cells that they have in common.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/compare", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("factor" = Option<String>, Query, description = "the factor; between two sweeps it may be left out"),
        ("a" = Option<String>, Query, description = "its label on side a"),
        ("b" = Option<String>, Query, description = "its label on side b"),
        ("other" = Option<SweepId>, Query, description = "take side b from this sweep, which has the same factors"),
        ("metric" = inline(Option<Vec<Name>>), Query, explode = false, description = "metrics, with commas; success if not given"),
        ("group_by" = inline(Option<Vec<Name>>), Query, explode = false, description = "other factors, with commas, by whose levels to answer, too"),
        ("format" = inline(Option<TableForm>), Query, description = "json, csv, md, latex or text; wins over the header Accept"),
    ),
    responses(
        (status = 200, content((ComparisonOfSweep = "application/json"), (String = "text/csv"), (String = "text/markdown"),
            (String = "application/x-latex"), (String = "text/plain"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_comparison(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let question = Question {
        factor: params.text("factor")?,
        a: params.text("a")?,
        b: params.text("b")?,
        metric: params.text("metric")?,
        group_by: params.text("group_by")?,
    };
    let other = params.text("other")?;
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let sweep = app.sweep_named(&name).await?;
    let other = other_sweep(&app, &sweep, other).await?;
    let text = answer(app.coordinator(), &sweep, other.as_ref(), &question, form.form).await?;
    Ok(([(CONTENT_TYPE, form.content_type())], text).into_response())
}

/// The sweep of side b, if it is another one.
async fn other_sweep(app: &App, sweep: &Sweep, name: Option<String>) -> Result<Option<Sweep>, Problem> {
    let Some(name) = name else { return Ok(None) };
    let wrong = || Problem::bad_request(format!("`other={name}` is no number of a sweep")).at("other");
    let id = sweep_id(&name).map_err(|_| wrong())?;
    if id == sweep.id {
        return Ok(None);
    }
    app.sweep(id).await.map(Some).map_err(|problem| problem.at("other"))
}

async fn answer(
    coordinator: &Coordinator,
    sweep: &Sweep,
    other: Option<&Sweep>,
    question: &Question,
    format: Format,
) -> Result<String, Problem> {
    let outline = outline(coordinator, sweep).await?;
    let outline_of_other = match other {
        Some(other) => Some(self::outline(coordinator, other).await?),
        None => None,
    };
    let question = question.resolve(&outline, outline_of_other.as_ref())?;
    let a = runs_of(coordinator, sweep, &question).await?;
    let b = match other {
        Some(other) => Some(runs_of(coordinator, other, &question).await?),
        None => None,
    };
    let (sweep, other) = (sweep.id, other.map(|other| other.id));
    // Thousands of resamples take a while: not on a thread that serves others.
    let writing = tokio::task::spawn_blocking(move || {
        let comparison = compare(&question, &a, b.as_ref().unwrap_or(&a));
        write(ComparisonOfSweep { sweep, other, comparison }, format)
    });
    writing.await.map_err(|error| Problem::internal(&error))?
}

fn write(answer: ComparisonOfSweep, format: Format) -> Result<String, Problem> {
    match format {
        Format::Json => serde_json::to_string(&answer).map_err(|error| Problem::internal(&error)),
        _ => Ok(answer.comparison.write(format)),
    }
}

/// What the sweep has, before its runs are read.
pub(crate) async fn outline(coordinator: &Coordinator, sweep: &Sweep) -> Result<Outline, StoreError> {
    Ok(Outline::of(sweep.factors.clone(), &coordinator.cells(sweep.id).await?))
}

/// The runs that the question needs.
pub(crate) async fn runs_of(
    coordinator: &Coordinator,
    sweep: &Sweep,
    question: &Resolved,
) -> Result<SweepRuns, StoreError> {
    let unfinished = coordinator.unfinished(sweep.id).await?;
    let values = coordinator.values(sweep.id, Some(&question.wanted())).await?;
    let mut runs = SweepRuns::new(values, unfinished);
    runs.scenarios = coordinator.scenario_texts(&runs.pooled()).await?;
    Ok(runs)
}
