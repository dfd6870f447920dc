//! Where the robot is in its lane: from the views of many scans and the robot's own motion.
//!
//! Each estimator is [predicted](LaneEstimator::predict) with what the wheels and the gyroscope say, and
//! [corrected](LaneEstimator::correct) with a scan, in turn.

pub mod ekf;
pub mod particle_filter;

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
        self.estimate = view.into();
    }

    fn estimate(&self) -> LaneEstimate {
        self.estimate
    }

    fn restart(&mut self, start: LaneEstimate) {
        self.estimate = start;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::localization::LocalizationSpec;
    use crate::parameters::Kinds;
    use crate::perception::lane::Side;

    const KINDS: [&str; 3] = ["view", "ekf", "particle-filter"];

    fn build(kind: &str) -> Box<dyn LaneEstimator> {
        let spec = LocalizationSpec::read_kind(kind, Default::default()).unwrap();
        spec.lane_estimator(0.75).unwrap()
    }

    fn number() -> impl Strategy<Value = f64> {
        let odd = prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e300), Just(1e5)];
        prop_oneof![4 => -2.0..2.0_f64, 1 => odd]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        #[test]
        fn any_motion_and_points_give_finite_estimates(
            steps in proptest::collection::vec(
                (number(), number(), number(), proptest::collection::vec((number(), number()), 0..30)), 1..6),
            [left_m, right_m, heading_rad] in [0.0..2.0_f64, 0.0..2.0_f64, -4.0..4.0_f64],
        ) {
            for kind in KINDS {
                let mut estimator = build(kind);
                let mut random = Stream::new(1, "localization");
                let side = |distance_m| Side { distance_m, valid: true };
                let view =
                    LaneView { left: side(left_m), right: side(right_m), heading_rad, heading_valid: true };
                for (linear_m_s, angular_rad_s, dt_s, points) in &steps {
                    estimator.predict(Twist { linear_m_s: *linear_m_s, angular_rad_s: *angular_rad_s }, *dt_s);
                    let (x_m, y_m) = points.iter().copied().unzip();
                    estimator.correct(&Points { x_m, y_m }, view, &mut random);
                    let LaneEstimate { left_m, right_m, heading_rad } = estimator.estimate();
                    prop_assert!(left_m.is_finite() && right_m.is_finite() && heading_rad.is_finite(), "{kind}");
                }
            }
        }
    }

    #[test]
    fn a_restart_is_believed() {
        for kind in KINDS {
            let mut estimator = build(kind);
            let start = LaneEstimate { left_m: 0.3, right_m: 0.45, heading_rad: 0.1 };
            estimator.restart(start);
            assert_eq!(estimator.estimate(), start);
        }
    }
}
