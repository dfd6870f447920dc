//! `/v1/sweeps/{sweep}/report`: a sweep as one document.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::{CellColumns, CellValues, JobFilter, JobRef};
use furrow_schema::id::{Digest, JobId, SweepId};
use furrow_schema::job::JobState;
use furrow_schema::sweep::Sweep;
use serde_json::Value;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::{Form, choose};
use super::parameters::ReportForm;
use super::problem::Problem;
use super::trajectories::draw;
use crate::publication;
use crate::report::{self, Ending, GivenUp, Material, compose};
use crate::table::SweepData;

/// Jobs that were given up on, in the report.
const GIVEN_UP: u32 = 20;
/// Runs that are drawn: one that went well, and some that did not.
const DRAWN: usize = 4;

pub(super) const FORMS: [Form<report::Form>; 2] = [
    Form { word: "html", media_type: "text/html", form: report::Form::Html },
    Form { word: "md", media_type: "text/markdown", form: report::Form::Markdown },
];

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_report))
}

/// A sweep as one document: tables, figures, failures, the engine, and how to run it again. Some runs are drawn, for which
/// they are repeated from their seeds.
#[utoipa::path(get, path = "/v1/sweeps/{sweep}/report", tag = "sweeps",
    params(
        ("sweep" = SweepId, Path, description = "its number"),
        ("format" = inline(Option<ReportForm>), Query, description = "html or md; wins over the header Accept"),
    ),
    responses(
        (status = 200, content((String = "text/html"), (String = "text/markdown"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_report(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let sweep = app.sweep_named(&name).await?;
    let material = app.material(sweep).await?;
    let writing = tokio::task::spawn_blocking(move || compose(&material).write(form.form)).await;
    let text = writing.map_err(|error| Problem::internal(&error))?;
    Ok(([(CONTENT_TYPE, form.content_type())], text).into_response())
}

impl App {
    async fn material(&self, sweep: Sweep) -> Result<Material, Problem> {
        let request = self.coordinator().request_of(sweep.id).await?;
        let request: Value = request.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        let cells = self.coordinator().cells(sweep.id).await?;
        let values = self.coordinator().values(sweep.id, None).await?;
        let endings = endings(&sweep.factors, &values);
        let digest = digest(&values);
        let columns = values.into_iter().map(CellColumns::from).collect();
        let data = SweepData::new(sweep.factors.clone(), cells, columns);
        let comparisons = publication::of_sweep(self.coordinator(), &sweep, &data).await?;
        let drawings = self.drawings(&endings).await;
        let given_up = self.given_up(&sweep).await?;
        Ok(Material { sweep, request, data, digest, comparisons, endings, given_up, drawings })
    }

    /// A drawing of a run that went well, and of the first runs of other outcomes. What cannot be run again, as results of
    /// another engine, is left out.
    async fn drawings(&self, endings: &[Ending]) -> Vec<(String, String)> {
        let (well, badly): (Vec<_>, Vec<_>) = endings.iter().partition(|ending| ending.success != Some(false));
        let mut seen = BTreeSet::new();
        let first_of_each = badly.into_iter().filter(|ending| seen.insert(ending.outcome.as_str()));
        let mut drawings = Vec::new();
        for ending in well.into_iter().take(1).chain(first_of_each).take(DRAWN) {
            let (job, seed) = ending.example;
            if let Ok(Some(svg)) = self.drawing(job).await {
                let caption = format!("{}, seed {seed}: {} (job {job}).", ending.labels.join(", "), ending.outcome);
                drawings.push((svg, caption));
            }
        }
        drawings
    }

    async fn drawing(&self, job: JobId) -> Result<Option<String>, Problem> {
        let Some(job) = self.coordinator().job(JobRef::Id(job)).await? else { return Ok(None) };
        let replay = self.replay(&job).await?;
        let drawing = tokio::task::spawn_blocking(move || draw(&job, &replay)).await;
        drawing.map_err(|error| Problem::internal(&error))?.map(Some)
    }

    async fn given_up(&self, sweep: &Sweep) -> Result<Vec<GivenUp>, Problem> {
        if sweep.failed == 0 {
            return Ok(Vec::new());
        }
        let filter = JobFilter {
            sweep: Some(sweep.id),
            state: Some(JobState::Failed),
            factors: BTreeMap::new(),
            limit: GIVEN_UP,
            after: None,
        };
        let mut given_up = Vec::new();
        for job in self.coordinator().jobs(&filter).await?.items {
            let detail = self.coordinator().job(JobRef::Id(job.id)).await?;
            let attempts = detail.map(|detail| detail.attempts).unwrap_or_default();
            let last = attempts.into_iter().max_by_key(|attempt| attempt.attempt);
            let reason = last.map(|attempt| attempt.reason.unwrap_or_else(|| attempt.end.as_str().to_owned()));
            let (key, seed, labels) = (job.key, job.seed, labels(&sweep.factors, &job.factors));
            given_up.push(GivenUp { key, labels, seed, reason: reason.unwrap_or_default() });
        }
        Ok(given_up)
    }
}

fn labels(factors: &[String], of: &BTreeMap<String, String>) -> Vec<String> {
    factors.iter().map(|factor| of.get(factor).cloned().unwrap_or_default()).collect()
}

/// The ways to end in each cell, the most frequent first.
fn endings(factors: &[String], cells: &[CellValues]) -> Vec<Ending> {
    let mut endings = Vec::new();
    for cell in cells {
        let mut of_cell: HashMap<&str, Ending> = HashMap::new();
        let success = cell.metrics.get("success");
        for (row, outcome) in cell.outcomes.iter().enumerate() {
            let (example, runs) = ((cell.jobs[row], cell.seeds[row]), 0);
            let success = success.and_then(|column| column[row]).map(|value| value > 0.5);
            let new = || Ending {
                labels: labels(factors, &cell.factors),
                outcome: outcome.to_string(),
                success,
                runs,
                example,
            };
            let ending = of_cell.entry(outcome).or_insert_with(new);
            ending.runs += 1;
            ending.example = ending.example.min(example);
        }
        let mut of_cell: Vec<Ending> = of_cell.into_values().collect();
        of_cell.sort_by(|a, b| b.runs.cmp(&a.runs).then_with(|| a.outcome.cmp(&b.outcome)));
        endings.append(&mut of_cell);
    }
    endings
}

/// Of all results together, whatever order they came in; none without any.
fn digest(cells: &[CellValues]) -> Option<Digest> {
    let mut digests: Vec<[u8; 32]> = cells.iter().flat_map(|cell| &cell.digests).map(|digest| digest.0).collect();
    digests.sort_unstable();
    (!digests.is_empty()).then(|| Digest(*blake3::hash(digests.as_flattened()).as_bytes()))
}
