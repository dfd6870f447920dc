//! Input-output linearization: a point B ahead of the robot moves as if it were free.
//!
//! Vintu (2018), sections 2.5.2 and 3.5.1, equations 2.4 to 2.8; equation 2.6 with T^-1 = [[cos, sin], [-sin / b, cos / b]].
//! The trajectory is the mid line at the speed in rows, in the line's frame: y_d is the foot point of B on it, so of the
//! Cartesian error only the part across the line is left, and of the gains k1 = k2 only the one across acts.
//!
//! Ours: a command beyond the robot's yaw rate or speed is slowed down as a whole, so that B keeps its direction; and
//! the robot never drives backward.

use super::{MidLine, MidLineControl};
use crate::control::Twist;

crate::parameters! {
    /// Parameters of [`IoLinearization`].
    pub struct IoLinearizationParams {
        /// How far ahead of the robot's centre the point B is. Ours.
        pub b_m: f64 = 0.4, "m", [0.01, 10.0];
        /// Gain k1 = k2: the error's rate of decay. Ours.
        pub k_per_s: f64 = 1.5, "1/s", [0.0, 100.0];
        /// Speed along the line, and the largest forward speed. Ours.
        pub speed_m_s: f64 = 0.8, "m/s", [0.0, 10.0];
        /// Largest yaw rate to either side. Ours.
        pub max_yaw_rate_rad_s: f64 = 0.8, "rad/s", [0.01, 10.0];
    }
}

/// The controller.
#[derive(Debug, Clone)]
pub struct IoLinearization {
    params: IoLinearizationParams,
}

impl IoLinearization {
    /// A controller with these parameters.
    #[must_use]
    pub const fn new(params: IoLinearizationParams) -> Self {
        Self { params }
    }

    /// The command within the robot's limits, in the direction of `wanted` for B.
    fn limited(&self, wanted: Twist) -> Twist {
        let IoLinearizationParams { speed_m_s, max_yaw_rate_rad_s, .. } = self.params;
        let share = |value: f64, limit: f64| if value > limit { limit / value } else { 1.0 };
        let slower = share(wanted.angular_rad_s.abs(), max_yaw_rate_rad_s).min(share(wanted.linear_m_s, speed_m_s));
        Twist {
            linear_m_s: (slower * wanted.linear_m_s).clamp(0.0, speed_m_s),
            angular_rad_s: (slower * wanted.angular_rad_s).clamp(-max_yaw_rate_rad_s, max_yaw_rate_rad_s),
        }
    }
}

impl MidLineControl for IoLinearization {
    fn steer(&mut self, line: MidLine, _dt_s: f64) -> Twist {
        if !line.is_plausible() {
            return Twist::default();
        }
        let IoLinearizationParams { b_m, k_per_s, speed_m_s, .. } = self.params;
        let error = [0.0, line.offset_m([b_m, 0.0])];
        let u = velocity([speed_m_s, 0.0], error, k_per_s);
        self.limited(input_transformation(u, -line.angle_rad(), b_m))
    }

    fn restart(&mut self) {}
}

/// Velocity for B \[m/s\], equation 2.8: that of the trajectory and the gain times what B lacks to it.
fn velocity(trajectory: [f64; 2], error: [f64; 2], k_per_s: f64) -> [f64; 2] {
    [0, 1].map(|i| trajectory[i] + k_per_s * error[i])
}

/// T^-1 u, equation 2.6: what moves a point `b_m` ahead of a robot with the heading `theta_rad` at the velocity `u`.
fn input_transformation([u1, u2]: [f64; 2], theta_rad: f64, b_m: f64) -> Twist {
    let (sin, cos) = libm::sincos(theta_rad);
    Twist { linear_m_s: cos * u1 + sin * u2, angular_rad_s: (cos * u2 - sin * u1) / b_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn t_undoes_the_input_transformation(u in [-2.0..2.0, -2.0..2.0], theta in -7.0..7.0_f64, b in 0.1..2.0) {
            let Twist { linear_m_s: v, angular_rad_s: omega } = input_transformation(u, theta, b);
            // T of equation 2.5.
            let (sin, cos) = libm::sincos(theta);
            let moved = [cos * v - b * sin * omega, sin * v + b * cos * omega];
            prop_assert!((moved[0] - u[0]).abs() < 1e-12 && (moved[1] - u[1]).abs() < 1e-12);
        }

        #[test]
        fn the_point_keeps_its_direction_within_the_limits(y_m in -2.0..2.0, angle in -1.2..1.2_f64) {
            let (sin, cos) = libm::sincos(angle);
            let line = MidLine { point: [0.0, y_m], direction: [cos, sin] };
            let wanted = input_transformation([0.8, 1.5 * line.offset_m([0.4, 0.0])], -angle, 0.4);
            let limited = IoLinearization::new(IoLinearizationParams::default()).steer(line, 0.1);
            prop_assert!(limited.angular_rad_s.abs() <= 0.8 && (0.0..=0.8).contains(&limited.linear_m_s));
            if wanted.linear_m_s > 0.0 {
                let across = limited.linear_m_s * wanted.angular_rad_s - limited.angular_rad_s * wanted.linear_m_s;
                prop_assert!(across.abs() < 1e-12);
            }
        }
    }

    /// B's Cartesian error after `seconds` of tracking a point that moves at 0.5 m/s along x, starting from `error`.
    fn tracked(error: [f64; 2], k_per_s: f64, seconds: f64) -> [f64; 2] {
        let (b_m, dt_s) = (0.4, 1e-4);
        let mut robot = Pose { heading_rad: 0.6, ..Pose::default() };
        let start = robot.world(b_m, 0.0);
        let trajectory = |time: f64| [start[0] + error[0] + 0.5 * time, start[1] + error[1]];
        let off = |robot: Pose, time: f64| {
            let (at, wanted) = (robot.world(b_m, 0.0), trajectory(time));
            [wanted[0] - at[0], wanted[1] - at[1]]
        };
        let steps = (seconds / dt_s).round() as u32;
        for i in 0..steps {
            let u = velocity([0.5, 0.0], off(robot, f64::from(i) * dt_s), k_per_s);
            let twist = input_transformation(u, robot.heading_rad, b_m);
            robot = robot.moved(twist.linear_m_s * dt_s, twist.angular_rad_s * dt_s);
        }
        off(robot, seconds)
    }

    #[test]
    fn the_cartesian_error_decays_exponentially_at_the_rate_of_the_gain() {
        for k_per_s in [0.5, 1.5, 3.0] {
            for seconds in [0.5, 1.0, 2.0] {
                let left = tracked([0.3, -0.2], k_per_s, seconds);
                let share = libm::exp(-k_per_s * seconds);
                assert!((left[0] - 0.3 * share).abs() < 2e-4, "{k_per_s} {seconds}: {left:?}");
                assert!((left[1] + 0.2 * share).abs() < 2e-4, "{k_per_s} {seconds}: {left:?}");
            }
        }
    }

    #[test]
    fn on_the_line_the_robot_drives_straight_on_at_its_speed() {
        let on_it = MidLine { point: [-3.0, 0.0], direction: [1.0, 0.0] };
        let twist = IoLinearization::new(IoLinearizationParams::default()).steer(on_it, 0.1);
        assert_eq!(twist, Twist { linear_m_s: 0.8, angular_rad_s: 0.0 });
    }
}
