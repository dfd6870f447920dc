//! Bands around lines that may overlap: a point belongs to every line that is near enough.

use super::lanes::BandSums;
use super::{Line, Points};

/// All places closer to a line than a distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Band {
    line: Line,
    /// The distance along y \[m\].
    half_height_m: f64,
}

impl Band {
    pub(super) fn new(line: Line, distance_m: f64) -> Self {
        Self { line, half_height_m: distance_m * line.slant() }
    }

    /// Whether the point is in the band.
    pub(super) fn holds(&self, x: f64, y: f64) -> bool {
        (y - (self.line.slope * x + self.line.intercept_m)).abs() < self.half_height_m
    }

    /// Number of the points in the band, and the sums of their x, y, x^2 and x y.
    pub(super) fn moments(&self, points: &Points) -> [f64; 5] {
        self.sums(points).moments()
    }

    /// Sum of the distances of the points in the band to `line` \[m\].
    pub(super) fn distances_m(&self, points: &Points, line: Line) -> f64 {
        self.sums(points).distances_m(line.slope, line.intercept_m) / line.slant()
    }

    fn sums<'a>(&self, points: &'a Points) -> BandSums<'a> {
        let band = [self.line.slope, self.line.intercept_m, self.half_height_m];
        BandSums { band, x_m: &points.x_m, y_m: &points.y_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_and_distances_take_all_points_in_the_band_and_no_other() {
        let mut points = Points::default();
        for i in 0..11 {
            points.push(0.5 * f64::from(i), if i % 3 == 0 { 2.0 } else { 0.1 });
        }
        let band = Band::new(Line::new(0.0, 0.0), 0.2);
        let inside: Vec<(f64, f64)> = points.iter().filter(|(x, y)| band.holds(*x, *y)).collect();
        assert_eq!(inside.len(), 7);
        let sums = band.moments(&points);
        let sum = |term: fn(&(f64, f64)) -> f64| inside.iter().map(term).sum::<f64>();
        let expected = [7.0, sum(|p| p.0), sum(|p| p.1), sum(|p| p.0 * p.0), sum(|p| p.0 * p.1)];
        assert!(sums.iter().zip(expected).all(|(sum, expected)| (sum - expected).abs() < 1e-12), "{sums:?}");
        assert!((band.distances_m(&points, Line::new(0.0, 0.15)) - 7.0 * 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_band_is_as_wide_across_a_sloping_line() {
        let band = Band::new(Line::new(1.0, 0.0), 0.2);
        let off = |distance: f64| (-distance * 0.5_f64.sqrt(), distance * 0.5_f64.sqrt());
        assert!(band.holds(off(0.199).0, off(0.199).1) && !band.holds(off(0.201).0, off(0.201).1));
    }
}
