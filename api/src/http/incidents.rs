//! `/v1/incidents`: results that differ, and how many were compared.

use axum::Json;
use axum::extract::State;
use furrow_coordinator::{Incident, VerificationCounts};
use furrow_schema::id::{Digest, EngineId, JobId, WorkerId};
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::problem::Problem;

/// Incidents on a page where nothing else is asked, and at most.
const LIMITS: (u32, u32) = (100, 1_000);

/// The latest incidents, and what verification came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Incidents {
    /// Newest first.
    pub items: Vec<IncidentLine>,
    /// How many results were, or are being, computed again.
    pub verified: Verified,
}

/// A second result of a job that differs from the one on record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct IncidentLine {
    /// The job.
    pub job: JobId,
    /// Whose result is on record.
    pub recorded_worker: WorkerId,
    /// With which engine.
    #[schema(value_type = String)]
    pub recorded_engine: EngineId,
    /// The digest on record.
    #[schema(value_type = String)]
    pub recorded_digest: Digest,
    /// Who sent the other.
    pub other_worker: WorkerId,
    /// With which engine.
    #[schema(value_type = String)]
    pub other_engine: EngineId,
    /// The other's digest.
    #[schema(value_type = String)]
    pub other_digest: Digest,
    /// The other's outcome.
    pub other_outcome: String,
    /// Which is right: `waits` or `leased` while other workers are asked, `upheld` (the one on record), `overruled` (not
    /// that one), `undecided` or `given-up`; null if it is not verified.
    pub verification: Option<String>,
    /// When it came [ms since 1970].
    pub noted_ms: i64,
}

/// How many results were computed again, by what came of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Verified {
    /// Those that wait or are at a worker.
    pub open: u64,
    /// Those whose digests were all equal.
    pub agreed: u64,
    /// Those with another digest, which is wrong.
    pub upheld: u64,
    /// Those with another digest, which is right: the result on record is wrong.
    pub overruled: u64,
    /// Those with another digest, nobody knows which is right.
    pub undecided: u64,
    /// Those that nobody brought to an end.
    pub given_up: u64,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_incidents))
}

/// Results that differ from those on record, newest first, and how many were compared.
#[utoipa::path(get, path = "/v1/incidents", tag = "jobs",
    params(("limit" = Option<u32>, Query, minimum = 1, maximum = 1_000, description = "at most this many, 1 to 1000; 100 if not given")),
    responses((status = 200, body = Incidents), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_incidents(State(app): State<App>, mut params: Params) -> Result<Json<Incidents>, Problem> {
    let limit = params.limit(LIMITS.0, LIMITS.1)?;
    params.finish()?;
    let items = app.coordinator().incidents(limit).await?.into_iter().map(IncidentLine::from).collect();
    Ok(Json(Incidents { items, verified: app.coordinator().verifications().await?.into() }))
}

impl From<Incident> for IncidentLine {
    fn from(incident: Incident) -> Self {
        Self {
            job: incident.job,
            recorded_worker: incident.recorded_worker,
            recorded_engine: incident.recorded_engine,
            recorded_digest: incident.recorded_digest,
            other_worker: incident.other_worker,
            other_engine: incident.other_engine,
            other_digest: incident.other_digest,
            other_outcome: incident.other_outcome,
            verification: incident.verification.map(|state| state.as_str().to_owned()),
            noted_ms: incident.noted_ms,
        }
    }
}

impl From<VerificationCounts> for Verified {
    fn from(counts: VerificationCounts) -> Self {
        let VerificationCounts { open, agreed, upheld, overruled, undecided, given_up } = counts;
        Self { open, agreed, upheld, overruled, undecided, given_up }
    }
}
