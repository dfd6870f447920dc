//! Watches the truth, decides how a run ends, and keeps its metrics. Nothing of it reaches an algorithm.

mod damage;
pub mod nursery;
pub mod operator;
mod progress;

use std::collections::BTreeMap;

use crate::Pose;
use crate::field::Field;
use crate::robot::TwoWheeledParams;
use crate::run::{Outcome, RunResult};
pub(crate) use nursery::NurseryObserver;
pub use nursery::NurseryObserverParams;
pub use operator::{Cause, Intervention, Operator, OperatorParams, SubCause};

use damage::Damage;
use furrow_navigation::mission::Step;
use progress::Progress;

furrow_navigation::kinds! {
    /// Who watches the run.
    pub enum ObserverSpec {
        /// Row following between the rows of a field, one after the other.
        InterRows(InterRowsParams) = "inter-rows",
        /// An operator who walks beside a robot in a lane, helps where it fails and says why.
        Operator(OperatorParams) = "operator",
        /// Coverage, damage and the way through the lanes of a nursery.
        Nursery(NurseryObserverParams) = "nursery",
    }
}

furrow_navigation::parameters! {
    /// Parameters of the observer of row following. Guyonneau et al. (2022), section 4.3.
    pub struct InterRowsParams {
        /// Scans of the front LiDAR over which the processed points are averaged. Paper: 500.
        pub points_scans: u32 = 500, "1", [1, 1000000];
    }
}

furrow_navigation::kinds! {
    /// When a run is given up.
    pub enum LimitsSpec {
        /// After some simulated time, or when the robot stays where it is.
        SimulatedTime(SimulatedTimeParams) = "simulated-time",
    }
}

furrow_navigation::parameters! {
    /// Limits of a run.
    pub struct SimulatedTimeParams {
        /// A run ends after this much simulated time. Ours.
        pub max_time_s: f64 = 1500.0, "s", [0.1, 100000.0];
        /// A run ends when the robot has moved less than 0.1 m and turned less than 0.1 rad for this long. Ours.
        pub stuck_after_s: f64 = 30.0, "s", [1.0, 100000.0];
    }
}

/// Moved or turned by less than this, the robot is where it was \[m\], \[rad\].
const STUCK_M: f64 = 0.1;
const STUCK_RAD: f64 = 0.1;

/// The observer of one run.
pub(crate) struct Observer<'a> {
    field: &'a Field,
    points_scans: u32,
    limits: SimulatedTimeParams,
    progress: Progress,
    damage: Damage<'a>,
    error: Mean,
    points: Mean,
    /// Where and when the robot last was somewhere else.
    anchor: (f64, Pose),
    trajectory: blake3::Hasher,
}

#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: f64,
    n: u32,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.n += 1;
    }

    fn value(self) -> Option<f64> {
        (self.n > 0).then(|| self.sum / f64::from(self.n))
    }
}

impl<'a> Observer<'a> {
    pub(crate) fn new(spec: &ObserverSpec, limits: &LimitsSpec, field: &'a Field, robot: &TwoWheeledParams) -> Self {
        let ObserverSpec::InterRows(params) = spec else { unreachable!("a scenario is checked") };
        let LimitsSpec::SimulatedTime(limits) = limits;
        Self {
            field,
            points_scans: params.points_scans,
            limits: limits.clone(),
            progress: Progress::new(field),
            damage: Damage::new(field, robot),
            error: Mean::default(),
            points: Mean::default(),
            anchor: (0.0, field.start),
            trajectory: blake3::Hasher::new(),
        }
    }

    /// Counts the points that the front LiDAR's finder worked on.
    pub(crate) fn count_points(&mut self, points: usize) {
        if self.points.n < self.points_scans {
            self.points.add(points as f64);
        }
    }

    /// Takes in the true pose, at 20 Hz; says how the run ends, if it does.
    pub(crate) fn observe(&mut self, time_s: f64, world_from_robot: Pose) -> Option<Outcome> {
        for value in [world_from_robot.x_m, world_from_robot.y_m, world_from_robot.heading_rad] {
            self.trajectory.update(&value.to_bits().to_le_bytes());
        }
        self.damage.observe(world_from_robot);
        let inside = self.progress.observe(world_from_robot);
        if let Some(on_middle) = inside
            && self.field.counts_as_inside(world_from_robot.x_m, &on_middle)
        {
            self.error.add(on_middle.across_m * on_middle.across_m);
        }
        if self.progress.in_wrong_row() {
            return Some(Outcome::WrongRow);
        }
        if self.is_stuck(time_s, world_from_robot) {
            return Some(Outcome::Stuck);
        }
        (time_s >= self.limits.max_time_s).then_some(Outcome::Time)
    }

    fn is_stuck(&mut self, time_s: f64, pose: Pose) -> bool {
        let (since_s, anchor) = self.anchor;
        let moved_m = libm::hypot(pose.x_m - anchor.x_m, pose.y_m - anchor.y_m);
        if moved_m >= STUCK_M || (pose.heading_rad - anchor.heading_rad).abs() >= STUCK_RAD {
            self.anchor = (time_s, pose);
        }
        time_s - since_s >= self.limits.stuck_after_s
    }

    /// How the run ends if the mission says that it does.
    pub(crate) fn judge(&self, step: Step) -> Option<Outcome> {
        match step {
            Step::Drive(_) => None,
            Step::Lost => Some(Outcome::Lost),
            Step::Finished if !self.progress.is_complete() => Some(Outcome::EndedEarly),
            Step::Finished if self.damage.body() > 0 => Some(Outcome::Crushed),
            Step::Finished => Some(Outcome::Success),
        }
    }

    /// The result of a run that ended at `time_s` with `outcome`.
    pub(crate) fn result(self, time_s: f64, outcome: Outcome) -> RunResult {
        let mut metrics: BTreeMap<&'static str, f64> = BTreeMap::new();
        metrics.insert("success", f64::from(u8::from(outcome == Outcome::Success)));
        metrics.insert("rows_completed", f64::from(self.progress.rows_completed()));
        metrics.insert("simulated_s", time_s);
        metrics.insert("crop_damage", f64::from(self.damage.body()));
        metrics.insert("wheel_damage", f64::from(self.damage.wheels()));
        metrics.extend(self.damage.closest_m().map(|distance_m| ("closest_plant_m", distance_m)));
        metrics.extend(self.points.value().map(|points| ("points_processed", points)));
        metrics.extend(self.error.value().map(|error| ("mean_squared_error_mm2", error * 1e6)));
        let digest = digest(self.trajectory, outcome, &metrics);
        RunResult { digest, outcome, metrics, damaged: self.damage.damaged(), interventions: Vec::new() }
    }
}

/// Hash over trajectory, outcome and metrics.
fn digest(mut hasher: blake3::Hasher, outcome: Outcome, metrics: &BTreeMap<&'static str, f64>) -> [u8; 32] {
    hasher.update(outcome.name().as_bytes());
    for (name, value) in metrics {
        hasher.update(name.as_bytes());
        hasher.update(&value.to_bits().to_le_bytes());
    }
    hasher.finalize().into()
}
