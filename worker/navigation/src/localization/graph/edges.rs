//! Error functions of the edges with their Jacobians by x, y and heading of the poses they tie.
//!
//! Poses are added to component by component, so an edge that is linear in them stays so.

use nalgebra::{Matrix2x3, Matrix3, RowVector3, Vector2, Vector3};

use crate::Pose;

/// Error and Jacobian of an edge with `N` components on one pose.
pub type Linear<const N: usize> = (nalgebra::SVector<f64, N>, nalgebra::SMatrix<f64, N, 3>);

/// The same angle within pi of zero.
#[must_use]
pub fn wrap(angle_rad: f64) -> f64 {
    if angle_rad.abs() <= std::f64::consts::PI {
        return angle_rad;
    }
    libm::remainder(angle_rad, std::f64::consts::TAU)
}

/// How far `x` is from the pose `z`, in its frame: t2v(Z^-1 X).
#[must_use]
pub fn prior(z: Pose, x: Pose) -> Linear<3> {
    let apart = z.relative(x);
    let (sin, cos) = libm::sincos(z.heading_rad);
    let jacobian = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
    (Vector3::new(apart.x_m, apart.y_m, wrap(apart.heading_rad)), jacobian)
}

/// How far `to`, seen from `from`, is from the relative pose `z` that the odometry gives: t2v(Z^-1 (X_i^-1 X_j)).
///
/// The Jacobians are by `from` and by `to`.
#[must_use]
pub fn relative(z: Pose, from: Pose, to: Pose) -> (Vector3<f64>, [Matrix3<f64>; 2]) {
    let seen = from.relative(to);
    let error = z.relative(seen);
    let (sin, cos) = libm::sincos(from.heading_rad + z.heading_rad);
    let (z_sin, z_cos) = libm::sincos(z.heading_rad);
    let by_to = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
    // Turning `from` moves what it sees by (y, -x).
    let turn = Vector2::new(z_cos * seen.y_m - z_sin * seen.x_m, -z_sin * seen.y_m - z_cos * seen.x_m);
    let mut by_from = -by_to;
    by_from[(0, 2)] = turn.x;
    by_from[(1, 2)] = turn.y;
    (Vector3::new(error.x_m, error.y_m, wrap(error.heading_rad)), [by_from, by_to])
}

/// A pose with the sine and cosine of its heading, for the many measurements at one node.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    at_m: [f64; 2],
    heading_rad: f64,
    sin: f64,
    cos: f64,
}

impl From<Pose> for Frame {
    fn from(pose: Pose) -> Self {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        Self { at_m: [pose.x_m, pose.y_m], heading_rad: pose.heading_rad, sin, cos }
    }
}

impl Frame {
    /// Where the map has a point less where the robot saw it, in the robot's frame: R^T (l - t) - z.
    #[must_use]
    pub fn point(&self, seen: [f64; 2], planted: [f64; 2]) -> Linear<2> {
        let (dx, dy) = (planted[0] - self.at_m[0], planted[1] - self.at_m[1]);
        let (sin, cos) = (self.sin, self.cos);
        let (ahead, left) = (cos * dx + sin * dy, cos * dy - sin * dx);
        let jacobian = Matrix2x3::new(-cos, -sin, left, sin, -cos, -ahead);
        (Vector2::new(ahead - seen[0], left - seen[1]), jacobian)
    }

    /// Signed distance of a point seen in the robot's frame from the row y = `row_y_m` of the map.
    #[must_use]
    pub fn row_point(&self, [x, y]: [f64; 2], row_y_m: f64) -> (f64, RowVector3<f64>) {
        let error = self.at_m[1] + self.sin * x + self.cos * y - row_y_m;
        (error, RowVector3::new(0.0, 1.0, self.cos * x - self.sin * y))
    }

    /// The row y = `row_y_m` less the line `[theta, rho]` of the robot's frame (its normal's angle, its distance along
    /// the normal): (theta' - theta_i - z_theta, rho' - n(theta') t_i - z_rho).
    ///
    /// Of the two normals of the map's row the nearer one counts, so the sign of the line's own does not matter.
    #[must_use]
    pub fn row_line(&self, [theta_rad, rho_m]: [f64; 2], row_y_m: f64) -> Linear<2> {
        let up = wrap(std::f64::consts::FRAC_PI_2 - self.heading_rad - theta_rad);
        let down = wrap(up - std::f64::consts::PI);
        let (turned, normal) = if up.abs() <= down.abs() { (up, 1.0) } else { (down, -1.0) };
        let error = Vector2::new(turned, normal * (row_y_m - self.at_m[1]) - rho_m);
        (error, Matrix2x3::new(0.0, 0.0, -1.0, 0.0, -normal, 0.0))
    }
}

