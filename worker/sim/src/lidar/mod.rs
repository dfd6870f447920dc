//! What the robot senses: LiDARs, and odometry.

pub mod planar;
mod stems;

pub use planar::PlanarLidar;

furrow_navigation::kinds! {
    /// The sensors on the robot.
    pub enum SensorsSpec {
        /// One planar LiDAR at each end, and wheel odometry.
        TwoPlanarLidars(TwoPlanarLidarsParams) = "two-planar-lidars",
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
        /// Odometry: standard deviation of the distance per distance.
        pub odometry_distance_sd: f64 = 0.05, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per distance.
        pub odometry_drift_sd: f64 = 0.02, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per turn.
        pub odometry_drift_turn_sd: f64 = 0.06, "m/rad", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per distance.
        pub odometry_heading_sd: f64 = 0.02, "rad/m", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per turn.
        pub odometry_heading_turn_sd: f64 = 0.10, "rad/rad", [0.0, 1.0];
    }
}
