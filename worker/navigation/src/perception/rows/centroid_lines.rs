//! Lines through the centroids of plants that the last scans showed.
//!
//! Vintu (2018), section 3.3.3. Silent there, ours: the queue is kept in the odometry's frame; a plant that is seen again
//! stays one plant, else a few scans of the same plants would fill the queue; what was not seen for some seconds is
//! forgotten; of the plants of one scan those of the fewest points leave first. A group of the second
//! clustering that is too wide for one row, as in plantings as wide as they are long, is divided at the robot's heading; of each side the
//! largest group counts, and its line is found by random sampling, as in `pcl-lines`.

use std::collections::VecDeque;

use super::{DetectedRows, PlantPoints, RowDetector, RowLine};
use crate::Pose;
use crate::localization::PlantingMap;
use crate::perception::cloud::line::LineSearch;
use crate::perception::cloud::{Clusters, Point3};
use crate::random::Stream;

super::row_parameters! {
    /// Parameters of [`CentroidLines`].
    pub struct CentroidLinesParams {
        /// Centroids that are kept. Paper: 20, table 4.5.
        pub cluster_limit: u32 = 20, "1", [2, 10000];
        /// Points of one plant are linked over gaps up to this. Paper: 0.1, table 4.5.
        pub cluster_tolerance_m: f64 = 0.1, "m", [0.001, 5.0];
        /// Points of a plant at least. Paper: 10, table 4.5.
        pub min_cluster_size: u32 = 10, "1", [1, 10000];
        /// A centroid nearer than this to a line supports it. Ours: as in `pcl-lines`.
        pub dist_threshold_m: f64 = 0.3, "m", [0.001, 5.0];
        /// Pairs of centroids that are tried per line at most. Ours: as in `pcl-lines`.
        pub max_iteration: u32 = 20, "1", [1, 10000];
        /// Plants of one row are linked over gaps up to so many planting distances. Ours: two plants may be missing.
        pub row_tolerance: f64 = 3.0, "1", [0.1, 100.0];
        /// A centroid nearer than so many planting distances to an earlier one is of the same plant. Ours.
        pub same_plant: f64 = 0.25, "1", [0.0, 1.0];
        /// Scans after which a centroid that was not seen again is forgotten. Ours: as in `map-lines`.
        pub memory_scans: u32 = 50, "1", [1, 100_000];
    }
}

/// Plants of one row lie this near to its line, as a share of the row distance.
const ROW_HALF_WIDTH: f64 = 0.25;

/// A centroid in the odometry's frame \[m\], and the scan that it was last seen in.
#[derive(Debug, Clone, Copy)]
struct Seen {
    at: [f64; 2],
    scan: u64,
}

/// The detector.
#[derive(Debug, Clone)]
pub struct CentroidLines {
    params: CentroidLinesParams,
    row_tolerance_m: f64,
    same_plant_m: f64,
    row_distance_m: f64,
    clusters: Clusters,
    search: LineSearch,
    /// Centroids on the ground, the oldest first.
    queue: VecDeque<Seen>,
    /// Scans so far.
    scans: u64,
    /// The same in the robot's frame, without heights.
    centroids: Vec<Point3>,
    /// Which of them are of the left and of the right row.
    sides: [Vec<u32>; 2],
    group: [Vec<u32>; 2],
    /// Those of the left and of the right row.
    plants: [Vec<[f64; 2]>; 2],
    /// Of these what this scan hit: others stand where odometry has carried them.
    supports: [Vec<[f64; 2]>; 2],
}

impl CentroidLines {
    /// A detector for plants as far apart as those of `map`.
    #[must_use]
    pub fn new(params: CentroidLinesParams, map: &PlantingMap) -> Self {
        Self {
            row_tolerance_m: params.row_tolerance * map.planting_distance_m,
            same_plant_m: params.same_plant * map.planting_distance_m,
            params,
            row_distance_m: map.row_distance_m,
            clusters: Clusters::default(),
            search: LineSearch::default(),
            queue: VecDeque::new(),
            scans: 0,
            centroids: Vec::new(),
            sides: Default::default(),
            group: Default::default(),
            plants: Default::default(),
            supports: Default::default(),
        }
    }

