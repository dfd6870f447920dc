//! The skid-steered TerraSentia of Velasquez et al. (2022), section 3.1: four wheels, driven by a twist.
//!
//! Forward speed and yaw rate follow their commands with a first-order lag. Uneven ground turns and shifts the robot
//! as it drives over it, which the gyroscope feels and the wheels do not.

use furrow_navigation::control::Twist;

use super::Motion;
use crate::Pose;
use crate::field::lane::Ground;

furrow_navigation::parameters! {
    /// Parameters of [`SkidSteer`].
    pub struct SkidSteerParams {
        /// Length of the body. Paper: 0.54.
        pub body_length_m: f64 = 0.54, "m", [0.05, 10.0];
        /// Width of the body. Paper: 0.32.
        pub body_width_m: f64 = 0.32, "m", [0.05, 10.0];
        /// Time constant of the lag of speed and yaw rate. Ours.
        pub lag_s: f64 = 0.1, "s", [0.0, 10.0];
        /// Largest yaw rate to either side. Paper: 1.5.
        pub max_yaw_rate_rad_s: f64 = 1.5, "rad/s", [0.01, 10.0];
    }
}

/// The robot's motion.
#[derive(Debug, Clone)]
pub struct SkidSteer {
    params: SkidSteerParams,
    twist: Twist,
}

impl SkidSteer {
    /// The robot at rest.
    #[must_use]
    pub fn new(params: SkidSteerParams) -> Self {
        Self { params, twist: Twist::default() }
    }

    /// Its dimensions.
    #[must_use]
    pub const fn params(&self) -> &SkidSteerParams {
        &self.params
    }

    /// Stands still: it was put somewhere.
    pub fn stop(&mut self) {
        self.twist = Twist::default();
    }

    /// Drives for `step_s` with a constant command over `ground`; returns the new pose and how it got there.
    ///
    /// The lag is integrated exactly, the pose along an arc of the step's mean twist, then shifted across it.
    pub fn drive(&mut self, world_from_robot: Pose, command: Twist, ground: Ground, step_s: f64) -> (Pose, Motion) {
        let limit = self.params.max_yaw_rate_rad_s;
        let yaw_rate = command.angular_rad_s.clamp(-limit, limit);
        let (distance_m, linear_m_s) = self.lagged(self.twist.linear_m_s, command.linear_m_s, step_s);
        let (steered_rad, angular_rad_s) = self.lagged(self.twist.angular_rad_s, yaw_rate, step_s);
        self.twist = Twist { linear_m_s, angular_rad_s };
        let turn_rad = steered_rad + ground.yaw_rad_per_m * distance_m;
        let pose = world_from_robot.moved(distance_m, turn_rad);
        let slip_m = ground.slip_m_per_m * distance_m;
        let (sin, cos) = libm::sincos(pose.heading_rad);
        let shifted = Pose { x_m: pose.x_m - slip_m * sin, y_m: pose.y_m + slip_m * cos, ..pose };
        (shifted, Motion { distance_m, turn_rad })
    }

    /// The integral of a value that follows `command` over `step_s`, and the value afterwards.
    fn lagged(&self, value: f64, command: f64, step_s: f64) -> (f64, f64) {
        let lag = self.params.lag_s;
        if lag <= 0.0 {
            return (command * step_s, command);
        }
        let left = libm::exp(-step_s / lag);
        (command * step_s + (value - command) * lag * (1.0 - left), command + (value - command) * left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AHEAD: Twist = Twist { linear_m_s: 0.7, angular_rad_s: 0.0 };

    fn drive(command: Twist, ground: Ground, steps: u32) -> (Pose, Motion) {
        let mut robot = SkidSteer::new(SkidSteerParams::default());
        let start = (Pose::default(), Motion::default());
        (0..steps).fold(start, |(pose, _), _| robot.drive(pose, command, ground, 0.025))
    }

    #[test]
    fn it_lags_its_command_by_a_tenth_of_a_second() {
        let (pose, _) = drive(AHEAD, Ground::default(), 400);
        assert!((pose.x_m - 0.7 * (10.0 - 0.1)).abs() < 1e-6 && pose.y_m == 0.0);
    }

    #[test]
    fn no_command_turns_it_faster_than_it_can() {
        let (_, motion) = drive(Twist { linear_m_s: 0.0, angular_rad_s: -9.0 }, Ground::default(), 400);
        assert!((motion.turn_rad + 1.5 * 0.025).abs() < 1e-9);
    }

    #[test]
    fn ground_turns_it_by_the_way_it_drives_and_shifts_it_to_the_left() {
        let ground = Ground { yaw_rad_per_m: 0.1, slip_m_per_m: 0.0, ..Ground::default() };
        let (pose, motion) = drive(AHEAD, ground, 400);
        assert!((pose.heading_rad - 0.1 * 0.7 * 9.9).abs() < 1e-6);
        assert!((motion.turn_rad - 0.1 * 0.7 * 0.025).abs() < 1e-9, "the gyroscope feels it");
        let (pose, _) = drive(AHEAD, Ground { slip_m_per_m: 0.05, ..Ground::default() }, 400);
        assert!((pose.y_m - 0.05 * 0.7 * 9.9).abs() < 1e-6);
        assert_eq!(drive(Twist::default(), ground, 400).0, Pose::default(), "standing, nothing moves it");
    }
}
