//! Lists of points by the cell of a cubic grid that they lie in, on a hash of the cells.

use super::Point3;

/// No number of a cell.
pub(super) const NONE: u32 = u32::MAX;
/// The end of a list of points.
pub(super) const END: u32 = u32::MAX - 1;
/// Bits of a coordinate in a key.
const BITS: u32 = 21;
const OFFSET: f64 = (1_u32 << (BITS - 1)) as f64;
/// Cells so near the edge of what a key can name have no neighbours there, and points in them are left out.
const EDGE: f64 = 2.0;

/// A cell of the absolute grid: three coordinates in one number.
pub(super) type Key = u64;

/// The cell of a point; none where it is no number or farther away than keys reach, a million cells.
pub(super) fn key(point: &Point3, cells_per_m: f64) -> Option<Key> {
    let part = |value: f64| {
        let cell = (value * cells_per_m).floor() + OFFSET;
        (EDGE..2.0 * OFFSET - EDGE).contains(&cell).then_some(cell as u64)
    };
    Some(part(point.x)? | part(point.y)? << BITS | part(point.z)? << (2 * BITS))
}

/// The 27 cells around and with `key`.
pub(super) fn around(key: Key) -> impl Iterator<Item = Key> {
    const STEPS: [i64; 3] = [-1, 0, 1];
    let steps = STEPS.into_iter().flat_map(|z| STEPS.into_iter().flat_map(move |y| STEPS.map(move |x| [x, y, z])));
    steps.map(move |[x, y, z]| key.wrapping_add_signed(x + (y << BITS) + (z << (2 * BITS))))
}

/// A number by cell: open addressing, never in the order of its hash.
#[derive(Debug, Clone, Default)]
pub(super) struct CellTable {
    slots: Vec<(Key, u32)>,
    used: usize,
}

impl CellTable {
    /// Forgets all cells, and makes room for `cells` of them.
    pub(super) fn clear(&mut self, cells: usize) {
        let slots = (2 * cells).next_power_of_two().max(64);
        self.slots.clear();
        self.slots.resize(slots, (0, NONE));
        self.used = 0;
    }

    /// The number of a cell.
    pub(super) fn get(&self, key: Key) -> Option<u32> {
        let (_, number) = self.slots.get(self.slot(key))?;
        (*number != NONE).then_some(*number)
    }

    /// The number of a cell, to be changed.
    pub(super) fn get_mut(&mut self, key: Key) -> Option<&mut u32> {
        let slot = self.slot(key);
        let (_, number) = self.slots.get_mut(slot)?;
        (*number != NONE).then_some(number)
    }

    /// Puts point `i` at the head of a cell's list; returns the one that was there, [`END`] if there was none.
    pub(super) fn push(&mut self, key: Key, i: u32) -> u32 {
        let head = self.entry(key);
        let before = if *head == NONE { END } else { *head };
        *head = i;
        before
    }

    /// Where the number of a cell stands, [`NONE`] if it has none yet: to be set to another one.
    pub(super) fn entry(&mut self, key: Key) -> &mut u32 {
        if 2 * (self.used + 1) > self.slots.len() {
            self.grow();
        }
        let slot = self.slot(key);
        self.used += usize::from(self.slots[slot].1 == NONE);
        self.slots[slot].0 = key;
        &mut self.slots[slot].1
    }

    fn grow(&mut self) {
        let all = std::mem::take(&mut self.slots);
        self.clear(all.len().max(32));
        for (key, number) in all.into_iter().filter(|(_, number)| *number != NONE) {
            *self.entry(key) = number;
        }
    }

    /// The slot with `key`, or the free one where it belongs.
    fn slot(&self, key: Key) -> usize {
        if self.slots.is_empty() {
            return 0;
        }
        let mask = self.slots.len() - 1;
        // Fibonacci hashing: the high bits of the product are mixed best.
        let mut slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & mask;
        while self.slots[slot].1 != NONE && self.slots[slot].0 != key {
            slot = (slot + 1) & mask;
        }
        slot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_gives_back_what_was_put_in_however_much_it_grows() {
        let mut table = CellTable::default();
        assert_eq!(table.get(3), None);
        for i in 0..5_000_u32 {
            *table.entry(u64::from(i) * 977) = i;
        }
        assert!((0..5_000).all(|i| table.get(u64::from(i) * 977) == Some(i)));
        assert_eq!(table.get(1), None);
        table.clear(10);
        assert_eq!(table.get(977), None);
    }

    #[test]
    fn neighbours_of_a_cell_are_the_cells_of_points_beside_it() {
        let at = |x: f64, y: f64, z: f64| key(&Point3 { x, y, z }, 10.0).unwrap();
        let middle = at(-0.05, 0.25, 0.0);
        let mut around: Vec<_> = around(middle).collect();
        let mut expected: Vec<_> = (0..27)
            .map(|i| [i % 3, i / 3 % 3, i / 9].map(|step| 0.1 * f64::from(step - 1)))
            .map(|[x, y, z]| at(-0.05 + x, 0.25 + y, 0.05 + z))
            .collect();
        around.sort_unstable();
        expected.sort_unstable();
        assert_eq!(around, expected);
    }

    #[test]
    fn what_is_no_place_has_no_cell() {
        for x in [f64::NAN, f64::INFINITY, -1e9] {
            assert_eq!(key(&Point3 { x, y: 0.0, z: 0.0 }, 10.0), None);
        }
    }
}
