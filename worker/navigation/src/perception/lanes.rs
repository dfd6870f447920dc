//! Inner loops over many points and lines, with the vector instructions that the machine has.
//!
//! The bits do not depend on these: every lane does the same operations in the same order whatever their number, no
//! product is fused with a sum, and numbers are added up over lanes only where they are whole.

use pulp::{Arch, Simd, WithSimd};

/// Each point's nearest line.
pub(super) struct NearestLines<'a> {
    /// Slope, 1 and intercept of each line, divided by its slant, and the number to know it by.
    pub(super) lines: &'a [[f64; 4]],
    /// Coordinates of the points \[m\].
    pub(super) x_m: &'a [f64],
    pub(super) y_m: &'a [f64],
    /// On entry how near a line has to be, and what stands for none; on exit the distance \[m\] and the line's number.
    pub(super) nearest_m: &'a mut [f64],
    pub(super) numbers: &'a mut [f64],
}

impl NearestLines<'_> {
    pub(super) fn find(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for NearestLines<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, x_rest) = S::as_simd_f64s(self.x_m);
        let (y, y_rest) = S::as_simd_f64s(self.y_m);
        let (nearest, nearest_rest) = S::as_mut_simd_f64s(self.nearest_m);
        let (numbers, numbers_rest) = S::as_mut_simd_f64s(self.numbers);
        let (x, x_odd) = x.as_chunks::<2>();
        let (y, y_odd) = y.as_chunks::<2>();
        let (nearest, nearest_odd) = nearest.as_chunks_mut::<2>();
        let (numbers, numbers_odd) = numbers.as_chunks_mut::<2>();
        for (((x, y), nearest), numbers) in x.iter().zip(y).zip(nearest).zip(numbers) {
            (*nearest, *numbers) = nearest_lines(simd, self.lines, *x, *y, *nearest, *numbers);
        }
        for (((x, y), nearest), number) in x_odd.iter().zip(y_odd).zip(nearest_odd).zip(numbers_odd) {
            let ([near], [which]) = nearest_lines(simd, self.lines, [*x], [*y], [*nearest], [*number]);
            (*nearest, *number) = (near, which);
        }
        if !x_rest.is_empty() {
            let load = |rest: &[f64]| [simd.partial_load_f64s(rest)];
            let before = (load(nearest_rest), load(numbers_rest));
            let ([near], [which]) = nearest_lines(simd, self.lines, load(x_rest), load(y_rest), before.0, before.1);
            simd.partial_store_f64s(nearest_rest, near);
            simd.partial_store_f64s(numbers_rest, which);
        }
    }
}

#[inline(always)]
fn nearest_lines<S: Simd, const N: usize>(
    simd: S,
    lines: &[[f64; 4]],
    x: [S::f64s; N],
    y: [S::f64s; N],
    mut nearest: [S::f64s; N],
    mut numbers: [S::f64s; N],
) -> ([S::f64s; N], [S::f64s; N]) {
    for line in lines {
        let [slope, scale, intercept, number] = line.map(|value| simd.splat_f64s(value));
        for i in 0..N {
            let across = simd.sub_f64s(simd.mul_f64s(slope, x[i]), simd.mul_f64s(scale, y[i]));
            let distance = simd.abs_f64s(simd.add_f64s(across, intercept));
            let closer = simd.less_than_f64s(distance, nearest[i]);
            nearest[i] = simd.select_f64s(closer, distance, nearest[i]);
            numbers[i] = simd.select_f64s(closer, number, numbers[i]);
        }
    }
    (nearest, numbers)
}

/// Which of many lines are the same as another one: slope and intercept are within each line's own tolerance.
pub(super) struct Sieve<'a> {
    pub(super) slope: f64,
    pub(super) intercept_m: f64,
    /// Slope, its tolerance, intercept and its tolerance \[m\] of each line.
    pub(super) lines: [&'a [f64]; 4],
    /// Becomes 0 where the line is the same.
    pub(super) new: &'a mut [f64],
}

