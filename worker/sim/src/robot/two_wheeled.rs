//! The symmetric robot with two driven wheels of Guyonneau et al. (2022), section 4.1.1.
//!
//! A wheel's speed follows its command with a first-order lag; the wheels do not slip.

use furrow_navigation::control::WheelSpeeds;

use super::Motion;
use crate::Pose;

furrow_navigation::parameters! {
    /// Parameters of [`TwoWheeled`].
    pub struct TwoWheeledParams {
        /// Length of the body. Program: 1.1.
        pub body_length_m: f64 = 1.1, "m", [0.05, 10.0];
        /// Width of the body. Program: 0.4.
        pub body_width_m: f64 = 0.4, "m", [0.05, 10.0];
        /// Radius of the wheels. Program: 0.22.
        pub wheel_radius_m: f64 = 0.22, "m", [0.01, 2.0];
        /// Width of the wheels. Program: 0.15.
        pub wheel_width_m: f64 = 0.15, "m", [0.005, 2.0];
        /// Distance between the wheels' middles. Program: 0.55.
        pub track_width_m: f64 = 0.55, "m", [0.05, 10.0];
        /// Time constant of a wheel's first-order lag. Program: 0.05.
        pub wheel_lag_s: f64 = 0.05, "s", [0.0, 10.0];
    }
}

/// The robot's motion.
#[derive(Debug, Clone)]
pub struct TwoWheeled {
    params: TwoWheeledParams,
    wheels: WheelSpeeds,
}

impl TwoWheeled {
    /// The robot at rest.
    #[must_use]
    pub const fn new(params: TwoWheeledParams) -> Self {
        Self { params, wheels: WheelSpeeds::STOP }
    }

    /// Its dimensions.
    #[must_use]
    pub const fn params(&self) -> &TwoWheeledParams {
        &self.params
    }

    /// What the wheels' encoders say.
    #[must_use]
    pub const fn wheels(&self) -> WheelSpeeds {
        self.wheels
    }

    /// Drives for `step_s` with a constant command; returns the new pose and how it got there.
    ///
    /// The lag is integrated exactly, the pose along an arc of the step's mean twist.
    pub fn drive(&mut self, world_from_robot: Pose, command: WheelSpeeds, step_s: f64) -> (Pose, Motion) {
        let (left_rad, left_after) = self.turned(self.wheels.left_rad_s, command.left_rad_s, step_s);
        let (right_rad, right_after) = self.turned(self.wheels.right_rad_s, command.right_rad_s, step_s);
        self.wheels = WheelSpeeds::new(left_after, right_after);
        let radius = self.params.wheel_radius_m;
        let distance_m = 0.5 * radius * (left_rad + right_rad);
        let turn_rad = radius * (right_rad - left_rad) / self.params.track_width_m;
        (world_from_robot.moved(distance_m, turn_rad), Motion { distance_m, turn_rad })
    }

    /// The angle that a wheel turns by within `step_s` \[rad\], and its speed afterwards [rad/s].
    fn turned(&self, speed: f64, command: f64, step_s: f64) -> (f64, f64) {
        let lag = self.params.wheel_lag_s;
        if lag <= 0.0 {
            return (command * step_s, command);
        }
        let left = libm::exp(-step_s / lag);
        (command * step_s + (speed - command) * lag * (1.0 - left), command + (speed - command) * left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(robot: &mut TwoWheeled, command: WheelSpeeds, steps: u32) -> Pose {
        let mut pose = Pose::default();
        for _ in 0..steps {
            pose = robot.drive(pose, command, 0.025).0;
        }
        pose
    }

    #[test]
    fn full_speed_is_0_137_m_per_s() {
        let mut robot = TwoWheeled::new(TwoWheeledParams::default());
        let command = WheelSpeeds::new(0.7 * 0.888_537, 0.7 * 0.888_537);
        let start = drive(&mut robot, command, 400);
        let pose = drive(&mut robot, command, 400);
        assert!((pose.x_m / 10.0 - 0.1368).abs() < 1e-4, "{pose:?}");
        assert!(start.x_m < pose.x_m && pose.y_m == 0.0);
    }

    #[test]
    fn a_faster_right_wheel_turns_counter_clockwise_at_the_rate_of_the_track_width() {
        let params = TwoWheeledParams { wheel_lag_s: 0.0, ..Default::default() };
        let mut robot = TwoWheeled::new(params);
        let pose = drive(&mut robot, WheelSpeeds::new(-0.14, 0.14), 40);
        assert!((pose.heading_rad - 2.0 * 0.14 * 0.22 / 0.55).abs() < 1e-12);
        assert!(libm::hypot(pose.x_m, pose.y_m) < 1e-12);
    }

    #[test]
    fn the_lag_does_not_depend_on_the_step() {
        let command = WheelSpeeds::new(1.0, 1.0);
        let mut coarse = TwoWheeled::new(TwoWheeledParams::default());
        let mut fine = coarse.clone();
        let one = coarse.drive(Pose::default(), command, 0.1).0;
        let mut many = Pose::default();
        for _ in 0..100 {
            many = fine.drive(many, command, 0.001).0;
        }
        assert!((one.x_m - many.x_m).abs() < 1e-12);
        // After two time constants the speed has reached 1 - exp(-2) of the command.
        assert!((fine.wheels().left_rad_s - (1.0 - (-2.0_f64).exp())).abs() < 1e-12);
    }
}
