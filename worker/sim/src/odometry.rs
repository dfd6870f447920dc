//! Odometry with the errors of [`OdometryNoise`]: a distance D' around D, a heading change T' around T and a drift C'
//! across (Vintu 2018, eqs. 3.2, 3.3). What is left of a chunk is carried on.

pub use furrow_navigation::odometry::OdometryNoise;

use furrow_navigation::odometry::CHUNK;
use furrow_navigation::random::Stream;

use crate::Pose;
use crate::robot::Motion;

/// Where the robot thinks it is, by its wheels alone.
#[derive(Debug, Clone)]
pub struct Odometry {
    noise: OdometryNoise,
    pose: Pose,
    driven_m: f64,
    turned_rad: f64,
}

impl Odometry {
    /// Odometry that starts at the origin of its own frame, heading along x.
    #[must_use]
    pub fn new(noise: OdometryNoise) -> Self {
        Self { noise, pose: Pose::default(), driven_m: 0.0, turned_rad: 0.0 }
    }

    /// The pose in the odometry's frame, up to the last whole chunk plus what was driven since.
    #[must_use]
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// Takes in what the robot did in a step.
    pub fn advance(&mut self, motion: Motion, random: &mut Stream) {
        self.pose = self.pose.moved(motion.distance_m, motion.turn_rad);
        self.driven_m += motion.distance_m.abs();
        self.turned_rad += motion.turn_rad.abs();
        while self.driven_m >= CHUNK {
            self.driven_m -= CHUNK;
            let OdometryNoise { distance_sd, drift_sd, heading_sd, .. } = self.noise;
            self.disturb([distance_sd, drift_sd, heading_sd], random);
        }
        while self.turned_rad >= CHUNK {
            self.turned_rad -= CHUNK;
            self.disturb([0.0, self.noise.drift_turn_sd, self.noise.heading_turn_sd], random);
        }
    }

    /// Adds one chunk's errors: along, across and of the heading; coefficients are per chunk length.
    fn disturb(&mut self, coefficients: [f64; 3], random: &mut Stream) {
        let [along, across, turn] = coefficients.map(|sd| CHUNK * sd * random.normal());
        let (sin, cos) = libm::sincos(self.pose.heading_rad);
        self.pose.x_m += along * cos - across * sin;
        self.pose.y_m += along * sin + across * cos;
        self.pose.heading_rad += turn;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lidar::TwoPlanarLidarsParams;

    /// Standard deviation of the heading [deg] after `steps` of the same motion.
    fn heading_sd(motion: Motion, steps: u32) -> f64 {
        let mut sum = 0.0;
        for seed in 0..2_000 {
            let mut random = Stream::new(seed, "odometry");
            let mut odometry = Odometry::new(TwoPlanarLidarsParams::default().odometry_noise());
            for _ in 0..steps {
                odometry.advance(motion, &mut random);
            }
            let error = odometry.pose().heading_rad - motion.turn_rad * f64::from(steps);
            sum += error * error / 2_000.0;
        }
        f64::sqrt(sum).to_degrees()
    }

    #[test]
    fn the_heading_is_off_by_two_degrees_after_thirty_metres_whatever_the_step() {
        for (step, steps) in [(0.01, 3_000), (0.05, 600)] {
            let sd = heading_sd(Motion { distance_m: step, turn_rad: 0.0 }, steps);
            assert!((sd - 1.98).abs() < 0.15, "{sd}");
        }
    }

    #[test]
    fn the_heading_is_off_by_3_9_degrees_after_a_blind_turn() {
        // 180, 45 and 45 degrees turned, and D + D sqrt(2) = 3.6 m driven for D = 1.5 m.
        let turn = heading_sd(Motion { distance_m: 0.0, turn_rad: 0.01 }, 471);
        let drive = heading_sd(Motion { distance_m: 0.01, turn_rad: 0.0 }, 362);
        let both = libm::hypot(turn, drive);
        assert!((both - 3.98).abs() < 0.25, "{both}");
    }
}
