//! `/v1/jobs/{job}/trajectory`: where a run went, stored or run again from its seed.

use std::fmt::Write;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::{JobDetail, JobResult};
use furrow_schema::id::{JobId, JobKey};
use furrow_sim::{Pose, Scenario, Seed, svg};
use furrow_worker::trajectory;
use serde::{Deserialize, Serialize};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::{Form, choose};
use super::parameters::{JobName, PathForm};
use super::problem::Problem;
use super::replays::{Order, Replay};

/// Time between two poses \[s\].
const STEP_S: f64 = 0.05;

/// Where a run went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Trajectory {
    /// The job.
    pub job: JobId,
    /// Its key.
    #[schema(value_type = String)]
    pub key: JobKey,
    /// Whether the poses were stored with the result (rounded to 0.06 mm) and not computed again.
    pub stored: bool,
    /// Seconds between two poses; the first is at 0.
    pub step_s: f64,
    /// What the numbers of a pose are.
    pub columns: [String; 3],
    /// The true poses.
    pub poses: Vec<[f64; 3]>,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    Json,
    Csv,
}

pub(super) const FORMS: [Form<Kind>; 2] = [
    Form { word: "json", media_type: "application/json", form: Kind::Json },
    Form { word: "csv", media_type: "text/csv", form: Kind::Csv },
];

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_trajectory)).routes(routes!(get_drawing)).routes(routes!(get_pose_graph))
}

/// The poses of a finished run, 20 a simulated second.
#[utoipa::path(get, path = "/v1/jobs/{job}/trajectory", tag = "jobs",
    params(
        ("job" = inline(JobName), Path, description = "number, key, or the first digits of a key: at least 8"),
        ("format" = inline(Option<PathForm>), Query, description = "json or csv; wins over the header Accept"),
    ),
    responses(
        (status = 200, content((Trajectory = "application/json"), (String = "text/csv"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_trajectory(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let job = app.job(&name).await?;
    let (poses, stored) = match stored(&job) {
        Some(path) => (path, true),
        None => (app.replay(&job).await?.path.clone(), false),
    };
    Ok(match form.form {
        Kind::Json => axum::Json(json(&job, &poses, stored)).into_response(),
        Kind::Csv => ([(CONTENT_TYPE, form.content_type())], csv(&poses)).into_response(),
    })
}

/// A drawing of a finished run: field, weeds, damaged plants and the path.
#[utoipa::path(get, path = "/v1/jobs/{job}/trajectory.svg", tag = "jobs",
    params(("job" = inline(JobName), Path, description = "number, key, or the first digits of a key: at least 8")),
    responses(
        (status = 200, body = String, content_type = "image/svg+xml"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_drawing(State(app): State<App>, Path(name): Path<String>, params: Params) -> Result<Response, Problem> {
    params.finish()?;
    let job = app.job(&name).await?;
    let replay = app.replay(&job).await?;
    let drawing = tokio::task::spawn_blocking(move || draw(&job, &replay)).await;
    let svg = drawing.map_err(|error| Problem::internal(&error))??;
    Ok(([(CONTENT_TYPE, "image/svg+xml")], svg).into_response())
}

/// A drawing of the graph of poses by which a robot placed itself in the map of a nursery.
#[utoipa::path(get, path = "/v1/jobs/{job}/pose-graph.svg", tag = "jobs",
    params(("job" = inline(JobName), Path, description = "number, key, or the first digits of a key: at least 8")),
    responses(
        (status = 200, body = String, content_type = "image/svg+xml"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_pose_graph(State(app): State<App>, Path(name): Path<String>, params: Params) -> Result<Response, Problem> {
    params.finish()?;
    let job = app.job(&name).await?;
    let replay = app.replay(&job).await?;
    let drawing = tokio::task::spawn_blocking(move || {
        let scenario = scenario(&job)?;
        let without = || {
            let kind = scenario.to_value()["localization"]["kind"].clone();
            let detail = format!("job {} has no graph of poses: its localization is {kind}, not `pose-graph`", job.id);
            Problem::new(StatusCode::CONFLICT, detail)
        };
        svg::pose_graph(&scenario, Seed(job.seed), &replay.nodes, &replay.result).ok_or_else(without)
    });
    let svg = drawing.await.map_err(|error| Problem::internal(&error))??;
    Ok(([(CONTENT_TYPE, "image/svg+xml")], svg).into_response())
}

/// Draws a finished run.
pub(super) fn draw(job: &JobDetail, replay: &Replay) -> Result<String, Problem> {
    Ok(svg::trajectory(&scenario(job)?, Seed(job.seed), &replay.path, &replay.result))
}

/// What was run.
pub(super) fn scenario(job: &JobDetail) -> Result<Scenario, Problem> {
    let value = serde_json::from_str(&job.scenario_json).map_err(|error| Problem::internal(&error))?;
    Scenario::from_value(value).map_err(|error| Problem::internal(&error))
}

impl App {
    /// The finished run of `job`, repeated.
    pub(super) async fn replay(&self, job: &JobDetail) -> Result<Arc<Replay>, Problem> {
        let result = finished(job)?;
        let order =
            Order { job: job.id, scenario: job.scenario_json.as_str().into(), seed: job.seed, digest: result.digest };
        self.replays().replay(order).await
    }
}

fn finished(job: &JobDetail) -> Result<&JobResult, Problem> {
    job.result.as_ref().ok_or_else(|| {
        let detail = format!("job {} is {}: it has no result to show", job.id, job.state.as_str());
        Problem::new(StatusCode::CONFLICT, detail)
    })
}

/// The stored path; none if there is none, or it cannot be read.
fn stored(job: &JobDetail) -> Option<Vec<Pose>> {
    let bytes = job.result.as_ref()?.trajectory.as_ref()?;
    let text = bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    });
    trajectory::decode(&text).inspect_err(|error| tracing::warn!(job = job.id.0, %error, "a stored path")).ok()
}

fn json(job: &JobDetail, poses: &[Pose], stored: bool) -> Trajectory {
    Trajectory {
        job: job.id,
        key: job.key,
        stored,
        step_s: STEP_S,
        columns: ["x_m", "y_m", "heading_rad"].map(str::to_owned),
        poses: poses.iter().map(|pose| [pose.x_m, pose.y_m, pose.heading_rad]).collect(),
    }
}

fn csv(poses: &[Pose]) -> String {
    let mut text = String::from("time_s,x_m,y_m,heading_rad\n");
    for (i, pose) in poses.iter().enumerate() {
        let time_s = i as f64 * STEP_S;
        let _ = writeln!(text, "{time_s:.2},{},{},{}", pose.x_m, pose.y_m, pose.heading_rad);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_as_csv_has_a_line_per_pose() {
        let poses = [Pose::default(), Pose { x_m: 0.0125, y_m: -1.0, heading_rad: 0.5 }];
        assert_eq!(csv(&poses), "time_s,x_m,y_m,heading_rad\n0.00,0,0,0\n0.05,0.0125,-1,0.5\n");
    }
}
