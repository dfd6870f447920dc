//! Fields, robots, LiDARs and closed loops: one run is a pure function of scenario and seed.
//!
//! [`scenario`] says what a run is made of, [`run`] is the loop. The world is in [`field`], [`robot`],
//! [`lidar`], [`odometry`] and [`motion_sensors`]; [`perception`], [`localization`] and [`mission`] add to navigation's what only a simulator can
//! have: an oracle that sees the truth, and a floor that sees nothing. [`observer`] judges, [`svg`] draws,
//! [`plan`] holds experiments as data. No clock, no threads, no input or output.

pub mod engine;
pub mod field;
pub mod lidar;
pub mod localization;
pub mod mission;
pub mod motion_sensors;
pub mod observer;
pub mod odometry;
pub mod perception;
pub mod plan;
pub mod robot;
pub mod run;
pub mod scenario;
pub mod svg;

#[cfg(test)]
mod bench_scans;
#[cfg(test)]
mod golden;
#[cfg(test)]
mod lane_view;
#[cfg(test)]
mod table5;

pub use furrow_navigation::Pose;
pub use furrow_navigation::perception::Scan;
pub use run::{Detection, InSpace, LocatedNode, Outcome, Part, Probe, RunResult, Seed, simulate};
pub use scenario::{Scenario, ScenarioError};
