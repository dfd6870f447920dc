//! `/v1/jobs/{job}/replay`: a run again, with the field around it and what the robot saw, for an animation.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::JobDetail;
use furrow_schema::id::{JobId, JobKey};
use furrow_sim::Pose;
use furrow_sim::field::lane::FoliageKind;
use furrow_sim::field::{Field, PlantKind};
use furrow_worker::replay::ThinnedScan;
use serde::Serialize;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::negotiate::{Form, choose};
use super::parameters::{Binary, JobName, ReplayForm};
use super::problem::Problem;
use super::recordings::MCAP;
use super::replays::Replay;
use crate::recording::body_m;

/// Of the recorded poses, which are 0.05 s apart, every second one.
const EVERY: usize = 2;
const STEP_S: f64 = 0.1;

/// A run that was repeated from its seed. Lengths are rounded to millimetres, angles to 0.001 rad.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct JobReplay {
    /// The job.
    pub job: JobId,
    /// Its key.
    #[schema(value_type = String)]
    pub key: JobKey,
    /// How it ended.
    pub outcome: String,
    /// Where it drove.
    pub field: ReplayField,
    /// The robot's length and width \[m\].
    pub body_m: [f64; 2],
    /// Seconds between two poses; the first is at 0.
    pub step_s: f64,
    /// The true poses: x, y \[m\], heading \[rad\].
    pub poses: Vec<[f64; 3]>,
    /// What the LiDARs saw, up to four times a second each, in order.
    pub scans: Vec<ReplayScan>,
    /// When an operator put the robot back, and why; in lanes.
    pub interventions: Vec<ReplayIntervention>,
}

/// A field seen from above.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ReplayField {
    /// For people.
    pub name: String,
    /// Stems: x, y, radius \[m\].
    pub crop: Vec<[f64; 3]>,
    /// Weeds that are stems, in the same way.
    pub weeds: Vec<[f64; 3]>,
    /// Crop plants that were run over, by their places in `crop`.
    pub damaged: Vec<usize>,
    /// Leaves: from (x, y) to (x, y) \[m\].
    pub leaves: Vec<[f64; 4]>,
    /// Fallen stalks, and weeds that are no stems, in the same way.
    pub litter: Vec<[f64; 4]>,
    /// The rows' centre lines (x, y) \[m\].
    pub rows: Vec<Vec<[f64; 2]>>,
}

/// One thinned scan of one LiDAR, in that LiDAR's frame.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ReplayScan {
    /// When \[s\].
    pub time_s: f64,
    /// Where the LiDAR truly was: x, y \[m\], heading \[rad\].
    pub world_from_lidar: [f64; 3],
    /// Returns, x and y by turns \[cm\].
    pub points_cm: Vec<i16>,
    /// Lines that were found: from x, y to x, y \[cm\].
    pub lines_cm: Vec<[i16; 4]>,
}

/// An intervention.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ReplayIntervention {
    /// When \[s\].
    pub time_s: f64,
    /// Why: `end-of-lane`, `bad-start`, `gap`, `perception` or `control`.
    pub cause: String,
    /// Where the robot was: x, y \[m\].
    pub at_m: [f64; 2],
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    Json,
    Mcap,
}

pub(super) const FORMS: [Form<Kind>; 2] = [
    Form { word: "json", media_type: "application/json", form: Kind::Json },
    Form { word: "mcap", media_type: MCAP, form: Kind::Mcap },
];

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(get_replay))
}

