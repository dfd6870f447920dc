//! Lines of several straight pieces: rows, and the middles between them.

use std::ops::Range;

/// Pieces within this of a place are searched by [`Polyline::project_near`] \[m\].
const NEAR_M: f64 = 3.0;

/// A line through two points or more, directed from the first to the last.
#[derive(Debug, Clone, PartialEq)]
pub struct Polyline {
    points: Vec<[f64; 2]>,
    /// Length from the first point to each point \[m\].
    along_m: Vec<f64>,
}

/// A position relative to a polyline whose end pieces go on straight for ever.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnLine {
    /// Distance along the line from its first point \[m\]; negative before it.
    pub along_m: f64,
    /// Length of the line \[m\].
    pub length_m: f64,
    /// Distance across \[m\]; positive to the left of the line's direction.
    pub across_m: f64,
}

impl OnLine {
    /// Whether the position is at least `margin_m` inside both ends.
    #[must_use]
    pub fn is_inside(&self, margin_m: f64) -> bool {
        (margin_m..=self.length_m - margin_m).contains(&self.along_m)
    }
}

impl Polyline {
    /// The line through `points` (x, y) \[m\]: two at least, neighbours apart.
    #[must_use]
    pub fn new(points: Vec<[f64; 2]>) -> Self {
        let mut along_m = Vec::with_capacity(points.len());
        let mut total = 0.0;
        for (i, point) in points.iter().enumerate() {
            if i > 0 {
                total += distance(points[i - 1], *point);
            }
            along_m.push(total);
        }
        Self { points, along_m }
    }

    /// Its points (x, y) \[m\].
    #[must_use]
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }

    /// Its length \[m\].
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.along_m.last().copied().unwrap_or(0.0)
    }

    /// The line half-way between two: points at equal shares of their lengths, as many as the finer one has.
    #[must_use]
    pub fn middle(a: &Self, b: &Self) -> Self {
        let mut shares: Vec<f64> =
            [a, b].iter().flat_map(|line| line.along_m.iter().map(|s| s / line.length_m())).collect();
        shares.sort_by(f64::total_cmp);
        shares.dedup_by(|x, y| (*x - *y).abs() < 1e-9);
        Self::new(
            shares
                .iter()
                .map(|share| {
                    let (p, q) = (a.at(share * a.length_m()), b.at(share * b.length_m()));
                    [0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1])]
                })
                .collect(),
        )
    }

    /// The point `along_m` from the first one.
    #[must_use]
    pub fn at(&self, along_m: f64) -> [f64; 2] {
        let piece = self.piece(along_m);
        let (p, q) = (self.points[piece], self.points[piece + 1]);
        let share = (along_m - self.along_m[piece]) / (self.along_m[piece + 1] - self.along_m[piece]);
        [p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])]
    }

    /// The piece that the point `along_m` from the first one is on.
    fn piece(&self, along_m: f64) -> usize {
        self.along_m[1..self.along_m.len() - 1].partition_point(|end| *end < along_m)
    }

    /// Where (x, y) is relative to this line: projected on its nearest piece.
    #[must_use]
    pub fn project(&self, x_m: f64, y_m: f64) -> OnLine {
        self.project_on(x_m, y_m, 0..self.points.len() - 1)
    }

    /// The same among the pieces within a few metres of `near_m` along the line: for long lines.
    #[must_use]
    pub fn project_near(&self, x_m: f64, y_m: f64, near_m: f64) -> OnLine {
        self.project_on(x_m, y_m, self.piece(near_m - NEAR_M)..self.piece(near_m + NEAR_M) + 1)
    }

    fn project_on(&self, x_m: f64, y_m: f64, searched: Range<usize>) -> OnLine {
        let pieces = self.points.len() - 1;
        let mut nearest = (f64::INFINITY, OnLine { along_m: 0.0, length_m: self.length_m(), across_m: 0.0 });
        for i in searched {
            let (p, q) = (self.points[i], self.points[i + 1]);
            let length = self.along_m[i + 1] - self.along_m[i];
            let (ux, uy) = ((q[0] - p[0]) / length, (q[1] - p[1]) / length);
            let (dx, dy) = (x_m - p[0], y_m - p[1]);
            let low = if i == 0 { f64::NEG_INFINITY } else { 0.0 };
            let high = if i + 1 == pieces { f64::INFINITY } else { length };
            let along = (dx * ux + dy * uy).clamp(low, high);
            let (ex, ey) = (dx - along * ux, dy - along * uy);
            let gap = (ex * ex + ey * ey).sqrt();
            if gap < nearest.0 {
                let side = if ux * dy - uy * dx < 0.0 { -1.0 } else { 1.0 };
                nearest.0 = gap;
                nearest.1.along_m = self.along_m[i] + along;
                nearest.1.across_m = side * gap;
            }
        }
        nearest.1
    }

    /// The straight line through the piece nearest to (x, y), as a point on it and a unit direction.
    #[must_use]
    pub fn piece_near(&self, x_m: f64, y_m: f64) -> ([f64; 2], [f64; 2]) {
        let along_m = self.project(x_m, y_m).along_m;
        let piece = self.piece(along_m);
        let (p, q) = (self.points[piece], self.points[piece + 1]);
        let length = distance(p, q);
        (p, [(q[0] - p[0]) / length, (q[1] - p[1]) / length])
    }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bent() -> Polyline {
        Polyline::new(vec![[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    }

    #[test]
    fn left_is_positive_and_the_ends_go_on() {
        let line = Polyline::new(vec![[0.0, 0.0], [10.0, 0.0]]);
        let left = line.project(12.0, 0.5);
        assert_eq!((left.along_m, left.across_m), (12.0, 0.5));
        assert!(!left.is_inside(1.0) && line.project(9.0, 0.0).is_inside(1.0));
        assert_eq!(line.project(-2.0, -0.5).along_m, -2.0);
        assert_eq!(line.project(5.0, -0.5).across_m, -0.5);
    }

    #[test]
    fn a_bent_line_is_measured_along_its_pieces() {
        let p = bent().project(4.5, 2.0);
        assert_eq!((p.along_m, p.length_m, p.across_m), (6.0, 7.0, -0.5));
        assert_eq!(bent().at(5.0), [4.0, 1.0]);
        assert_eq!(bent().piece_near(4.5, 2.0).1, [0.0, 1.0]);
    }

    #[test]
    fn near_its_place_a_point_is_projected_as_on_the_whole_line() {
        let line = Polyline::new((0..100).map(|i| [f64::from(i), 0.1 * f64::from(i % 3)]).collect());
        for (x, y) in [(0.2, 0.3), (50.4, -0.3), (98.9, 0.5), (120.0, 0.0), (-5.0, 1.0)] {
            assert_eq!(line.project_near(x, y, x + 1.5), line.project(x, y));
        }
    }

    #[test]
    fn the_middle_lies_between() {
        let a = Polyline::new(vec![[0.0, 0.0], [10.0, 0.0]]);
        let b = Polyline::new(vec![[0.0, 1.0], [5.0, 1.0], [10.0, 1.0]]);
        assert_eq!(Polyline::middle(&a, &b).points(), [[0.0, 0.5], [5.0, 0.5], [10.0, 0.5]]);
    }
}
