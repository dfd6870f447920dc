//! `/v1/jobs`: single runs, as a list and in full.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::{Path, State};
use furrow_coordinator::view::{
    Attempt, JobCell, JobCursor, JobDetail, JobFilter, JobItem, JobRef, Opinion, Verification,
};
use furrow_schema::id::{CellId, Digest, JobId, JobKey, SweepId, WorkerId};
use furrow_schema::job::{JobState, Timings};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::incidents::IncidentLine;
use super::parameters::{JobName, Labels, PlaceInJobs, StateWord};
use super::problem::Problem;

/// Some jobs of a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Jobs {
    /// The jobs, by cell and number; one that several cells want stands once for each.
    pub items: Vec<JobLine>,
    /// What to give as `after` for the next page; null at the end.
    pub next: Option<String>,
}

/// A job as a line of a list.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JobLine {
    /// Its number.
    pub id: JobId,
    /// Its key: the same key is not run twice.
    #[schema(value_type = String)]
    pub key: JobKey,
    /// Where it stands.
    pub state: JobState,
    /// The sweep of the cell in which it is listed.
    pub sweep: SweepId,
    /// That cell's label by factor.
    pub factors: BTreeMap<String, String>,
    /// Its seed.
    pub seed: u64,
    /// How often it was handed out.
    pub attempts: u32,
    /// Who holds it, or whose result is on record.
    pub worker: Option<WorkerId>,
    /// How its run ended, when it has.
    pub outcome: Option<String>,
    /// The digest of its result, when it has one.
    #[schema(value_type = Option<String>)]
    pub digest: Option<Digest>,
}

/// A job in full.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Job {
    /// Its number.
    pub id: JobId,
    /// Its key: the same key is not run twice.
    #[schema(value_type = String)]
    pub key: JobKey,
    /// Where it stands.
    pub state: JobState,
    /// Its seed.
    pub seed: u64,
    /// The highest priority among the sweeps that want it.
    pub priority: i64,
    /// The cells that want it, oldest first.
    pub cells: Vec<CellOfJob>,
    /// Every handing-out, oldest first.
    pub attempts: Vec<AttemptOfJob>,
    /// How its run ended, when it has.
    pub outcome: Option<String>,
    /// The digest of its result, when it has one.
    #[schema(value_type = Option<String>)]
    pub digest: Option<Digest>,
    /// Per-run values by metric name; empty without a result.
    pub metrics: BTreeMap<String, f64>,
    /// Wall-clock figures of the run; null without a result.
    pub timings: Option<Timings>,
    /// Whether its trajectory is stored.
    pub recorded: bool,
    /// Further results that differ from the one on record.
    pub incidents: Vec<IncidentLine>,
    /// Whether and how its result was computed again; null if it was not.
    pub verification: Option<VerificationOfJob>,
    /// When it was first asked for [ms since 1970].
    pub created_ms: i64,
    /// When it ended [ms since 1970].
    pub ended_ms: Option<i64>,
    /// What was run, with all defaults filled in.
    #[schema(value_type = Object)]
    pub scenario: Value,
}

/// A cell that wants a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CellOfJob {
    /// Its sweep.
    pub sweep: SweepId,
    /// Its number.
    pub cell: CellId,
    /// Its label by factor.
    pub factors: BTreeMap<String, String>,
}

/// One handing-out of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct AttemptOfJob {
    /// Which, from 1.
    pub attempt: u32,
    /// To whom.
    pub worker: WorkerId,
    /// When [ms since 1970].
    pub claimed_ms: i64,
    /// Until when [ms since 1970]; null while it lasts.
    pub ended_ms: Option<i64>,
    /// `open`, `done`, `panicked`, `died`, `expired`, `handed-back`, `superseded` or `cancelled`.
    pub end: String,
    /// The panic's message, or what else there is to say.
    pub reason: Option<String>,
}

/// Whether and how a result was computed again by other workers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct VerificationOfJob {
    /// `waits`, `leased`, `agreed`, `upheld` (another digest came and is wrong), `overruled` (another digest came and is
    /// right: the result on record is wrong), `undecided` or `given-up`.
    pub state: String,
    /// The digests that came back, by attempt.
    pub opinions: Vec<OpinionOfJob>,
}

/// A digest that a worker had beside the one on record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct OpinionOfJob {
    /// In which handing-out.
    pub attempt: u32,
    /// Whose.
    pub worker: WorkerId,
    /// What came out.
    #[schema(value_type = String)]
    pub digest: Digest,
    /// When it came [ms since 1970].
    pub given_ms: i64,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_jobs)).routes(routes!(get_job))
}

