//! Where the robot is in its lane: from the views of many scans and the robot's own motion.
//!
//! Each estimator is [predicted](LaneEstimator::predict) with what the wheels and the gyroscope say, and
//! [corrected](LaneEstimator::correct) with a scan, in turn.

pub mod ekf;

use crate::control::Twist;
use crate::perception::{LaneEstimate, LaneView, Points};
use crate::random::Stream;

/// Estimates where the robot is in its lane.
pub trait LaneEstimator: Send {
    /// The robot has moved for `dt_s` \[s\] with the twist `measured`. Nothing changes if a number is not finite.
    fn predict(&mut self, measured: Twist, dt_s: f64);

    /// A scan has come: `points` in the robot's frame {R} \[m\], and what a finder saw in them.
    fn correct(&mut self, points: &Points, view: LaneView, random: &mut Stream);

    /// What it believes now.
    fn estimate(&self) -> LaneEstimate;

    /// Starts again: the robot was put to `start`, more or less.
    fn restart(&mut self, start: LaneEstimate);
}

/// Believes the last view: the system without a filter.
#[derive(Debug, Clone)]
pub struct LastView {
    estimate: LaneEstimate,
}

impl LastView {
    /// Believes `start` until a view comes.
    #[must_use]
    pub const fn new(start: LaneEstimate) -> Self {
        Self { estimate: start }
    }
}

impl LaneEstimator for LastView {
    fn predict(&mut self, _measured: Twist, _dt_s: f64) {}

    fn correct(&mut self, _points: &Points, view: LaneView, _random: &mut Stream) {
        self.estimate = LaneEstimate {
            left_m: view.left.distance_m,
            right_m: view.right.distance_m,
            heading_rad: view.heading_rad,
        };
    }

    fn estimate(&self) -> LaneEstimate {
        self.estimate
    }

    fn restart(&mut self, start: LaneEstimate) {
        self.estimate = start;
    }
}
