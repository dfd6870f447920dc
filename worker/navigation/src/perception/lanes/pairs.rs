//! Weights of all pairs of points, and the sum of those of different lines.

use pulp::{Arch, Simd, WithSimd};

use super::from_whole;

/// The exponential weights of the pairs of one point with many.
pub(crate) struct Weights<'a> {
    pub(crate) x_m: f32,
    pub(crate) y_m: f32,
    /// Coordinates of the others \[m\].
    pub(crate) others: [&'a [f32]; 2],
    /// The exponent is this times the squared distance \[1/m^2\].
    pub(crate) scale: f32,
    /// One in units of a weight, at most 2^16.
    pub(crate) one: f32,
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
        let constants = [self.x_m, self.y_m, self.scale, self.one].map(|value| simd.splat_f32s(value));
        for ((x, y), result) in x.iter().zip(y).zip(weights) {
            *result = weight(simd, constants, *x, *y);
        }
        if !x_rest.is_empty() {
            let result = weight(simd, constants, simd.partial_load_f32s(x_rest), simd.partial_load_f32s(y_rest));
            simd.partial_store_f32s(weights_rest, result);
        }
    }
}

#[inline(always)]
fn weight<S: Simd>(simd: S, [own_x, own_y, scale, one]: [S::f32s; 4], x: S::f32s, y: S::f32s) -> S::f32s {
    let (dx, dy) = (simd.sub_f32s(own_x, x), simd.sub_f32s(own_y, y));
    let distance2 = simd.add_f32s(simd.mul_f32s(dx, dx), simd.mul_f32s(dy, dy));
    let weight = simd.mul_f32s(exponential(simd, simd.mul_f32s(distance2, scale)), one);
    // There is no room for a fraction.
    simd.add_f32s(weight, simd.splat_f32s(from_whole(0)))
}

/// exp(x) for x <= 0, right to 8e-6 of it; below -14 it is that of -14, 8e-7.
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
    /// What stands for no line.
    pub(crate) none: u32,
    /// So many weights add up to less than 2^32.
    pub(crate) block: usize,
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
            if *owner != self.none {
                for (weights, others) in row.chunks(self.block).zip(self.owners[..i].chunks(self.block)) {
                    sum += u64::from(sum_apart(weights, others, *owner, self.none));
                }
            }
        }
        sum
    }
}

#[inline(always)]
fn sum_apart(weights: &[u32], others: &[u32], owner: u32, none: u32) -> u32 {
    let mut sum = 0_u32;
    for (weight, other) in weights.iter().zip(others) {
        let apart = (*other != owner) & (*other != none);
        sum = sum.wrapping_add(if apart { *weight } else { 0 });
    }
    sum
}
