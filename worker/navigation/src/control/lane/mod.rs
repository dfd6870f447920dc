//! From the place in a lane to a yaw rate: Velasquez et al. (2022), section 3.4.

pub mod lgg;
pub mod pd;

use crate::perception::LaneEstimate;
use lgg::Lgg;
use pd::Pd;

crate::words! {
    /// What the controller drives to zero.
    pub enum Guide {
        /// The heading's difference from the local goal generator's reference.
        Lgg = "lgg",
        /// The cross-track error itself: the system without a local goal generator.
        Offset = "offset",
    }
}

crate::parameters! {
    /// Parameters of [`LanePd`].
    pub struct LanePdParams {
        /// What the controller drives to zero. Paper: `lgg`; `offset` in its comparisons.
        pub guide: Guide = Guide::Lgg, "";
        /// Yaw rate per error; in rad/s per m for `offset`. Paper: 0.7; 0.35 and 1.7 in table 4.
        pub kp: f64 = 0.7, "1/s", [0.0, 100.0];
        /// Yaw rate per rate of the error; in rad per m for `offset`. Paper: 1.5; 0.75 and 1.7 in table 4.
        pub kd: f64 = 1.5, "1", [0.0, 100.0];
        /// Time constant of the filter on the error's rate. Ours.
        pub derivative_filter_s: f64 = 0.1, "s", [0.0, 10.0];
        /// Largest yaw rate to either side. Paper: 1.5.
        pub max_yaw_rate_rad_s: f64 = 1.5, "rad/s", [0.01, 10.0];
        /// The reference curve's smoothness b. Paper: 3.8.
        pub lgg_b: f64 = 3.8, "1", [0.01, 100.0];
        /// The reference curve's dead band c. Paper: 0.55.
        pub lgg_c: f64 = 0.55, "1", [0.01, 10.0];
        /// The reference curve's width e. Paper: 0.7.
        pub lgg_e: f64 = 0.7, "m", [0.01, 100.0];
    }
}

/// The controller.
#[derive(Debug, Clone)]
pub struct LanePd {
    guide: Guide,
    lgg: Lgg,
    pd: Pd,
    max_yaw_rate_rad_s: f64,
}

impl LanePd {
    /// A controller that has seen no error yet.
    #[must_use]
    pub fn new(params: &LanePdParams) -> Self {
        Self {
            guide: params.guide,
            lgg: Lgg::new(params.lgg_b, params.lgg_c, params.lgg_e),
            pd: Pd::new(params.kp, params.kd, params.derivative_filter_s),
            max_yaw_rate_rad_s: params.max_yaw_rate_rad_s,
        }
    }

    /// The yaw rate \[rad/s\] that brings the robot to the middle of its lane, positive to the left.
    ///
    /// `dt_s` \[s\] has passed since the last call. The error distance is e_d = -0.5 (d_R - d_L).
    pub fn steer(&mut self, estimate: LaneEstimate, dt_s: f64) -> f64 {
        let error_m = -estimate.cross_track_m();
        let error = match self.guide {
            Guide::Lgg => self.lgg.heading_rad(error_m) - estimate.heading_rad,
            Guide::Offset => error_m,
        };
        self.pd.control(error, dt_s).clamp(-self.max_yaw_rate_rad_s, self.max_yaw_rate_rad_s)
    }

    /// Forgets all earlier errors: the robot was put somewhere else.
    pub fn restart(&mut self) {
        self.pd.restart();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steer(params: LanePdParams, [left_m, right_m, heading_rad]: [f64; 3]) -> f64 {
        LanePd::new(&params).steer(LaneEstimate { left_m, right_m, heading_rad }, 0.025)
    }

    fn by_offset(kp: f64) -> LanePdParams {
        LanePdParams { guide: Guide::Offset, kp, ..LanePdParams::default() }
    }

    #[test]
    fn a_robot_right_of_the_middle_is_told_to_turn_left() {
        let right_of_it = [0.5, 0.25, 0.0];
        assert!(steer(LanePdParams::default(), right_of_it) > 0.0);
        assert!(steer(by_offset(0.7), right_of_it) > 0.0);
    }

    #[test]
    fn a_robot_turned_left_is_told_to_turn_right_unless_only_its_offset_counts() {
        let turned_left = [0.375, 0.375, 0.2];
        assert!((steer(LanePdParams::default(), turned_left) + 0.7 * 0.2).abs() < 1e-15);
        assert_eq!(steer(by_offset(0.7), turned_left), 0.0);
    }

    #[test]
    fn an_offset_of_a_tenth_of_a_metre_at_rest_asks_for_its_share_of_the_gain() {
        assert!((steer(by_offset(1.7), [0.475, 0.275, 0.0]) - 0.17).abs() < 1e-12);
        let reference_rad = 1.714_f64.to_radians();
        assert!((steer(LanePdParams::default(), [0.475, 0.275, 0.0]) - 0.7 * reference_rad).abs() < 1e-4);
    }

    #[test]
    fn no_error_asks_for_more_than_the_largest_yaw_rate() {
        for heading_rad in [-3.0, 3.0] {
            assert_eq!(steer(LanePdParams::default(), [0.3, 0.4, heading_rad]), -1.5 * f64::signum(heading_rad));
        }
    }

    #[test]
    fn mirrored_places_get_mirrored_yaw_rates() {
        for guide in [Guide::Lgg, Guide::Offset] {
            let mut controllers = [0; 2].map(|_| LanePd::new(&LanePdParams { guide, ..LanePdParams::default() }));
            for (left_m, right_m, heading_rad) in [(0.5, 0.2, 0.1), (0.4, 0.3, 0.05), (0.2, 0.6, -0.2)] {
                let place = LaneEstimate { left_m, right_m, heading_rad };
                let mirrored = LaneEstimate { left_m: right_m, right_m: left_m, heading_rad: -heading_rad };
                assert_eq!(controllers[0].steer(place, 0.1), -controllers[1].steer(mirrored, 0.1));
            }
        }
    }
}
