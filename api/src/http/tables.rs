//! `/v1/sweeps/{sweep}/table`: a sweep's results as a table.

use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::{CellColumns, CellSummary};
use furrow_coordinator::{Coordinator, StoreError};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::Sweep;
use furrow_schema::table::Cell;
use serde::Serialize;
use serde_json::json;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::etag::Tag;
use super::extract::Params;
use super::negotiate::{Form, PARQUET, choose};
use super::parameters::{Binary, Name, ResultsTableForm, StatisticWord};
use super::problem::Problem;
use crate::table::{Format, Metric, Query, SweepData, parquet, tabulate};

/// A table of a sweep, as JSON.
#[derive(Debug, Clone, Serialize, utoipa::ToSchema)]
pub struct TableOfSweep {
    /// The sweep.
    pub sweep: SweepId,
    /// The factors that make up a cell.
    pub factors: Vec<String>,
    /// The metrics, with titles and units.
    pub metrics: Vec<Metric>,
    /// The cells, in the plan's order; of the statistics only those asked for, and always `n`.
    pub cells: Vec<Cell>,
}

const fn form(format: Format, media_type: &'static str) -> Form<Format> {
    Form { word: format.as_str(), media_type, form: format }
}

/// The forms of every table.
pub(super) const FORMS: [Form<Format>; 5] = [
    form(Format::Json, "application/json"),
    form(Format::Csv, "text/csv"),
    form(Format::Md, "text/markdown"),
    form(Format::Latex, "application/x-latex"),
    form(Format::Text, "text/plain"),
];

/// What a table of results is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Text(Format),
    Parquet,
}

const fn kind(form: Form<Format>) -> Form<Kind> {
    Form { word: form.word, media_type: form.media_type, form: Kind::Text(form.form) }
}

/// The forms of a table of results.
pub(super) const KINDS: [Form<Kind>; 6] = [
    kind(FORMS[0]),
    kind(FORMS[1]),
    kind(FORMS[2]),
    kind(FORMS[3]),
    kind(FORMS[4]),
    Form { word: "parquet", media_type: PARQUET, form: Kind::Parquet },
];

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_table))
}

/// Statistics of a sweep's results so far, by cell.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/table", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("group_by" = inline(Option<Vec<Name>>), Query, explode = false, description = "factors to keep, with commas; all if not given"),
        ("metric" = inline(Option<Vec<Name>>), Query, explode = false, description = "metrics, with commas; all if not given"),
        ("columns" = Option<String>, Query, description = "a factor whose labels become columns (not in JSON)"),
        ("statistic" = inline(Option<Vec<StatisticWord>>), Query, explode = false, description = "mean, std, median, min, max, ci95, n, sum, p5, p25, p75, p95, with commas; the first seven if not given"),
        ("format" = inline(Option<ResultsTableForm>), Query, description = "json, csv, md, latex, text or parquet; wins over the header Accept"),
        ("If-None-Match" = String, Header, description = "the ETag of an earlier answer"),
    ),
    responses(
        (status = 200, content((TableOfSweep = "application/json"), (String = "text/csv"), (String = "text/markdown"),
            (String = "application/x-latex"), (String = "text/plain"), (inline(Binary) = "application/vnd.apache.parquet")),
            headers(("ETag" = String, description = "changes with the results"))),
        (status = 304, description = "no result came since the answer with this ETag"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_table(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let query = query(&mut params)?;
    let form = choose(&KINDS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let sweep = app.sweep_named(&name).await?;
    let cells = app.coordinator().cells(sweep.id).await?;
    let tag = Tag::of_results(&sweep, &cells, form.word);
    if tag.is_known(&headers) {
        return Ok(tag.not_modified());
    }
    let data = data_of(app.coordinator(), &sweep, cells, &query).await?;
    // Medians of a million values take a while: not on a thread that serves others.
    let writing = tokio::task::spawn_blocking(move || write(&sweep, &data, &query, form.form));
    let body = writing.await.map_err(|error| Problem::internal(&error))??;
    Ok((tag.headers(), [(CONTENT_TYPE, form.content_type())], body).into_response())
}

fn query(params: &mut Params) -> Result<Query, Problem> {
    let (group_by, metric) = (params.text("group_by")?, params.text("metric")?);
    let (columns, statistic) = (params.text("columns")?, params.text("statistic")?);
    Ok(Query::from_words(group_by.as_deref(), metric.as_deref(), columns.as_deref(), statistic.as_deref())?)
}

fn write(sweep: &Sweep, data: &SweepData, query: &Query, kind: Kind) -> Result<Vec<u8>, Problem> {
    let table = tabulate(data, query)?;
    match kind {
        Kind::Parquet => parquet(&table.exact_grid()).map_err(|error| Problem::internal(&error)),
        Kind::Text(Format::Json) => {
            let mut body = table.to_json();
            body["sweep"] = json!(sweep.id);
            Ok(body.to_string().into_bytes())
        }
        Kind::Text(format) => Ok(table.write(format).into_bytes()),
    }
}

/// What a table of `sweep` after `query` needs: the cells, and single values only for medians and times.
pub(crate) async fn sweep_data(
    coordinator: &Coordinator,
    sweep: &Sweep,
    query: &Query,
) -> Result<SweepData, StoreError> {
    data_of(coordinator, sweep, coordinator.cells(sweep.id).await?, query).await
}

async fn data_of(
    coordinator: &Coordinator,
    sweep: &Sweep,
    cells: Vec<CellSummary>,
    query: &Query,
) -> Result<SweepData, StoreError> {
    let present = |name: &str| cells.iter().any(|cell| cell.metrics.contains_key(name));
    let columns = if !query.needs_values(sweep.timing, present) {
        Vec::new()
    } else if sweep.timing {
        coordinator.values(sweep.id, None).await?.into_iter().map(CellColumns::from).collect()
    } else {
        let wanted = query.wanted();
        let wanted: Option<Vec<&str>> = wanted.as_ref().map(|names| names.iter().map(String::as_str).collect());
        coordinator.columns(sweep.id, wanted.as_deref()).await?
    };
    Ok(SweepData::new(sweep.factors.clone(), cells, columns))
}
