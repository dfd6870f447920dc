//! The topics of a 3D LiDAR, in the robot's frame but for its cloud.

use std::io::Write;

use foxglove::messages::{FrameTransform, PointCloud, SceneUpdate};
use furrow_sim::lidar::SensorsSpec;
use furrow_sim::run::STEPS_PER_S;
use furrow_sim::{InSpace, Scenario};
use mcap::McapError;

use super::file::{File, Topic};
use super::messages::{BASE, mounted, point_cloud_in_space};
use super::recorder::STEP_NS;
use super::scene;

/// The LiDAR's frame.
const LIDAR: &str = "lidar";
/// From scan to scan.
const PERIOD_NS: u64 = STEPS_PER_S as u64 / furrow_sim::lidar::fx10::RATE_HZ as u64 * STEP_NS;

/// All returns, those that stand above the ground, and the rows found in these.
pub(super) struct SpaceEye {
    cloud: Topic<PointCloud>,
    plants: Topic<PointCloud>,
    rows: Topic<SceneUpdate>,
}

impl SpaceEye {
    /// Where the LiDAR is on the robot; none of a robot without one.
    pub(super) fn mount(scenario: &Scenario) -> Option<FrameTransform> {
        match &scenario.sensors {
            SensorsSpec::Fx10(sensors) => Some(mounted([BASE, LIDAR], sensors.mount())),
            _ => None,
        }
    }

    pub(super) fn new<W: Write>(file: &mut File<W>) -> Result<Self, McapError> {
        Ok(Self { cloud: file.topic("/lidar/cloud")?, plants: file.topic("/plants")?, rows: file.topic("/rows")? })
    }

    pub(super) fn write<W: Write>(
        &mut self,
        file: &mut File<W>,
        time_ns: u64,
        sight: &InSpace<'_>,
    ) -> Result<(), McapError> {
        file.write(&mut self.cloud, time_ns, &point_cloud_in_space(time_ns, LIDAR, sight.cloud.points))?;
        file.write(&mut self.plants, time_ns, &point_cloud_in_space(time_ns, BASE, sight.plants))?;
        file.write(&mut self.rows, time_ns, &scene::rows(time_ns, PERIOD_NS, &sight.rows))
    }
}
