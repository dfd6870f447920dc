//! Why an operator had to help: the classes of Velasquez et al. (2022), sections 5.2 and 5.3.

use std::collections::VecDeque;

use super::{Heard, OperatorParams};
use crate::observer::operator::label::label;

/// Why an operator had to help.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The robot came to the end of the lane.
    EndOfLane,
    /// In the first metres.
    BadStart,
    /// Without gaps it would not have happened.
    Gap,
    /// The robot was wrong about its place, first of all about this.
    Perception(SubCause),
    /// None of these: control.
    Control,
}

impl Cause {
    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::EndOfLane => "end-of-lane",
            Self::BadStart => "bad-start",
            Self::Gap => "gap",
            Self::Perception(_) => "perception",
            Self::Control => "control",
        }
    }
}

/// What the robot was wrong about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SubCause {
    /// Its heading.
    Heading,
    /// The rows seemed to converge: the lane narrower than it is.
    Convergence,
    /// A side counted as seen in which a person would see no row, or the reverse.
    ValidSide,
    /// A distance, for no such reason.
    Distance,
}

type Counts = (&'static str, fn(Cause) -> bool);

/// Metrics and the causes they count.
pub(super) const METRICS: [Counts; 12] = [
    ("interventions", |_| true),
    ("relevant_interventions", |cause| cause != Cause::EndOfLane),
    ("relevant_interventions_without_bad_starts", |cause| !matches!(cause, Cause::EndOfLane | Cause::BadStart)),
    ("interventions_end_of_lane", |cause| cause == Cause::EndOfLane),
    ("interventions_bad_start", |cause| cause == Cause::BadStart),
    ("interventions_gap", |cause| cause == Cause::Gap),
    ("interventions_perception", |cause| matches!(cause, Cause::Perception(_))),
    ("interventions_perception_heading", |cause| cause == Cause::Perception(SubCause::Heading)),
    ("interventions_perception_convergence", |cause| cause == Cause::Perception(SubCause::Convergence)),
    ("interventions_perception_valid_side", |cause| cause == Cause::Perception(SubCause::ValidSide)),
    ("interventions_perception_distance", |cause| cause == Cause::Perception(SubCause::Distance)),
    ("interventions_control", |cause| cause == Cause::Control),
];

/// What was wrong with recent estimates.
pub(super) struct Suspicions {
    distance_m: f64,
    heading_rad: f64,
    before_s: f64,
    label_points: u32,
    recent: VecDeque<(f64, SubCause)>,
}

impl Suspicions {
    pub(super) fn new(params: &OperatorParams) -> Self {
        Self {
            distance_m: params.perception_distance_m,
            heading_rad: params.perception_heading_rad,
            before_s: params.perception_before_s,
            label_points: params.label_points,
            recent: VecDeque::new(),
        }
    }

    pub(super) fn hear(&mut self, heard: &Heard<'_>) {
        while self.recent.front().is_some_and(|(time_s, _)| *time_s < heard.time_s - self.before_s) {
            self.recent.pop_front();
        }
        if let Some(what) = self.wrong(heard) {
            self.recent.push_back((heard.time_s, what));
        }
    }

    pub(super) fn forget(&mut self) {
        self.recent.clear();
    }

    /// What an intervention now is due to: the first thing that was wrong shortly before.
    pub(super) fn cause(&self, now_s: f64) -> Cause {
        let first = self.recent.iter().find(|(time_s, _)| *time_s >= now_s - self.before_s);
        first.map_or(Cause::Control, |(_, what)| Cause::Perception(*what))
    }

    fn wrong(&self, heard: &Heard<'_>) -> Option<SubCause> {
        let Heard { place, view, estimate, .. } = heard;
        if (estimate.heading_rad - place.heading_rad).abs() > self.heading_rad {
            return Some(SubCause::Heading);
        }
        let off_m = [estimate.left_m - place.left_m, estimate.right_m - place.right_m];
        if off_m.iter().all(|off_m| off_m.abs() <= self.distance_m) {
            return None;
        }
        let seen = label(&heard.scan, heard.from_stem, place.heading_rad, self.label_points);
        let misjudged = [(view.left.valid, seen[0]), (view.right.valid, seen[1])]
            .iter()
            .zip(off_m)
            .any(|((valid, seen), off_m)| off_m.abs() > self.distance_m && *valid != seen.is_some());
        if misjudged {
            return Some(SubCause::ValidSide);
        }
        let converges = off_m[0] + off_m[1] < -self.distance_m;
        Some(if converges { SubCause::Convergence } else { SubCause::Distance })
    }
}