/// A finished run for an animation: field, poses ten times a simulated second, scans and what was found in them.
///
/// The run is repeated from its seed, at a few hundred times its own speed, and must give the digest on record. MCAP is for
/// Foxglove, Rerun and other programs that read logs of robots: with all scans as they were taken, tens of megabytes.
#[utoipa::path(get, path = "/v1/jobs/{job}/replay", tag = "jobs",
    params(
        ("job" = inline(JobName), Path, description = "number, key, or the first digits of a key: at least 8"),
        ("format" = inline(Option<ReplayForm>), Query, description = "json or mcap; wins over the header Accept"),
    ),
    responses(
        (status = 200, content((JobReplay = "application/json"), (inline(Binary) = "application/vnd.mcap"))),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn get_replay(
    State(app): State<App>,
    Path(name): Path<String>,
    headers: HeaderMap,
    mut params: Params,
) -> Result<Response, Problem> {
    let form = choose(&FORMS, params.text("format")?.as_deref(), &headers)?;
    params.finish()?;
    let job = app.job(&name).await?;
    let replay = app.replay(&job).await?;
    match form.form {
        Kind::Json => {
            let writing = tokio::task::spawn_blocking(move || write(&job, &replay)).await;
            let text = writing.map_err(|error| Problem::internal(&error))??;
            Ok(([(CONTENT_TYPE, form.content_type())], text).into_response())
        }
        Kind::Mcap => {
            let file = format!("attachment; filename=\"run-{}.mcap\"", job.id);
            let file = HeaderValue::from_str(&file).expect("a number and a word are plain ASCII");
            let body = app.recordings().stream(job, replay).await?;
            Ok(([(CONTENT_TYPE, form.content_type()), (CONTENT_DISPOSITION, file)], body).into_response())
        }
    }
}

fn write(job: &JobDetail, replay: &Arc<Replay>) -> Result<String, Problem> {
    let scenario = super::trajectories::scenario(job)?;
    let field = scenario.field.build(job.seed);
    let body = JobReplay {
        job: job.id,
        key: job.key,
        outcome: replay.result.outcome.name().to_owned(),
        body_m: body_m(&scenario),
        step_s: STEP_S,
        poses: replay.path.iter().step_by(EVERY).map(rounded_pose).collect(),
        scans: replay.scans.iter().map(ReplayScan::from).collect(),
        interventions: interventions(replay),
        field: ReplayField::new(&field, &replay.result.damaged),
    };
    serde_json::to_string(&body).map_err(|error| Problem::internal(&error))
}

fn interventions(replay: &Replay) -> Vec<ReplayIntervention> {
    let told = replay.result.interventions.iter().map(|intervention| ReplayIntervention {
        time_s: rounded(intervention.time_s),
        cause: intervention.cause.name().to_owned(),
        at_m: [rounded(intervention.pose.x_m), rounded(intervention.pose.y_m)],
    });
    told.collect()
}

impl ReplayField {
    fn new(field: &Field, damaged: &[usize]) -> Self {
        let stems = |kind: PlantKind| {
            let those = field.plants.iter().filter(move |plant| plant.kind == kind);
            those.map(|plant| [plant.x_m, plant.y_m, plant.radius_m].map(rounded)).collect()
        };
        let crops_before = |index: usize| {
            let crop = field.plants[..index].iter().filter(|plant| plant.kind == PlantKind::Crop);
            crop.count()
        };
        let foliage = field.lane.as_ref().map_or(&[][..], |lane| &lane.foliage);
        let (leaves, litter): (Vec<_>, Vec<_>) = foliage.iter().partition(|foliage| foliage.kind == FoliageKind::Leaf);
        let ribbons = |those: Vec<&furrow_sim::field::lane::Foliage>| {
            let ends = |of: &furrow_sim::field::lane::Foliage| [of.from_m[0], of.from_m[1], of.to_m[0], of.to_m[1]];
            those.into_iter().map(|foliage| ends(foliage).map(rounded)).collect()
        };
        Self {
            name: field.name.clone(),
            crop: stems(PlantKind::Crop),
            weeds: stems(PlantKind::Weed),
            damaged: damaged.iter().map(|index| crops_before(*index)).collect(),
            leaves: ribbons(leaves),
            litter: ribbons(litter),
            rows: field.rows.iter().map(|row| row.points().iter().map(|point| point.map(rounded)).collect()).collect(),
        }
    }
}

impl From<&ThinnedScan> for ReplayScan {
    fn from(scan: &ThinnedScan) -> Self {
        Self {
            time_s: rounded(scan.time_s),
            world_from_lidar: rounded_pose(&scan.world_from_lidar),
            points_cm: scan.points_cm.as_flattened().to_vec(),
            lines_cm: scan.lines_cm.clone(),
        }
    }
}

fn rounded_pose(pose: &Pose) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.heading_rad].map(rounded)
}

/// To three digits after the decimal point.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
