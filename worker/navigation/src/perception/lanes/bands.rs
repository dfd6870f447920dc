//! Sums over the points in a band around a line.

use pulp::{Arch, Simd, WithSimd};

/// Sums over the points in the band around a line.
pub(crate) struct BandSums<'a> {
    /// Slope and intercept \[m\] of the line, and how far the band reaches along y \[m\].
    pub(crate) band: [f64; 3],
    /// Coordinates of the points \[m\].
    pub(crate) x_m: &'a [f64],
    pub(crate) y_m: &'a [f64],
}

/// Partial sums that are added up at the end in a fixed order.
const PARTS: usize = 8;

impl BandSums<'_> {
    /// Number of the points in the band, and the sums of their x, y, x^2 and x y.
    pub(crate) fn moments(self) -> [f64; 5] {
        Arch::new().dispatch(Moments(self))
    }

    /// Sum of the distances along y of the points in the band to the line of this slope and intercept \[m\].
    pub(crate) fn distances_m(self, slope: f64, intercept_m: f64) -> f64 {
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
                let inside = simd.less_than_f64s(distance_along_y(simd, *x, *y, slope, intercept), reach);
                for (sum, term) in sums.iter_mut().zip(terms(*x, *y)) {
                    sum[part] = simd.add_f64s(sum[part], simd.select_f64s(inside, term, zero));
                }
            }
        }
        sums.map(|parts| total::<S>(parts))
    }
}

pub(crate) struct Moments<'a>(pub(crate) BandSums<'a>);

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

/// Slope and intercept \[m\] of the line follow.
pub(crate) struct Distances<'a>(pub(crate) BandSums<'a>, pub(crate) f64, pub(crate) f64);

impl WithSimd for Distances<'_> {
    type Output = [f64; 1];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; 1] {
        let (slope, intercept) = (simd.splat_f64s(self.1), simd.splat_f64s(self.2));
        self.0.sum(
            simd,
            #[inline(always)]
            |x, y| [distance_along_y(simd, x, y, slope, intercept)],
        )
    }
}

/// Distance of (x, y) from a line, along y \[m\]; the same operations as in `Band::holds`, so the same bits.
#[inline(always)]
fn distance_along_y<S: Simd>(simd: S, x: S::f64s, y: S::f64s, slope: S::f64s, intercept: S::f64s) -> S::f64s {
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
