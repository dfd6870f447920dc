//! `/v1/publications/{source}/{table}`: published values with ours beside them.

use axum::Json;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::Sweep;
use serde::Serialize;
use serde_json::json;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::choose;
use super::parameters::TableForm;
use super::problem::Problem;
use super::tables::{FORMS, sweep_data};
use crate::publication::{self, Comparison, PublicationError};
use crate::table::{Format, Query, SweepData};

/// Sweeps looked at together.
const PAGE: u32 = 200;

/// Plans of a publication whose claims are checked together: their values are in memory at once.
const SWEEPS_OF_CLAIMS: usize = 16;

/// Published tables.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct Publications {
    /// By publication, in the paper's order.
    pub items: Vec<PublishedTable>,
}

/// A published table.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct PublishedTable {
    /// The publication, such as `guyonneau2022`.
    pub source: &'static str,
    /// The table, such as `table-2`; `claims` is what the paper says in words.
    pub table: &'static str,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_publications)).routes(routes!(get_publication))
}

/// The published tables, of all publications or those that belong to a sweep's plan.
#[utoipa::path(get, path = "/v1/publications", tag = "publications",
    params(("sweep" = Option<SweepId>, Query, description = "only the tables that this sweep can be held against")),
    responses((status = 200, body = Publications), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_publications(State(app): State<App>, mut params: Params) -> Result<Json<Publications>, Problem> {
    let asked: Option<SweepId> = params.parsed("sweep")?;
    params.finish()?;
    let tables = match asked {
        Some(id) => {
            let sweep = app.sweep(id).await?;
            let data = SweepData::new(sweep.factors, app.coordinator().cells(id).await?, Vec::new());
            publication::tables_of(&sweep.plan, &data)
        }
        None => publication::all_tables(),
    };
    let items = tables.into_iter().map(|(source, table)| PublishedTable { source, table }).collect();
    Ok(Json(Publications { items }))
}

/// A published table, cell by cell beside the results of a sweep.
#[utoipa::path(get, path = "/v1/publications/{source}/{table}", tag = "publications",
    params(
        ("source" = String, Path, description = "the publication, such as `guyonneau2022`"),
        ("table" = String, Path, description = "the table, such as `table-2`, `figure-18` or `claims`"),
        ("sweep" = Option<SweepId>, Query, description = "if not given the newest sweep of the plan of that name, else of any plan of that publication; for a table of times the newest that measured them; for claims the newest of each plan, of which the first with runs for a claim decides"),
        ("format" = inline(Option<TableForm>), Query, description = "json, csv, md, latex or text; wins over the header Accept"),
    ),
    responses(
        (status = 200, content((Comparison = "application/json"), (String = "text/csv"), (String = "text/markdown"),
            (String = "application/x-latex"), (String = "text/plain"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_publication(
    State(app): State<App>,
    Path((source, table)): Path<(String, String)>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let asked: Option<SweepId> = params.parsed("sweep")?;
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let sweeps = match asked {
        Some(id) => vec![app.sweep(id).await?],
        None => app.newest_of(&source, &table).await?,
    };
    let mut data = Vec::new();
    for sweep in &sweeps {
        data.push(sweep_data(app.coordinator(), sweep, &Query::default()).await?);
    }
    let comparing = tokio::task::spawn_blocking(move || compare(&source, &table, &data));
    let mut comparison = comparing.await.map_err(|error| Problem::internal(&error))??;
    let sweep = sweeps.first().map(|sweep| sweep.id);
    if let Some(sweep) = sweep {
        publication::cite(app.coordinator(), sweep, &mut comparison).await?;
    }
    let text = match form.form {
        Format::Json => json_of(&comparison, sweep),
        format => comparison.write(format),
    };
    Ok(([(CONTENT_TYPE, form.content_type())], text).into_response())
}

/// Claims are checked in the first sweep that has runs for them; a table is of one sweep.
fn compare(source: &str, table: &str, data: &[SweepData]) -> Result<Comparison, PublicationError> {
    match data {
        [_, _, ..] => publication::check(source, data),
        _ => publication::compare(source, table, data.first()),
    }
}

/// The comparison with the sweep it is of; null where none was run yet.
fn json_of(comparison: &Comparison, sweep: Option<SweepId>) -> String {
    let mut body = json!(comparison);
    body["sweep"] = json!(sweep);
    body.to_string()
}

impl App {
    /// The newest sweep whose plan is the table itself, else the newest of a plan of publication `source`; for tables
    /// of times of those that measured them. For claims the newest sweep of each plan, newest first.
    async fn newest_of(&self, source: &str, table: &str) -> Result<Vec<Sweep>, Problem> {
        let timing = publication::is_of_times(source, table);
        let mut newest: Vec<Sweep> = Vec::new();
        let mut after = None;
        loop {
            let page = self.coordinator().sweeps(after, PAGE).await?;
            after = page.last().map(|sweep| sweep.id);
            let last = page.len() < PAGE as usize;
            for sweep in page.into_iter().filter(|sweep| sweep.timing || !timing) {
                let Some((of, plan)) = sweep.plan.split_once('/') else { continue };
                if of != source || newest.iter().any(|other| other.plan == sweep.plan) {
                    continue;
                }
                if plan == table {
                    return Ok(vec![sweep]);
                }
                newest.push(sweep);
            }
            if last {
                break;
            }
        }
        newest.truncate(if table == publication::CLAIMS { SWEEPS_OF_CLAIMS } else { 1 });
        Ok(newest)
    }
}
