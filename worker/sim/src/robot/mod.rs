//! Robots: from wheel commands to motion, and the ground they touch.

pub mod two_wheeled;

pub use two_wheeled::{TwoWheeled, TwoWheeledParams};

furrow_navigation::kinds! {
    /// Which robot drives.
    pub enum RobotSpec {
        /// A differential robot with two driven wheels, the same at both ends.
        TwoWheeled(TwoWheeledParams) = "two-wheeled",
    }
}
