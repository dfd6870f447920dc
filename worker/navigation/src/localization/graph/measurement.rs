//! What a node saw of the map.

use nalgebra::{Matrix3, Vector3};

use super::edges::{Frame, huber};

/// Something seen in the robot's frame \[m\] and what it is on the map: a unary edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    /// A point of a detected line, matched with the row y = `row_y_m`.
    RowPoint {
        /// Where it was seen.
        seen: [f64; 2],
        /// The row's y on the map.
        row_y_m: f64,
        /// How much it counts: one over the points taken of its line, so that a line counts as one point.
        share: f64,
    },
    /// A detected line as the angle \[rad\] of its normal and its distance along it, matched with the row y = `row_y_m`.
    RowLine {
        /// Angle and distance.
        seen: [f64; 2],
        /// The row's y on the map.
        row_y_m: f64,
        /// Standard deviations of both.
        sds: [f64; 2],
    },
    /// A plant, matched with a planting position.
    Plant {
        /// Where it was seen.
        seen: [f64; 2],
        /// The planting position on the map.
        planted: [f64; 2],
    },
}

/// Standard deviations of measurements, and the kernel's threshold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurementNoise {
    /// Of a point of a line that counts wholly \[m\].
    pub line_m: f64,
    /// Of a plant, in each direction \[m\].
    pub plant_m: f64,
    /// Huber's threshold in standard deviations.
    pub huber: f64,
}

/// Half of the Hessian and of the gradient of a cost, and the cost, at one pose.
#[derive(Debug, Clone, Copy)]
pub struct Quadratic {
    /// The information.
    pub information: Matrix3<f64>,
    /// Half of the gradient.
    pub gradient: Vector3<f64>,
    /// The sum of squares, under the kernel.
    pub cost: f64,
}

impl Default for Quadratic {
    fn default() -> Self {
        Self { information: Matrix3::zeros(), gradient: Vector3::zeros(), cost: 0.0 }
    }
}

impl Measurement {
    /// Whether its numbers can be metres of a field: finite and under a thousand kilometres.
    #[must_use]
    pub(super) fn is_plausible(&self) -> bool {
        let plausible = |value: &f64| value.abs() < 1e6;
        match self {
            Self::RowPoint { seen, row_y_m, share } => {
                seen.iter().chain([row_y_m]).all(plausible) && (0.0..=1.0).contains(share)
            }
            Self::RowLine { seen, row_y_m, sds } => {
                seen.iter().chain([row_y_m]).all(plausible) && sds.iter().all(|sd| (1e-6..1e6).contains(sd))
            }
            Self::Plant { seen, planted } => seen.iter().chain(planted).all(plausible),
        }
    }

    /// Adds the edge's share at the pose `frame`.
    pub(super) fn add_to(&self, total: &mut Quadratic, frame: &Frame, noise: &MeasurementNoise) {
        match *self {
            Self::RowPoint { seen, row_y_m, share } => {
                let (error, jacobian) = frame.row_point(seen, row_y_m);
                let (weight, cost) = huber(error.abs() / noise.line_m, noise.huber);
                let weight = weight * share / (noise.line_m * noise.line_m);
                total.information += jacobian.transpose() * (weight * jacobian);
                total.gradient += jacobian.transpose() * (weight * error);
                total.cost += share * cost;
            }
            Self::RowLine { seen, row_y_m, sds } => {
                let (error, jacobian) = frame.row_line(seen, row_y_m);
                let sds = nalgebra::Vector2::from(sds);
                add_whitened(total, (error.component_div(&sds), divided(jacobian, sds)), noise.huber);
            }
            Self::Plant { seen, planted } => {
                let (error, jacobian) = frame.point(seen, planted);
                let sds = nalgebra::Vector2::repeat(noise.plant_m);
                add_whitened(total, (error.component_div(&sds), divided(jacobian, sds)), noise.huber);
            }
        }
    }
}

/// Each row by its standard deviation.
fn divided(mut jacobian: nalgebra::Matrix2x3<f64>, sds: nalgebra::Vector2<f64>) -> nalgebra::Matrix2x3<f64> {
    for (mut row, sd) in jacobian.row_iter_mut().zip(sds.iter()) {
        row /= *sd;
    }
    jacobian
}

/// Adds an edge in units of its standard deviations.
fn add_whitened(total: &mut Quadratic, (error, jacobian): super::edges::Linear<2>, threshold: f64) {
    let (weight, cost) = huber(error.dot(&error).sqrt(), threshold);
    total.information += jacobian.transpose() * jacobian * weight;
    total.gradient += jacobian.transpose() * error * weight;
    total.cost += cost;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use proptest::prelude::*;

    const NOISE: MeasurementNoise = MeasurementNoise { line_m: 0.1, plant_m: 0.2, huber: 1.0 };

    fn at(measurement: Measurement, pose: Pose) -> Quadratic {
        let mut total = Quadratic::default();
        measurement.add_to(&mut total, &Frame::from(pose), &NOISE);
        total
    }

    proptest! {
        #[test]
        fn the_gradient_is_half_the_slope_of_the_robust_cost(
            x_m in -1.0..1.0, y_m in -1.0..1.0, heading_rad in -0.5..0.5, a in -3.0..3.0, b in -3.0..3.0, kind in 0..3,
        ) {
            let measurement = match kind {
                0 => Measurement::RowPoint { seen: [a, b], row_y_m: 0.65, share: 0.25 },
                1 => Measurement::RowLine { seen: [1.5 + 0.1 * a, b], row_y_m: 0.65, sds: [0.05, 0.1] },
                _ => Measurement::Plant { seen: [a, b], planted: [0.4, 0.65] },
            };
            let cost = |[dx, dy, turn]: [f64; 3]| {
                at(measurement, Pose { x_m: x_m + dx, y_m: y_m + dy, heading_rad: heading_rad + turn }).cost
            };
            let gradient = at(measurement, Pose { x_m, y_m, heading_rad }).gradient;
            for i in 0..3 {
                let mut step = [0.0; 3];
                step[i] = 1e-6;
                let slope = (cost(step) - cost(step.map(|s| -s))) / 4e-6;
                prop_assert!((slope - gradient[i]).abs() < 1e-3 * (1.0 + gradient.amax()), "{slope} {gradient}");
            }
        }
    }

    #[test]
    fn twenty_points_of_a_line_count_as_one() {
        let mut total = Quadratic::default();
        for i in 0..20 {
            let point = Measurement::RowPoint { seen: [f64::from(i) * 0.2, 0.65], row_y_m: 0.65, share: 1.0 / 20.0 };
            point.add_to(&mut total, &Frame::from(Pose::default()), &NOISE);
        }
        assert!((total.information[(1, 1)] - 1.0 / (0.1 * 0.1)).abs() < 1e-9);
        assert_eq!((total.information[(0, 0)], total.cost), (0.0, 0.0));
    }

    #[test]
    fn what_is_no_place_in_a_field_is_not_plausible() {
        for odd in [f64::NAN, f64::INFINITY, 1e7] {
            assert!(!Measurement::Plant { seen: [odd, 0.0], planted: [0.0; 2] }.is_plausible());
            assert!(!Measurement::RowPoint { seen: [0.0; 2], row_y_m: odd, share: 1.0 }.is_plausible());
        }
        assert!(Measurement::Plant { seen: [1.0, -2.0], planted: [0.0; 2] }.is_plausible());
    }
}
