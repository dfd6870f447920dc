//! The pieces of Foxglove's schemas that are needed here.

use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    Color, Duration, FrameTransform, LaserScan, PackedElementField, Point3, PointCloud, Pose, Quaternion, SceneEntity,
    Timestamp, Vector3,
};
use furrow_navigation::perception::Points;
use furrow_navigation::perception::cloud::{CloudMount, Point3 as InSpace};
use furrow_sim::Scan;

/// The frame that the field stands still in.
pub(super) const WORLD: &str = "world";
/// The robot's: its centre on the ground, x ahead.
pub(super) const BASE: &str = "base_link";

const NS_PER_S: u64 = 1_000_000_000;
/// Units of a point's coordinate in a metre, 0.24 mm each: short binary fractions take half the room when compressed.
const UNITS_PER_M: f64 = 4_096.0;
/// Bytes of a coordinate in a point cloud.
const COORDINATE: u32 = 4;

pub(super) fn timestamp(time_ns: u64) -> Timestamp {
    Timestamp::new((time_ns / NS_PER_S) as u32, (time_ns % NS_PER_S) as u32)
}

pub(super) fn duration(time_ns: u64) -> Duration {
    Duration::new((time_ns / NS_PER_S) as i32, (time_ns % NS_PER_S) as u32)
}

pub(super) const fn color([r, g, b]: [f64; 3], a: f64) -> Color {
    Color { r, g, b, a }
}

pub(super) const fn point([x, y]: [f64; 2], z: f64) -> Point3 {
    Point3 { x, y, z }
}

/// Upright, at (x, y, z) \[m\].
pub(super) fn pose_at([x, y, z]: [f64; 3]) -> Pose {
    Pose { position: Some(Vector3 { x, y, z }), orientation: Some(turned(0.0)) }
}

/// Turned counter-clockwise about the vertical \[rad\].
fn turned(heading_rad: f64) -> Quaternion {
    let (sin, cos) = libm::sincos(0.5 * heading_rad);
    Quaternion { x: 0.0, y: 0.0, z: sin, w: cos }
}

/// Where `child` is in `parent`, `height_m` above its plane.
pub(super) fn transform(
    time_ns: u64,
    [parent, child]: [&str; 2],
    parent_from_child: furrow_sim::Pose,
    height_m: f64,
) -> FrameTransform {
    let furrow_sim::Pose { x_m, y_m, heading_rad } = parent_from_child;
    FrameTransform {
        timestamp: Some(timestamp(time_ns)),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(Vector3 { x: x_m, y: y_m, z: height_m }),
        rotation: Some(turned(heading_rad)),
    }
}

/// All beams, as 32-bit numbers; infinity is no return.
pub(super) fn laser_scan(time_ns: u64, frame: &str, scan: &Scan<'_>) -> LaserScan {
    let beams = scan.beams;
    LaserScan {
        timestamp: Some(timestamp(time_ns)),
        frame_id: frame.to_owned(),
        pose: Some(pose_at([0.0; 3])),
        start_angle: beams.angle_min_rad,
        end_angle: beams.angle_min_rad + beams.angle_increment_rad * beams.len().saturating_sub(1) as f64,
        ranges: scan.ranges_m.iter().map(|range| f64::from(*range as f32)).collect(),
        intensities: Vec::new(),
    }
}

/// Where a 3D LiDAR is on the robot, nose down.
pub(super) fn mounted([parent, child]: [&str; 2], mount: CloudMount) -> FrameTransform {
    let (sin, cos) = libm::sincos(0.5 * mount.pitch_down_rad);
    FrameTransform {
        timestamp: Some(timestamp(0)),
        parent_frame_id: parent.to_owned(),
        child_frame_id: child.to_owned(),
        translation: Some(Vector3 { x: mount.x_m, y: 0.0, z: mount.height_m }),
        // Counter-clockwise about y, which points left, takes the nose down.
        rotation: Some(Quaternion { x: 0.0, y: sin, z: 0.0, w: cos }),
    }
}

/// Points in the plane of `frame`, rounded.
pub(super) fn point_cloud(time_ns: u64, frame: &str, points: &Points) -> PointCloud {
    cloud(time_ns, frame, points.iter().map(|(x, y)| [x, y, 0.0]))
}

/// Points in space, rounded.
pub(super) fn point_cloud_in_space(time_ns: u64, frame: &str, points: &[InSpace]) -> PointCloud {
    cloud(time_ns, frame, points.iter().map(|point| [point.x, point.y, point.z]))
}

fn cloud(time_ns: u64, frame: &str, points: impl Iterator<Item = [f64; 3]>) -> PointCloud {
    let field = |(name, i): (&str, u32)| PackedElementField {
        name: name.to_owned(),
        offset: i * COORDINATE,
        r#type: NumericType::Float32.into(),
    };
    let rounded = |metres: f64| ((metres * UNITS_PER_M).round() / UNITS_PER_M) as f32;
    let coordinates = points.flat_map(|point| point.map(rounded));
    PointCloud {
        timestamp: Some(timestamp(time_ns)),
        frame_id: frame.to_owned(),
        pose: Some(pose_at([0.0; 3])),
        point_stride: 3 * COORDINATE,
        fields: [("x", 0), ("y", 1), ("z", 2)].map(field).to_vec(),
        data: coordinates.flat_map(f32::to_le_bytes).collect::<Vec<u8>>().into(),
    }
}

/// An entity without anything in it, which stays.
pub(super) fn entity(time_ns: u64, frame: &str, id: &str) -> SceneEntity {
    SceneEntity {
        timestamp: Some(timestamp(time_ns)),
        frame_id: frame.to_owned(),
        id: id.to_owned(),
        frame_locked: true,
        ..SceneEntity::default()
    }
}