    /// Adds the plants of a scan to the queue, that of the most points last, so that it stays longest. A plant seen again
    /// takes the place of what was seen of it before.
    fn remember(&mut self, view: PlantPoints<'_>) {
        let CentroidLinesParams { cluster_tolerance_m, min_cluster_size, cluster_limit, memory_scans, .. } =
            self.params;
        for cluster in self.clusters.find(view.points, cluster_tolerance_m, min_cluster_size).rev() {
            let n = cluster.len() as f64;
            let sum = cluster.iter().map(|i| &view.points[*i as usize]);
            let [x, y] = sum.fold([0.0; 2], |[x, y], point| [x + point.x, y + point.y]);
            let at = view.odometry_from_robot.world(x / n, y / n);
            self.queue.retain(|other| f64::hypot(at[0] - other.at[0], at[1] - other.at[1]) > self.same_plant_m);
            self.queue.push_back(Seen { at, scan: self.scans });
        }
        self.scans += 1;
        let is_old = |seen: &Seen| seen.scan + u64::from(memory_scans) < self.scans;
        while self.queue.len() > cluster_limit as usize || self.queue.front().is_some_and(is_old) {
            self.queue.pop_front();
        }
    }

    /// Sorts the plants of the queue into the rows on either side.
    fn group_rows(&mut self, robot: Pose) {
        let to_robot = robot.locals();
        self.centroids.clear();
        self.centroids.extend(self.queue.iter().map(|seen| {
            let (x, y) = to_robot(seen.at[0], seen.at[1]);
            Point3 { x, y, z: 0.0 }
        }));
        self.sides.iter_mut().for_each(Vec::clear);
        for cluster in self.clusters.find(&self.centroids, self.row_tolerance_m, 1) {
            self.group.iter_mut().for_each(Vec::clear);
            let points = cluster.iter().map(|i| &self.centroids[*i as usize]).map(|point| [point.x, point.y]);
            let row = single_row(points.clone(), self.row_distance_m);
            for (i, point) in cluster.iter().zip(points) {
                let is_right = row.map_or(point[1] < 0.0, |row| row.left_of([0.0, 0.0]) > 0.0);
                self.group[usize::from(is_right)].push(*i);
            }
            for (side, group) in self.sides.iter_mut().zip(&mut self.group) {
                if group.len() > side.len() {
                    std::mem::swap(side, group);
                }
            }
        }
        for ((side, plants), supports) in self.sides.iter().zip(&mut self.plants).zip(&mut self.supports) {
            plants.clear();
            supports.clear();
            for i in side.iter().map(|i| *i as usize) {
                let plant = [self.centroids[i].x, self.centroids[i].y];
                plants.push(plant);
                if self.queue[i].scan + 1 == self.scans {
                    supports.push(plant);
                }
            }
        }
    }
}

impl RowDetector for CentroidLines {
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_> {
        self.remember(view);
        self.group_rows(view.odometry_from_robot);
        let [left, right] = &self.plants;
        let search = &mut self.search;
        let CentroidLinesParams { dist_threshold_m, max_iteration, .. } = self.params;
        let lines = [left, right].map(|side| search.find(side, dist_threshold_m, max_iteration, random));
        let [left, right] = &self.supports;
        DetectedRows { lines, supports: [left, right], plants: &[] }
    }
}

