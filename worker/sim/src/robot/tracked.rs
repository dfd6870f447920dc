//! A tracked mower, the robot of Vintu (2018), section 3.1.
//!
//! It moves as the skid-steered robot does. Tracks that turn slip: the robot turns less than it is told to, and on a slope across
//! it slides downhill as it drives (ours; the thesis simulates neither). Its odometry, which an inertial sensor is part of, sees the true turn, not the slide.

use furrow_navigation::control::Twist;

use super::{Motion, SkidSteer, SkidSteerParams};
use crate::Pose;
use crate::field::lane::Ground;

furrow_navigation::parameters! {
    /// Parameters of [`Tracked`]; those of a Jackal are 0.508 m, 0.430 m.
    pub struct TrackedParams {
        /// Length of the body. Paper: 1.15.
        pub body_length_m: f64 = 1.15, "m", [0.05, 10.0];
        /// Width of the body. Paper: 0.90.
        pub body_width_m: f64 = 0.9, "m", [0.05, 10.0];
        /// Time constant of the lag of speed and yaw rate. Ours.
        pub lag_s: f64 = 0.15, "s", [0.0, 10.0];
        /// Largest yaw rate to either side. Ours.
        pub max_yaw_rate_rad_s: f64 = 0.8, "rad/s", [0.01, 10.0];
        /// Share of a commanded turn that is lost by slipping. Ours.
        pub turn_slip: f64 = 0.1, "1", [0.0, 0.9];
        /// Slide across per way driven and slope across. Ours.
        pub side_slip: f64 = 0.1, "m/m", [0.0, 1.0];
    }
}

/// The robot's motion.
#[derive(Debug, Clone)]
pub struct Tracked {
    params: TrackedParams,
    body: SkidSteer,
}

impl Tracked {
    /// The robot at rest.
    #[must_use]
    pub fn new(params: TrackedParams) -> Self {
        let body = SkidSteer::new(SkidSteerParams {
            body_length_m: params.body_length_m,
            body_width_m: params.body_width_m,
            lag_s: params.lag_s,
            max_yaw_rate_rad_s: params.max_yaw_rate_rad_s,
        });
        Self { params, body }
    }

    /// Its dimensions.
    #[must_use]
    pub const fn params(&self) -> &TrackedParams {
        &self.params
    }

    /// Drives for `step_s` with a constant command; `roll_rad` is the ground's, positive where its left side is up.
    pub fn drive(&mut self, world_from_robot: Pose, command: Twist, roll_rad: f64, step_s: f64) -> (Pose, Motion) {
        let limit = self.params.max_yaw_rate_rad_s;
        let angular_rad_s = command.angular_rad_s.clamp(-limit, limit) * (1.0 - self.params.turn_slip);
        // What slides to the left is negative where the left side is up.
        let slip_m_per_m = -self.params.side_slip * libm::sin(roll_rad);
        let ground = Ground { slip_m_per_m, ..Ground::default() };
        self.body.drive(world_from_robot, Twist { angular_rad_s, ..command }, ground, step_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(command: Twist, roll_rad: f64) -> Pose {
        let mut robot = Tracked::new(TrackedParams::default());
        (0..400).fold(Pose::default(), |pose, _| robot.drive(pose, command, roll_rad, 0.025).0)
    }

    #[test]
    fn it_slides_downhill_and_only_while_it_drives() {
        let ahead = Twist { linear_m_s: 0.8, angular_rad_s: 0.0 };
        let left_side_up = drive(ahead, 0.1);
        assert!((left_side_up.y_m + 0.1 * libm::sin(0.1) * left_side_up.x_m).abs() < 1e-9);
        assert_eq!(drive(Twist::default(), 0.1), Pose::default());
    }

    #[test]
    fn it_turns_less_than_it_is_told_to() {
        let turned = drive(Twist { linear_m_s: 0.0, angular_rad_s: 0.5 }, 0.0);
        assert!((turned.heading_rad - 0.9 * 0.5 * (10.0 - 0.15)).abs() < 1e-6);
        let turned = drive(Twist { linear_m_s: 0.0, angular_rad_s: 5.0 }, 0.0);
        assert!((turned.heading_rad - 0.9 * 0.8 * (10.0 - 0.15)).abs() < 1e-6);
    }
}
