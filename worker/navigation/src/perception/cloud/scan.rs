//! What a 3D LiDAR measured in one scan, and where it sits on the robot.

use super::Point3;

/// The returns of one scan in the LiDAR's frame: x along its optical axis, y to the left, z up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudScan<'a> {
    /// Where each ray that came back met something \[m\], in firing order; the others are left out.
    pub points: &'a [Point3],
    /// Cell of each point in the grid of rays, row * `columns` + column: rows from above to below, columns from left to right.
    pub cells: &'a [u32],
    /// Columns of the grid.
    pub columns: u32,
    /// Rows of the grid.
    pub rows: u32,
}

/// `robot_from_lidar` of a 3D LiDAR: on the robot's x axis, nose down. The robot's origin is on the ground below its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudMount {
    /// Ahead of the robot's centre \[m\].
    pub x_m: f64,
    /// Above the ground \[m\].
    pub height_m: f64,
    /// Of the optical axis below the robot's x axis \[rad\].
    pub pitch_down_rad: f64,
}

impl CloudMount {
    /// What takes points of the LiDAR's frame into the robot's \[m\].
    pub fn robot_from_lidar(self) -> impl Fn(Point3) -> Point3 {
        let (sin, cos) = libm::sincos(self.pitch_down_rad);
        move |p| Point3 { x: self.x_m + cos * p.x + sin * p.z, y: p.y, z: self.height_m - sin * p.x + cos * p.z }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lidar_that_looks_down_sees_the_ground_ahead() {
        let mount = CloudMount { x_m: 0.5, height_m: 1.0, pitch_down_rad: std::f64::consts::FRAC_PI_4 };
        let robot = mount.robot_from_lidar()(Point3 { x: f64::sqrt(2.0), y: 0.3, z: 0.0 });
        assert!((robot.x - 1.5).abs() < 1e-12 && robot.y == 0.3 && robot.z.abs() < 1e-12);
        let above = mount.robot_from_lidar()(Point3 { x: 0.0, y: 0.0, z: 0.1 });
        assert!(above.x > 0.5 && above.z > 1.0);
    }
}
