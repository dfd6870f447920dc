//! Exact searches around all points of a cloud at once, as many points at a time as a vector holds.
//!
//! A box is passed over when even its nearest corner is too far. That is exact in floating point, too: distances to
//! boxes and to points are computed by the same operations, each of which keeps order.

use std::marker::PhantomData;
use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::buckets::{BLOCK, BUCKET, Boxes, Buckets};

/// Lists of so many stay in registers.
const SHORT: usize = 11;
/// Buckets that are looked at before any distance to a box is computed: the nearest ones, more often than not.
const FAMILY: usize = 4;

/// What a search keeps of the points around those of a vector.
trait Seen<S: Simd> {
    /// Squared distances \[m^2\] from here on do not matter any more.
    fn limit(&mut self, simd: S) -> f64;
    /// One more point at these squared distances \[m^2\].
    fn see(&mut self, simd: S, squared: S::f64s);
}

/// Mean distance to the k nearest other points of each point, of which there are more than k, none of them lost.
pub(super) struct MeanDistances<'a> {
    pub(super) cloud: &'a Buckets,
    pub(super) k: usize,
    /// Room for the least distances.
    pub(super) least: &'a mut Vec<f64>,
    /// The answer, in the order in which the points came \[m\].
    pub(super) mean_m: &'a mut [f64],
}

impl WithSimd for MeanDistances<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { cloud, k, least, mean_m } = self;
        if k < SHORT {
            mean_distances(simd, cloud, k, [simd.splat_f64s(0.0); SHORT], mean_m);
        } else {
            least.resize((k + 1) * S::F64_LANES, 0.0);
            mean_distances(simd, cloud, k, S::as_mut_simd_f64s(least).0, mean_m);
        }
    }
}

/// With a list that has room for the `k` + 1 least distances of each point of a vector, or more.
#[inline(always)]
fn mean_distances<S: Simd>(simd: S, cloud: &Buckets, k: usize, least: impl AsMut<[S::f64s]>, mean_m: &mut [f64]) {
    let mut least = Least::<S, _>(least, PhantomData);
    let spare = least.0.as_mut().len() - (k + 1);
    for first in (0..cloud.len()).step_by(S::F64_LANES) {
        let present = cloud.present(simd, first);
        let (none, farthest) = (simd.splat_f64s(0.0), simd.splat_f64s(f64::INFINITY));
        let places = least.0.as_mut();
        places.fill(simd.select_f64s(present, farthest, none));
        // Nothing is below what spare places hold.
        places[..spare].fill(none);
        look_around(simd, cloud, first, &mut least);
        // The nearest of all is the point itself.
        let mut sums = simd.splat_f64s(0.0);
        for squared in &least.0.as_mut()[spare + 1..] {
            sums = simd.add_f64s(sums, simd.sqrt_f64s(*squared));
        }
        let mut each = [0.0; BUCKET];
        simd.partial_store_f64s(&mut each[..S::F64_LANES], sums);
        for (sum, place) in each[..S::F64_LANES].iter().zip(first..cloud.len()) {
            mean_m[cloud.index(place)] = sum / k as f64;
        }
    }
}

/// The least squared distances, ascending; lanes without a point hold zeros.
struct Least<S, L>(L, PhantomData<S>);

impl<S: Simd, L: AsMut<[S::f64s]>> Seen<S> for Least<S, L> {
    #[inline(always)]
    fn limit(&mut self, simd: S) -> f64 {
        let least = self.0.as_mut();
        simd.reduce_max_f64s(least[least.len() - 1])
    }

    #[inline(always)]
    fn see(&mut self, simd: S, mut squared: S::f64s) {
        let least = self.0.as_mut();
        let closer = simd.less_than_f64s(squared, least[least.len() - 1]);
        if simd.first_true_m64s(closer) == S::F64_LANES {
            return;
        }
        for place in least.iter_mut() {
            let before = *place;
            *place = simd.min_f64s(squared, before);
            squared = simd.max_f64s(squared, before);
        }
    }
}

/// Whether each point has at least k others within a radius. Lost points have none and are none.
pub(super) struct Accompanied<'a> {
    pub(super) cloud: &'a Buckets,
    pub(super) k: usize,
    pub(super) radius_m: f64,
    /// The answer, in the order in which the points came.
    pub(super) accompanied: &'a mut [bool],
}

