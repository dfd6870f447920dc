//! The operator who walks beside a robot in a lane: puts it back where it fails, says why, and keeps the metrics.
//!
//! Velasquez et al. (2022), section 5: an intervention is a collision, a robot that leaves its lane or gets no further,
//! or the end of the lane. Distances are those of the LiDAR, from which the paper measures.

mod cause;
mod errors;
pub(crate) mod label;
mod spectrum;

use std::collections::BTreeMap;

use furrow_navigation::perception::{LaneEstimate, LaneView, Scan};

use super::{LimitsSpec, digest};
use crate::Pose;
use crate::field::lane::Place;
use crate::field::{Field, Lane};
use crate::robot::SkidSteerParams;
use crate::run::{Outcome, RunResult};
use cause::Suspicions;
pub use cause::{Cause, SubCause};
use errors::Errors;
use label::Labels;

furrow_navigation::parameters! {
    /// Parameters of the operator.
    pub struct OperatorParams {
        /// A stem that the body's rectangle overlaps by more than this is a collision, by less a brush. Ours.
        pub brush_m: f64 = 0.02, "m", [0.0, 0.5];
        /// The robot is put back so far beyond the place where it failed. Ours.
        pub put_back_m: f64 = 0.5, "m", [0.0, 10.0];
        /// No progress: less than this along the lane.. Ours.
        pub no_progress_m: f64 = 0.1, "m", [0.001, 10.0];
        /// ..in so much time. Ours.
        pub no_progress_s: f64 = 10.0, "s", [0.1, 1000.0];
        /// An intervention in the first so many metres is a bad start. Ours.
        pub bad_start_m: f64 = 3.0, "m", [0.0, 100.0];
        /// A gap is to blame where the same run without gaps has no intervention within this distance. Ours.
        pub gap_reach_m: f64 = 3.0, "m", [0.0, 100.0];
        /// ..and a gap ends at most so far before the place, or begins at most 2 m behind it. Ours: what is that far
        /// from any gap differs by chance.
        pub gap_after_m: f64 = 5.0, "m", [0.0, 100.0];
        /// Perception is to blame where a distance was off by more than this.. Ours.
        pub perception_distance_m: f64 = 0.1, "m", [0.0, 10.0];
        /// ..or the heading by more than this (10 degrees).. Ours.
        pub perception_heading_rad: f64 = 10.0 * std::f64::consts::PI / 180.0, "rad", [0.0, 3.2];
        /// ..within so much time before. Ours.
        pub perception_before_s: f64 = 2.0, "s", [0.0, 100.0];
        /// Every so many scans are labelled as a person would. Ours.
        pub label_every: u32 = 10, "1", [1, 100000];
        /// A side is valid to a person with so many returns of stems in the rectangle. Ours.
        pub label_points: u32 = 5, "1", [1, 10000];
    }
}

/// An intervention.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intervention {
    /// Simulated time \[s\].
    pub time_s: f64,
    /// The LiDAR's place along the lane \[m\].
    pub along_m: f64,
    /// The robot's pose: `world_from_robot`.
    pub pose: Pose,
    /// Why.
    pub cause: Cause,
}

/// What the operator does after a look.
pub(crate) enum Verdict {
    DriveOn,
    PutBack(Pose),
    Ended(Outcome),
}

/// What the robot made of one scan, and the truth.
pub(crate) struct Heard<'a> {
    pub(crate) time_s: f64,
    pub(crate) place: Place,
    pub(crate) view: LaneView,
    pub(crate) estimate: LaneEstimate,
    pub(crate) scan: Scan<'a>,
    pub(crate) from_stem: &'a [bool],
}

/// The operator of one run.
pub struct Operator<'a> {
    params: OperatorParams,
    max_time_s: f64,
    field: &'a Field,
    lane: &'a Lane,
    /// Half length and half width of what must not touch a stem \[m\].
    body_half_m: (f64, f64),
    lidar_x_m: f64,
    /// The LiDAR's place along the lane.
    along_m: f64,
    started_m: f64,
    /// When the robot last had got further, and how far.
    progress: (f64, f64),
    interventions: Vec<Intervention>,
    suspicions: Suspicions,
    errors: Errors,
    labels: Labels,
    time_s: f64,
    trajectory: blake3::Hasher,
}

impl<'a> Operator<'a> {
    pub(crate) fn new(
        params: &OperatorParams,
        limits: &LimitsSpec,
        (field, lane): (&'a Field, &'a Lane),
        robot: &SkidSteerParams,
        lidar_x_m: f64,
    ) -> Self {
        let LimitsSpec::SimulatedTime(limits) = limits;
        let half_m = |length_m: f64| (0.5 * length_m - params.brush_m).max(0.0);
        let mut operator = Self {
            params: params.clone(),
            max_time_s: limits.max_time_s,
            field,
            lane,
            body_half_m: (half_m(robot.body_length_m), half_m(robot.body_width_m)),
            lidar_x_m,
            along_m: 0.0,
            started_m: 0.0,
            progress: (0.0, 0.0),
            interventions: Vec::new(),
            suspicions: Suspicions::new(params),
            errors: Errors::default(),
            labels: Labels::new(params),
            time_s: 0.0,
            trajectory: blake3::Hasher::new(),
        };
        operator.put(0.0, field.start);
        operator.started_m = operator.along_m;
        operator
    }

    /// The LiDAR's place along the lane, as last seen \[m\].
    pub(crate) const fn along_m(&self) -> f64 {
        self.along_m
    }

