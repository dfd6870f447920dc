//! Points in small buckets of near ones, for searches of neighbours.

use super::Point3;

/// Points in a bucket: whole vectors of any machine.
pub(super) const BUCKET: usize = 8;
/// Buckets in a block.
pub(super) const BLOCK: usize = 8;

/// The points of a cloud, split in halves across its longest side again and again down to buckets of [`BUCKET`] points.
#[derive(Debug, Default)]
pub(super) struct Buckets {
    /// Coordinates, bucket after bucket \[m\]; infinite where the last bucket has no more points.
    pub(super) coordinates: [Vec<f64>; 3],
    /// What contains each bucket.
    pub(super) buckets: Boxes,
    /// What contains each [`BLOCK`] of buckets.
    pub(super) blocks: Boxes,
    /// Which point each one is, below a key that it is sorted by.
    order: Vec<u64>,
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
        halve(&mut self.order, points);
        for (axis, coordinates) in self.coordinates.iter_mut().enumerate() {
            coordinates.clear();
            coordinates.extend(self.order.iter().map(|key| coordinate(&points[index(*key)], axis)));
            coordinates.resize(points.len().next_multiple_of(BUCKET), f64::INFINITY);
        }
        self.buckets.contain(&self.coordinates, BUCKET);
        self.blocks.contain(&self.coordinates, BUCKET * BLOCK);
    }

    /// How many points there are.
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

fn halve(order: &mut [u64], points: &[Point3]) {
    if order.len() <= BUCKET {
        return;
    }
    let axis = longest_side(order, points);
    for key in order.iter_mut() {
        *key = sortable(coordinate(&points[index(*key)], axis)) | (*key & u64::from(u32::MAX));
    }
    let middle = order.len().div_ceil(BUCKET).next_power_of_two() / 2 * BUCKET;
    order.select_nth_unstable(middle);
    let (below, above) = order.split_at_mut(middle);
    halve(below, points);
    halve(above, points);
}

fn longest_side(order: &[u64], points: &[Point3]) -> usize {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for key in order {
        let point = &points[index(*key)];
        for (axis, c) in [point.x, point.y, point.z].into_iter().enumerate() {
            low[axis] = if c < low[axis] { c } else { low[axis] };
            high[axis] = if c > high[axis] { c } else { high[axis] };
        }
    }
    let [x, y, z] = [high[0] - low[0], high[1] - low[1], high[2] - low[2]];
    if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) }
}

/// A coordinate's order in the upper half of a key. Single precision will do: the boxes are of what came of it.
fn sortable(coordinate_m: f64) -> u64 {
    let bits = (coordinate_m as f32).to_bits();
    let sign = (bits as i32 >> 31) as u32;
    u64::from(bits ^ (sign | 0x8000_0000)) << 32
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
