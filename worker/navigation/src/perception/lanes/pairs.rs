//! Weights of all pairs of points, and the sum of those of different lines.

use pulp::{Arch, Simd, WithSimd};

use super::from_whole;
use crate::perception::population::OUTLIER;

/// The square of zeta, 3 m, of eq. 5 \[m^2\].
const PAIR_RANGE_M2: f32 = 9.0;
/// One in units of a weight.
pub(crate) const ONE: f32 = 65536.0;
/// So many weights of one add up to less than 2^32.
const BLOCK: usize = 1 << 15;

/// The exponential weights of the pairs of one point with many.
pub(crate) struct Weights<'a> {
    pub(crate) x_m: f32,
    pub(crate) y_m: f32,
    /// Coordinates of the others \[m\].
    pub(crate) others: [&'a [f32]; 2],
    /// The weights in whole units, for [`to_whole`](super::to_whole).
    pub(crate) weights: &'a mut [f32],
}

impl Weights<'_> {
    pub(crate) fn compute(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for Weights<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, x_rest) = S::as_simd_f32s(self.others[0]);
        let (y, y_rest) = S::as_simd_f32s(self.others[1]);
        let (weights, weights_rest) = S::as_mut_simd_f32s(self.weights);
        let own = [self.x_m, self.y_m].map(|value| simd.splat_f32s(value));
        for ((x, y), result) in x.iter().zip(y).zip(weights) {
            *result = weight(simd, own, *x, *y);
        }
        if !x_rest.is_empty() {
            let result = weight(simd, own, simd.partial_load_f32s(x_rest), simd.partial_load_f32s(y_rest));
            simd.partial_store_f32s(weights_rest, result);
        }
    }
}

#[inline(always)]
fn weight<S: Simd>(simd: S, [own_x, own_y]: [S::f32s; 2], x: S::f32s, y: S::f32s) -> S::f32s {
    let (dx, dy) = (simd.sub_f32s(own_x, x), simd.sub_f32s(own_y, y));
    let distance2 = simd.add_f32s(simd.mul_f32s(dx, dx), simd.mul_f32s(dy, dy));
    let exponent = simd.mul_f32s(distance2, simd.splat_f32s(-1.0 / PAIR_RANGE_M2));
    let weight = simd.mul_f32s(exponential(simd, exponent), simd.splat_f32s(ONE));
    // There is no room for a fraction.
    simd.add_f32s(weight, simd.splat_f32s(from_whole(0)))
}

/// exp(x) for x <= 0, right to 4e-5 of it and to 2e-6 of one; below -14 it is that of -14, 8e-7.
///
/// The Taylor series of degree 6 at x / 32, then five squarings: no branch, and nothing but sums and products.
#[inline(always)]
fn exponential<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    const FACTORIALS: [f32; 7] = [720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0];
    let x = simd.mul_f32s(simd.max_f32s(x, simd.splat_f32s(-14.0)), simd.splat_f32s(1.0 / 32.0));
    let mut power = simd.splat_f32s(1.0 / FACTORIALS[0]);
    for factorial in &FACTORIALS[1..] {
        power = simd.add_f32s(simd.mul_f32s(power, x), simd.splat_f32s(1.0 / factorial));
    }
    for _ in 0..5 {
        power = simd.mul_f32s(power, power);
    }
    power
}

/// The sum of the weights of all pairs of points that belong to two different lines.
pub(crate) struct SumApart<'a> {
    /// Row by row the pairs (i, j) with j < i.
    pub(crate) weights: &'a [u32],
    /// The line of each point.
    pub(crate) owners: &'a [u32],
}

impl SumApart<'_> {
    pub(crate) fn sum(self) -> u64 {
        Arch::new().dispatch(self)
    }
}

impl WithSimd for SumApart<'_> {
    type Output = u64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> u64 {
        let mut rows = self.weights;
        let mut sum = 0;
        for (i, owner) in self.owners.iter().enumerate() {
            let (row, rest) = rows.split_at(i);
            rows = rest;
            if *owner != OUTLIER {
                for (weights, others) in row.chunks(BLOCK).zip(self.owners[..i].chunks(BLOCK)) {
                    sum += u64::from(sum_apart(weights, others, *owner));
                }
            }
        }
        sum
    }
}

#[inline(always)]
fn sum_apart(weights: &[u32], others: &[u32], owner: u32) -> u32 {
    let mut sum = 0_u32;
    for (weight, other) in weights.iter().zip(others) {
        let apart = (*other != owner) & (*other != OUTLIER);
        sum = sum.wrapping_add(if apart { *weight } else { 0 });
    }
    sum
}
