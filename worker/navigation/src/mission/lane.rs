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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::LanePdParams;
    use crate::control::lane::Guide;
    use crate::localization::LocalizationSpec;
    use crate::parameters::Kinds;
    use crate::perception::LaneFinderSpec;
    use crate::perception::lane::simulated::Scene;

    /// Drives 12 m from `left_m` and `heading_rad`, without lag or noise of motion; returns the places.
    fn drive(estimator: &str, guide: Guide, rate_hz: f64, [left_m, heading_rad]: [f64; 2]) -> Vec<LaneEstimate> {
        let params = LaneParams::default();
        let spec = LocalizationSpec::read_kind(estimator, Default::default()).unwrap();
        let estimator = spec.lane_estimator(params.lane_width_m).unwrap();
        let control = LanePd::new(&LanePdParams { guide, ..LanePdParams::default() });
        let mut finder = LaneFinderSpec::read_kind("pl", Default::default()).unwrap().build(params.lane_width_m);
        let mut follower = LaneFollower::new(params, estimator, control);
        let mut random = Stream::new(1, "drive");
        let (dt_s, mut twist) = (1.0 / rate_hz, Twist::default());
        let mut truth = LaneEstimate { left_m, right_m: 0.75 - left_m, heading_rad };
        (0..(17.0 * rate_hz) as u32)
            .map(|_| {
                let prior = follower.predict(twist, dt_s);
                let points = Scene::new(truth, 0.5).scan(&mut random);
                let view = finder.find(&points, prior, dt_s, &mut random);
                follower.correct(&points, view, &mut random);
                twist = follower.steer(dt_s);
                let across_m = twist.linear_m_s * dt_s * libm::sin(truth.heading_rad);
                truth = LaneEstimate {
                    left_m: truth.left_m - across_m,
                    right_m: truth.right_m + across_m,
                    heading_rad: truth.heading_rad + twist.angular_rad_s * dt_s,
                };
                truth
            })
            .collect()
    }

    fn assert_settles(places: &[LaneEstimate], case: &str) {
        assert!(places.iter().all(|place| place.left_m > 0.0 && place.right_m > 0.0), "{case}: left the lane");
        let end = &places[places.len() * 2 / 3..];
        let worst_m = end.iter().map(|place| place.cross_track_m().abs()).fold(0.0, f64::max);
        assert!(worst_m < 0.1, "{case}: {worst_m}");
    }

    #[test]
    fn it_drives_to_the_middle_from_either_side_at_all_rates() {
        for rate_hz in [40.0, 10.0, 5.0] {
            for start in [[0.25, 0.1], [0.5, -0.1]] {
                assert_settles(&drive("ekf", Guide::Lgg, rate_hz, start), &format!("{rate_hz} Hz {start:?}"));
            }
        }
    }

    #[test]
    fn it_does_so_without_filter_or_without_local_goals_or_by_particles() {
        for (estimator, guide) in [("view", Guide::Lgg), ("ekf", Guide::Offset), ("particle-filter", Guide::Lgg)] {
            assert_settles(&drive(estimator, guide, 40.0, [0.28, 0.05]), &format!("{estimator} {guide:?}"));
        }
    }

    #[test]
    fn after_a_restart_it_believes_to_be_in_the_middle() {
        let estimator = LocalizationSpec::read_kind("ekf", Default::default()).unwrap().lane_estimator(0.75).unwrap();
        let control = LanePd::new(&LanePdParams::default());
        let mut follower = LaneFollower::new(LaneParams::default(), estimator, control);
        let off = LaneEstimate { left_m: 0.5, right_m: 0.25, heading_rad: 0.2 };
        follower.correct(&Points::default(), LaneView::nothing(off), &mut Stream::new(1, "test"));
        assert!(follower.steer(0.025).angular_rad_s != 0.0);
        assert_eq!(follower.restart(), LaneEstimate::middle(0.75));
        assert_eq!(follower.steer(0.025), Twist { linear_m_s: 0.7, angular_rad_s: 0.0 });
    }
}
