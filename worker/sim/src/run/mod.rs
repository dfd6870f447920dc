//! One run: the closed loop, in fixed steps, a pure function of scenario and seed.
//!
//! `rows` is the loop of a robot that drives from inter-row to inter-row, `lane` of one that follows a lane, `nursery` of one with a 3D
//! LiDAR in a nursery.

mod lane;
mod nursery;
mod rows;

use std::collections::BTreeMap;

use furrow_navigation::perception::cloud::{CloudScan, Point3};
use furrow_navigation::perception::rows::DetectedRows;
use furrow_navigation::perception::{Found, LaneView, Scan};

use crate::mission::MissionSpec;
use crate::observer::Intervention;
use crate::{Pose, Scenario};

/// One step of the loop \[s\]: the period of the LiDARs, 40 Hz.
pub const STEP_S: f64 = 0.025;
/// Steps in a second.
pub const STEPS_PER_S: u32 = 40;
/// Steps per control cycle: 250 ms, the program behind the tables of Guyonneau et al. (2022).
pub const STEPS_PER_CYCLE: u64 = 10;
/// Steps per sample of the observer: 20 Hz.
pub const STEPS_PER_SAMPLE: u64 = 2;

/// The seed of a run's random streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(pub u64);

/// A part of the loop, for timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Part {
    /// Ray casting of all LiDARs.
    Scan,
    /// The line finder on a scan of the front LiDAR.
    LineFindingFront,
    /// The line finder on a scan of the back LiDAR.
    LineFindingBack,
    /// Merging, filter, state machine and controller; in a lane the controller alone.
    Control,
    /// The robot's motion.
    Drive,
    /// The observer.
    Observe,
    /// The lane finder on a scan.
    LaneFinding,
    /// The lane estimator on the robot's motion.
    LanePrediction,
    /// The lane estimator on what the finder saw.
    LaneCorrection,
    /// Outlier removal in a cloud of the 3D LiDAR.
    Filtering,
    /// The ground plane in it, and the points above.
    GroundDetection,
    /// The row detector on these.
    RowDetection,
    /// Localization in the map of a nursery.
    Localization,
}

impl Part {
    /// All parts, in the order of the loop.
    pub const ALL: [Self; 13] = [
        Self::Scan,
        Self::LineFindingFront,
        Self::LineFindingBack,
        Self::Control,
        Self::Drive,
        Self::Observe,
        Self::LaneFinding,
        Self::LanePrediction,
        Self::LaneCorrection,
        Self::Filtering,
        Self::GroundDetection,
        Self::RowDetection,
        Self::Localization,
    ];

    /// Those of a robot in a nursery alone.
    #[cfg(test)]
    pub(crate) const OF_NURSERIES: [Self; 4] =
        [Self::Filtering, Self::GroundDetection, Self::RowDetection, Self::Localization];

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
            Self::LaneFinding => "lane-finding",
            Self::LanePrediction => "lane-prediction",
            Self::LaneCorrection => "lane-correction",
            Self::Filtering => "filtering",
            Self::GroundDetection => "ground-detection",
            Self::RowDetection => "row-detection",
            Self::Localization => "localization",
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
    /// A 3D LiDAR's scan was taken at a true pose of the robot, and what was found in it.
    fn scanned_in_space(&mut self, _world_from_robot: Pose, _sight: &InSpace<'_>) {}
    /// A LiDAR's scan, where it was truly taken, and what was found in it.
    fn scanned(&mut self, _world_from_lidar: Pose, _scan: &Scan<'_>, _found: Detection<'_>) {}
    /// A node was added to the graph of poses by which the robot places itself in the map of a nursery.
    fn located(&mut self, _node: &LocatedNode) {}
    /// Asked every 0.25 s of simulated time; true ends the run with [`Outcome::Stopped`].
    fn stop(&mut self) -> bool {
        false
    }
}

impl Probe for () {}

/// What perception found in a scan, in the LiDAR's frame.
#[derive(Debug, Clone, Copy)]
pub enum Detection<'a> {
    /// Lines along rows, and the points they were found in.
    Lines(Found<'a>),
    /// The lane, in all returns.
    Lane(LaneView),
}

/// A scan of a 3D LiDAR and what was found in it.
#[derive(Debug, Clone, Copy)]
pub struct InSpace<'a> {
    /// All returns, in the LiDAR's frame.
    pub cloud: CloudScan<'a>,
    /// The points above the ground, in the robot's frame \[m\].
    pub plants: &'a [Point3],
    /// The rows, in the robot's frame.
    pub rows: DetectedRows<'a>,
}

/// A node of a graph of poses.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LocatedNode {
    /// The pose that the robot believed to have when the node was added.
    pub map_from_robot: Pose,
    /// The parts of the map's rows that were matched from it: from (x, y), to (x, y) \[m\].
    pub matched_m: Vec<[[f64; 2]; 2]>,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// The end of the last inter-row was reached and no crop plant run over; the end of the lane, without help.
    Success,
    /// The end was reached, but crop plants were run over.
    Crushed,
    /// The robot did not know where it was any more.
    Lost,
    /// It was in another inter-row than it should have been.
    WrongRow,
    /// Its centre crossed a row of a nursery.
    CrossedRow,
    /// It entered a lane of a nursery again.
    SameRow,
    /// It drove too far away from a nursery.
    TooFar,
    /// It said that it was done and was not.
    EndedEarly,
    /// The end of the lane was reached, but an operator had to help on the way.
    Intervened,
    /// It stayed where it was for too long.
    Stuck,
    /// The simulated time ran out.
    Time,
    /// The probe asked for it; there is no result.
    Stopped,
}

impl Outcome {
    /// All outcomes, the good one first.
    pub const ALL: [Self; 12] = [
        Self::Success,
        Self::Crushed,
        Self::Lost,
        Self::WrongRow,
        Self::CrossedRow,
        Self::SameRow,
        Self::TooFar,
        Self::EndedEarly,
        Self::Intervened,
        Self::Stuck,
        Self::Time,
        Self::Stopped,
    ];

    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Crushed => "crushed",
            Self::Lost => "lost",
            Self::WrongRow => "wrong-row",
            Self::CrossedRow => "crossed-row",
            Self::SameRow => "same-row",
            Self::TooFar => "too-far",
            Self::EndedEarly => "ended-early",
            Self::Intervened => "intervened",
            Self::Stuck => "stuck",
            Self::Time => "time",
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
    /// When an operator had to help, in order; in lanes.
    pub interventions: Vec<Intervention>,
}

/// Runs `scenario` with `seed` to its end.
pub fn simulate(scenario: &Scenario, seed: Seed, probe: &mut impl Probe) -> RunResult {
    match &scenario.mission {
        MissionSpec::RowByRow(_) | MissionSpec::HeadingHold(_) => rows::simulate(scenario, seed, probe),
        MissionSpec::Lane(params) => lane::simulate(scenario, params, seed, probe),
        MissionSpec::Nursery(params) => nursery::simulate(scenario, params, seed, probe),
    }
}

fn timed<T>(probe: &mut impl Probe, part: Part, work: impl FnOnce() -> T) -> T {
    probe.begin(part);
    let result = work();
    probe.end(part);
    result
}
