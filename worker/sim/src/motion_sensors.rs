//! Wheel encoders and a gyroscope: what a robot in a lane knows of its own motion.
//!
//! Velasquez et al. (2022), section 3.3: v_x from the encoders, omega from the gyroscope. Side-slip shows in neither.

use furrow_navigation::control::Twist;
use furrow_navigation::random::Stream;

use crate::lidar::OnePlanarLidarParams;
use crate::robot::Motion;

/// Both sensors, and what they measured since they were last asked.
#[derive(Debug, Clone)]
pub struct MotionSensors {
    speed_noise: f64,
    yaw_rate_noise_rad_s: f64,
    yaw_rate_bias_rad_s: f64,
    driven_m: f64,
    turned_rad: f64,
    time_s: f64,
}

impl MotionSensors {
    /// Sensors that have measured nothing yet.
    #[must_use]
    pub const fn new(params: &OnePlanarLidarParams) -> Self {
        Self {
            speed_noise: params.speed_noise,
            yaw_rate_noise_rad_s: params.yaw_rate_noise_rad_s,
            yaw_rate_bias_rad_s: params.yaw_rate_bias_rad_s,
            driven_m: 0.0,
            turned_rad: 0.0,
            time_s: 0.0,
        }
    }

    /// Measures one step, each sensor with its own noise.
    pub fn measure(&mut self, motion: Motion, step_s: f64, random: &mut Stream) {
        self.driven_m += motion.distance_m * (1.0 + self.speed_noise * random.normal());
        let rate_error = self.yaw_rate_bias_rad_s + self.yaw_rate_noise_rad_s * random.normal();
        self.turned_rad += motion.turn_rad + step_s * rate_error;
        self.time_s += step_s;
    }

    /// The mean twist since this was last asked, and the time since then \[s\].
    pub fn take(&mut self) -> (Twist, f64) {
        let (time_s, driven_m, turned_rad) = (self.time_s, self.driven_m, self.turned_rad);
        self.forget();
        if time_s <= 0.0 {
            return (Twist::default(), 0.0);
        }
        (Twist { linear_m_s: driven_m / time_s, angular_rad_s: turned_rad / time_s }, time_s)
    }

    /// Forgets what was measured: the robot was put somewhere.
    pub fn forget(&mut self) {
        (self.driven_m, self.turned_rad, self.time_s) = (0.0, 0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_two_percent_of_the_speed_and_a_hundredth_of_a_radian_per_second() {
        let mut random = Stream::new(1, "motion");
        let mut sensors = MotionSensors::new(&OnePlanarLidarParams::default());
        let (mut speed2, mut rate2) = (0.0, 0.0);
        for _ in 0..4_000 {
            sensors.measure(Motion { distance_m: 0.0175, turn_rad: 0.005 }, 0.025, &mut random);
            let (twist, time_s) = sensors.take();
            assert_eq!(time_s, 0.025);
            speed2 += (twist.linear_m_s - 0.7) * (twist.linear_m_s - 0.7) / 4_000.0;
            rate2 += (twist.angular_rad_s - 0.2) * (twist.angular_rad_s - 0.2) / 4_000.0;
        }
        assert!((f64::sqrt(speed2) - 0.014).abs() < 0.001 && (f64::sqrt(rate2) - 0.01).abs() < 0.0005);
    }

    #[test]
    fn between_slow_scans_the_twist_is_the_mean() {
        let params = OnePlanarLidarParams { speed_noise: 0.0, yaw_rate_noise_rad_s: 0.0, ..Default::default() };
        let mut sensors = MotionSensors::new(&params);
        let mut random = Stream::new(1, "motion");
        for turn_rad in [0.0, 0.01] {
            sensors.measure(Motion { distance_m: 0.0175, turn_rad }, 0.025, &mut random);
        }
        let (twist, time_s) = sensors.take();
        assert!((twist.angular_rad_s - 0.2).abs() < 1e-12 && time_s == 0.05);
        assert_eq!(sensors.take(), (Twist::default(), 0.0));
    }
}