/// Huber's kernel at an error of `sigmas` standard deviations: the weight of its square, and its cost.
#[must_use]
pub fn huber(sigmas: f64, threshold: f64) -> (f64, f64) {
    if sigmas <= threshold {
        return (1.0, sigmas * sigmas);
    }
    (threshold / sigmas, threshold * (2.0 * sigmas - threshold))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Pose> {
        (-9.0..9.0, -9.0..9.0, -7.0..7.0).prop_map(|(x_m, y_m, heading_rad)| Pose { x_m, y_m, heading_rad })
    }

    fn points() -> impl Strategy<Value = [f64; 2]> {
        [-6.0..6.0, -6.0..6.0]
    }

    const STEP: f64 = 1e-6;

    fn nudged(pose: Pose, component: usize, by: f64) -> Pose {
        let mut values = [pose.x_m, pose.y_m, pose.heading_rad];
        values[component] += by;
        Pose { x_m: values[0], y_m: values[1], heading_rad: values[2] }
    }

    /// The largest difference of `jacobian` from finite differences of `error` at `pose`; none where an angle wraps.
    fn off<const N: usize>(
        jacobian: nalgebra::SMatrix<f64, N, 3>,
        pose: Pose,
        error: impl Fn(Pose) -> nalgebra::SVector<f64, N>,
    ) -> f64 {
        let mut worst = 0.0_f64;
        for column in 0..3 {
            let [before, after] = [-STEP, STEP].map(|by| error(nudged(pose, column, by)));
            let difference = (after - before) / (2.0 * STEP);
            if (after - before).amax() < 1.0 {
                worst = worst.max((difference - jacobian.column(column)).amax());
            }
        }
        worst
    }

    proptest! {
        #[test]
        fn jacobians_are_those_of_finite_differences(
            z in poses(), x in poses(), y in poses(), seen in points(), planted in points(), row_y_m in -9.0..9.0,
        ) {
            prop_assert!(off(prior(z, x).1, x, |x| prior(z, x).0) < 1e-7);
            let [by_from, by_to] = relative(z, x, y).1;
            prop_assert!(off(by_from, x, |x| relative(z, x, y).0) < 1e-7);
            prop_assert!(off(by_to, y, |y| relative(z, x, y).0) < 1e-7);
            let frame = Frame::from(x);
            prop_assert!(off(frame.point(seen, planted).1, x, |x| Frame::from(x).point(seen, planted).0) < 1e-7);
            let row_point = |x| nalgebra::Vector1::new(Frame::from(x).row_point(seen, row_y_m).0);
            prop_assert!(off(frame.row_point(seen, row_y_m).1, x, row_point) < 1e-7);
            prop_assert!(off(frame.row_line(seen, row_y_m).1, x, |x| Frame::from(x).row_line(seen, row_y_m).0) < 1e-7);
        }

        #[test]
        fn what_is_seen_from_the_true_pose_leaves_no_error(
            x in poses(), z in poses(), planted in points(), turns in -3..3_i32,
        ) {
            let whole_turns = f64::from(turns) * std::f64::consts::TAU;
            let to = nudged(x.compose(z), 2, whole_turns);
            prop_assert!(relative(z, x, to).0.amax() < 1e-12);
            prop_assert!(prior(x, nudged(x, 2, whole_turns)).0.amax() < 1e-12);
            let (ahead, left) = x.local(planted[0], planted[1]);
            let frame = Frame::from(x);
            prop_assert!(frame.point([ahead, left], planted).0.amax() < 1e-12);
            prop_assert!(frame.row_point([ahead, left], planted[1]).0.abs() < 1e-12);
        }

        #[test]
        fn a_row_line_may_be_given_by_either_normal(x in poses(), row_y_m in -9.0..9.0) {
            let theta_rad = std::f64::consts::FRAC_PI_2 - x.heading_rad;
            let rho_m = row_y_m - x.y_m;
            for line in [[theta_rad, rho_m], [theta_rad + std::f64::consts::PI, -rho_m]] {
                prop_assert!(Frame::from(x).row_line(line, row_y_m).0.amax() < 1e-12);
            }
        }
    }

    #[test]
    fn hubers_kernel_is_square_inside_and_grows_evenly_outside() {
        assert_eq!(huber(0.5, 1.0), (1.0, 0.25));
        assert_eq!(huber(4.0, 1.0), (0.25, 7.0));
        let (inside, outside) = (huber(1.0 - 1e-9, 1.0), huber(1.0 + 1e-9, 1.0));
        assert!((inside.0 - outside.0).abs() < 1e-8 && (inside.1 - outside.1).abs() < 1e-8);
    }
}
