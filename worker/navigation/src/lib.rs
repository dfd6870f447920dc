//! Perception, localization, control and missions for LiDAR crop-row navigation.
//!
//! Knows no simulator: everything here takes what a real robot's sensors give and returns wheel commands.
//! The folders are the stages of the loop: [`perception`] turns a scan into lines, [`localization`] turns the
//! lines of many scans into the rows around the robot, [`control`] turns these into wheel speeds and
//! [`mission`] decides which row to follow, when it ends and how to change to the next one.
//!
//! Frames: x forward, y to the left, angles counter-clockwise. A line is y = slope x + intercept in the frame
//! that its name says; a positive intercept is a row to the left, a positive slope means that the robot is
//! turned clockwise with respect to the row.

pub mod control;
pub mod labelled;
pub mod localization;
pub mod mission;
pub mod odometry;
pub mod parameters;
pub mod perception;
mod pose;
pub mod random;

pub use pose::Pose;
