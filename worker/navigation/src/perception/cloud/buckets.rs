//! Points in small buckets of near ones, for searches of neighbours.

use pulp::Simd;

use super::Point3;

/// Points in a bucket: whole vectors of any machine.
pub(super) const BUCKET: usize = 8;
/// Buckets in a block.
pub(super) const BLOCK: usize = 8;

/// The points of a cloud, split in halves across its longest side again and again down to buckets of [`BUCKET`] points.
#[derive(Debug, Default)]
pub(super) struct Buckets {
    /// Coordinates, bucket after bucket \[m\]; infinite for lost points, and where the last bucket has no more.
    pub(super) coordinates: [Vec<f64>; 3],
    /// What contains each bucket.
    pub(super) buckets: Boxes,
    /// What contains each [`BLOCK`] of buckets.
    pub(super) blocks: Boxes,
    /// Which point each one is, below a key that it is sorted by.
    order: Vec<u64>,
    /// The points in single precision, which is enough to sort by: the boxes are of what came of it.
    coarse: Vec<[f32; 4]>,
}

/// Boxes along the axes \[m\].
#[derive(Debug, Default)]
pub(super) struct Boxes {
    pub(super) low: [Vec<f64>; 3],
    pub(super) high: [Vec<f64>; 3],
}

impl Buckets {
    /// Sorts `points`, all of which are finite.
    pub(super) fn sort(&mut self, points: &[Point3]) {
        self.order.clear();
        self.order.extend(0..points.len() as u64);
        self.coarse.clear();
        self.coarse.extend(points.iter().map(|point| [point.x as f32, point.y as f32, point.z as f32, 0.0]));
        halve(&mut self.order, &self.coarse);
        for (axis, coordinates) in self.coordinates.iter_mut().enumerate() {
            coordinates.clear();
            coordinates.extend(self.order.iter().map(|key| coordinate(&points[index(*key)], axis)));
            coordinates.resize(points.len().next_multiple_of(BUCKET), f64::INFINITY);
        }
        self.buckets.contain(&self.coordinates, BUCKET);
        self.blocks.contain(&self.coordinates, BUCKET * BLOCK);
    }

    /// Takes the point at `place` out of all searches.
    pub(super) fn lose(&mut self, place: usize) {
        self.coordinates.iter_mut().for_each(|coordinates| coordinates[place] = f64::INFINITY);
    }

    pub(super) fn is_lost(&self, place: usize) -> bool {
        self.coordinates[0][place] == f64::INFINITY
    }

    /// The points of the vector that begins at `first`.
    #[inline(always)]
    pub(super) fn vector<S: Simd>(&self, first: usize) -> [S::f64s; 3] {
        let at = first / S::F64_LANES;
        let [x, y, z] = &self.coordinates;
        [S::as_simd_f64s(x).0[at], S::as_simd_f64s(y).0[at], S::as_simd_f64s(z).0[at]]
    }

    /// Which of them there are.
    #[inline(always)]
    pub(super) fn present<S: Simd>(&self, simd: S, first: usize) -> S::m64s {
        simd.less_than_f64s(self.vector::<S>(first)[0], simd.splat_f64s(f64::INFINITY))
    }

    /// How many points were sorted.
    pub(super) fn len(&self) -> usize {
        self.order.len()
    }

    /// Which of the points that were sorted stands at `place`.
    #[inline(always)]
    pub(super) fn index(&self, place: usize) -> usize {
        index(self.order[place])
    }
}

impl Boxes {
    pub(super) fn len(&self) -> usize {
        self.low[0].len()
    }

    fn contain(&mut self, coordinates: &[Vec<f64>; 3], each: usize) {
        for ((low, high), coordinates) in self.low.iter_mut().zip(&mut self.high).zip(coordinates) {
            low.clear();
            high.clear();
            for some in coordinates.chunks(each) {
                low.push(some.iter().fold(f64::INFINITY, |low, c| if *c < low { *c } else { low }));
                let finite = some.iter().filter(|c| c.is_finite());
                high.push(finite.fold(f64::NEG_INFINITY, |high, c| if *c > high { *c } else { high }));
            }
        }
    }
}

fn halve(order: &mut [u64], coarse: &[[f32; 4]]) {
    if order.len() <= BUCKET {
        return;
    }
    let axis = longest_side(order, coarse);
    for key in order.iter_mut() {
        *key = sortable(coarse[index(*key)][axis]) | (*key & u64::from(u32::MAX));
    }
    let middle = order.len().div_ceil(BUCKET).next_power_of_two() / 2 * BUCKET;
    order.select_nth_unstable(middle);
    let (below, above) = order.split_at_mut(middle);
    halve(below, coarse);
    halve(above, coarse);
}

fn longest_side(order: &[u64], coarse: &[[f32; 4]]) -> usize {
    let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
    for key in order {
        let point = coarse[index(*key)];
        for axis in 0..4 {
            low[axis] = if point[axis] < low[axis] { point[axis] } else { low[axis] };
            high[axis] = if point[axis] > high[axis] { point[axis] } else { high[axis] };
        }
    }
    let [x, y, z] = [high[0] - low[0], high[1] - low[1], high[2] - low[2]];
    if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) }
}

/// A coordinate's order in the upper half of a key.
const fn sortable(coordinate_m: f32) -> u64 {
    let bits = coordinate_m.to_bits();
    let sign = (bits as i32 >> 31) as u32;
    ((bits ^ (sign | 0x8000_0000)) as u64) << 32
}

#[inline(always)]
fn index(key: u64) -> usize {
    key as u32 as usize
}

#[inline(always)]
const fn coordinate(point: &Point3, axis: usize) -> f64 {
    match axis {
        0 => point.x,
        1 => point.y,
        _ => point.z,
    }
}
