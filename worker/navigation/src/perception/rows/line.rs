//! Lines on the ground.

/// Tangent of 20 degrees.
const STEEPEST: f64 = 0.364;

/// A line on the ground in the robot's frame: a point \[m\] and a unit direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowLine {
    /// A point of the line \[m\].
    pub point: [f64; 2],
    /// Unit vector along it, in the half plane ahead of the robot.
    pub direction: [f64; 2],
}

impl RowLine {
    /// The line through `point` \[m\] along `direction`, of any length; none where it has no direction.
    #[must_use]
    pub fn along(point: [f64; 2], direction: [f64; 2]) -> Option<Self> {
        let length = (direction[0] * direction[0] + direction[1] * direction[1]).sqrt();
        let ahead = if direction[0] < 0.0 { -length } else { length };
        let unit = [direction[0] / ahead, direction[1] / ahead];
        let is_finite = unit.iter().chain(&point).all(|value| value.is_finite());
        (length > 0.0 && is_finite).then_some(Self { point, direction: unit })
    }

    /// The line of least squared distances: through the centroid along the largest eigenvector of the scatter.
    #[must_use]
    pub fn through(points: impl Iterator<Item = [f64; 2]> + Clone) -> Option<Self> {
        let (n, sum) = points.clone().fold((0.0, [0.0; 2]), |(n, sum), [x, y]| (n + 1.0, [sum[0] + x, sum[1] + y]));
        let centre = [sum[0] / n, sum[1] / n];
        Self::along(centre, scatter(points, centre)?)
    }

    /// From the foot of the robot's centre to `ahead_m` further along it \[m\].
    #[must_use]
    pub fn piece(&self, ahead_m: f64) -> [[f64; 2]; 2] {
        let ([x, y], [dx, dy]) = (self.point, self.direction);
        let foot_m = -(x * dx + y * dy);
        [foot_m, foot_m + ahead_m].map(|along_m| [x + along_m * dx, y + along_m * dy])
    }

    /// Whether it may be a row: within 20 degrees of x, the robot's heading. Ours: a robot of 1.15 by 0.9 m fits between
    /// rows 1.3 m apart at up to 24 degrees.
    #[must_use]
    pub fn runs_ahead(&self) -> bool {
        is_ahead(self.direction)
    }

    /// Distance of a point from the line \[m\], positive to its left.
    #[must_use]
    pub fn left_of(&self, [x, y]: [f64; 2]) -> f64 {
        self.direction[0] * (y - self.point[1]) - self.direction[1] * (x - self.point[0])
    }

    /// The line `distance_m` to its left.
    #[must_use]
    pub fn shifted(&self, distance_m: f64) -> Self {
        let [dx, dy] = self.direction;
        Self { point: [self.point[0] - distance_m * dy, self.point[1] + distance_m * dx], ..*self }
    }
}

/// Whether a direction, or its opposite, may be that of a row: see [`RowLine::runs_ahead`].
pub(super) const fn is_ahead([dx, dy]: [f64; 2]) -> bool {
    dy.abs() <= STEEPEST * dx.abs()
}

/// The direction in which points scatter most; none where they scatter alike in all directions.
fn scatter(points: impl Iterator<Item = [f64; 2]>, centre: [f64; 2]) -> Option<[f64; 2]> {
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for [x, y] in points {
        let (dx, dy) = (x - centre[0], y - centre[1]);
        xx += dx * dx;
        xy += dx * dy;
        yy += dy * dy;
    }
    if xy == 0.0 && xx == yy {
        return None;
    }
    let (sin, cos) = libm::sincos(0.5 * libm::atan2(2.0 * xy, xx - yy));
    Some([cos, sin])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_line_give_it_back_and_left_is_positive() {
        for angle in [-1.4, -0.3, 0.0, 0.7, 1.5] {
            let (sin, cos) = libm::sincos(angle);
            let points: Vec<_> = (0..9).map(|i| f64::from(i) - 3.0).map(|t| [1.0 + t * cos, 0.5 + t * sin]).collect();
            let line = RowLine::through(points.iter().copied()).unwrap();
            assert!((line.direction[0] - cos).abs() < 1e-12 && (line.direction[1] - sin).abs() < 1e-12);
            assert!(points.iter().all(|point| line.left_of(*point).abs() < 1e-12));
            assert!((line.left_of([1.0 - 0.2 * sin, 0.5 + 0.2 * cos]) - 0.2).abs() < 1e-12);
            assert!((line.shifted(0.2).left_of([1.0, 0.5]) + 0.2).abs() < 1e-12);
        }
    }

    #[test]
    fn one_point_or_a_round_heap_is_no_line() {
        let through = |points: &[[f64; 2]]| RowLine::through(points.iter().copied());
        assert_eq!(through(&[]), None);
        assert_eq!(through(&[[1.0, 2.0]; 3]), None);
        assert_eq!(through(&[[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), None);
        assert_eq!(RowLine::along([f64::NAN, 0.0], [1.0, 0.0]), None);
    }
}