/// Jobs by sweep, state and labels, page by page.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs",
    params(
        ("sweep" = Option<SweepId>, Query, description = "only jobs of this sweep"),
        ("state" = inline(Option<StateWord>), Query, description = "only jobs in this state"),
        ("labels" = inline(Option<Labels>), Query, explode, description = "only jobs with these labels: `factor.NAME=LABEL` each, such as `factor.algorithm=rgop`"),
        ("limit" = Option<u32>, Query, minimum = 1, maximum = 10_000, description = "jobs a page, 1 to 10000; 100 if not given"),
        ("after" = inline(Option<PlaceInJobs>), Query, description = "`next` of the page before"),
    ),
    responses((status = 200, body = Jobs), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_jobs(State(app): State<App>, mut params: Params) -> Result<Json<Jobs>, Problem> {
    let filter = JobFilter {
        sweep: params.parsed("sweep")?,
        state: state(&mut params)?,
        factors: params.prefixed("factor.", "factor.NAME").into_iter().collect(),
        limit: params.limit(JobFilter::DEFAULT_LIMIT, JobFilter::MAX_LIMIT)?,
        after: params.parsed::<JobCursor>("after")?,
    };
    params.finish()?;
    if let Some(sweep) = filter.sweep {
        known_factors(&app, sweep, &filter.factors).await?;
    }
    let page = app.coordinator().jobs(&filter).await?;
    let next = page.next.map(|cursor| cursor.to_string());
    Ok(Json(Jobs { items: page.items.into_iter().map(JobLine::from).collect(), next }))
}

fn state(params: &mut Params) -> Result<Option<JobState>, Problem> {
    let Some(word) = params.text("state")? else { return Ok(None) };
    let words = JobState::ALL.map(JobState::as_str);
    let unknown = || Problem::bad_request(format!("`state={word}` is none of {}", words.join(", ")));
    JobState::from_word(&word).map(Some).ok_or_else(|| unknown().at("state").allowing(words))
}

async fn known_factors(app: &App, sweep: SweepId, factors: &BTreeMap<String, String>) -> Result<(), Problem> {
    let sweep = app.sweep(sweep).await?;
    let Some(unknown) = factors.keys().find(|name| !sweep.factors.contains(name)) else { return Ok(()) };
    let detail = format!("sweep {} has no factor `{unknown}`", sweep.id);
    Err(Problem::unprocessable(detail).at(format!("factor.{unknown}")).allowing(sweep.factors))
}

/// One job with its scenario, attempts, metrics and timings.
#[utoipa::path(get, path = "/v1/jobs/{job}", tag = "jobs",
    params(("job" = inline(JobName), Path, description = "number, key, or the first digits of a key: at least 8")),
    responses((status = 200, body = Job), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_job(State(app): State<App>, Path(name): Path<String>, params: Params) -> Result<Json<Job>, Problem> {
    params.finish()?;
    Job::try_from(app.job(&name).await?).map(Json)
}

impl App {
    /// The job of that number, key or beginning of a key.
    pub(super) async fn job(&self, name: &str) -> Result<JobDetail, Problem> {
        let no_job = || Problem::not_found("job", name.chars().take(80).collect::<String>());
        let job: JobRef = name.parse().map_err(|_| no_job())?;
        self.coordinator().job(job).await?.ok_or_else(no_job)
    }
}

impl From<JobItem> for JobLine {
    fn from(job: JobItem) -> Self {
        Self {
            id: job.id,
            key: job.key,
            state: job.state,
            sweep: job.sweep,
            factors: job.factors,
            seed: job.seed,
            attempts: job.attempts,
            worker: job.worker,
            outcome: job.outcome,
            digest: job.digest,
        }
    }
}

impl TryFrom<JobDetail> for Job {
    type Error = Problem;

    fn try_from(job: JobDetail) -> Result<Self, Problem> {
        let scenario = serde_json::from_str(&job.scenario_json).map_err(|error| Problem::internal(&error))?;
        let (mut outcome, mut digest, mut metrics, mut timings, mut recorded) = Default::default();
        if let Some(result) = job.result {
            (outcome, digest) = (Some(result.outcome), Some(result.digest));
            (metrics, timings, recorded) = (result.metrics, Some(result.timings), result.trajectory.is_some());
        }
        Ok(Self {
            id: job.id,
            key: job.key,
            state: job.state,
            seed: job.seed,
            priority: job.priority,
            cells: job.cells.into_iter().map(CellOfJob::from).collect(),
            attempts: job.attempts.into_iter().map(AttemptOfJob::from).collect(),
            outcome,
            digest,
            metrics,
            timings,
            recorded,
            incidents: job.incidents.into_iter().map(IncidentLine::from).collect(),
            verification: job.verification.map(VerificationOfJob::from),
            created_ms: job.created_ms,
            ended_ms: job.ended_ms,
            scenario,
        })
    }
}

impl From<JobCell> for CellOfJob {
    fn from(cell: JobCell) -> Self {
        Self { sweep: cell.sweep, cell: cell.cell, factors: cell.factors }
    }
}

impl From<Attempt> for AttemptOfJob {
    fn from(attempt: Attempt) -> Self {
        Self {
            attempt: attempt.attempt,
            worker: attempt.worker,
            claimed_ms: attempt.claimed_ms,
            ended_ms: attempt.ended_ms,
            end: attempt.end.as_str().to_owned(),
            reason: attempt.reason,
        }
    }
}

impl From<Verification> for VerificationOfJob {
    fn from(verification: Verification) -> Self {
        let opinion =
            |Opinion { attempt, worker, digest, given_ms }| OpinionOfJob { attempt, worker, digest, given_ms };
        let opinions = verification.opinions.into_iter().map(opinion).collect();
        Self { state: verification.state.as_str().to_owned(), opinions }
    }
}