/// The row that all of `points` \[m\] belong to: a line ahead that none of them is far from; none if they are of several rows.
fn single_row(mut points: impl Iterator<Item = [f64; 2]> + Clone, row_distance_m: f64) -> Option<RowLine> {
    let line = RowLine::through(points.clone()).filter(RowLine::runs_ahead)?;
    points.all(|point| line.left_of(point).abs() < ROW_HALF_WIDTH * row_distance_m).then_some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detector(params: CentroidLinesParams, row_distance_m: f64, planting_distance_m: f64) -> CentroidLines {
        let (rows, plants_per_row, lanes_to_the_left) = (2, 20, true);
        CentroidLines::new(
            params,
            &PlantingMap { row_distance_m, planting_distance_m, rows, plants_per_row, lanes_to_the_left },
        )
    }

    fn narrow(params: CentroidLinesParams) -> CentroidLines {
        detector(params, 1.3, 0.4)
    }

    /// Plants of two rows, a lane of `row_m` between them, seen from its middle by a robot turned by `heading_rad` to the left.
    fn sides(row_m: f64, planting_m: f64, heading_rad: f64) -> [Vec<[f64; 2]>; 2] {
        let mut detector = detector(CentroidLinesParams::default(), row_m, planting_m);
        let places = (0..5).flat_map(|i| [0.5, -0.5].map(|side| [1.7 + f64::from(i) * planting_m, side * row_m]));
        detector.queue.extend(places.map(|at| Seen { at, scan: 0 }));
        detector.group_rows(Pose { heading_rad, ..Pose::default() });
        detector.plants
    }

    /// Points of plants at these places, so many each.
    fn cloud(plants: &[([f64; 2], u32)]) -> Vec<Point3> {
        let of = |([x, y], n): &([f64; 2], u32)| {
            let (x, y) = (*x, *y);
            (0..*n).map(move |i| Point3 { x, y, z: 0.1 + 0.01 * f64::from(i) })
        };
        plants.iter().flat_map(of).collect()
    }

    fn queue(detector: &CentroidLines) -> Vec<[f64; 2]> {
        let rounded = |value: f64| (value * 1e6).round() / 1e6;
        detector.queue.iter().map(|seen| seen.at.map(rounded)).collect()
    }

    #[test]
    fn a_plant_seen_again_stays_one_plant_where_it_was_seen_last() {
        let mut detector = narrow(CentroidLinesParams { cluster_limit: 2, ..CentroidLinesParams::default() });
        for i in 0..30 {
            let points = cloud(&[([2.0, 0.6], 12), ([2.0 + 0.001 * f64::from(i), -0.6], 10)]);
            detector.remember(PlantPoints { points: &points, odometry_from_robot: Pose::default() });
        }
        assert_eq!(queue(&detector), [[2.029, -0.6], [2.0, 0.6]]);
    }

    #[test]
    fn a_line_is_found_in_all_plants_and_supported_by_those_of_this_scan() {
        let mut detector = narrow(CentroidLinesParams::default());
        let mut random = Stream::new(1, "centroid-lines");
        for (plants, supports) in [(&[1.6, 2.0, 2.4][..], 3), (&[2.8], 1), (&[], 0)] {
            let plants: Vec<_> = plants.iter().map(|x| ([*x, 0.6], 10)).collect();
            let points = cloud(&plants);
            let view = PlantPoints { points: &points, odometry_from_robot: Pose::default() };
            let found = detector.detect(view, &mut random);
            assert_eq!([found.supports[0].len(), found.supports[1].len()], [supports, 0]);
            assert!(found.lines[0].unwrap().left_of([0.0, 0.6]).abs() < 1e-9);
        }
        assert_eq!(detector.plants[0].len(), 4);
    }

    #[test]
    fn of_too_many_plants_those_of_the_fewest_points_leave() {
        let mut detector = narrow(CentroidLinesParams { cluster_limit: 2, ..CentroidLinesParams::default() });
        let points = cloud(&[([2.0, 0.6], 30), ([2.0, -0.6], 10), ([3.0, 0.6], 20)]);
        detector.remember(PlantPoints { points: &points, odometry_from_robot: Pose::default() });
        assert_eq!(queue(&detector), [[3.0, 0.6], [2.0, 0.6]]);
    }

    #[test]
    fn what_was_not_seen_for_long_is_forgotten() {
        let mut detector = narrow(CentroidLinesParams { memory_scans: 3, ..CentroidLinesParams::default() });
        let points = cloud(&[([2.0, 0.6], 10)]);
        detector.remember(PlantPoints { points: &points, odometry_from_robot: Pose::default() });
        let left = [(); 4].map(|()| {
            detector.remember(PlantPoints { points: &[], odometry_from_robot: Pose::default() });
            detector.queue.len()
        });
        assert_eq!(left, [1, 1, 0, 0]);
    }

    #[test]
    fn a_row_that_crosses_the_robots_heading_stays_on_its_side() {
        let [left, right] = sides(1.3, 0.4, 0.3);
        assert_eq!([left.len(), right.len()], [5, 5]);
        // The far end of the left row lies to the right of the heading.
        assert!(left.iter().any(|point| point[1] < 0.0) && left[0][1] > 0.0);
    }

    #[test]
    fn a_group_of_two_rows_is_divided_at_the_heading() {
        let [left, right] = sides(1.5, 1.6, 0.0);
        assert!(left.iter().all(|point| point[1] > 0.0) && right.iter().all(|point| point[1] < 0.0));
        assert_eq!([left.len(), right.len()], [5, 5]);
    }
}
