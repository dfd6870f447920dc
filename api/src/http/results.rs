//! `/v1/sweeps/{sweep}/results`: all runs of a sweep as rows, page by page on their way out.

use std::error::Error;
use std::future::ready;

use axum::body::Body;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Response};
use furrow_coordinator::Coordinator;
use furrow_coordinator::view::RunCursor;
use furrow_schema::id::SweepId;
use futures::{StreamExt, stream};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::etag::Tag;
use super::extract::Params;
use super::negotiate::{Form, PARQUET, choose};
use super::parameters::{Binary, RunsForm};
use super::problem::Problem;
use crate::export::{self, Columns, Export};

/// Rows in memory at a time.
const PAGE: u32 = 10_000;

pub(super) const FORMS: [Form<export::Form>; 3] = [
    Form { word: "json", media_type: "application/x-ndjson", form: export::Form::Lines },
    Form { word: "csv", media_type: "text/csv", form: export::Form::Csv },
    Form { word: "parquet", media_type: PARQUET, form: export::Form::Parquet },
];

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_results))
}

/// All runs of a sweep, a row each, with everything that was measured; failed and waiting ones are rows, too. JSON is an
/// object a line. A run that ends meanwhile may be shown before or after that; the columns are those known at the start.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/results", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("format" = inline(Option<RunsForm>), Query, description = "json, csv or parquet; wins over the header Accept"),
        ("If-None-Match" = String, Header, description = "the ETag of an earlier answer"),
    ),
    responses(
        (status = 200, content((String = "application/x-ndjson"), (String = "text/csv"),
            (inline(Binary) = "application/vnd.apache.parquet")),
            headers(("ETag" = String, description = "only of a sweep that is done"))),
        (status = 304, description = "nothing changed since the answer with this ETag"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_results(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let sweep = app.sweep_named(&name).await?;
    let cells = app.coordinator().cells(sweep.id).await?;
    let tag = Tag::of_runs(&sweep, &cells, form.word);
    if let Some(tag) = tag.as_ref().filter(|tag| tag.is_known(&headers)) {
        return Ok(tag.not_modified());
    }
    let columns = Columns::of(&sweep, &cells);
    let (export, first) = Export::begin(form.form, columns).map_err(|error| Problem::internal(&error))?;
    let file = format!("attachment; filename=\"sweep-{}.{}\"", sweep.id, form.word);
    let file = HeaderValue::from_str(&file).expect("a number and a word are plain ASCII");
    let body = rows(app.coordinator().clone(), sweep.id, export, first);
    let mut response = ([(CONTENT_TYPE, form.content_type()), (CONTENT_DISPOSITION, file)], body).into_response();
    response.headers_mut().extend(tag.iter().flat_map(Tag::headers));
    Ok(response)
}

type Broken = Box<dyn Error + Send + Sync>;

/// The rows as they are read. What goes wrong on the way breaks the answer off: a file that ends is a whole one.
fn rows(coordinator: Coordinator, sweep: SweepId, export: Export, first: Vec<u8>) -> Body {
    let begin = Some((export, RunCursor::default()));
    let pages = stream::try_unfold(begin, move |state| {
        let coordinator = coordinator.clone();
        async move {
            let Some((export, after)) = state else { return Ok(None) };
            next(&coordinator, sweep, export, after).await.map(Some).inspect_err(|error| {
                tracing::error!(%error, sweep = sweep.0, "an export broke off");
            })
        }
    });
    Body::from_stream(stream::once(ready(Ok(first))).chain(pages))
}

type Step = (Vec<u8>, Option<(Export, RunCursor)>);

async fn next(coordinator: &Coordinator, sweep: SweepId, export: Export, after: RunCursor) -> Result<Step, Broken> {
    let page = coordinator.run_rows(sweep, after, PAGE).await?;
    let Some(last) = page.last() else { return Ok((export.end()?, None)) };
    let after = RunCursor { position: last.position, job: last.job };
    // Thousands of rows take a while: not on a thread that serves others.
    let writing = tokio::task::spawn_blocking(move || {
        let mut export = export;
        export.rows(&page).map(|bytes| (bytes, Some((export, after))))
    });
    Ok(writing.await??)
}
