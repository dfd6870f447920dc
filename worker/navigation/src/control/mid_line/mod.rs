//! Following a mid line: Vintu (2018), section 3.5.1. Here the line itself; a file per controller.

pub mod io_linearization;
pub mod pid;

#[cfg(test)]
mod conformance;

use super::Twist;
use crate::perception::rows::RowLine;

/// The line to follow, in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MidLine {
    /// A point of it \[m\].
    pub point: [f64; 2],
    /// Unit vector along it, in the direction to drive.
    pub direction: [f64; 2],
}

impl MidLine {
    /// Signed distance of the line from a point of the robot's frame \[m\]: positive if the line lies to the left,
    /// seen along it.
    #[must_use]
    pub fn offset_m(&self, from: [f64; 2]) -> f64 {
        let ([x, y], [dx, dy]) = (self.point, self.direction);
        dx * (y - from[1]) - dy * (x - from[0])
    }

    /// Its angle to the robot's x axis \[rad\], in [-pi, pi].
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        libm::atan2(self.direction[1], self.direction[0])
    }

    /// Finite and within a thousand kilometres.
    fn is_plausible(&self) -> bool {
        self.point.iter().chain(&self.direction).all(|value| value.abs() < 1e6)
    }
}

/// Follows a mid line.
pub trait MidLineControl: Send {
    /// What brings the robot onto `line`, `dt_s` \[s\] after the last call.
    ///
    /// A line that is not finite, or no place within 1000 km, stops the robot and is forgotten.
    fn steer(&mut self, line: MidLine, dt_s: f64) -> Twist;

    /// Forgets what was seen of earlier lines: the robot follows another row.
    fn restart(&mut self);
}

/// The line half way between two lines, directed ahead; none if one of them is not finite or has no direction.
///
/// Equations 3.4 to 3.6. Deviation: of the two bisectors the one between the lines is wanted; for lines directed alike
/// that is phi = -n1 / n2. Of the line itself its foot point and its direction are given: y at x = 0 and 1 does not
/// exist for a line across.
#[must_use]
pub fn bisector(a: RowLine, b: RowLine) -> Option<MidLine> {
    let alike = a.direction[0] * b.direction[0] + a.direction[1] * b.direction[1] >= 0.0;
    let sign = if alike { 1.0 } else { -1.0 };
    let ([a1, b1, c1], [a2, b2, c2]) = (equation(a, 1.0), equation(b, sign));
    let (n1, n2) = (norm(a1, b1), norm(a2, b2));
    let phi = -n1 / n2;
    let (am, bm, cm) = (a1 - phi * a2, b1 - phi * b2, c1 - phi * c2);
    let n = norm(am, bm);
    if !(n1 > 0.0 && n2 > 0.0 && n > 0.0) {
        return None;
    }
    let ahead = if -bm < 0.0 { -1.0 } else { 1.0 };
    let line =
        MidLine { point: [-cm * am / (n * n), -cm * bm / (n * n)], direction: [-ahead * bm / n, ahead * am / n] };
    line.is_plausible().then_some(line)
}

/// The middle of the lane beside one of its rows: the row, moved towards the robot by half of `row_distance_m`.
///
/// A row that goes through the robot counts as the left one.
#[must_use]
pub fn shifted(row: RowLine, row_distance_m: f64) -> MidLine {
    let RowLine { point: [x, y], direction } = row;
    let line = MidLine { point: row.point, direction };
    let left_m = if line.offset_m([0.0, 0.0]) < 0.0 { 0.5 * row_distance_m } else { -0.5 * row_distance_m };
    MidLine { point: [x - left_m * direction[1], y + left_m * direction[0]], direction }
}

/// a, b and c of a x + b y + c = 0, equation 3.4, from a line's point and the one a unit (times `sign`) further along.
fn equation(RowLine { point: [x, y], direction }: RowLine, sign: f64) -> [f64; 3] {
    let [dx, dy] = direction.map(|component| sign * component);
    [dy, -dx, dx * y - dy * x]
}

