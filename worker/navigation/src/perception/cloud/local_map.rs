//! The plant points around the robot, one per voxel, and their clusters: the local map of Vintu (2018), section 3.3.4.
//!
//! Clusters are kept from scan to scan: a new point joins the clusters it is near to. They are those that [`Clusters`](super::Clusters) finds
//! from nothing, but that points which have left the window keep joined what they joined (ours).
//!
//! Deviation: a voxel's point is the centroid of the points of the scan that first filled it, and later scans, redundant there, change
//! nothing; the library would average again. What has left the window, or was last seen too long ago for the robot's pose to be trusted
//! (ours), is dropped every ten scans.

use super::Point3;
use super::cells::{CellTable, END, Key, NONE, around, key};
use crate::Pose;

/// Scans from one sweep to the next.
const SWEEP_SCANS: u32 = 10;

/// A plant, or several that touch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cluster {
    /// Points, of a voxel each.
    pub size: u32,
    /// Mean of its points, in the odometry's frame \[m\].
    pub centroid: Point3,
    /// Whether the last scan hit it. Where others are is as old as their last points, and as wrong as the odometry since.
    pub is_seen: bool,
}

/// The map.
#[derive(Debug, Clone)]
pub struct LocalMap {
    window_m: f64,
    /// Scans after which a point that was not seen again is dropped.
    memory: u32,
    tolerance_m: f64,
    voxels_per_m: f64,
    /// In the odometry's frame; the oldest first.
    points: Vec<Point3>,
    /// Points of the scan that filled a voxel.
    counts: Vec<u32>,
    /// The last scan with a point in a voxel.
    seen: Vec<u32>,
    /// Another point of the same cluster, itself in the end.
    parents: Vec<u32>,
    /// The point of each voxel.
    voxels: CellTable,
    voxel_of: Vec<Key>,
    /// Lists of points by cells as large as the tolerance.
    cells: CellTable,
    cell_of: Vec<Key>,
    next: Vec<u32>,
    /// The present scan.
    scan: u32,
    /// By root: the point that stands for its cluster when others are dropped, or the cluster's number.
    heirs: Vec<u32>,
    clusters: Vec<Cluster>,
}

impl LocalMap {
    /// An empty map with voxels of `voxel_m`, reaching `window_m` from the robot and `memory` scans back; points are linked over
    /// `tolerance_m`.
    #[must_use]
    pub fn new(voxel_m: f64, (window_m, memory): (f64, u32), tolerance_m: f64) -> Self {
        Self {
            window_m,
            memory,
            tolerance_m,
            voxels_per_m: 1.0 / voxel_m,
            points: Vec::new(),
            counts: Vec::new(),
            seen: Vec::new(),
            parents: Vec::new(),
            voxels: CellTable::default(),
            voxel_of: Vec::new(),
            cells: CellTable::default(),
            cell_of: Vec::new(),
            next: Vec::new(),
            scan: 0,
            heirs: Vec::new(),
            clusters: Vec::new(),
        }
    }

    /// Adds the points of a scan \[m\], given in the robot's frame; those beyond the window, or no numbers, are left out.
    pub fn insert(&mut self, points: &[Point3], odometry_from_robot: Pose) {
        if !odometry_from_robot.is_finite() {
            return;
        }
        self.scan += 1;
        if self.scan.is_multiple_of(SWEEP_SCANS) {
            self.sweep(odometry_from_robot);
        }
        let first = self.points.len();
        let to_odometry = odometry_from_robot.worlds();
        let square = self.window_m * self.window_m;
        for point in points.iter().filter(|point| point.x * point.x + point.y * point.y <= square) {
            let [x, y] = to_odometry(point.x, point.y);
            self.fill(Point3 { x, y, z: point.z }, first);
        }
        for i in first..self.points.len() {
            let n = f64::from(self.counts[i]);
            let Point3 { x, y, z } = self.points[i];
            self.points[i] = Point3 { x: x / n, y: y / n, z: z / n };
            self.enlist(i);
            self.link(i);
        }
    }

    /// Adds a point to its voxel, unless an earlier scan did; points of this scan are summed up.
    fn fill(&mut self, point: Point3, first: usize) {
        let Some(voxel) = key(&point, self.voxels_per_m) else { return };
        let new = self.points.len() as u32;
        let number = self.voxels.entry(voxel);
        if *number == NONE {
            *number = new;
            self.points.push(point);
            self.counts.push(1);
            self.seen.push(self.scan);
            self.parents.push(new);
            self.voxel_of.push(voxel);
        } else if *number as usize >= first {
            let i = *number as usize;
            let Point3 { x, y, z } = self.points[i];
            self.points[i] = Point3 { x: x + point.x, y: y + point.y, z: z + point.z };
            self.counts[i] += 1;
        } else {
            self.seen[*number as usize] = self.scan;
        }
    }

