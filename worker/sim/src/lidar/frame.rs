//! Where a sensor is in space.

use furrow_navigation::perception::cloud::CloudMount;

use crate::Pose;
use crate::field::vintu2018::Standing;

/// `world_from_lidar`: its place, and its axes ahead, to the left and up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// \[m\]
    pub origin: [f64; 3],
    /// Unit vectors.
    pub axes: [[f64; 3]; 3],
}

impl Frame {
    /// Of a LiDAR on a robot that stands on the ground at `world_from_robot`.
    #[must_use]
    pub fn of_lidar(mount: CloudMount, world_from_robot: Pose, standing: Standing) -> Self {
        let (sy, cy) = libm::sincos(world_from_robot.heading_rad);
        let (sp, cp) = libm::sincos(standing.pitch_rad);
        let (sr, cr) = libm::sincos(standing.roll_rad);
        let foot = [world_from_robot.x_m, world_from_robot.y_m, standing.z_m];
        let ahead = [cy * cp, sy * cp, -sp];
        let left = [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr];
        let up = [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr];
        let (sin, cos) = libm::sincos(mount.pitch_down_rad);
        Self {
            origin: [0, 1, 2].map(|k| foot[k] + mount.x_m * ahead[k] + mount.height_m * up[k]),
            axes: [
                [0, 1, 2].map(|k| cos * ahead[k] - sin * up[k]),
                left,
                [0, 1, 2].map(|k| sin * ahead[k] + cos * up[k]),
            ],
        }
    }

    /// A direction of this frame in the world's.
    #[inline]
    #[must_use]
    pub fn turn(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [ahead, left, up] = &self.axes;
        [
            x * ahead[0] + y * left[0] + z * up[0],
            x * ahead[1] + y * left[1] + z * up[1],
            x * ahead[2] + y * left[2] + z * up[2],
        ]
    }

    /// A point of the world in this frame \[m\].
    #[inline]
    #[must_use]
    pub fn local(&self, point: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = [point[0] - self.origin[0], point[1] - self.origin[1], point[2] - self.origin[2]];
        self.axes.map(|[ax, ay, az]| x * ax + y * ay + z * az)
    }
}
