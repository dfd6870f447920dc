//! Euclidean clusters, as the point cloud library makes them: points within the tolerance of each other are of one cluster.

use super::Point3;
use super::cells::{CellTable, END, Key, around, key};

/// Finds clusters, and keeps the room that it takes.
#[derive(Debug, Clone, Default)]
pub struct Clusters {
    /// Lists of the points that are in no cluster yet.
    cells: CellTable,
    next: Vec<u32>,
    /// The cell of each point; none of what is no number.
    keys: Vec<Option<Key>>,
    taken: Vec<bool>,
    /// Points, cluster by cluster.
    order: Vec<u32>,
    /// From, to in `order`.
    found: Vec<[usize; 2]>,
}

impl Clusters {
    /// Clusters of at least `min_size` points, each at most `tolerance_m` from another one.
    ///
    /// The largest come first, of equal ones that with the first point. Points that are no numbers belong to none.
    pub fn find(
        &mut self,
        points: &[Point3],
        tolerance_m: f64,
        min_size: u32,
    ) -> impl DoubleEndedIterator<Item = &[u32]> {
        self.sort_in(points, tolerance_m);
        self.order.clear();
        self.found.clear();
        for seed in 0..points.len() {
            let Some(cell) = self.keys[seed].filter(|_| !self.taken[seed]) else { continue };
            let from = self.order.len();
            self.unlink(cell, seed as u32);
            self.grow(points, seed as u32, tolerance_m * tolerance_m);
            if self.order.len() - from >= min_size as usize {
                self.found.push([from, self.order.len()]);
            }
        }
        self.found.sort_by_key(|[from, to]| std::cmp::Reverse(to - from));
        self.found.iter().map(|[from, to]| &self.order[*from..*to])
    }

    fn sort_in(&mut self, points: &[Point3], tolerance_m: f64) {
        self.cells.clear(points.len());
        self.keys.clear();
        self.next.clear();
        self.taken.clear();
        self.taken.resize(points.len(), false);
        for (i, point) in points.iter().enumerate() {
            let key = key(point, 1.0 / tolerance_m);
            self.keys.push(key);
            self.next.push(key.map_or(END, |key| self.cells.push(key, i as u32)));
        }
    }

    /// Takes a point out of its cell's list.
    fn unlink(&mut self, cell: Key, point: u32) {
        let Some(head) = self.cells.get_mut(cell) else { return };
        if *head == point {
            *head = self.next[point as usize];
            return;
        }
        let mut before = *head as usize;
        while self.next[before] != point {
            before = self.next[before] as usize;
        }
        self.next[before] = self.next[point as usize];
    }

    /// Appends to `order` the cluster of `seed`, breadth first.
    fn grow(&mut self, points: &[Point3], seed: u32, square: f64) {
        let mut at = self.order.len();
        self.order.push(seed);
        while let Some(i) = self.order.get(at).copied() {
            at += 1;
            let point = &points[i as usize];
            for cell in self.keys[i as usize].into_iter().flat_map(around) {
                self.take_near(points, point, cell, square);
            }
        }
    }

    /// Moves the points of `cell` that are near `point` from the cell's list to `order`.
    fn take_near(&mut self, points: &[Point3], point: &Point3, cell: Key, square: f64) {
        let Some(head) = self.cells.get_mut(cell) else { return };
        let (mut before, mut i) = (END, *head);
        while i != END {
            let (other, after) = (&points[i as usize], self.next[i as usize]);
            if point.squared_distance(other) <= square {
                self.order.push(i);
                self.taken[i as usize] = true;
                if before == END {
                    *head = after;
                } else {
                    self.next[before as usize] = after;
                }
            } else {
                before = i;
            }
            i = after;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// By comparing each point with each other one.
    fn brute_force(points: &[Point3], tolerance_m: f64, min_size: usize) -> Vec<Vec<u32>> {
        let mut label: Vec<usize> = (0..points.len()).collect();
        for i in 0..points.len() {
            for j in 0..i {
                if points[i].squared_distance(&points[j]) <= tolerance_m * tolerance_m {
                    let (a, b) = (label[i], label[j]);
                    label.iter_mut().filter(|label| **label == a.max(b)).for_each(|label| *label = a.min(b));
                }
            }
        }
        let of = |seed: usize| (0..points.len()).filter(|i| label[*i] == seed).map(|i| i as u32).collect::<Vec<_>>();
        let mut clusters: Vec<_> =
            (0..points.len()).map(of).filter(|cluster| !cluster.is_empty() && cluster.len() >= min_size).collect();
        clusters.sort_by_key(|cluster| std::cmp::Reverse(cluster.len()));
        clusters
    }

    proptest! {
        #[test]
        fn clusters_are_those_of_comparing_all_with_all(
            points in prop::collection::vec((-0.5..0.5_f64, -0.5..0.5_f64, 0.0..0.2_f64), 0..120),
            tolerance_m in 0.02..0.3_f64,
            min_size in 1..5_u32,
        ) {
            let mut points: Vec<_> = points.into_iter().map(|(x, y, z)| Point3 { x, y, z }).collect();
            points.extend(points.first().copied());
            let mut clusters = Clusters::default();
            let found: Vec<Vec<u32>> = clusters.find(&points, tolerance_m, min_size).map(|cluster| {
                let mut cluster = cluster.to_vec();
                cluster.sort_unstable();
                cluster
            }).collect();
            prop_assert_eq!(found, brute_force(&points, tolerance_m, min_size as usize));
        }
    }

    #[test]
    fn points_at_the_tolerance_belong_together_and_those_that_are_no_numbers_to_nothing() {
        let at = |x: f64| Point3 { x, y: 0.0, z: 0.0 };
        let points = [at(0.0), at(f64::NAN), at(0.25), at(0.5), at(0.76)];
        let mut clusters = Clusters::default();
        let found: Vec<Vec<u32>> = clusters.find(&points, 0.25, 1).map(<[u32]>::to_vec).collect();
        assert_eq!(found, [vec![0, 2, 3], vec![4]]);
    }
}
