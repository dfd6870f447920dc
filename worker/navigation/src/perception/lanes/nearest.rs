//! Each point's nearest line.

use pulp::{Arch, Simd, WithSimd};

/// Finds each point's nearest line.
pub(crate) struct NearestLines<'a> {
    /// Slope, 1 and intercept \[m\] of each line, divided by its slant, and the number to know it by.
    pub(crate) lines: &'a [[f32; 4]],
    /// Coordinates of the points \[m\].
    pub(crate) x_m: &'a [f32],
    pub(crate) y_m: &'a [f32],
    /// On entry how near a line has to be \[m\], and what stands for none; on exit the distance and the line's number.
    pub(crate) nearest_m: &'a mut [f32],
    pub(crate) numbers: &'a mut [f32],
}

impl NearestLines<'_> {
    pub(crate) fn find(self) {
        Arch::new().dispatch(self);
    }
}

impl WithSimd for NearestLines<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (x, x_rest) = S::as_simd_f32s(self.x_m);
        let (y, y_rest) = S::as_simd_f32s(self.y_m);
        let (nearest, nearest_rest) = S::as_mut_simd_f32s(self.nearest_m);
        let (numbers, numbers_rest) = S::as_mut_simd_f32s(self.numbers);
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
            let load = |rest: &[f32]| [simd.partial_load_f32s(rest)];
            let before = (load(nearest_rest), load(numbers_rest));
            let ([near], [which]) = nearest_lines(simd, self.lines, load(x_rest), load(y_rest), before.0, before.1);
            simd.partial_store_f32s(nearest_rest, near);
            simd.partial_store_f32s(numbers_rest, which);
        }
    }
}

#[inline(always)]
fn nearest_lines<S: Simd, const N: usize>(
    simd: S,
    lines: &[[f32; 4]],
    x: [S::f32s; N],
    y: [S::f32s; N],
    mut nearest: [S::f32s; N],
    mut numbers: [S::f32s; N],
) -> ([S::f32s; N], [S::f32s; N]) {
    for line in lines {
        let [slope, scale, intercept, number] = line.map(|value| simd.splat_f32s(value));
        for i in 0..N {
            let across = simd.sub_f32s(simd.mul_f32s(slope, x[i]), simd.mul_f32s(scale, y[i]));
            let distance = simd.abs_f32s(simd.add_f32s(across, intercept));
            let closer = simd.less_than_f32s(distance, nearest[i]);
            nearest[i] = simd.select_f32s(closer, distance, nearest[i]);
            numbers[i] = simd.select_f32s(closer, number, numbers[i]);
        }
    }
    (nearest, numbers)
}
