//! Pair energy: what it costs that points which are near to each other belong to different lines.
//!
//! Guyonneau et al. (2022), eqs. 3 and 5. The neighbourhood of a point is all other points, as in the program
//! behind the tables (Deviation: the paper's is open).
//!
//! The weights of all pairs are computed once per scan and kept as whole multiples of 2^-16. Sums of whole
//! numbers are exact in any order, so they may be added up in as many lanes as a machine has.

use super::Points;
use super::lanes::{ONE, SumApart, Weights, to_whole};

/// Weight of a pair, lambda of eq. 3 \[m\].
const PAIR_WEIGHT: f64 = 4.0;
/// The weights exp(-distance^2 / 9 m^2) of all pairs of points of a scan.
#[derive(Debug, Clone, Default)]
pub(super) struct PairWeights {
    /// Row by row the pairs (i, j) with j < i, in units of 2^-16.
    weights: Vec<u32>,
    /// Scratch: the points' coordinates \[m\], and one row.
    x_m: Vec<f32>,
    y_m: Vec<f32>,
    row: Vec<f32>,
}

impl PairWeights {
    pub(super) fn compute(&mut self, points: &Points) {
        points.in_single_precision(&mut self.x_m, &mut self.y_m);
        self.weights.clear();
        self.weights.reserve(points.len() * points.len().saturating_sub(1) / 2);
        self.row.resize(points.len(), 0.0);
        for i in 0..points.len() {
            let (x_m, y_m, others) = (self.x_m[i], self.y_m[i], [&self.x_m[..i], &self.y_m[..i]]);
            let weights = &mut self.row[..i];
            Weights { x_m, y_m, others, weights }.compute();
            self.weights.extend(self.row[..i].iter().map(|weight| to_whole(*weight)));
        }
    }

    /// Energy of the pairs of points that belong to two different lines, by each point's line.
    pub(super) fn between_lines(&self, owners: &[u32]) -> f64 {
        let sum = SumApart { weights: &self.weights, owners }.sum();
        PAIR_WEIGHT * sum as f64 / f64::from(ONE)
    }

    /// Likewise where a point may belong to several lines: bit k of its mask stands for line k.
    ///
    /// A point of two lines makes a pair with itself.
    pub(super) fn between_overlapping(&self, masks: &[u64]) -> f64 {
        let lines = |mask: u64| u64::from(mask.count_ones());
        let mut pairs_with_itself = 0;
        let mut sum = 0_u64;
        for (row, mask) in self.rows().zip(masks).filter(|(_, mask)| **mask != 0) {
            pairs_with_itself += lines(*mask) * (lines(*mask) - 1) / 2;
            for (weight, other) in row.iter().zip(masks) {
                sum += u64::from(*weight) * (lines(*mask) * lines(*other) - lines(mask & other));
            }
        }
        PAIR_WEIGHT * (sum as f64 / f64::from(ONE) + pairs_with_itself as f64)
    }

    /// For each point its pairs with those before it.
    fn rows(&self) -> impl Iterator<Item = &[u32]> {
        let mut rest = self.weights.as_slice();
        (0..).map_while(move |i| {
            let (row, after) = rest.split_at_checked(i)?;
            rest = after;
            Some(row)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::population::OUTLIER;

    #[test]
    fn a_weight_is_the_exponential_to_a_unit() {
        let mut points = Points::default();
        points.push(0.0, 0.0);
        (0..20_000).for_each(|i| points.push(0.0, 1e-3 * f64::from(i)));
        points.push(1e6, 1e200);
        let (mut x_m, mut y_m, mut weights) = (Vec::new(), Vec::new(), vec![0.0; points.len()]);
        points.in_single_precision(&mut x_m, &mut y_m);
        let others = [x_m.as_slice(), y_m.as_slice()];
        Weights { x_m: 0.0, y_m: 0.0, others, weights: &mut weights }.compute();
        for (y, weight) in points.y_m.iter().zip(weights) {
            let (weight, exact) = (f64::from(to_whole(weight)), libm::exp(-y * y / 9.0) * f64::from(ONE));
            assert!((weight - exact).abs() <= 1.0, "{y}: {exact} {weight}");
        }
    }

    fn points() -> Points {
        let mut points = Points::default();
        for i in 0..40 {
            let i = f64::from(i);
            points.push(4.0 * libm::sin(i), 3.0 * libm::cos(1.7 * i));
        }
        points
    }

    #[test]
    fn the_energy_is_that_of_the_formula() {
        let points = points();
        let owners: Vec<u32> = (0..40).map(|i| if i % 7 == 0 { OUTLIER } else { i % 3 }).collect();
        let mut weights = PairWeights::default();
        weights.compute(&points);
        let mut expected = 0.0;
        for i in 0..40 {
            for j in 0..i {
                if owners[i] != OUTLIER && owners[j] != OUTLIER && owners[i] != owners[j] {
                    let (dx, dy) = (points.x_m[i] - points.x_m[j], points.y_m[i] - points.y_m[j]);
                    expected += 4.0 * libm::exp(-(dx * dx + dy * dy) / 9.0);
                }
            }
        }
        assert!((weights.between_lines(&owners) - expected).abs() < 1e-2);
        let masks: Vec<u64> = owners.iter().map(|owner| if *owner == OUTLIER { 0 } else { 1 << owner }).collect();
        assert_eq!(weights.between_overlapping(&masks), weights.between_lines(&owners));
    }

    #[test]
    fn a_point_of_two_lines_makes_pairs_for_each() {
        let mut points = Points::default();
        points.push(0.0, 0.0);
        points.push(3.0, 0.0);
        let mut weights = PairWeights::default();
        weights.compute(&points);
        // Lines {a, b} and {b}: the pairs (a, b) and (b, b).
        let expected = 4.0 * (1.0 + libm::exp(-1.0));
        assert!((weights.between_overlapping(&[0b01, 0b11]) - expected).abs() < 1e-4);
    }
}