    /// Puts a point into the list of its cell.
    fn enlist(&mut self, i: usize) {
        let cell = key(&self.points[i], 1.0 / self.tolerance_m).unwrap_or_default();
        let next = self.cells.push(cell, i as u32);
        self.cell_of.push(cell);
        self.next.push(next);
    }

    /// Joins the clusters that a point is near to.
    fn link(&mut self, i: usize) {
        let (point, square) = (self.points[i], self.tolerance_m * self.tolerance_m);
        for cell in around(self.cell_of[i]) {
            let mut other = self.cells.get(cell).unwrap_or(END);
            while other != END {
                if point.squared_distance(&self.points[other as usize]) <= square {
                    self.join(i as u32, other);
                }
                other = self.next[other as usize];
            }
        }
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (root(&mut self.parents, a), root(&mut self.parents, b));
        // The older point stands for the cluster.
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// Drops what has left the window, or is too old.
    fn sweep(&mut self, robot: Pose) {
        let squared = |x: f64, y: f64| (x - robot.x_m) * (x - robot.x_m) + (y - robot.y_m) * (y - robot.y_m);
        let (square, oldest) = (self.window_m * self.window_m, self.scan.saturating_sub(self.memory));
        let stays = |point: &Point3, seen: u32| seen >= oldest && squared(point.x, point.y) <= square;
        if self.points.iter().zip(&self.seen).any(|(point, seen)| !stays(point, *seen)) {
            self.retain(stays);
        }
    }

    /// Keeps some of the points; the oldest of those left stands for its cluster.
    fn retain(&mut self, stays: impl Fn(&Point3, u32) -> bool) {
        let mut kept = 0;
        self.heirs.clear();
        self.heirs.resize(self.points.len(), NONE);
        for i in 0..self.points.len() {
            let root = root(&mut self.parents, i as u32) as usize;
            if !stays(&self.points[i], self.seen[i]) {
                continue;
            }
            if self.heirs[root] == NONE {
                self.heirs[root] = kept as u32;
            }
            // Roots are read through `parents` up to here only, and points move to the front.
            self.points[kept] = self.points[i];
            self.seen[kept] = self.seen[i];
            self.voxel_of[kept] = self.voxel_of[i];
            self.cell_of[kept] = self.cell_of[i];
            self.next[kept] = self.heirs[root];
            kept += 1;
        }
        self.points.truncate(kept);
        self.counts.truncate(kept);
        self.seen.truncate(kept);
        self.voxel_of.truncate(kept);
        self.cell_of.truncate(kept);
        self.parents.clear();
        self.parents.extend_from_slice(&self.next[..kept]);
        self.index();
    }

    /// Both tables and the lists, anew.
    fn index(&mut self) {
        self.voxels.clear(self.points.len());
        self.cells.clear(self.points.len());
        self.next.clear();
        for i in 0..self.points.len() {
            *self.voxels.entry(self.voxel_of[i]) = i as u32;
            self.next.push(self.cells.push(self.cell_of[i], i as u32));
        }
    }

    /// Clusters of at least `min_size` points: the largest first, of equal ones that with the oldest point.
    pub fn clusters(&mut self, min_size: u32) -> &[Cluster] {
        self.clusters.clear();
        self.heirs.clear();
        for (i, point) in self.points.iter().enumerate() {
            let root = root(&mut self.parents, i as u32) as usize;
            // A root is older than all of its cluster.
            let number = if root == i { self.clusters.len() as u32 } else { self.heirs[root] };
            if root == i {
                self.clusters.push(Cluster { size: 0, centroid: Point3::default(), is_seen: false });
            }
            self.heirs.push(number);
            let Cluster { size, centroid: Point3 { x, y, z }, is_seen } = &mut self.clusters[number as usize];
            (*size, *x, *y, *z) = (*size + 1, *x + point.x, *y + point.y, *z + point.z);
            *is_seen |= self.seen[i] == self.scan;
        }
        self.clusters.retain(|cluster| cluster.size >= min_size);
        for Cluster { size, centroid: Point3 { x, y, z }, .. } in &mut self.clusters {
            let n = f64::from(*size);
            (*x, *y, *z) = (*x / n, *y / n, *z / n);
        }
        self.clusters.sort_by_key(|cluster| std::cmp::Reverse(cluster.size));
        &self.clusters
    }

    /// All points, in the odometry's frame \[m\], the oldest first.
    #[must_use]
    pub fn points(&self) -> &[Point3] {
        &self.points
    }
}

/// The point that stands for the cluster of point `i`; halves the way there.
fn root(parents: &mut [u32], mut i: u32) -> u32 {
    while parents[i as usize] != i {
        let parent = parents[i as usize];
        parents[i as usize] = parents[parent as usize];
        i = parent;
    }
    i
}

#[cfg(test)]
mod tests {
    use super::super::Clusters;
    use super::*;
    use crate::random::Stream;
    use proptest::prelude::*;

