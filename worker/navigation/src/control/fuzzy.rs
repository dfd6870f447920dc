//! The fuzzy controller: where the robot is between two rows, and how it is turned, to wheel speeds.
//!
//! Guyonneau et al. (2022), section 3.3, table 1, figures 9 and 10. Minimum for "and", product implication,
//! maximum aggregation, centroid over 100 midpoints.

use std::f64::consts::PI;

use super::WheelSpeeds;
use crate::perception::line::Line;

crate::parameters! {
    /// Parameters of [`Fuzzy`].
    pub struct FuzzyParams {
        /// Wheel speed for an output of 1; full speed comes out at 0.8885 of it. Program: 0.7.
        pub max_velocity: f64 = 0.7, "rad/s", [0.01, 100.0];
    }
}

/// The controller.
#[derive(Debug, Clone)]
pub struct Fuzzy {
    params: FuzzyParams,
}

/// Speed terms of the output, in steps from full backward (-3) to full forward (3).
type Speed = i8;

/// Left wheel by angle (very left .. very right) and position (very left .. very right), table 1.
const LEFT_WHEEL: [[Speed; 5]; 5] =
    [[2, 2, 1, 3, 3], [1, 1, 2, 1, 2], [3, 3, 3, 2, 1], [2, 1, 1, -1, -1], [2, 1, -1, -2, -2]];

/// Right wheel, likewise.
const RIGHT_WHEEL: [[Speed; 5]; 5] =
    [[-2, -2, -1, 1, 2], [-1, -1, 1, 1, 2], [1, 2, 3, 3, 3], [2, 1, 2, 1, 1], [3, 3, 1, 2, 2]];

/// Where the terms of the angle peak, from very left to very right: 15 degrees apart.
const ANGLE_STEP_RAD: f64 = PI / 12.0;
/// Where the terms of the position peak: half apart.
const POSITION_STEP: f64 = 0.5;
/// Feet and peaks of the output's terms.
const SPEEDS: [f64; 4] = [0.0, 0.333, 0.666, 1.0];
/// Samples of the centroid.
const SAMPLES: u32 = 100;

impl Fuzzy {
    /// A controller with these parameters.
    #[must_use]
    pub const fn new(params: FuzzyParams) -> Self {
        Self { params }
    }

    /// Wheel speeds for an output of `left` and `right`, each in [-1, 1].
    #[must_use]
    pub fn scale(&self, left: f64, right: f64) -> WheelSpeeds {
        WheelSpeeds::new(left, right).scaled(self.params.max_velocity)
    }

    /// Wheel speeds to follow the middle between the rows `left` and `right`, forward or backward.
    ///
    /// The angle is that of the mean slope (the program's; eq. 18 prints the mean angle of all rows). Driving
    /// backward the angle's sign and the wheels' are turned round.
    #[must_use]
    pub fn follow(&self, left: Line, right: Line, forward: bool) -> WheelSpeeds {
        let position = position(left.intercept_m, right.intercept_m);
        let angle_rad = libm::atan(0.5 * (left.slope + right.slope));
        if forward {
            let (l, r) = output(position, angle_rad);
            self.scale(l, r)
        } else {
            let (l, r) = output(position, -angle_rad);
            self.scale(-l, -r)
        }
    }
}

/// Where the robot is between the rows, eq. 19: -1 at the left row, 0 in the middle, 1 at the right row.
///
/// The second case prints the ratio upside down; it is 1 - |right| / |left|.
#[must_use]
pub fn position(left_m: f64, right_m: f64) -> f64 {
    let (left, right) = (left_m.abs(), right_m.abs());
    if left < right {
        left / right - 1.0
    } else if left > 0.0 {
        1.0 - right / left
    } else {
        0.0
    }
}

/// The controller's outputs (left, right), each in [-1, 1].
///
/// `position` is [`position`]'s; `angle_rad` is the rows' angle in the robot's frame, positive when the robot
/// is turned clockwise.
#[must_use]
pub fn output(position: f64, angle_rad: f64) -> (f64, f64) {
    let angles = memberships(angle_rad / ANGLE_STEP_RAD);
    let positions = memberships(position / POSITION_STEP);
    (centroid(&LEFT_WHEEL, angles, positions), centroid(&RIGHT_WHEEL, angles, positions))
}

/// Degrees of the five terms that peak at -2, -1, 0, 1, 2; the outer ones stay at 1 beyond.
fn memberships(x: f64) -> [f64; 5] {
    let x = x.clamp(-2.0, 2.0);
    [-2.0, -1.0, 0.0, 1.0, 2.0].map(|peak: f64| (1.0 - (x - peak).abs()).max(0.0))
}

