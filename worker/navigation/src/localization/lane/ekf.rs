//! An extended Kalman filter over the distances to both rows and the heading.
//!
//! Velasquez et al. (2022), section 3.3, equations 5 to 9. A side that a scan did not show is measured by the distance
//! that its finder hands on, as in the paper.
//!
//! Deviation: the paper prints four entries of Q and R for three states: the first three are taken, per iteration.
//! Equation 8 takes the cosine at the new state; the Jacobian of equation 7 has it at the previous one.

use super::LaneEstimator;
use crate::control::Twist;
use crate::perception::{LaneEstimate, LaneView, Points};
use crate::random::Stream;

crate::parameters! {
    /// Parameters of [`Ekf`].
    pub struct EkfParams {
        /// Variance that a distance gains in each step. Paper: 0.001.
        pub distance_process_m2: f64 = 0.001, "m^2", [0.0, 100.0];
        /// Variance that the heading gains in each step. Paper: 0.01.
        pub heading_process_rad2: f64 = 0.01, "rad^2", [0.0, 100.0];
        /// Variance of a measured distance. Paper: 0.05.
        pub distance_noise_m2: f64 = 0.05, "m^2", [1e-9, 100.0];
        /// Variance of a measured heading. Paper: 0.5.
        pub heading_noise_rad2: f64 = 0.5, "rad^2", [1e-9, 100.0];
        /// A view whose innovation, squared and normalised (chi-square, 3 degrees of freedom), exceeds this is not taken in; 0 takes
        /// all. Paper: all.
        pub gate: f64 = 0.0, "1", [0.0, 1e6];
    }
}

/// Left and right distance \[m\] and heading \[rad\].
type State = [f64; 3];
type Matrix = [State; 3];

/// The filter.
#[derive(Debug, Clone)]
pub struct Ekf {
    /// Diagonal of Q.
    process: State,
    /// Diagonal of R.
    noise: State,
    gate: f64,
    state: State,
    covariance: Matrix,
}

impl Ekf {
    /// At `start`, as sure of it as of one measurement.
    #[must_use]
    pub fn new(params: &EkfParams, start: LaneEstimate) -> Self {
        let process = [params.distance_process_m2, params.distance_process_m2, params.heading_process_rad2];
        let noise = [params.distance_noise_m2, params.distance_noise_m2, params.heading_noise_rad2];
        let state = [start.left_m, start.right_m, start.heading_rad];
        Self { process, noise, gate: params.gate, state, covariance: diagonal(noise) }
    }

    /// Takes in a measured state; returns the innovation's square, normalised by its covariance (chi-square, 3).
    ///
    /// R is diagonal, so the three numbers are taken in one after the other.
    fn measure(&mut self, measured: State) -> f64 {
        let mut normalised = 0.0;
        for (i, measured) in measured.into_iter().enumerate() {
            let difference = measured - self.state[i];
            let innovation = if i == 2 { wrap(difference) } else { difference };
            let variance = self.covariance[i][i] + self.noise[i];
            normalised += innovation * innovation / variance;
            let row = self.covariance[i];
            for j in 0..3 {
                let gain = row[j] / variance;
                self.state[j] += gain * innovation;
                self.covariance[j].iter_mut().zip(row).for_each(|(entry, covariance)| *entry -= gain * covariance);
            }
        }
        self.state[2] = wrap(self.state[2]);
        normalised
    }
}

impl LaneEstimator for Ekf {
    fn predict(&mut self, measured: Twist, dt_s: f64) {
        let Some((ahead_m, turn_rad)) = measured.moved(dt_s) else { return };
        let (sin, cos) = libm::sincos(self.state[2]);
        self.state[0] -= ahead_m * sin;
        self.state[1] += ahead_m * sin;
        self.state[2] = wrap(self.state[2] + turn_rad);
        self.covariance = propagate(&self.covariance, ahead_m * cos);
        for i in 0..3 {
            self.covariance[i][i] += self.process[i];
        }
    }

    fn correct(&mut self, _points: &Points, view: LaneView, _random: &mut Stream) {
        let measured = [view.left.distance_m, view.right.distance_m, view.heading_rad];
        if measured.iter().all(|value| value.is_finite()) {
            let (state, covariance) = (self.state, self.covariance);
            if self.measure(measured) > self.gate && self.gate > 0.0 {
                (self.state, self.covariance) = (state, covariance);
            }
        }
    }

