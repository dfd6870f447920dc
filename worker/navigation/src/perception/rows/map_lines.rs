//! The planting grid in the centroids of a map of the robot's surroundings.
//!
//! Vintu (2018), section 3.3.4. The lines are those grid lines on either side of the robot that hold two plants or more. Their
//! supports, and the plants, are only what the last scan hit (ours): others stand where odometry has carried them, and matched with
//! the planting map they would confirm odometry by itself.

use super::grid::{Grid, GridSearch, OnGrid};
use super::{DetectedRows, PlantPoints, RowDetector, RowLine};
use crate::localization::PlantingMap;
use crate::perception::cloud::LocalMap;
use crate::random::Stream;

super::row_parameters! {
    /// Parameters of [`MapLines`].
    pub struct MapLinesParams {
        /// Points of one plant are linked over gaps up to this. Paper: 0.06, table 4.7.
        pub cluster_tolerance_m: f64 = 0.06, "m", [0.001, 5.0];
        /// Points of a plant at least, one per voxel. Paper: 15, table 4.7.
        pub min_cluster_size: u32 = 15, "1", [1, 10000];
        /// The map reaches so far from the robot. Ours: as far as the LiDAR.
        pub window_m: f64 = 15.0, "m", [0.5, 30.0];
        /// What was not seen for so many scans is forgotten: odometry drifts, most of all in turns. Ours: 5 s, the way of 4 m, less
        /// than a blind turn takes.
        pub memory_scans: u32 = 50, "1", [1, 100000];
        /// Side of a voxel. Ours.
        pub voxel_m: f64 = 0.03, "m", [0.005, 1.0];
        /// A centroid nearer than this to a node of the grid is a plant. Ours.
        pub grid_threshold_m: f64 = 0.2, "m", [0.001, 5.0];
        /// Nor may it be farther than this share of the planting distance. Ours.
        pub grid_threshold_share: f64 = 0.2, "1", [0.001, 0.5];
        /// Pairs of centroids that are tried as plants of one row. Ours.
        pub grid_pairs: u32 = 100, "1", [1, 10000];
    }
}

/// The fewest plants of a row that give a line.
const FEWEST_OF_A_ROW: usize = 2;

/// The detector.
#[derive(Debug, Clone)]
pub struct MapLines {
    params: MapLinesParams,
    search: GridSearch,
    map: LocalMap,
    /// Of clusters, on the ground in the robot's frame.
    centroids: Vec<[f64; 2]>,
    /// Which of them the last scan hit.
    is_seen: Vec<bool>,
    on_grid: Vec<OnGrid>,
    /// The last grid, in the odometry's frame.
    last: Option<Grid>,
    plants: Vec<[f64; 2]>,
    supports: [Vec<[f64; 2]>; 2],
}

impl MapLines {
    /// A detector for a planting grid with the distances of `map`.
    #[must_use]
    pub fn new(params: MapLinesParams, map: &PlantingMap) -> Self {
        let search = GridSearch {
            row_distance_m: map.row_distance_m,
            planting_distance_m: map.planting_distance_m,
            threshold_m: params.grid_threshold_m.min(params.grid_threshold_share * map.planting_distance_m),
            pairs: params.grid_pairs,
        };
        Self {
            map: LocalMap::new(params.voxel_m, (params.window_m, params.memory_scans), params.cluster_tolerance_m),
            params,
            search,
            centroids: Vec::new(),
            is_seen: Vec::new(),
            on_grid: Vec::new(),
            last: None,
            plants: Vec::new(),
            supports: Default::default(),
        }
    }

    /// The line along the grid's row number `row`, and its plants.
    fn line(&mut self, grid: &Grid, row: f64, side: usize) -> Option<RowLine> {
        let of_row = || self.on_grid.iter().filter(|plant| plant.row == row);
        let seen = of_row().filter(|plant| self.is_seen[plant.index]);
        self.supports[side].extend(seen.map(|plant| self.centroids[plant.index]));
        let (point, direction) = self.search.row(grid, row);
        RowLine::along(point, direction).filter(|_| of_row().count() >= FEWEST_OF_A_ROW)
    }
}

impl RowDetector for MapLines {
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_> {
        self.map.insert(view.points, view.odometry_from_robot);
        let to_robot = view.odometry_from_robot.locals();
        let clusters = self.map.clusters(self.params.min_cluster_size);
        self.centroids.clear();
        self.centroids.extend(clusters.iter().map(|cluster| {
            let (x, y) = to_robot(cluster.centroid.x, cluster.centroid.y);
            [x, y]
        }));
        self.is_seen.clear();
        self.is_seen.extend(clusters.iter().map(|cluster| cluster.is_seen));
        self.plants.clear();
        self.supports.iter_mut().for_each(Vec::clear);
        let mut lines = [None, None];
        let robot = view.odometry_from_robot;
        let last = self.last.take().map(|grid| grid.moved(|pose| robot.relative(pose)));
        if let Some(grid) = self.search.best(&self.centroids, last, &mut self.on_grid, random) {
            self.last = Some(grid.moved(|pose| robot.compose(pose)));
            let seen = self.on_grid.iter().filter(|plant| self.is_seen[plant.index]);
            self.plants.extend(seen.map(|plant| self.centroids[plant.index]));
            let [left, right] = self.search.beside(&grid);
            lines = [self.line(&grid, left, 0), self.line(&grid, right, 1)];
        }
        let [left, right] = &self.supports;
        DetectedRows { lines, supports: [left, right], plants: &self.plants }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose;
    use crate::perception::cloud::Point3;

    #[test]
    fn a_line_holds_on_to_plants_that_are_out_of_sight_and_only_what_is_seen_stands_for_it() {
        let (rows, plants_per_row, lanes_to_the_left) = (2, 20, true);
        let map =
            PlantingMap { row_distance_m: 1.5, planting_distance_m: 1.2, rows, plants_per_row, lanes_to_the_left };
        let mut detector = MapLines::new(MapLinesParams::default(), &map);
        let mut random = Stream::new(1, "row-detector");
        // Posts 0.9 m high, three of the left row and as many of the right one as `rights`.
        let mut seen = |rights: i32| {
            let posts = (0..3).map(|i| (i, 0.75)).chain((0..rights).map(|i| (i, -0.75)));
            let post = |(i, y): (i32, f64)| (1..30).map(move |k| (2.0 + 1.2 * f64::from(i), y, 0.03 * f64::from(k)));
            let points: Vec<_> = posts.flat_map(post).map(|(x, y, z)| Point3 { x, y, z }).collect();
            let view = PlantPoints { points: &points, odometry_from_robot: Pose::default() };
            let rows = detector.detect(view, &mut random);
            (rows.lines.map(|line| line.is_some()), rows.supports.map(<[_]>::len), rows.plants.len())
        };
        assert_eq!(seen(3), ([true; 2], [3, 3], 6));
        assert_eq!(seen(1), ([true; 2], [3, 1], 4));
        assert_eq!(seen(0), ([true; 2], [3, 0], 3));
    }
}
