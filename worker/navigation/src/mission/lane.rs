//! Along one lane at constant speed: Velasquez et al. (2022), figure 1.
//!
//! Per scan and in this order: [`predict`](LaneFollower::predict) gives the prior that a lane finder gets,
//! [`correct`](LaneFollower::correct) takes its view, [`steer`](LaneFollower::steer) says how to drive on.

use crate::control::{LanePd, Twist};
use crate::localization::LaneEstimator;
use crate::perception::{LaneEstimate, LaneView, Points};
use crate::random::Stream;

crate::parameters! {
    /// Parameters of [`LaneFollower`].
    pub struct LaneParams {
        /// Nominal width of the lane, for finder and estimator. Paper: 0.75.
        pub lane_width_m: f64 = 0.75, "m", [0.2, 5.0];
        /// Forward speed. Paper: 0.7.
        pub speed_m_s: f64 = 0.7, "m/s", [0.01, 5.0];
    }
}

/// Follows a lane; never ends of itself.
pub struct LaneFollower {
    params: LaneParams,
    estimator: Box<dyn LaneEstimator>,
    control: LanePd,
}

impl LaneFollower {
    /// A mission at the start of a lane.
    #[must_use]
    pub const fn new(params: LaneParams, estimator: Box<dyn LaneEstimator>, control: LanePd) -> Self {
        Self { params, estimator, control }
    }

    /// The robot has moved for `dt_s` \[s\] with the twist `measured`; returns what it believes now.
    pub fn predict(&mut self, measured: Twist, dt_s: f64) -> LaneEstimate {
        self.estimator.predict(measured, dt_s);
        self.estimator.estimate()
    }

    /// Takes in a scan: its points in the robot's frame \[m\] and the lane that a finder saw in them; returns what it
    /// believes now.
    pub fn correct(&mut self, points: &Points, view: LaneView, random: &mut Stream) -> LaneEstimate {
        self.estimator.correct(points, view, random);
        self.estimator.estimate()
    }

    /// How to drive on, `dt_s` \[s\] after the last command.
    pub fn steer(&mut self, dt_s: f64) -> Twist {
        let angular_rad_s = self.control.steer(self.estimator.estimate(), dt_s);
        Twist { linear_m_s: self.params.speed_m_s, angular_rad_s }
    }

    /// Begins again: an operator has put the robot back into the lane's middle, along it; returns where that is.
    pub fn restart(&mut self) -> LaneEstimate {
        let start = LaneEstimate::middle(self.params.lane_width_m);
        self.estimator.restart(start);
        self.control.restart();
        start
    }
}
