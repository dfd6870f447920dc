//! One run.

use std::collections::BTreeMap;

use crate::Scenario;

/// The seed of a run's random streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(pub u64);

/// Position [m] and heading [rad, counter-clockwise] in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// [m]
    pub x_m: f64,
    /// [m]
    pub y_m: f64,
    /// [rad]
    pub heading_rad: f64,
}

/// A part of the loop, for timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Part {
    /// Ray casting of both LiDARs.
    Scan,
    /// The line finder on a scan of the front LiDAR.
    LineFindingFront,
    /// The line finder on a scan of the back LiDAR.
    LineFindingBack,
    /// Merging, filter, state machine and controller.
    Control,
    /// The robot's motion.
    Drive,
    /// The observer.
    Observe,
}

impl Part {
    /// All parts, in the order of the loop.
    pub const ALL: [Self; 6] =
        [Self::Scan, Self::LineFindingFront, Self::LineFindingBack, Self::Control, Self::Drive, Self::Observe];

    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::LineFindingFront => "line-finding-front",
            Self::LineFindingBack => "line-finding-back",
            Self::Control => "control",
            Self::Drive => "drive",
            Self::Observe => "observe",
        }
    }
}

/// Watches a run: times parts, records, may ask to stop. It never feeds back.
pub trait Probe {
    /// A part begins.
    fn begin(&mut self, _part: Part) {}
    /// A part ends.
    fn end(&mut self, _part: Part) {}
    /// The true pose, every 0.05 s of simulated time.
    fn pose(&mut self, _time_s: f64, _world_from_robot: Pose) {}
    /// Asked every 0.25 s of simulated time; true ends the run with [`Outcome::Stopped`].
    fn stop(&mut self) -> bool {
        false
    }
}

impl Probe for () {}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// As it should.
    Success,
    /// The probe asked for it; there is no result.
    Stopped,
}

impl Outcome {
    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Stopped => "stopped",
        }
    }
}

/// What came out of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunResult {
    /// Hash over trajectory, outcome and metrics.
    pub digest: [u8; 32],
    /// How it ended.
    pub outcome: Outcome,
    /// Value by metric; undefined metrics are absent. All finite.
    pub metrics: BTreeMap<&'static str, f64>,
    /// Crop plants that were run over, by index in the field.
    pub damaged: Vec<usize>,
}

/// Runs `scenario` with `seed` to its end.
pub fn simulate(_scenario: &Scenario, _seed: Seed, _probe: &mut impl Probe) -> RunResult {
    unimplemented!("not yet written")
}
