//! Where the LiDARs are on the robot.

use furrow_sim::lidar::SensorsSpec;
use furrow_sim::run::STEPS_PER_S;
use furrow_sim::{Pose, Scenario};

use super::recorder::STEP_NS;

/// One LiDAR, in the order in which they look.
pub(super) struct Mount {
    /// `front` or `back`.
    pub(super) name: &'static str,
    /// Its frame.
    pub(super) frame: &'static str,
    /// Ahead of the robot's centre \[m\].
    pub(super) x_m: f64,
    looks_back: bool,
    /// Of the scan plane above the ground, where the simulation knows it \[m\].
    pub(super) height_m: f64,
    /// From scan to scan.
    pub(super) period_ns: u64,
}

impl Mount {
    /// Of the planar LiDARs.
    pub(super) fn all(scenario: &Scenario) -> Vec<Self> {
        let (front, back) = (("front", "lidar_front"), ("back", "lidar_back"));
        let mount = |(name, frame), x_m, looks_back, height_m, steps| Self {
            name,
            frame,
            x_m,
            looks_back,
            height_m,
            period_ns: steps * STEP_NS,
        };
        match &scenario.sensors {
            SensorsSpec::TwoPlanarLidars(both) => {
                vec![mount(front, both.front_x_m, false, 0.0, 1), mount(back, both.back_x_m, true, 0.0, 1)]
            }
            SensorsSpec::OnePlanarLidar(one) => {
                let steps = u64::from(STEPS_PER_S / one.rate_hz.max(1)).max(1);
                vec![mount(front, one.lidar_x_m, false, one.height_m, steps)]
            }
            // It sees in space, and has topics of its own.
            SensorsSpec::Fx10(_) => Vec::new(),
        }
    }

    pub(super) fn robot_from_lidar(&self) -> Pose {
        Pose::default().sensor(self.x_m, self.looks_back)
    }

    /// Where the robot is whose LiDAR is there.
    pub(super) fn world_from_robot(&self, world_from_lidar: Pose) -> Pose {
        let turned = if self.looks_back { std::f64::consts::PI } else { 0.0 };
        let heading_rad = world_from_lidar.heading_rad - turned;
        Pose { heading_rad, ..world_from_lidar }.sensor(-self.x_m, false)
    }

    pub(super) fn world_from_lidar(&self, world_from_robot: Pose) -> Pose {
        world_from_robot.sensor(self.x_m, self.looks_back)
    }
}
