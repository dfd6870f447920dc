//! `/v1/plans`: what can be submitted by name.

use axum::Json;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::problem::Problem;
use crate::plan::{self, PlanSummary};

/// All plans.
#[derive(Debug, Clone, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Plans {
    /// Sorted by name.
    pub items: Vec<PlanSummary>,
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_plans))
}

/// The plans that come with the server, with their factors and the labels of their levels.
#[utoipa::path(get, path = "/v1/plans", tag = "plans",
    responses((status = 200, body = Plans), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_plans(params: Params) -> Result<Json<Plans>, Problem> {
    params.finish()?;
    let items = plan::catalogue().map_err(|error| Problem::internal(&error))?;
    Ok(Json(Plans { items }))
}
