//! Lines and when two are the same.

/// A line y = slope x + intercept.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Line {
    /// dy / dx; positive when the robot is turned clockwise with respect to the row.
    pub slope: f64,
    /// y at x = 0 \[m\]; positive to the left.
    pub intercept_m: f64,
}

impl Line {
    /// The line y = `slope` x + `intercept_m`.
    #[must_use]
    pub const fn new(slope: f64, intercept_m: f64) -> Self {
        Self { slope, intercept_m }
    }

    /// Orthogonal distance of the point (x, y) \[m\].
    #[must_use]
    pub fn distance_m(&self, x_m: f64, y_m: f64) -> f64 {
        (self.slope * x_m - y_m + self.intercept_m).abs() / self.slant()
    }

    /// sqrt(slope^2 + 1): the factor from an orthogonal distance to a difference of intercepts.
    ///
    /// Guyonneau et al. (2022), eq. 15, prints sqrt(slope^2) + 1, which is wrong.
    #[must_use]
    pub fn slant(&self) -> f64 {
        slant(self.slope)
    }
}

/// sqrt(slope^2 + 1).
#[must_use]
pub fn slant(slope: f64) -> f64 {
    (slope * slope + 1.0).sqrt()
}

/// How alike two lines must be to count as one; the program behind the tables of Guyonneau et al. (2022).
pub const SAME_SLOPE: f64 = 0.1;
/// See [`SAME_SLOPE`]: for intercepts \[m\], and as a share.
pub const SAME_INTERCEPT: f64 = 0.2;

/// How far a slope may be from `second` to be the same.
#[must_use]
pub fn slope_tolerance(second: f64) -> f64 {
    SAME_SLOPE.max(SAME_SLOPE * second.abs())
}

/// How far an intercept may be from `second_m` to be the same \[m\].
#[must_use]
pub fn intercept_tolerance_m(second_m: f64) -> f64 {
    SAME_INTERCEPT.max(SAME_INTERCEPT * second_m.abs())
}

/// Whether two slopes are the same: their difference is within 0.1, or their ratio within 10 % of one.
#[must_use]
pub fn same_slope(first: f64, second: f64) -> bool {
    (first - second).abs() <= slope_tolerance(second)
}

/// Whether two intercepts are the same: their difference is within 0.2 m, or their ratio within 20 % of one.
#[must_use]
pub fn same_intercept(first_m: f64, second_m: f64) -> bool {
    (first_m - second_m).abs() <= intercept_tolerance_m(second_m)
}

/// Whether two lines are the same: slope and intercept both are. Not symmetric: ratios are first over second.
#[must_use]
pub fn same_line(first: Line, second: Line) -> bool {
    same_slope(first.slope, second.slope) && same_intercept(first.intercept_m, second.intercept_m)
}

/// Whether `spread`, n times the sum of x^2 less the square of the sum of x over `n` points \[m^2\], determines a slope.
///
/// Below this the x of the points differ by less than about a micrometre, and rounding decides.
#[must_use]
pub(super) fn determines_slope(spread: f64, n: f64) -> bool {
    spread > 1e-12 * n * n
}

/// Sums for a least-squares line of y on x.
#[derive(Debug, Clone, Copy, Default)]
pub struct LineFit {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
}

impl LineFit {
    /// Sums that were made elsewhere: the number of points, and the sums of x, y, x^2 and x y over them.
    #[must_use]
    pub(super) const fn from_sums([n, x, y, xx, xy]: [f64; 5]) -> Self {
        Self { n, x, y, xx, xy }
    }

    /// Number of points taken in.
    #[must_use]
    pub const fn points(&self) -> f64 {
        self.n
    }

    /// Whether it took in more than `n` points.
    #[must_use]
    pub fn has_more_than(&self, n: u32) -> bool {
        self.n > f64::from(n)
    }

    /// Takes in all points of `other`.
    pub fn merge(&mut self, other: &Self) {
        self.n += other.n;
        self.x += other.x;
        self.y += other.y;
        self.xx += other.xx;
        self.xy += other.xy;
    }

    /// Takes a point in.
    pub fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
    }

    /// The line of least squares of y on x; none for fewer than two points or points one above the other.
    #[must_use]
    pub fn line(&self) -> Option<Line> {
        let spread = self.n * self.xx - self.x * self.x;
        if self.n < 2.0 || !determines_slope(spread, self.n) {
            return None;
        }
        let slope = (self.n * self.xy - self.x * self.y) / spread;
        Some(Line { slope, intercept_m: (self.y - slope * self.x) / self.n })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_is_orthogonal() {
        assert!((Line::new(1.0, 0.0).distance_m(0.0, 1.0) - 0.5_f64.sqrt()).abs() < 1e-15);
        assert_eq!(Line::new(0.0, 2.0).distance_m(7.0, -1.0), 3.0);
    }

    #[test]
    fn a_fit_recovers_its_line_and_refuses_a_vertical_one() {
        let mut fit = LineFit::default();
        for x in [-1.0, 0.5, 3.0] {
            fit.add(x, 0.25 * x - 0.75);
        }
        let line = fit.line().unwrap();
        assert!((line.slope - 0.25).abs() < 1e-14 && (line.intercept_m + 0.75).abs() < 1e-14);

        let mut vertical = LineFit::default();
        for y in [0.0, 1.0, 2.0] {
            vertical.add(1.5, y);
        }
        assert_eq!(vertical.line(), None);
    }

    #[test]
    fn same_means_close_or_of_like_size() {
        assert!(same_slope(0.0, 0.1) && !same_slope(0.0, 0.11));
        assert!(same_slope(2.0, 2.19) && !same_slope(2.0, 2.3));
        assert!(same_intercept(0.5, 0.7) && !same_intercept(0.5, 0.71));
        assert!(same_intercept(2.0, 2.4) && !same_intercept(-0.5, 0.5));
    }
}