    fn estimate(&self) -> LaneEstimate {
        let [left_m, right_m, heading_rad] = self.state;
        LaneEstimate { left_m, right_m, heading_rad }
    }

    fn restart(&mut self, start: LaneEstimate) {
        self.state = [start.left_m, start.right_m, start.heading_rad];
        self.covariance = diagonal(self.noise);
    }
}

/// F P F', where F is the identity but for -+ `across_m` per radian of heading, equation 8.
fn propagate(p: &Matrix, across_m: f64) -> Matrix {
    let a = across_m;
    let fp = [std::array::from_fn(|j| p[0][j] - a * p[2][j]), std::array::from_fn(|j| p[1][j] + a * p[2][j]), p[2]];
    fp.map(|row: State| [row[0] - a * row[2], row[1] + a * row[2], row[2]])
}

const fn diagonal([a, b, c]: State) -> Matrix {
    [[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]]
}

/// The same angle within pi of zero.
fn wrap(angle_rad: f64) -> f64 {
    if angle_rad.abs() <= std::f64::consts::PI {
        return angle_rad;
    }
    libm::remainder(angle_rad, std::f64::consts::TAU)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::lane::Side;
    use proptest::prelude::*;

    fn ekf() -> Ekf {
        Ekf::new(&EkfParams::default(), LaneEstimate::middle(0.75))
    }

    fn twist(linear_m_s: f64, angular_rad_s: f64) -> Twist {
        Twist { linear_m_s, angular_rad_s }
    }

    /// Equation 7, written out again.
    fn model([left, right, heading]: State, [v, omega]: [f64; 2], dt: f64) -> State {
        [left - v * libm::sin(heading) * dt, right + v * libm::sin(heading) * dt, heading + omega * dt]
    }

    #[test]
    fn a_robot_turned_left_comes_nearer_to_the_left_row() {
        let mut ekf = ekf();
        ekf.state[2] = 0.3;
        ekf.predict(twist(0.7, 0.2), 0.025);
        let expected = model([0.375, 0.375, 0.3], [0.7, 0.2], 0.025);
        assert!(ekf.state.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15));
        assert!(ekf.state[0] < 0.375 && ekf.state[2] > 0.3);
    }

    #[test]
    fn the_covariance_moves_by_the_models_jacobian_at_the_previous_state() {
        let covariance = [[0.04, 0.01, -0.02], [0.01, 0.05, 0.03], [-0.02, 0.03, 0.2]];
        let (state, input, dt) = ([0.3, 0.4, 0.5], [0.7, 0.9], 0.2);
        let mut jacobian = [[0.0; 3]; 3];
        for j in 0..3 {
            let (mut above, mut below) = (state, state);
            above[j] += 1e-6;
            below[j] -= 1e-6;
            let (above, below) = (model(above, input, dt), model(below, input, dt));
            (0..3).for_each(|i| jacobian[i][j] = (above[i] - below[i]) / 2e-6);
        }
        let mut ekf = Ekf { state, covariance, ..ekf() };
        ekf.predict(twist(input[0], input[1]), dt);
        for i in 0..3 {
            for j in 0..3 {
                let mut expected = if i == j { ekf.process[i] } else { 0.0 };
                for k in 0..3 {
                    for l in 0..3 {
                        expected += jacobian[i][k] * covariance[k][l] * jacobian[j][l];
                    }
                }
                assert!((ekf.covariance[i][j] - expected).abs() < 1e-9, "{i} {j}");
            }
        }
    }

    #[test]
    fn gains_settle_where_the_published_variances_put_them() {
        let mut ekf = ekf();
        for _ in 0..500 {
            ekf.predict(twist(0.0, 0.0), 0.025);
            ekf.measure([0.3, 0.45, 0.1]);
        }
        // p = (q + sqrt(q^2 + 4 q r)) / 2 before a measurement; the gain is p / (p + r).
        for (i, (q, r)) in [(0.001_f64, 0.05_f64), (0.001, 0.05), (0.01, 0.5)].into_iter().enumerate() {
            let before = 0.5 * (q + (q * q + 4.0 * q * r).sqrt());
            assert!((ekf.covariance[i][i] - before * r / (before + r)).abs() < 1e-9);
        }
        assert!((ekf.state[0] - 0.3).abs() < 1e-9 && (ekf.state[2] - 0.1).abs() < 1e-9);
    }

    #[test]
    fn innovations_are_consistent_on_data_from_its_own_model() {
        let (runs, steps) = (40, 100);
        let mut sum = 0.0;
        for seed in 0..runs {
            let mut random = Stream::new(seed, "model");
            let params = EkfParams { heading_process_rad2: 1e-4, heading_noise_rad2: 0.01, ..EkfParams::default() };
            let mut ekf = Ekf::new(&params, LaneEstimate::middle(0.75));
            let sd = |variance: State| variance.map(f64::sqrt);
            let mut scattered = |state: State, sd: State| {
                let [a, b, c] = state;
                [a + sd[0] * random.normal(), b + sd[1] * random.normal(), c + sd[2] * random.normal()]
            };
            let mut truth = scattered(ekf.state, sd(ekf.noise));
            for step in 0..steps {
                let input = [0.7, 0.4 * libm::sin(0.2 * f64::from(step))];
                truth = scattered(model(truth, input, 0.1), sd(ekf.process));
                ekf.predict(twist(input[0], input[1]), 0.1);
                sum += ekf.measure(scattered(truth, sd(ekf.noise)));
            }
        }
        // The sum of n squares, chi-square with 3 degrees each: mean 3 n, variance 6 n; within three deviations.
        let n = f64::from(steps) * runs as f64;
        assert!((sum - 3.0 * n).abs() < 3.0 * (6.0 * n).sqrt(), "{} instead of 3", sum / n);
    }

    #[test]
    fn a_gate_keeps_out_what_can_hardly_be_and_lets_in_what_can() {
        let params =
            EkfParams { distance_noise_m2: 0.0036, heading_noise_rad2: 0.0049, gate: 11.3, ..Default::default() };
        let view = |left_m: f64, right_m: f64, heading_rad: f64| {
            let side = |distance_m| Side { distance_m, valid: true };
            LaneView { left: side(left_m), right: side(right_m), heading_rad, heading_valid: true }
        };
        let moves = |params: &EkfParams, view: LaneView| {
            let mut ekf = Ekf::new(params, LaneEstimate::middle(0.75));
            let before = (ekf.state, ekf.covariance);
            ekf.correct(&Points::default(), view, &mut Stream::new(1, "test"));
            before != (ekf.state, ekf.covariance)
        };
        // Variances of 0.0072 and 0.0098 rad^2: 3 deviations to one side are 9, and 4 are 16.
        assert!(moves(&params, view(0.375 + 0.25, 0.375, 0.0)) && !moves(&params, view(0.375 + 0.34, 0.375, 0.0)));
        assert!(moves(&params, view(0.375, 0.375, 0.3)) && !moves(&params, view(0.375, 0.375, 0.4)));
        // Two and a half of one and of the other are 12.5.
        assert!(!moves(&params, view(0.375 + 0.212, 0.375, 0.2475)));
        // The published filter takes the next lane for a measurement, too.
        assert!(moves(&EkfParams::default(), view(1.125, -0.375, 0.0)));
    }

    #[test]
    fn what_is_not_a_number_changes_nothing() {
        let mut filter = ekf();
        let nothing = LaneView { heading_rad: f64::NAN, ..LaneView::nothing(filter.estimate()) };
        filter.predict(twist(f64::NAN, 0.1), 0.025);
        filter.correct(&Points::default(), nothing, &mut Stream::new(1, "test"));
        assert_eq!((filter.state, filter.covariance), (ekf().state, ekf().covariance));
    }

    proptest! {
        #[test]
        fn estimates_stay_finite_and_variances_positive(
            inputs in proptest::collection::vec((-1e3..1e3_f64, -1e3..1e3_f64, 0.0..1.0_f64, -10.0..10.0_f64), 1..50)
        ) {
            let mut ekf = ekf();
            for (v, omega, dt, heading_rad) in inputs {
                ekf.predict(twist(v, omega), dt);
                ekf.measure([v, omega, heading_rad]);
                prop_assert!(ekf.state.iter().all(|value| value.is_finite()));
                prop_assert!((0..3).all(|i| ekf.covariance[i][i] > 0.0));
                prop_assert!(ekf.state[2].abs() <= std::f64::consts::PI + 1e-12);
            }
        }
    }
}
