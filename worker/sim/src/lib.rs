//! Fields, robots, LiDARs and closed loops: one run is a pure function of scenario and seed.

pub mod engine;
pub mod plan;
pub mod run;
pub mod scenario;
pub mod svg;

pub use run::{Outcome, Part, Pose, Probe, RunResult, Seed, simulate};
pub use scenario::{Scenario, ScenarioError};
