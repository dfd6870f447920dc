//! Many lines through three points each, and which of them are the same.

use pulp::{Arch, Simd, WithSimd};

use crate::perception::line::{determines_slope, intercept_tolerance_m, slope_tolerance};

/// Fits lines to three points each, by least squares of y on x.
pub(crate) struct FitTriples<'a> {
    /// Coordinates of the first, second and third point of each line \[m\].
    pub(crate) x_m: [&'a [f64]; 3],
    pub(crate) y_m: [&'a [f64]; 3],
    pub(crate) slopes: &'a mut [f64],
    pub(crate) intercepts_m: &'a mut [f64],
    /// Slope, how far another one may be to be the same, intercept \[m\] and likewise.
    pub(crate) compared: [&'a mut [f32]; 4],
    /// 1, or 0 where the points are one above the other.
    pub(crate) new: &'a mut [f32],
}

impl FitTriples<'_> {
    pub(crate) fn fit(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for FitTriples<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        let n = self.slopes.len();
        let [x0, x1, x2] = self.x_m.map(|all| &all[..n]);
        let [y0, y1, y2] = self.y_m.map(|all| &all[..n]);
        let intercepts_m = &mut self.intercepts_m[..n];
        let [slopes32, slope_tolerances, intercepts32, intercept_tolerances] = self.compared.map(|all| &mut all[..n]);
        let new = &mut self.new[..n];
        for i in 0..n {
            let x = x0[i] + x1[i] + x2[i];
            let y = y0[i] + y1[i] + y2[i];
            let xx = x0[i] * x0[i] + x1[i] * x1[i] + x2[i] * x2[i];
            let xy = x0[i] * y0[i] + x1[i] * y1[i] + x2[i] * y2[i];
            let spread = 3.0 * xx - x * x;
            let slope = (3.0 * xy - x * y) / spread;
            let intercept_m = (y - slope * x) / 3.0;
            self.slopes[i] = slope;
            intercepts_m[i] = intercept_m;
            slopes32[i] = slope as f32;
            slope_tolerances[i] = slope_tolerance(slope) as f32;
            intercepts32[i] = intercept_m as f32;
            intercept_tolerances[i] = intercept_tolerance_m(intercept_m) as f32;
            new[i] = if determines_slope(spread, 3.0) { 1.0 } else { 0.0 };
        }
    }
}

/// Counts the lines of the same slope: each pair, the earlier one over the later one's tolerance, counts for both.
pub(crate) struct CountParallel<'a> {
    pub(crate) slopes: &'a [f64],
    /// How far another slope may be to be the same.
    pub(crate) tolerances: &'a [f64],
    /// The pairs of each line are added to these.
    pub(crate) counts: &'a mut [f64],
}

impl CountParallel<'_> {
    pub(crate) fn count(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for CountParallel<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for (i, slope) in self.slopes.iter().enumerate() {
            let (upto, later) = self.counts.split_at_mut(i + 1);
            let mut same_as_this = [0.0; 4];
            let others = self.slopes[i + 1..].chunks(4).zip(self.tolerances[i + 1..].chunks(4));
            for ((slopes, tolerances), counts) in others.zip(later.chunks_mut(4)) {
                for k in 0..slopes.len() {
                    let same = if (slope - slopes[k]).abs() <= tolerances[k] { 1.0 } else { 0.0 };
                    counts[k] += same;
                    same_as_this[k] += same;
                }
            }
            upto[i] += same_as_this.iter().sum::<f64>();
        }
    }
}

/// Finds out which of many lines are the same as a line before them.
pub(crate) struct SameLines<'a> {
    /// Slope, how far another one may be to be the same, intercept \[m\] and likewise: room for whole groups of [`GROUP`].
    pub(crate) lines: [&'a [f32]; 4],
    /// Each line's place among them, counted from 0.
    pub(crate) places: &'a [f32],
    /// How many lines there are.
    pub(crate) n: usize,
    /// Slopes and intercepts \[m\] of lines that stand before all of these.
    pub(crate) before: &'a [[f32; 2]],
    /// Becomes 0 where the line is the same as one of those before, or as an earlier one that is not 0.
    pub(crate) new: &'a mut [f32],
}

/// Lines are looked at in groups of this many, or of a part of it.
pub(crate) const GROUP: usize = 16;

impl SameLines<'_> {
    pub(crate) fn find(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for SameLines<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let groups = self.n.div_ceil(S::F32_LANES);
        let lines = self.lines.map(|all| &S::as_simd_f32s(all).0[..groups]);
        let places = &S::as_simd_f32s(self.places).0[..groups];
        for line in self.before {
            sieve(simd, *line, -1.0, lines, places, &mut S::as_mut_simd_f32s(self.new).0[..groups]);
        }
        for i in 0..self.n {
            if self.new[i] > 0.0 {
                let first = i / S::F32_LANES;
                let (line, place) = ([self.lines[0][i], self.lines[2][i]], i as f32);
                let new = &mut S::as_mut_simd_f32s(self.new).0[first..groups];
                sieve(simd, line, place, lines.map(|all| &all[first..]), &places[first..], new);
            }
        }
    }
}

/// Lets go of those lines behind `place` that are the same as `line`.
#[inline(always)]
fn sieve<S: Simd>(
    simd: S,
    line: [f32; 2],
    place: f32,
    [slopes, slope_tolerances, intercepts, intercept_tolerances]: [&[S::f32s]; 4],
    places: &[S::f32s],
    new: &mut [S::f32s],
) {
    let [slope, intercept] = line.map(|value| simd.splat_f32s(value));
    let (place, zero) = (simd.splat_f32s(place), simd.splat_f32s(0.0));
    let n = new.len();
    let (slopes, slope_tolerances) = (&slopes[..n], &slope_tolerances[..n]);
    let (intercepts, intercept_tolerances) = (&intercepts[..n], &intercept_tolerances[..n]);
    let places = &places[..n];
    for i in 0..n {
        let gap = simd.abs_f32s(simd.sub_f32s(slope, slopes[i]));
        let intercept_gap = simd.abs_f32s(simd.sub_f32s(intercept, intercepts[i]));
        let same = simd.and_m32s(
            simd.less_than_or_equal_f32s(gap, slope_tolerances[i]),
            simd.less_than_or_equal_f32s(intercept_gap, intercept_tolerances[i]),
        );
        let gives_way = simd.and_m32s(same, simd.less_than_f32s(place, places[i]));
        new[i] = simd.select_f32s(gives_way, zero, new[i]);
    }
}
