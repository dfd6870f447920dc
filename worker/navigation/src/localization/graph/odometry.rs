//! How far the odometry's reading of a way may be off, by [`OdometryNoise`]: the variances of its chunks of 0.1 m or
//! 0.1 rad, whichever is full first, add up.

use nalgebra::Matrix3;

use crate::Pose;
use crate::odometry::{CHUNK, OdometryNoise};

/// What no odometry beats, on any way at all: 1 mm and 1 mrad. Keeps the information of short ways finite.
const LEAST_VARIANCE: f64 = 1e-6;

/// The way since the last node, by the odometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Travel {
    /// Where the robot is now, seen from the node.
    pub node_from_robot: Pose,
    /// Covariance of x, y and heading in the node's frame.
    covariance: Matrix3<f64>,
}

impl Default for Travel {
    fn default() -> Self {
        Self { node_from_robot: Pose::default(), covariance: Matrix3::zeros() }
    }
}

impl Travel {
    /// Goes on by `step`, seen from where the robot was.
    #[must_use]
    pub fn then(&self, step: Pose, noise: &OdometryNoise) -> Self {
        let node_from_robot = self.node_from_robot.compose(step);
        let (dx, dy) = (node_from_robot.x_m - self.node_from_robot.x_m, node_from_robot.y_m - self.node_from_robot.y_m);
        let carried = carry(self.covariance, dx, dy);
        let own = turned(covariance(noise, step), self.node_from_robot.heading_rad + 0.5 * step.heading_rad);
        Self { node_from_robot, covariance: carried + own }
    }

    /// Covariance of the robot's pose for that of its node, both in the map's frame.
    #[must_use]
    pub fn covariance_after(&self, node: Pose, covariance: Matrix3<f64>) -> Matrix3<f64> {
        let [x_m, y_m] = node.world(self.node_from_robot.x_m, self.node_from_robot.y_m);
        carry(covariance, x_m - node.x_m, y_m - node.y_m) + turned(self.covariance, node.heading_rad)
    }

    /// Information of the relative edge, whose error is seen from the way's end; none if it is not finite.
    #[must_use]
    pub fn information(&self) -> Option<Matrix3<f64>> {
        let covariance = turned(self.covariance, -self.node_from_robot.heading_rad);
        let inverse = (covariance + Matrix3::from_diagonal_element(LEAST_VARIANCE)).cholesky()?.inverse();
        inverse.iter().all(|entry| entry.is_finite()).then_some(inverse)
    }
}

/// Covariance of a step on which distance and turn are even, in the frame half way along it.
fn covariance(noise: &OdometryNoise, step: Pose) -> Matrix3<f64> {
    let distance = (step.x_m * step.x_m + step.y_m * step.y_m).sqrt();
    let turn = step.heading_rad.abs();
    let longer = distance.max(turn);
    if longer <= 0.0 {
        return Matrix3::zeros();
    }
    // n = longer / CHUNK chunks, each of 1 / n of the way.
    let variance = |per_m: f64, per_rad: f64| {
        let (by_distance, by_turn) = (per_m * distance, per_rad * turn);
        CHUNK / longer * (by_distance * by_distance + by_turn * by_turn)
    };
    Matrix3::from_diagonal(&nalgebra::Vector3::new(
        variance(noise.distance_sd, 0.0),
        variance(noise.drift_sd, noise.drift_turn_sd),
        variance(noise.heading_sd, noise.heading_turn_sd),
    ))
}

/// The covariance (`dx`, `dy`) further on: an error of the heading moves the place across the way.
fn carry(covariance: Matrix3<f64>, dx: f64, dy: f64) -> Matrix3<f64> {
    let jacobian = Matrix3::new(1.0, 0.0, -dy, 0.0, 1.0, dx, 0.0, 0.0, 1.0);
    jacobian * covariance * jacobian.transpose()
}

