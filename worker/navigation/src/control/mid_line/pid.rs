//! Two PID loops, one on the distance to the mid line and one on the angle to it; the yaw rate is their sum.
//!
//! Vintu (2018), sections 2.5.1 and 3.5.1, equation 2.2. Both errors are the line's place seen from the robot, so a line
//! to the left or turned to the left asks for a turn to the left.

use super::{MidLine, MidLineControl};
use crate::control::Twist;
use crate::control::lane::pd::Pd;

crate::parameters! {
    /// Parameters of [`MidLinePid`].
    pub struct MidLinePidParams {
        /// Yaw rate per distance to the line. Ours.
        pub lateral_kp: f64 = 1.5, "rad/s/m", [0.0, 100.0];
        /// Yaw rate per distance summed over time. Ours.
        pub lateral_ki: f64 = 0.1, "rad/s^2/m", [0.0, 100.0];
        /// Yaw rate per rate of the distance. Ours.
        pub lateral_kd: f64 = 0.3, "rad/m", [0.0, 100.0];
        /// Yaw rate per angle to the line. Ours.
        pub angle_kp: f64 = 2.0, "1/s", [0.0, 100.0];
        /// Yaw rate per angle summed over time. Ours.
        pub angle_ki: f64 = 0.0, "1/s^2", [0.0, 100.0];
        /// Yaw rate per rate of the angle. Ours.
        pub angle_kd: f64 = 0.2, "1", [0.0, 100.0];
        /// Largest yaw rate that a loop's sum over time may ask for. Ours.
        pub max_integral_rad_s: f64 = 0.1, "rad/s", [0.0, 10.0];
        /// Time constant of the filter on the errors' rates. Ours.
        pub derivative_filter_s: f64 = 0.1, "s", [0.0, 10.0];
        /// Forward speed. Ours.
        pub speed_m_s: f64 = 0.8, "m/s", [0.0, 10.0];
        /// Largest yaw rate to either side. Ours.
        pub max_yaw_rate_rad_s: f64 = 0.8, "rad/s", [0.01, 10.0];
    }
}

/// The controller.
#[derive(Debug, Clone)]
pub struct MidLinePid {
    lateral: Pid,
    angle: Pid,
    speed_m_s: f64,
    max_yaw_rate_rad_s: f64,
}

impl MidLinePid {
    /// A controller that has seen no line yet.
    #[must_use]
    pub fn new(params: &MidLinePidParams) -> Self {
        let pid = |kp, ki, kd| Pid {
            pd: Pd::new(kp, kd, params.derivative_filter_s),
            ki,
            max_integral: params.max_integral_rad_s,
            integral: 0.0,
        };
        Self {
            lateral: pid(params.lateral_kp, params.lateral_ki, params.lateral_kd),
            angle: pid(params.angle_kp, params.angle_ki, params.angle_kd),
            speed_m_s: params.speed_m_s,
            max_yaw_rate_rad_s: params.max_yaw_rate_rad_s,
        }
    }
}

impl MidLineControl for MidLinePid {
    fn steer(&mut self, line: MidLine, dt_s: f64) -> Twist {
        if !line.is_plausible() {
            return Twist::default();
        }
        let yaw_rate =
            self.lateral.control(line.offset_m([0.0, 0.0]), dt_s) + self.angle.control(line.angle_rad(), dt_s);
        let angular_rad_s = yaw_rate.clamp(-self.max_yaw_rate_rad_s, self.max_yaw_rate_rad_s);
        Twist { linear_m_s: self.speed_m_s, angular_rad_s }
    }

    fn restart(&mut self) {
        self.lateral.restart();
        self.angle.restart();
    }
}

/// One loop.
#[derive(Debug, Clone)]
struct Pid {
    pd: Pd,
    ki: f64,
    max_integral: f64,
    /// ki times the error's integral, clamped.
    integral: f64,
}

impl Pid {
    fn control(&mut self, error: f64, dt_s: f64) -> f64 {
        let grown = self.integral + self.ki * error * dt_s;
        if grown.is_finite() && dt_s > 0.0 {
            self.integral = grown.clamp(-self.max_integral, self.max_integral);
        }
        self.pd.control(error, dt_s) + self.integral
    }

    const fn restart(&mut self) {
        self.pd.restart();
        self.integral = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(y_m: f64, angle_rad: f64) -> MidLine {
        let (sin, cos) = libm::sincos(angle_rad);
        MidLine { point: [0.0, y_m], direction: [cos, sin] }
    }

    fn first(y_m: f64, angle_rad: f64) -> f64 {
        MidLinePid::new(&MidLinePidParams::default()).steer(line(y_m, angle_rad), 0.1).angular_rad_s
    }

    #[test]
    fn both_errors_ask_for_their_share_of_the_gains() {
        // The first error has no rate; its integral is one step old.
        assert!((first(0.1, 0.0) - (1.5 * 0.1 + 0.1 * 0.1 * 0.1)).abs() < 1e-12);
        assert!((first(0.0, 0.1) - 2.0 * 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_integral_stops_at_its_limit_and_is_gone_after_a_restart() {
        let mut pid = MidLinePid::new(&MidLinePidParams::default());
        let held = (0..1000).map(|_| pid.steer(line(0.2, 0.0), 0.1).angular_rad_s).last().unwrap();
        assert!((held - (1.5 * 0.2 + 0.1)).abs() < 1e-9, "{held}");
        pid.restart();
        assert_eq!(pid.steer(line(0.2, 0.0), 0.1).angular_rad_s, first(0.2, 0.0));
    }

    #[test]
    fn a_line_that_comes_nearer_damps_the_turn() {
        let mut pid = MidLinePid::new(&MidLinePidParams { lateral_ki: 0.0, ..MidLinePidParams::default() });
        pid.steer(line(0.3, 0.0), 0.1);
        // Backward Euler: -0.02 m in 0.1 s, filtered over 0.1 s, is a rate of -0.1 m/s.
        let yaw_rate = pid.steer(line(0.28, 0.0), 0.1).angular_rad_s;
        assert!((yaw_rate - (1.5 * 0.28 - 0.3 * 0.1)).abs() < 1e-12, "{yaw_rate}");
    }
}