impl WithSimd for Accompanied<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { cloud, k, radius_m, accompanied } = self;
        let (none, enough) = (simd.splat_f64s(0.0), simd.splat_f64s((k + 1) as f64));
        for first in (0..cloud.len()).step_by(S::F64_LANES) {
            let missing = simd.select_f64s(cloud.present(simd, first), enough, none);
            let mut within = Within::<S> { squared: radius_m * radius_m, missing };
            look_around(simd, cloud, first, &mut within);
            let mut missing = [0.0; BUCKET];
            simd.partial_store_f64s(&mut missing[..S::F64_LANES], within.missing);
            for (missing, place) in missing[..S::F64_LANES].iter().zip(first..cloud.len()) {
                accompanied[cloud.index(place)] = *missing <= 0.0 && !cloud.is_lost(place);
            }
        }
    }
}

/// How many points each still misses.
struct Within<S: Simd> {
    squared: f64,
    missing: S::f64s,
}

impl<S: Simd> Seen<S> for Within<S> {
    #[inline(always)]
    fn limit(&mut self, simd: S) -> f64 {
        if simd.reduce_max_f64s(self.missing) > 0.0 { self.squared } else { f64::NEG_INFINITY }
    }

    #[inline(always)]
    fn see(&mut self, simd: S, squared: S::f64s) {
        let near = simd.less_than_or_equal_f64s(squared, simd.splat_f64s(self.squared));
        let one = simd.select_f64s(near, simd.splat_f64s(1.0), simd.splat_f64s(0.0));
        self.missing = simd.sub_f64s(self.missing, one);
    }
}

/// Shows `seen` all points that may matter to those of the vector that begins at `first`.
#[inline(always)]
fn look_around<S: Simd>(simd: S, cloud: &Buckets, first: usize, seen: &mut impl Seen<S>) {
    let at = cloud.vector::<S>(first);
    let family = first / BUCKET / FAMILY * FAMILY;
    let family = family..(family + FAMILY).min(cloud.buckets.len());
    family.clone().for_each(|bucket| look_at(simd, cloud, bucket, at, seen));
    let mut limit = seen.limit(simd);
    let own = OwnBox::around(cloud, first..first + S::F64_LANES);
    for start in (0..cloud.blocks.len()).step_by(BLOCK) {
        let blocks = start..(start + BLOCK).min(cloud.blocks.len());
        let gaps = own.gaps(&cloud.blocks, blocks.clone());
        for (block, gap) in blocks.zip(gaps) {
            if gap > limit {
                continue;
            }
            let buckets = block * BLOCK..((block + 1) * BLOCK).min(cloud.buckets.len());
            let gaps = own.gaps(&cloud.buckets, buckets.clone());
            for (bucket, gap) in buckets.zip(gaps) {
                if gap <= limit && !family.contains(&bucket) {
                    look_at(simd, cloud, bucket, at, seen);
                    limit = seen.limit(simd);
                }
            }
        }
    }
}

#[inline(always)]
fn look_at<S: Simd>(simd: S, cloud: &Buckets, bucket: usize, at: [S::f64s; 3], seen: &mut impl Seen<S>) {
    let [x, y, z] = &cloud.coordinates;
    let places = bucket * BUCKET..(bucket + 1) * BUCKET;
    for ((x, y), z) in x[places.clone()].iter().zip(&y[places.clone()]).zip(&z[places]) {
        let x = simd.sub_f64s(simd.splat_f64s(*x), at[0]);
        let y = simd.sub_f64s(simd.splat_f64s(*y), at[1]);
        let z = simd.sub_f64s(simd.splat_f64s(*z), at[2]);
        let squared = simd.add_f64s(simd.mul_f64s(x, x), simd.mul_f64s(y, y));
        seen.see(simd, simd.add_f64s(squared, simd.mul_f64s(z, z)));
    }
}

/// The box around those points of a vector that are not lost \[m\].
struct OwnBox {
    low: [f64; 3],
    high: [f64; 3],
}

impl OwnBox {
    #[inline(always)]
    fn around(cloud: &Buckets, places: Range<usize>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for axis in 0..3 {
            for c in &cloud.coordinates[axis][places.clone()] {
                low[axis] = if *c < low[axis] { *c } else { low[axis] };
                high[axis] = if *c > high[axis] && *c < f64::INFINITY { *c } else { high[axis] };
            }
        }
        Self { low, high }
    }

    /// Squared distances to some boxes, at most as many as make a block \[m^2\].
    #[inline(always)]
    fn gaps(&self, boxes: &Boxes, some: Range<usize>) -> [f64; BLOCK] {
        let mut squared = [0.0; BLOCK];
        for axis in 0..3 {
            let (low, high) = (&boxes.low[axis][some.clone()], &boxes.high[axis][some.clone()]);
            for ((squared, low), high) in squared.iter_mut().zip(low).zip(high) {
                let gap = larger(larger(low - self.high[axis], self.low[axis] - high), 0.0);
                *squared += gap * gap;
            }
        }
        squared
    }
}

#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
