//! What is drawn: the field, the robot's outline, lines that were found, interventions.

use foxglove::messages::line_primitive::Type;
use foxglove::messages::{
    CylinderPrimitive, LinePrimitive, Point3, SceneEntity, SceneUpdate, SpherePrimitive, TextPrimitive, Vector3,
};
use furrow_navigation::perception::rows::DetectedRows;
use furrow_sim::field::lane::FoliageKind;
use furrow_sim::field::{Field, Plant, PlantKind};
use furrow_sim::observer::Intervention;
use furrow_sim::robot::RobotSpec;
use furrow_sim::{Detection, Scenario};

use super::messages::{BASE, WORLD, color, duration, entity, point, pose_at};
use super::mount::Mount;

const GREEN: [f64; 3] = [0.20, 0.60, 0.25];
const RED: [f64; 3] = [0.85, 0.10, 0.10];
const YELLOW: [f64; 3] = [0.90, 0.75, 0.15];
const BROWN: [f64; 3] = [0.55, 0.40, 0.25];
const BLUE: [f64; 3] = [0.15, 0.45, 0.90];
const GREY: [f64; 3] = [0.55, 0.55, 0.55];
/// Of lines, in pixels.
const THICKNESS: f64 = 2.0;
/// Of texts, in pixels.
const FONT_SIZE: f64 = 16.0;
/// Diameter of an intervention's mark, and its height above the ground \[m\].
const MARK_M: f64 = 0.15;
/// Lines are drawn up to here ahead of the LiDAR \[m\].
const AHEAD_M: f64 = 3.0;
/// A found line is shown for so many scans, should the next one be missing.
const SCANS_SHOWN: u64 = 2;

/// Plants, foliage and rows, none of which move.
pub(super) fn field(field: &Field, damaged: &[usize]) -> SceneUpdate {
    let is_damaged = |i: &usize| damaged.contains(i);
    let stems = |id: &str, rgb, those: &dyn Fn(usize, &Plant) -> bool| {
        let drawn = field.plants.iter().enumerate().filter(|(i, plant)| those(*i, plant));
        SceneEntity { cylinders: drawn.map(|(_, plant)| stem(plant, rgb)).collect(), ..entity(0, WORLD, id) }
    };
    let foliage = |id: &str, rgb, kind: FoliageKind| {
        let all = field.lane.as_ref().map_or(&[][..], |lane| &lane.foliage);
        let ends = all.iter().filter(|foliage| foliage.kind == kind).flat_map(|foliage| {
            let middle_m = 0.5 * (foliage.height_m[0] + foliage.height_m[1]);
            [point(foliage.from_m, middle_m), point(foliage.to_m, middle_m)]
        });
        SceneEntity { lines: lines(Type::LineList, ends.collect(), rgb), ..entity(0, WORLD, id) }
    };
    let rows = field
        .rows
        .iter()
        .flat_map(|row| lines(Type::LineStrip, row.points().iter().map(|at| point(*at, 0.0)).collect(), GREY));
    let entities = vec![
        stems("crop", GREEN, &|i, plant| plant.kind == PlantKind::Crop && !is_damaged(&i)),
        stems("damaged", RED, &|i, _| is_damaged(&i)),
        stems("weeds", YELLOW, &|i, plant| plant.kind == PlantKind::Weed && !is_damaged(&i)),
        foliage("leaves", GREEN, FoliageKind::Leaf),
        foliage("stalks", BROWN, FoliageKind::Stalk),
        foliage("grass", YELLOW, FoliageKind::Weed),
        SceneEntity { lines: rows.collect(), ..entity(0, WORLD, "rows") },
    ];
    SceneUpdate { deletions: Vec::new(), entities }
}

fn stem(plant: &Plant, rgb: [f64; 3]) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: Some(pose_at([plant.x_m, plant.y_m, 0.5 * plant.height_m])),
        size: Some(Vector3 { x: 2.0 * plant.radius_m, y: 2.0 * plant.radius_m, z: plant.height_m }),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(color(rgb, 1.0)),
    }
}

/// None where there is nothing to draw.
fn lines(kind: Type, points: Vec<Point3>, rgb: [f64; 3]) -> Vec<LinePrimitive> {
    let line = |points| LinePrimitive {
        r#type: kind.into(),
        pose: Some(pose_at([0.0; 3])),
        thickness: THICKNESS,
        scale_invariant: true,
        points,
        color: Some(color(rgb, 1.0)),
        ..LinePrimitive::default()
    };
    if points.is_empty() { Vec::new() } else { vec![line(points)] }
}