impl Sieve<'_> {
    pub(super) fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for Sieve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (slope, intercept) = (simd.splat_f64s(self.slope), simd.splat_f64s(self.intercept_m));
        let zero = simd.splat_f64s(0.0);
        let [slopes, slope_tolerances, intercepts, intercept_tolerances] = self.lines.map(|all| S::as_simd_f64s(all).0);
        let lines = slopes.iter().zip(slope_tolerances).zip(intercepts.iter().zip(intercept_tolerances));
        for (((a, a_tolerance), (b, b_tolerance)), new) in lines.zip(S::as_mut_simd_f64s(self.new).0) {
            let within =
                |value, of, tolerance| simd.less_than_or_equal_f64s(simd.abs_f64s(simd.sub_f64s(value, of)), tolerance);
            let same = simd.and_m64s(within(slope, *a, *a_tolerance), within(intercept, *b, *b_tolerance));
            *new = simd.select_f64s(same, zero, *new);
        }
    }
}

/// The exponential weights of the pairs of one point with many.
pub(super) struct Weights<'a> {
    pub(super) x_m: f64,
    pub(super) y_m: f64,
    /// Coordinates of the others \[m\].
    pub(super) others: [&'a [f64]; 2],
    /// The exponent is this times the squared distance \[1/m^2\].
    pub(super) scale: f64,
    /// One in units of a weight.
    pub(super) one: f64,
    /// The weights, in whole units.
    pub(super) weights: &'a mut [f64],
}

impl Weights<'_> {
    pub(super) fn compute(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for Weights<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, x_rest) = S::as_simd_f64s(self.others[0]);
        let (y, y_rest) = S::as_simd_f64s(self.others[1]);
        let (weights, weights_rest) = S::as_mut_simd_f64s(self.weights);
        let constants = [self.x_m, self.y_m, self.scale, self.one].map(|value| simd.splat_f64s(value));
        for ((x, y), result) in x.iter().zip(y).zip(weights) {
            *result = weight(simd, constants, *x, *y);
        }
        if !x_rest.is_empty() {
            let result = weight(simd, constants, simd.partial_load_f64s(x_rest), simd.partial_load_f64s(y_rest));
            simd.partial_store_f64s(weights_rest, result);
        }
    }
}

#[inline(always)]
fn weight<S: Simd>(simd: S, [own_x, own_y, scale, one]: [S::f64s; 4], x: S::f64s, y: S::f64s) -> S::f64s {
    let (dx, dy) = (simd.sub_f64s(own_x, x), simd.sub_f64s(own_y, y));
    let distance2 = simd.add_f64s(simd.mul_f64s(dx, dx), simd.mul_f64s(dy, dy));
    rounded(simd, simd.mul_f64s(exponential(simd, simd.mul_f64s(distance2, scale)), one))
}

/// exp(x) for x <= 0, off by at most 1e-8; below -20 it is that of -20, 2e-9.
///
/// The Taylor series of degree 7 at x / 32, then five squarings: no branch, and nothing but sums and products.
#[inline(always)]
fn exponential<S: Simd>(simd: S, x: S::f64s) -> S::f64s {
    const FACTORIALS: [f64; 8] = [5040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0];
    let x = simd.mul_f64s(simd.max_f64s(x, simd.splat_f64s(-20.0)), simd.splat_f64s(1.0 / 32.0));
    let term = |factorial: f64| simd.splat_f64s(1.0 / factorial);
    let mut power = term(FACTORIALS[0]);
    for factorial in &FACTORIALS[1..] {
        power = simd.add_f64s(simd.mul_f64s(power, x), term(*factorial));
    }
    for _ in 0..5 {
        power = simd.mul_f64s(power, power);
    }
    power
}

/// The nearest whole number, for 0 <= x < 2^51.
#[inline(always)]
fn rounded<S: Simd>(simd: S, x: S::f64s) -> S::f64s {
    let shift = simd.splat_f64s((1_u64 << 52) as f64);
    simd.sub_f64s(simd.add_f64s(x, shift), shift)
}

/// Sums over the points in the band around a line.
pub(super) struct BandSums<'a> {
    /// Slope and intercept \[m\] of the line, and how far the band reaches along y \[m\].
    pub(super) band: [f64; 3],
    /// Coordinates of the points \[m\].
    pub(super) x_m: &'a [f64],
    pub(super) y_m: &'a [f64],
}

/// Partial sums that are added up at the end in a fixed order.
const PARTS: usize = 8;

