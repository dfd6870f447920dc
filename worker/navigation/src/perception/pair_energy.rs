//! Pair energy: what it costs that points which are near to each other belong to different lines.
//!
//! Guyonneau et al. (2022), eqs. 3 and 5. The neighbourhood of a point is all other points, as in the program
//! behind the tables (Deviation: the paper's is open).
//!
//! The weights of all pairs are computed once per scan and kept as whole multiples of 2^-22. Sums of whole
//! numbers are exact in any order, so they may be added up in as many lanes as a machine has.

use super::Points;
use super::population::OUTLIER;

/// Weight of a pair, lambda of eq. 3 \[m\].
const PAIR_WEIGHT: f64 = 4.0;
/// The square of zeta, 3 m, of eq. 5 \[m^2\].
const PAIR_RANGE_M2: f64 = 9.0;
/// One in units of a weight.
const ONE: f64 = (1_u32 << 22) as f64;
/// So many weights of one add up in 32 bits.
const BLOCK: usize = 1 << 10;

/// The weights exp(-distance^2 / 9 m^2) of all pairs of points of a scan.
#[derive(Debug, Clone, Default)]
pub(super) struct PairWeights {
    /// Row by row the pairs (i, j) with j < i, in units of 2^-22.
    weights: Vec<u32>,
}

impl PairWeights {
    pub(super) fn compute(&mut self, points: &Points) {
        self.weights.clear();
        for (i, (x, y)) in points.iter().enumerate() {
            let others = points.x_m[..i].iter().zip(&points.y_m[..i]);
            self.weights.extend(others.map(|(other_x, other_y)| {
                let (dx, dy) = (x - other_x, y - other_y);
                weight(dx * dx + dy * dy)
            }));
        }
    }

    /// Energy of the pairs of points that belong to two different lines, by each point's line.
    pub(super) fn between_lines(&self, owners: &[u32]) -> f64 {
        let mut sum = 0_u64;
        for (row, owner) in self.rows().zip(owners).filter(|(_, owner)| **owner != OUTLIER) {
            for (weights, others) in row.chunks(BLOCK).zip(owners.chunks(BLOCK)) {
                sum += u64::from(sum_apart(weights, others, *owner));
            }
        }
        PAIR_WEIGHT * sum as f64 / ONE
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
        PAIR_WEIGHT * (sum as f64 / ONE + pairs_with_itself as f64)
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

/// Sum of the weights of pairs whose other point belongs to a line, and not to `owner`; at most [`BLOCK`] of them.
fn sum_apart(weights: &[u32], others: &[u32], owner: u32) -> u32 {
    let term = |(weight, other): (&u32, &u32)| {
        let apart = (*other != owner) & (*other != OUTLIER);
        if apart { *weight } else { 0 }
    };
    weights.iter().zip(others).map(term).fold(0, u32::wrapping_add)
}

/// exp(-`distance_m2` / 9 m^2) in units of 2^-22, rounded: right to one unit.
///
/// A power of two times a polynomial of degree 7 for 2^f, |f| <= 1/2 (the Taylor series, off by 5e-9 at most), without
/// a branch, so that it is computed in lanes. Adding 1.5 x 2^52 leaves a rounded integer in the low bits.
fn weight(distance_m2: f64) -> u32 {
    const ROUND: f64 = 1.5 * (1_u64 << 52) as f64;
    /// ln(2)^k / k!.
    const TERMS: [f64; 8] = [
        1.0,
        0.693_147_180_559_945_3,
        0.240_226_506_959_100_7,
        0.055_504_108_664_821_58,
        0.009_618_129_107_628_477,
        0.001_333_355_814_642_844_3,
        0.000_154_035_303_933_816_1,
        0.000_015_252_733_804_059_84,
    ];
    let exponent = (distance_m2 * (-std::f64::consts::LOG2_E / PAIR_RANGE_M2)).max(-60.0);
    let rounded = exponent + ROUND;
    let f = exponent - (rounded - ROUND);
    let power = TERMS.iter().rev().fold(0.0, |sum, term| sum * f + term);
    let scale = f64::from_bits(rounded.to_bits().wrapping_add(1023) << 52);
    (power * scale * ONE + (1_u64 << 52) as f64).to_bits() as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_weight_is_the_exponential_to_its_last_unit() {
        for i in 0..20_000 {
            let distance_m2 = 0.01 * f64::from(i);
            let exact = libm::exp(-distance_m2 / 9.0) * ONE;
            assert!((f64::from(weight(distance_m2)) - exact).abs() <= 0.55, "{distance_m2}: {exact}");
        }
        assert_eq!((weight(0.0), weight(1e12), weight(f64::INFINITY)), (1 << 22, 0, 0));
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
        assert!((weights.between_lines(&owners) - expected).abs() < 1e-3);
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
        assert!((weights.between_overlapping(&[0b01, 0b11]) - expected).abs() < 1e-5);
    }
}