/// The robot's length and width \[m\].
pub(crate) fn body_m(scenario: &Scenario) -> [f64; 2] {
    match &scenario.robot {
        RobotSpec::TwoWheeled(robot) => [robot.body_length_m, robot.body_width_m],
        RobotSpec::SkidSteer(robot) => [robot.body_length_m, robot.body_width_m],
        RobotSpec::Tracked(robot) => [robot.body_length_m, robot.body_width_m],
    }
}

/// The robot's outline on the ground; the simulation knows no height.
pub(super) fn robot(scenario: &Scenario) -> SceneUpdate {
    let [x, y] = body_m(scenario).map(|length| 0.5 * length);
    let corners = [[x, y], [-x, y], [-x, -y], [x, -y]].map(|corner| point(corner, 0.0));
    let body = SceneEntity { lines: lines(Type::LineLoop, corners.to_vec(), BLUE), ..entity(0, BASE, "body") };
    SceneUpdate { deletions: Vec::new(), entities: vec![body] }
}

/// What was found in a scan of `mount`, until the next one.
pub(super) fn found(time_ns: u64, mount: &Mount, detection: Detection<'_>) -> SceneUpdate {
    let ends = segments(detection).into_iter().flatten().map(|end| point(end, 0.0));
    let found = SceneEntity {
        lifetime: Some(duration(SCANS_SHOWN * mount.period_ns)),
        lines: lines(Type::LineList, ends.collect(), BLUE),
        ..entity(time_ns, mount.frame, "lines")
    };
    SceneUpdate { deletions: Vec::new(), entities: vec![found] }
}

/// The rows that were found in a scan of a 3D LiDAR, until the next one.
pub(super) fn rows(time_ns: u64, period_ns: u64, rows: &DetectedRows<'_>) -> SceneUpdate {
    let ends = rows.lines.iter().flatten().flat_map(|line| line.piece(AHEAD_M)).map(|end| point(end, 0.0));
    let found = SceneEntity {
        lifetime: Some(duration(SCANS_SHOWN * period_ns)),
        lines: lines(Type::LineList, ends.collect(), BLUE),
        ..entity(time_ns, BASE, "rows")
    };
    SceneUpdate { deletions: Vec::new(), entities: vec![found] }
}

/// From beside the LiDAR to [`AHEAD_M`], in its frame.
pub(super) fn segments(detection: Detection<'_>) -> Vec<[[f64; 2]; 2]> {
    match detection {
        Detection::Lines(found) => {
            let segment = |slope: f64, intercept_m: f64| [[0.0, intercept_m], [AHEAD_M, slope * AHEAD_M + intercept_m]];
            found.lines.iter().map(|line| segment(line.slope, line.intercept_m)).collect()
        }
        Detection::Lane(view) => {
            let (sin, cos) = libm::sincos(-view.heading_rad);
            let row = |across_m: f64| {
                let foot = [-across_m * sin, across_m * cos];
                [foot, [foot[0] + AHEAD_M * cos, foot[1] + AHEAD_M * sin]]
            };
            let left = view.left.valid.then(|| row(view.left.distance_m));
            left.into_iter().chain(view.right.valid.then(|| row(-view.right.distance_m))).collect()
        }
    }
}

/// All interventions so far: whoever jumps to this moment sees them, too.
pub(super) fn interventions(time_ns: u64, so_far: &[Intervention]) -> SceneUpdate {
    let mark = |(i, intervention): (usize, &Intervention)| {
        let pose = || Some(pose_at([intervention.pose.x_m, intervention.pose.y_m, MARK_M]));
        let size = Some(Vector3 { x: MARK_M, y: MARK_M, z: MARK_M });
        SceneEntity {
            spheres: vec![SpherePrimitive { pose: pose(), size, color: Some(color(RED, 0.8)) }],
            texts: vec![TextPrimitive {
                pose: pose(),
                billboard: true,
                font_size: FONT_SIZE,
                scale_invariant: true,
                color: Some(color(RED, 1.0)),
                text: format!("{} at {:.2} s", intervention.cause.name(), intervention.time_s),
            }],
            ..entity(time_ns, WORLD, &format!("intervention-{}", i + 1))
        }
    };
    SceneUpdate { deletions: Vec::new(), entities: so_far.iter().enumerate().map(mark).collect() }
}