fn norm(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn line(point: [f64; 2], angle_rad: f64) -> RowLine {
        let (sin, cos) = libm::sincos(angle_rad);
        RowLine { point, direction: [cos, sin] }
    }

    fn distance(line: RowLine, from: [f64; 2]) -> f64 {
        MidLine { point: line.point, direction: line.direction }.offset_m(from).abs()
    }

    fn assert_close(line: MidLine, point: [f64; 2], direction: [f64; 2]) {
        let off = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        assert!(off(line.point, point) < 1e-12 && off(line.direction, direction) < 1e-12, "{line:?}");
    }

    #[test]
    fn lines_that_open_alike_to_both_sides_have_the_x_axis_between_them() {
        let five = 5_f64.to_radians();
        let middle = bisector(line([0.0, 0.6], five), line([0.0, -0.6], -five)).unwrap();
        assert_close(middle, [0.0, 0.0], [1.0, 0.0]);
        let backward = line([0.0, -0.6], std::f64::consts::PI - five);
        assert_close(bisector(line([0.0, 0.6], five), backward).unwrap(), [0.0, 0.0], [1.0, 0.0]);
    }

    #[test]
    fn parallel_lines_have_their_mean_between_them() {
        let (sin, cos) = libm::sincos(0.2);
        let shift = |left: f64| line([3.0 * cos - left * sin, 3.0 * sin + left * cos], 0.2);
        let middle = bisector(shift(0.9), shift(-0.5)).unwrap();
        assert_close(middle, [-0.2 * sin, 0.2 * cos], [cos, sin]);
    }

    #[test]
    fn lines_without_direction_or_place_have_no_bisector() {
        let good = line([0.0, 0.6], 0.0);
        for bad in [
            RowLine { direction: [0.0, 0.0], ..good },
            RowLine { direction: [f64::NAN, 0.0], ..good },
            RowLine { point: [0.0, f64::INFINITY], ..good },
        ] {
            assert_eq!(bisector(good, bad), None, "{bad:?}");
            assert_eq!(bisector(bad, good), None, "{bad:?}");
        }
    }

    #[test]
    fn a_single_row_is_moved_by_half_a_row_distance_towards_the_robot() {
        assert_close(shifted(line([1.0, 0.6], 0.0), 1.3), [1.0, -0.05], [1.0, 0.0]);
        assert_close(shifted(line([1.0, -0.6], 0.0), 1.3), [1.0, 0.05], [1.0, 0.0]);
    }

    proptest! {
        #[test]
        fn a_bisector_is_ahead_and_as_far_from_either_line_everywhere(
            a in ([-4.0..4.0, -4.0..4.0], -1.5..1.5), b in ([-4.0..4.0, -4.0..4.0], -1.5..1.5), along in -9.0..9.0,
        ) {
            let lines = [line(a.0, a.1), line(b.0, b.1)];
            let middle = bisector(lines[0], lines[1]).unwrap();
            let at = [0, 1].map(|i| middle.point[i] + along * middle.direction[i]);
            prop_assert!((distance(lines[0], at) - distance(lines[1], at)).abs() < 1e-9);
            prop_assert!((norm(middle.direction[0], middle.direction[1]) - 1.0).abs() < 1e-12);
            prop_assert!(middle.direction[0] >= 0.0);
            // The near one: within half of the angle between them, so no steeper to either than 45 degrees.
            let along_lines = lines.map(|line| {
                (middle.direction[0] * line.direction[0] + middle.direction[1] * line.direction[1]).abs()
            });
            prop_assert!(along_lines.iter().all(|cos| *cos > 0.707 - 1e-3));
        }

        #[test]
        fn a_shifted_row_is_half_a_row_distance_from_it(x in -4.0..4.0, y in 0.1..4.0, angle in -1.5..1.5) {
            let row = line([x, y], angle);
            let middle = shifted(row, 1.3);
            prop_assert!((distance(row, middle.point) - 0.65).abs() < 1e-12);
            let [before, after] = [distance(row, [0.0; 2]), middle.offset_m([0.0; 2]).abs()];
            prop_assert!(after <= (before - 0.65).abs() + 1e-12);
        }
    }
}
