//! What the robot senses: LiDARs, and odometry.

pub mod canopy;
mod foliage;
pub mod frame;
pub mod fx10;
pub mod planar;
mod stems;
pub mod tilted;

pub use fx10::{Fx10, Fx10Params};
pub use planar::PlanarLidar;
pub use tilted::TiltedLidar;

use crate::odometry::OdometryNoise;

furrow_navigation::kinds! {
    /// The sensors on the robot.
    pub enum SensorsSpec {
        /// One planar LiDAR at each end, and wheel odometry.
        TwoPlanarLidars(TwoPlanarLidarsParams) = "two-planar-lidars",
        /// One planar LiDAR at the front, wheel encoders and a gyroscope.
        OnePlanarLidar(OnePlanarLidarParams) = "one-planar-lidar",
        /// One 3D LiDAR at the front, and wheel odometry.
        Fx10(Fx10Params) = "fx10",
    }
}

furrow_navigation::parameters! {
    /// Two planar LiDARs of one kind at 40 Hz, the front one looking forward and the back one backward.
    /// Guyonneau et al. (2022), section 4.1.1; odometry after Eliazar and Parr, coefficients for a skid-steered robot on soil.
    pub struct TwoPlanarLidarsParams {
        /// Position of the front LiDAR ahead of the robot's centre. Program: 0.50.
        pub front_x_m: f64 = 0.5, "m", [-5.0, 5.0];
        /// Position of the back LiDAR. Program: -0.50.
        pub back_x_m: f64 = -0.5, "m", [-5.0, 5.0];
        /// How much farther out than they are the robot believes both LiDARs to be. Program: 0.05 (0.55 for 0.50).
        pub mounting_error_m: f64 = 0.0, "m", [-1.0, 1.0];
        /// Beams of each, both ends of the field of view included. Paper: 360.
        pub beams: u32 = 360, "1", [2, 10000];
        /// Field of view, symmetric about the LiDAR's x axis. Paper: pi.
        pub field_of_view_rad: f64 = std::f64::consts::PI, "rad", [0.1, 3.2];
        /// Closest return. Paper: 0.1.
        pub range_min_m: f64 = 0.1, "m", [0.0, 10.0];
        /// Farthest return. Paper: 4.
        pub range_max_m: f64 = 4.0, "m", [0.1, 200.0];
        /// Standard deviation of a range. Paper: 0.01.
        pub range_noise_m: f64 = 0.01, "m", [0.0, 1.0];
        /// Odometry: standard deviation of the distance per distance. Ours.
        pub odometry_distance_sd: f64 = 0.05, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per distance. Ours.
        pub odometry_drift_sd: f64 = 0.02, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per turn. Ours.
        pub odometry_drift_turn_sd: f64 = 0.06, "m/rad", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per distance. Ours.
        pub odometry_heading_sd: f64 = 0.02, "rad/m", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per turn. Ours.
        pub odometry_heading_turn_sd: f64 = 0.10, "rad/rad", [0.0, 1.0];
    }
}

impl TwoPlanarLidarsParams {
    /// The errors of the odometry.
    #[must_use]
    pub const fn odometry_noise(&self) -> OdometryNoise {
        OdometryNoise {
            distance_sd: self.odometry_distance_sd,
            drift_sd: self.odometry_drift_sd,
            drift_turn_sd: self.odometry_drift_turn_sd,
            heading_sd: self.odometry_heading_sd,
            heading_turn_sd: self.odometry_heading_turn_sd,
        }
    }
}

furrow_navigation::parameters! {
    /// One planar LiDAR (UST-10LX) that turns 40 times a second, encoders and a gyroscope: Velasquez et al. (2022),
    /// section 3.1. The gyroscope's bias is removed by its own calibration, as in the paper.
    pub struct OnePlanarLidarParams {
        /// Position of the LiDAR ahead of the robot's centre: the point of which distances to rows are spoken. Ours: at
        /// the front of the body, 0.27, less half of its own depth.
        pub lidar_x_m: f64 = 0.24, "m", [-5.0, 5.0];
        /// Height of the scan plane above the ground. Ours.
        pub height_m: f64 = 0.2, "m", [0.01, 2.0];
        /// Scans that are used, a divisor of 40; control goes with them. Paper: 40, in table 2 also 10 and 5.
        pub rate_hz: u32 = 40, "Hz", [1, 40];
        /// Beams, both ends of the field of view included. Paper: 1081.
        pub beams: u32 = 1081, "1", [2, 10000];
        /// Field of view, symmetric about the LiDAR's x axis. Paper: 270 degrees.
        pub field_of_view_rad: f64 = 1.5 * std::f64::consts::PI, "rad", [0.1, 5.0];
        /// Closest return. Data sheet: 0.06.
        pub range_min_m: f64 = 0.06, "m", [0.0, 10.0];
        /// Farthest return. Data sheet: 10.
        pub range_max_m: f64 = 10.0, "m", [0.1, 30.0];
        /// Standard deviation of a range. Ours.
        pub range_noise_m: f64 = 0.01, "m", [0.0, 1.0];
        /// Encoders: standard deviation of a speed as a share of it. Ours.
        pub speed_noise: f64 = 0.02, "1", [0.0, 1.0];
        /// Gyroscope: standard deviation of a yaw rate. Ours.
        pub yaw_rate_noise_rad_s: f64 = 0.01, "rad/s", [0.0, 1.0];
        /// Gyroscope: what is left of its bias after calibration. Paper: 0.
        pub yaw_rate_bias_rad_s: f64 = 0.0, "rad/s", [-1.0, 1.0];
    }
}
