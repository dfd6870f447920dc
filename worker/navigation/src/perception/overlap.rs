//! Bands around lines that may overlap: a point belongs to every line that is near enough.

use super::{Line, Points};

/// So many partial sums, added up at the end in a fixed order.
const LANES: usize = 4;

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

    pub(super) fn holds(&self, x: f64, y: f64) -> bool {
        above_m(self.line, x, y).abs() < self.half_height_m
    }
}

/// How far the point is above the line, along y \[m\].
fn above_m(line: Line, x: f64, y: f64) -> f64 {
    y - (line.slope * x + line.intercept_m)
}

/// Number of the points in the band, and the sums of their x, y, x^2 and x y.
pub(super) fn band_sums(points: &Points, band: Band) -> [f64; 5] {
    let mut sums = [[0.0; LANES]; 5];
    let (x, x_rest) = points.x_m.as_chunks::<LANES>();
    let (y, y_rest) = points.y_m.as_chunks::<LANES>();
    for (x, y) in x.iter().zip(y) {
        add_in_band(&mut sums, x, y, band);
    }
    add_in_band(&mut sums, &padded(x_rest), &padded(y_rest), band);
    sums.map(total)
}

#[inline(always)]
fn add_in_band(sums: &mut [[f64; LANES]; 5], x: &[f64; LANES], y: &[f64; LANES], band: Band) {
    for i in 0..LANES {
        let inside = band.holds(x[i], y[i]);
        let terms = [1.0, x[i], y[i], x[i] * x[i], x[i] * y[i]];
        for (sum, term) in sums.iter_mut().zip(terms) {
            sum[i] += if inside { term } else { 0.0 };
        }
    }
}

/// Sum of the distances along y of the points in the band to `line` \[m\].
pub(super) fn band_distances_m(points: &Points, band: Band, line: Line) -> f64 {
    let mut sums = [0.0; LANES];
    let mut add = |x: &[f64; LANES], y: &[f64; LANES]| {
        for i in 0..LANES {
            let distance_m = above_m(line, x[i], y[i]).abs();
            sums[i] += if band.holds(x[i], y[i]) { distance_m } else { 0.0 };
        }
    };
    let (x, x_rest) = points.x_m.as_chunks::<LANES>();
    let (y, y_rest) = points.y_m.as_chunks::<LANES>();
    x.iter().zip(y).for_each(|(x, y)| add(x, y));
    add(&padded(x_rest), &padded(y_rest));
    total(sums)
}

/// Fewer than [`LANES`] coordinates, filled up with some that lie in no band.
fn padded(coordinates: &[f64]) -> [f64; LANES] {
    let mut all = [f64::NAN; LANES];
    all[..coordinates.len()].copy_from_slice(coordinates);
    all
}

fn total(sums: [f64; LANES]) -> f64 {
    (sums[0] + sums[1]) + (sums[2] + sums[3])
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
        let sums = band_sums(&points, band);
        let sum = |term: fn(&(f64, f64)) -> f64| inside.iter().map(term).sum::<f64>();
        let expected = [7.0, sum(|p| p.0), sum(|p| p.1), sum(|p| p.0 * p.0), sum(|p| p.0 * p.1)];
        assert!(sums.iter().zip(expected).all(|(sum, expected)| (sum - expected).abs() < 1e-12), "{sums:?}");
        assert!((band_distances_m(&points, band, Line::new(0.0, 0.15)) - 7.0 * 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_band_is_as_wide_across_a_sloping_line() {
        let band = Band::new(Line::new(1.0, 0.0), 0.2);
        let off = |distance: f64| (-distance * 0.5_f64.sqrt(), distance * 0.5_f64.sqrt());
        assert!(band.holds(off(0.199).0, off(0.199).1) && !band.holds(off(0.201).0, off(0.201).1));
    }
}
