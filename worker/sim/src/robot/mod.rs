//! Robots: from commands to motion, and the ground they touch.

pub mod skid_steer;
pub mod tracked;
pub mod two_wheeled;

pub use skid_steer::{SkidSteer, SkidSteerParams};
pub use tracked::{Tracked, TrackedParams};
pub use two_wheeled::{TwoWheeled, TwoWheeledParams};

furrow_navigation::kinds! {
    /// Which robot drives.
    pub enum RobotSpec {
        /// A differential robot with two driven wheels, the same at both ends.
        TwoWheeled(TwoWheeledParams) = "two-wheeled",
        /// A skid-steered robot with four wheels.
        SkidSteer(SkidSteerParams) = "skid-steer",
        /// A tracked robot that slips.
        Tracked(TrackedParams) = "tracked",
    }
}

/// How a robot moved in a step, as its own odometry would see it without error.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Along its heading \[m\].
    pub distance_m: f64,
    /// Counter-clockwise \[rad\].
    pub turn_rad: f64,
}