fn centroid(rules: &[[Speed; 5]; 5], angles: [f64; 5], positions: [f64; 5]) -> f64 {
    // Strongest degree of each speed term, from -3 to 3: maximum aggregation.
    let mut degrees = [0.0_f64; 7];
    for (row, angle) in rules.iter().zip(angles) {
        for (speed, position) in row.iter().zip(positions) {
            let degree = &mut degrees[(speed + 3) as usize];
            *degree = degree.max(angle.min(position));
        }
    }
    let (mut moment, mut area) = (0.0, 0.0);
    for i in 0..SAMPLES {
        let x = -1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(SAMPLES);
        let mu = (-3..=3).zip(degrees).map(|(speed, degree)| degree * speed_term(speed, x)).fold(0.0, f64::max);
        moment += mu * x;
        area += mu;
    }
    if area > 0.0 { moment / area } else { 0.0 }
}

/// Degree of `x` in the term of `speed`: a triangle, or for the fastest a ramp from the next slower one's peak.
fn speed_term(speed: Speed, x: f64) -> f64 {
    let (k, x) = (speed.unsigned_abs() as usize, if speed < 0 { -x } else { x });
    if k == 0 {
        return 0.0;
    }
    let rising = (x - SPEEDS[k - 1]) / (SPEEDS[k] - SPEEDS[k - 1]);
    let falling = if k == 3 { 1.0 } else { (SPEEDS[k + 1] - x) / (SPEEDS[k + 1] - SPEEDS[k]) };
    rising.min(falling).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// (position, angle \[rad\], left, right), computed by the fuzzy library that the paper used.
    const CHECKS: [(f64, f64, f64, f64); 16] = [
        (0.0, 0.0, 0.888537, 0.888537),
        (0.2, 0.0, 0.749183, 0.888537),
        (-0.1, 0.1, 0.581738, 0.660792),
        (0.6, 0.3, -0.373749, 0.373749),
        (-1.0, -0.4, 0.510889, -0.510889),
        (0.05, -0.2, 0.648146, 0.407448),
        (-1.0, -0.7, 0.666410, -0.666410),
        (-0.75, -0.05, 0.648242, 0.350745),
        (-0.5, 0.6, 0.332943, 0.888537),
        (-0.3, 0.02, 0.775986, 0.673018),
        (0.0, -0.2, 0.677206, 0.407448),
        (0.05, 0.6, -0.357945, 0.357945),
        (0.2, -0.7, 0.472091, -0.066589),
        (0.6, 0.1, 0.281030, 0.581738),
        (1.0, -0.05, 0.385258, 0.820183),
        (1.0, 0.3, -0.371254, 0.371254),
    ];

    #[test]
    fn outputs_agree_with_the_check_values() {
        for (position, angle, left, right) in CHECKS {
            let (l, r) = output(position, angle);
            assert!((l - left).abs() < 2e-6 && (r - right).abs() < 2e-6, "({position}, {angle}): {l}, {r}");
        }
    }

    #[test]
    fn full_speed_is_the_output_times_the_velocity() {
        let fuzzy = Fuzzy::new(FuzzyParams::default());
        let speeds = fuzzy.follow(Line::new(0.0, 0.5), Line::new(0.0, -0.5), true);
        assert!((speeds.left_rad_s - 0.7 * 0.888_537).abs() < 1e-5);
        assert_eq!(speeds.left_rad_s, speeds.right_rad_s);
        assert_eq!(fuzzy.follow(Line::new(0.0, 0.5), Line::new(0.0, -0.5), false), speeds.scaled(-1.0));
    }

    #[test]
    fn a_robot_near_the_right_row_turns_left_and_one_turned_clockwise_turns_back() {
        let fuzzy = Fuzzy::new(FuzzyParams::default());
        let near_right = fuzzy.follow(Line::new(0.0, 0.8), Line::new(0.0, -0.2), true);
        assert!(near_right.right_rad_s > near_right.left_rad_s);
        let clockwise = fuzzy.follow(Line::new(0.2, 0.5), Line::new(0.2, -0.5), true);
        assert!(clockwise.right_rad_s > clockwise.left_rad_s);
    }

    #[test]
    fn the_position_runs_from_minus_one_to_one() {
        assert_eq!(position(0.0, -1.0), -1.0);
        assert_eq!(position(0.5, -0.5), 0.0);
        assert_eq!(position(1.0, 0.0), 1.0);
        assert_eq!(position(0.0, 0.0), 0.0);
    }

    proptest! {
        #[test]
        fn a_mirrored_situation_swaps_the_wheels(position in -1.0..1.0_f64, angle in -1.5..1.5_f64) {
            let (left, right) = output(position, angle);
            let (mirrored_left, mirrored_right) = output(-position, -angle);
            prop_assert!((left - mirrored_right).abs() < 1e-9 && (right - mirrored_left).abs() < 1e-9);
            prop_assert!(left.abs() <= 1.0 && right.abs() <= 1.0);
        }
    }
}