impl BandSums<'_> {
    /// Number of the points in the band, and the sums of their x, y, x^2 and x y.
    pub(super) fn moments(self) -> [f64; 5] {
        Arch::new().dispatch(Moments(self))
    }

    /// Sum of the distances along y of the points in the band to the line of this slope and intercept \[m\].
    pub(super) fn distances_m(self, slope: f64, intercept_m: f64) -> f64 {
        let [sum] = Arch::new().dispatch(Distances(self, slope, intercept_m));
        sum
    }

    /// Sums what `terms` makes of x and y, over the points in the band.
    #[inline(always)]
    fn sum<S: Simd, const N: usize>(&self, simd: S, terms: impl Fn(S::f64s, S::f64s) -> [S::f64s; N]) -> [f64; N] {
        let zero = simd.splat_f64s(0.0);
        let [slope, intercept, reach] = self.band.map(|value| simd.splat_f64s(value));
        let mut sums = [[zero; PARTS]; N];
        let (x, x_rest) = self.x_m.as_chunks::<PARTS>();
        let (y, y_rest) = self.y_m.as_chunks::<PARTS>();
        let rest = (padded(x_rest), padded(y_rest));
        for (x, y) in x.iter().zip(y).chain([(&rest.0, &rest.1)]) {
            let vectors = S::as_simd_f64s(x).0.iter().zip(S::as_simd_f64s(y).0);
            for (part, (x, y)) in vectors.enumerate() {
                let inside = simd.less_than_f64s(above(simd, *x, *y, slope, intercept), reach);
                for (sum, term) in sums.iter_mut().zip(terms(*x, *y)) {
                    sum[part] = simd.add_f64s(sum[part], simd.select_f64s(inside, term, zero));
                }
            }
        }
        sums.map(|parts| total::<S>(parts))
    }
}

struct Moments<'a>(BandSums<'a>);

impl WithSimd for Moments<'_> {
    type Output = [f64; 5];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; 5] {
        let one = simd.splat_f64s(1.0);
        self.0.sum(
            simd,
            #[inline(always)]
            |x, y| [one, x, y, simd.mul_f64s(x, x), simd.mul_f64s(x, y)],
        )
    }
}

struct Distances<'a>(BandSums<'a>, f64, f64);

impl WithSimd for Distances<'_> {
    type Output = [f64; 1];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; 1] {
        let (slope, intercept) = (simd.splat_f64s(self.1), simd.splat_f64s(self.2));
        self.0.sum(
            simd,
            #[inline(always)]
            |x, y| [above(simd, x, y, slope, intercept)],
        )
    }
}

/// How far (x, y) is above or below a line, along y \[m\].
#[inline(always)]
fn above<S: Simd>(simd: S, x: S::f64s, y: S::f64s, slope: S::f64s, intercept: S::f64s) -> S::f64s {
    simd.abs_f64s(simd.sub_f64s(y, simd.add_f64s(simd.mul_f64s(slope, x), intercept)))
}

/// Fewer than [`PARTS`] coordinates, filled up with some that lie in no band.
fn padded(coordinates: &[f64]) -> [f64; PARTS] {
    let mut all = [f64::NAN; PARTS];
    all[..coordinates.len()].copy_from_slice(coordinates);
    all
}

/// The sum of the lanes of as many vectors as hold [`PARTS`] numbers.
#[inline(always)]
fn total<S: Simd>(vectors: [S::f64s; PARTS]) -> f64 {
    let mut parts = [0.0; PARTS];
    S::as_mut_simd_f64s(&mut parts).0.copy_from_slice(&vectors[..PARTS / S::F64_LANES]);
    let [a, b, c, d, e, f, g, h] = parts;
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}

/// The sum of the weights of all pairs of points that belong to two different lines.
pub(super) struct SumApart<'a> {
    /// Row by row the pairs (i, j) with j < i.
    pub(super) weights: &'a [u32],
    /// The line of each point.
    pub(super) owners: &'a [u32],
    /// What stands for no line.
    pub(super) none: u32,
    /// So many weights add up to less than 2^32.
    pub(super) block: usize,
}

impl SumApart<'_> {
    pub(super) fn sum(self) -> u64 {
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

/// A whole number in 0..2^32, read from the low bits of its sum with 2^52.
#[inline(always)]
pub(super) fn whole(number: f64) -> u32 {
    (number + (1_u64 << 52) as f64).to_bits() as u32
}