    /// Where the LiDAR of a robot at `pose` is.
    pub(crate) fn place(&self, pose: Pose) -> Place {
        self.lane.place(self.field, (pose.sensor(self.lidar_x_m, false), self.lidar_x_m), self.along_m)
    }

    /// Takes in what the robot made of a scan.
    pub(crate) fn hear(&mut self, heard: &Heard<'_>) {
        self.errors.hear(heard);
        self.labels.hear(heard);
        self.suspicions.hear(heard);
    }

    /// Takes in the true pose, at 20 Hz.
    pub(crate) fn observe(&mut self, time_s: f64, pose: Pose) -> Verdict {
        for value in [pose.x_m, pose.y_m, pose.heading_rad] {
            self.trajectory.update(&value.to_bits().to_le_bytes());
        }
        self.time_s = time_s;
        let place = self.place(pose);
        self.along_m = place.along_m;
        self.errors.observe(place.across_m);
        if place.along_m >= self.lane.length_m {
            self.note(pose, Cause::EndOfLane);
            let alone = self.interventions.len() == 1;
            return Verdict::Ended(if alone { Outcome::Success } else { Outcome::Intervened });
        }
        if place.along_m > self.progress.1 + self.params.no_progress_m {
            self.progress = (time_s, place.along_m);
        }
        let stuck = time_s - self.progress.0 >= self.params.no_progress_s;
        if stuck || self.has_left(pose) || self.collides(pose) {
            let bad_start = place.along_m - self.started_m < self.params.bad_start_m;
            self.note(pose, if bad_start { Cause::BadStart } else { self.suspicions.cause(time_s) });
            return Verdict::PutBack(self.put_back(time_s));
        }
        if time_s >= self.max_time_s { Verdict::Ended(Outcome::Time) } else { Verdict::DriveOn }
    }

    /// Whether the robot's centre has crossed one of the lane's rows.
    fn has_left(&self, pose: Pose) -> bool {
        let centre = self.lane.place(self.field, (pose, 0.0), self.along_m);
        centre.left_m < 0.0 || centre.right_m < 0.0
    }

    fn collides(&self, pose: Pose) -> bool {
        let reach_m = self.lidar_x_m.abs() + self.body_half_m.0 + self.body_half_m.1 + 0.3;
        let near = self.lane.plants_within(&self.field.plants, self.along_m - reach_m, self.along_m + reach_m);
        let local = pose.locals();
        near.iter().any(|plant| {
            let (x, y) = local(plant.x_m, plant.y_m);
            super::damage::outside(x, y, self.body_half_m) <= plant.radius_m
        })
    }

    fn note(&mut self, pose: Pose, cause: Cause) {
        self.interventions.push(Intervention { time_s: self.time_s, along_m: self.along_m, pose, cause });
    }

    /// On the middle, further on, along it.
    fn put_back(&mut self, time_s: f64) -> Pose {
        let robot_along_m = self.along_m + self.params.put_back_m - self.lidar_x_m;
        let pose = self.lane.pose(self.field, robot_along_m);
        self.put(time_s, pose);
        pose
    }

    fn put(&mut self, time_s: f64, pose: Pose) {
        // From a failure to where the robot is put, a place on the middle is never far.
        self.along_m = self.place(pose).along_m;
        self.progress = (time_s, self.along_m);
        self.suspicions.forget();
        self.errors.begin_stretch();
    }

    /// Whether a run without gaps is needed to say what an intervention came from.
    pub(crate) fn suspects_gaps(&self) -> bool {
        self.interventions.iter().any(|intervention| self.may_be_gap(intervention))
    }

    fn may_be_gap(&self, intervention: &Intervention) -> bool {
        /// A gap shows so far before the robot is in it \[m\]: the rectangle of perception.
        const AHEAD_M: f64 = 2.0;
        let along_m = intervention.along_m;
        let near = |[from_m, to_m]: &[f64; 2]| (from_m - AHEAD_M..=to_m + self.params.gap_after_m).contains(&along_m);
        !matches!(intervention.cause, Cause::EndOfLane | Cause::BadStart) && self.lane.gaps_m.iter().any(near)
    }

    /// Blames gaps for what does not happen in `filled`, the same run without them.
    pub(crate) fn blame_gaps(&mut self, filled: &Operator<'_>) {
        let reach_m = self.params.gap_reach_m;
        for i in 0..self.interventions.len() {
            let here = self.interventions[i];
            let again = |other: &Intervention| (other.along_m - here.along_m).abs() <= reach_m;
            if self.may_be_gap(&here) && !filled.interventions.iter().any(again) {
                self.interventions[i].cause = Cause::Gap;
            }
        }
    }

    /// The result of a run that ended with `outcome`.
    pub(crate) fn result(self, outcome: Outcome) -> RunResult {
        let mut metrics: BTreeMap<&'static str, f64> = BTreeMap::new();
        metrics.insert("success", f64::from(u8::from(outcome == Outcome::Success)));
        metrics.insert("simulated_s", self.time_s);
        metrics.insert("distance_m", (self.along_m - self.started_m).max(0.0));
        let of = |counts: &dyn Fn(Cause) -> bool| self.interventions.iter().filter(|i| counts(i.cause)).count() as f64;
        for (name, counts) in cause::METRICS {
            metrics.insert(name, of(&counts));
        }
        self.errors.report(&mut metrics);
        self.labels.report(&mut metrics);
        metrics.retain(|_, value| value.is_finite());
        let digest = digest(self.trajectory, outcome, &metrics);
        RunResult { digest, outcome, metrics, damaged: Vec::new(), interventions: self.interventions }
    }
}