/// A covariance of a frame in the frame in which that one has the heading `angle_rad`.
fn turned(covariance: Matrix3<f64>, angle_rad: f64) -> Matrix3<f64> {
    let (sin, cos) = libm::sincos(angle_rad);
    let rotation = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    rotation * covariance * rotation.transpose()
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::random::Stream;

    pub const DEFAULT: OdometryNoise = OdometryNoise {
        distance_sd: 0.05,
        drift_sd: 0.02,
        drift_turn_sd: 0.06,
        heading_sd: 0.02,
        heading_turn_sd: 0.10,
    };

    /// What the odometry reports of a chunk: of `distance_m` and `turn_rad`, none of them beyond a chunk.
    pub fn reported(distance_m: f64, turn_rad: f64, random: &mut Stream) -> Pose {
        let mut normal = |per_m: f64, per_rad: f64| {
            let (by_distance, by_turn) = (per_m * distance_m, per_rad * turn_rad);
            (by_distance * by_distance + by_turn * by_turn).sqrt() * random.normal()
        };
        let distance = distance_m + normal(0.05, 0.0);
        let slip = normal(0.02, 0.06);
        let turn = turn_rad + normal(0.02, 0.10);
        let half = 0.5 * turn;
        let (sin, cos) = libm::sincos(half);
        Pose { x_m: distance * cos - slip * sin, y_m: distance * sin + slip * cos, heading_rad: turn }
    }

    fn after(steps: u32, step: Pose) -> Travel {
        (0..steps).fold(Travel::default(), |travel, _| travel.then(step, &DEFAULT))
    }

    #[test]
    fn an_edge_of_a_quarter_metre_has_the_variance_of_two_and_a_half_chunks() {
        for steps in [1, 2, 5, 100] {
            let travel = after(steps, Pose { x_m: 0.25 / f64::from(steps), ..Pose::default() });
            let chunks = 2.5;
            for (i, per_m) in [(0, 0.05), (2, 0.02)] {
                let expected = chunks * (per_m * CHUNK) * (per_m * CHUNK);
                assert!((travel.covariance[(i, i)] - expected).abs() < 1e-15, "{steps}: {travel:?}");
            }
        }
    }

    #[test]
    fn the_heading_is_unsure_by_two_degrees_after_thirty_metres_and_by_four_after_a_blind_turn() {
        let heading_deg = |travel: Travel| travel.covariance[(2, 2)].sqrt().to_degrees();
        let straight = heading_deg(after(300, Pose { x_m: 0.1, ..Pose::default() }));
        let turning = heading_deg(after(270, Pose { heading_rad: 1_f64.to_radians(), ..Pose::default() }));
        assert!((straight - 2.0).abs() < 0.05 && (turning - 3.9).abs() < 0.05, "{straight} {turning}");
    }

    #[test]
    fn the_covariance_is_that_of_many_noisy_ways() {
        let chunks = 30;
        let (distance_m, turn_rad) = (0.1, 0.03);
        let expected = after(chunks, Pose::default().moved(distance_m, turn_rad));
        let mut random = Stream::new(1, "odometry");
        let mut sum = Matrix3::zeros();
        let ways = 4000;
        for _ in 0..ways {
            let end =
                (0..chunks).fold(Pose::default(), |pose, _| pose.compose(reported(distance_m, turn_rad, &mut random)));
            let off = nalgebra::Vector3::new(
                end.x_m - expected.node_from_robot.x_m,
                end.y_m - expected.node_from_robot.y_m,
                end.heading_rad - expected.node_from_robot.heading_rad,
            );
            sum += off * off.transpose() / f64::from(ways);
        }
        let scale = expected.covariance.diagonal().map(f64::sqrt);
        let difference = (sum - expected.covariance).component_div(&(scale * scale.transpose()));
        assert!(difference.amax() < 0.07, "{sum} {}", expected.covariance);
    }

    #[test]
    fn a_robot_that_stood_still_has_finite_information() {
        let information = Travel::default().information().unwrap();
        assert!((information[(0, 0)] - 1e6).abs() < 1.0);
    }
}
