//! `/v1/publications/{source}/{table}`: published values with ours beside them.

use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use furrow_schema::id::SweepId;
use furrow_schema::sweep::Sweep;
use serde_json::json;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::choose;
use super::problem::Problem;
use super::tables::{FORMS, sweep_data};
use crate::publication::{self, Comparison};
use crate::table::{Format, Query};

/// Sweeps looked at together.
const PAGE: u32 = 200;

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_publication))
}

/// A published table, cell by cell beside the results of a sweep.
#[utoipa::path(get, path = "/v1/publications/{source}/{table}", tag = "publications",
    params(
        ("source" = String, Path, description = "the publication, such as `guyonneau2022`"),
        ("table" = String, Path, description = "the table, such as `table-2`"),
        ("sweep" = Option<SweepId>, Query, description = "if not given the newest sweep of a plan of that publication; for a table of times the newest that measured them"),
        ("format" = Option<String>, Query, description = "json, csv, md, latex or text; wins over the header Accept"),
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
    let sweep = match asked {
        Some(id) => Some(app.sweep(id).await?),
        None => app.newest_of(&source, publication::is_of_times(&source, &table)).await?,
    };
    let data = match &sweep {
        Some(sweep) => Some(sweep_data(app.coordinator(), sweep, &Query::default()).await?),
        None => None,
    };
    let comparing = tokio::task::spawn_blocking(move || publication::compare(&source, &table, data.as_ref()));
    let mut comparison = comparing.await.map_err(|error| Problem::internal(&error))??;
    if let Some(sweep) = &sweep {
        publication::cite(app.coordinator(), sweep.id, &mut comparison).await?;
    }
    let text = match form.form {
        Format::Json => json_of(&comparison, sweep.map(|sweep| sweep.id)),
        format => comparison.write(format),
    };
    Ok(([(CONTENT_TYPE, form.content_type())], text).into_response())
}

/// The comparison with the sweep it is of; null where none was run yet.
fn json_of(comparison: &Comparison, sweep: Option<SweepId>) -> String {
    let mut body = json!(comparison);
    body["sweep"] = json!(sweep);
    body.to_string()
}

impl App {
    /// The newest sweep of a plan of publication `source`, or the newest of those that measure times.
    async fn newest_of(&self, source: &str, timing: bool) -> Result<Option<Sweep>, Problem> {
        let mut after = None;
        loop {
            let page = self.coordinator().sweeps(after, PAGE).await?;
            after = page.last().map(|sweep| sweep.id);
            let last = page.len() < PAGE as usize;
            let is_of_source = |sweep: &Sweep| sweep.plan.split_once('/').is_some_and(|(of, _)| of == source);
            let belongs = |sweep: &Sweep| is_of_source(sweep) && (sweep.timing || !timing);
            let found = page.into_iter().find(belongs);
            if found.is_some() || last {
                return Ok(found);
            }
        }
    }
}