    /// Sizes and centroids in order, as `Clusters` finds them from nothing; all of them seen.
    fn from_nothing(points: &[Point3], tolerance_m: f64, min_size: u32) -> Vec<Cluster> {
        let mut clusters = Clusters::default();
        let found = clusters.find(points, tolerance_m, min_size).map(|indices| {
            let mut indices = indices.to_vec();
            indices.sort_unstable();
            let mut sum = Cluster { size: indices.len() as u32, centroid: Point3::default(), is_seen: true };
            for i in &indices {
                let point = points[*i as usize];
                let Point3 { x, y, z } = sum.centroid;
                sum.centroid = Point3 { x: x + point.x, y: y + point.y, z: z + point.z };
            }
            let (n, Point3 { x, y, z }) = (f64::from(sum.size), sum.centroid);
            Cluster { centroid: Point3 { x: x / n, y: y / n, z: z / n }, ..sum }
        });
        found.collect()
    }

    proptest! {
        #[test]
        fn clusters_are_those_found_from_nothing_as_long_as_nothing_is_dropped(seed in any::<u64>(), tolerance_m in 0.04..0.25_f64) {
            let mut random = Stream::new(seed, "map");
            let mut map = LocalMap::new(0.03, (9.0, 99), tolerance_m);
            let mut pose = Pose::default();
            for _ in 0..20 {
                pose = pose.moved(random.between(-0.1, 0.2), random.between(-0.5, 0.5));
                let mut point = || Point3 { x: random.between(-1.3, 1.3), y: random.between(-1.3, 1.3), z: random.between(0.0, 0.2) };
                let scan: Vec<_> = (0..60).map(|_| point()).collect();
                map.insert(&scan, pose);
                let expected = from_nothing(map.points(), tolerance_m, 2);
                let found: Vec<_> = map.clusters(2).iter().map(|cluster| Cluster { is_seen: true, ..*cluster }).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }

    /// Posts a metre apart, driven along: each is whole or gone.
    #[test]
    fn posts_stay_clusters_of_their_own_while_others_are_dropped() {
        let mut map = LocalMap::new(0.03, (3.0, 999), 0.06);
        for i in 0..400 {
            let x_m = 0.05 * f64::from(i);
            let posts = (0..20).map(f64::from).filter(|x| (x - x_m).abs() < 3.0);
            let scan: Vec<_> = posts
                .flat_map(|x| (0..40).map(move |k| Point3 { x: x - x_m, y: 0.6, z: 0.015 + 0.03 * f64::from(k) }))
                .collect();
            map.insert(&scan, Pose { x_m, ..Pose::default() });
            let clusters = map.clusters(2);
            assert!(clusters.iter().all(|cluster| cluster.size == 40), "{clusters:?}");
            assert!(clusters.iter().all(|cluster| (cluster.centroid.x - cluster.centroid.x.round()).abs() < 1e-9));
            assert!(clusters.iter().all(|cluster| cluster.is_seen == ((cluster.centroid.x - x_m).abs() < 3.0)));
        }
        assert!((2..=4).contains(&map.clusters(2).len()));
    }

    #[test]
    fn a_voxel_holds_the_centroid_of_the_scan_that_filled_it() {
        let mut map = LocalMap::new(0.1, (6.0, 99), 0.2);
        let at = |x: f64| Point3 { x, y: 0.05, z: 0.05 };
        map.insert(&[at(1.02), at(1.06), at(2.0)], Pose::default());
        map.insert(&[at(1.09)], Pose::default());
        assert_eq!(map.points(), [at(1.04), at(2.0)]);
    }

    #[test]
    fn what_the_robot_leaves_behind_is_dropped_and_what_is_no_number_never_comes_in() {
        let mut map = LocalMap::new(0.03, (6.0, 99), 0.06);
        let post = [Point3 { x: 1.0, y: 0.0, z: 0.5 }, Point3 { x: f64::NAN, y: 0.0, z: 0.0 }];
        for i in 0..200 {
            map.insert(&post, Pose { x_m: 0.1 * f64::from(i), ..Pose::default() });
            map.insert(&post, Pose { x_m: f64::NAN, ..Pose::default() });
        }
        assert!((60..90).contains(&map.points().len()), "{}", map.points().len());
        assert!(map.points().iter().all(|point| point.x > 19.9 - 6.6));
    }
}
