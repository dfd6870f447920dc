//! The planting grid in centroids of plants and weeds, by random sample consensus: Vintu (2018), section 3.3.4.
//!
//! A hypothesis is a pair of centroids taken for plants of one row. Silent in the thesis, ours: rows lie within 20
//! degrees of the robot's heading; the last scan's grid counts as the first hypothesis; the best grid is fitted to its plants at
//! the end.

use super::line::is_ahead;
use crate::Pose;
use crate::random::Stream;

/// Draws for each pair that is wanted: many are of different rows.
const DRAWS_PER_PAIR: u32 = 10;
/// Fewer plants than this are no grid.
const FEWEST_PLANTS: usize = 3;

/// A planting grid in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Grid {
    /// A node \[m\].
    origin: [f64; 2],
    /// Unit vector along the rows, ahead.
    along: [f64; 2],
}

/// A centroid on the grid: its index, the number of its row to the left of the origin's, and of its plant ahead of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OnGrid {
    pub(super) index: usize,
    pub(super) row: f64,
    pub(super) plant: f64,
}

/// Distances of a grid, and how it is searched.
#[derive(Debug, Clone, Copy)]
pub(super) struct GridSearch {
    pub(super) row_distance_m: f64,
    pub(super) planting_distance_m: f64,
    /// A centroid nearer than this to a node is a plant.
    pub(super) threshold_m: f64,
    pub(super) pairs: u32,
}

impl Grid {
    /// The grid in another frame: `to_other` takes poses of this one there.
    pub(super) fn moved(self, to_other: impl Fn(Pose) -> Pose) -> Self {
        let heading_rad = libm::atan2(self.along[1], self.along[0]);
        let pose = to_other(Pose { x_m: self.origin[0], y_m: self.origin[1], heading_rad });
        let (sin, cos) = libm::sincos(pose.heading_rad);
        Self { origin: [pose.x_m, pose.y_m], along: [cos, sin] }
    }

    /// Position of a point along and across the rows from the origin \[m\].
    fn local(&self, point: [f64; 2]) -> [f64; 2] {
        let [dx, dy] = [point[0] - self.origin[0], point[1] - self.origin[1]];
        let [cos, sin] = self.along;
        [cos * dx + sin * dy, cos * dy - sin * dx]
    }

    /// A point given along and across the rows \[m\].
    fn world(&self, [along, across]: [f64; 2]) -> [f64; 2] {
        let [cos, sin] = self.along;
        [self.origin[0] + along * cos - across * sin, self.origin[1] + along * sin + across * cos]
    }
}

impl GridSearch {
    /// The grid that most centroids lie on, with these in `plants`; none where there are too few.
    pub(super) fn best(
        &self,
        centroids: &[[f64; 2]],
        last: Option<Grid>,
        plants: &mut Vec<OnGrid>,
        random: &mut Stream,
    ) -> Option<Grid> {
        plants.clear();
        let grid = self.sampled(centroids, last, random)?;
        self.assign(&grid, centroids, plants);
        let grid = self.refitted(&grid, centroids, plants).unwrap_or(grid);
        self.assign(&grid, centroids, plants);
        (plants.len() >= FEWEST_PLANTS).then_some(grid)
    }

    fn sampled(&self, centroids: &[[f64; 2]], last: Option<Grid>, random: &mut Stream) -> Option<Grid> {
        let n = centroids.len() as u32;
        let (mut best, mut pairs) = ((self.count(last.as_ref(), centroids), last), 0);
        for _ in 0..self.pairs * DRAWS_PER_PAIR {
            let [a, b] = [random.below(n), random.below(n)];
            if pairs == self.pairs || n < 2 {
                break;
            }
            let Some(grid) = self.through(centroids[a as usize], centroids[b as usize]) else { continue };
            pairs += 1;
            let on_it = self.count(Some(&grid), centroids);
            if on_it > best.0 {
                best = (on_it, Some(grid));
            }
        }
        best.1
    }

    /// Nodes that have a plant. Of those far away each plant counts, also of one node.
    fn count(&self, grid: Option<&Grid>, centroids: &[[f64; 2]]) -> usize {
        let Some(grid) = grid else { return 0 };
        let (mut taken, mut count) = ([0_u64; 16], 0);
        for [row, plant] in centroids.iter().filter_map(|point| self.node(grid, *point)) {
            let (row, plant) = (row + 8.0, plant + 32.0);
            if (0.0..16.0).contains(&row) && (0.0..64.0).contains(&plant) {
                let (nodes, bit) = (&mut taken[row as usize], 1 << plant as u64);
                count += usize::from(*nodes & bit == 0);
                *nodes |= bit;
            } else {
                count += 1;
            }
        }
        count
    }

    /// The grid in which `a` and `b` are plants of one row; none if they cannot be.
    fn through(&self, a: [f64; 2], b: [f64; 2]) -> Option<Grid> {
        let [dx, dy] = [b[0] - a[0], b[1] - a[1]];
        let length_m = (dx * dx + dy * dy).sqrt();
        let plants = (length_m / self.planting_distance_m).round();
        let fits = (length_m - plants * self.planting_distance_m).abs() < self.threshold_m;
        (plants >= 1.0 && fits && is_ahead([dx, dy])).then(|| {
            let ahead = if dx < 0.0 { -length_m } else { length_m };
            Grid { origin: a, along: [dx / ahead, dy / ahead] }
        })
    }

    /// The node (row, plant) that a point belongs to.
    fn node(&self, grid: &Grid, point: [f64; 2]) -> Option<[f64; 2]> {
        let [along_m, across_m] = grid.local(point);
        let [plant, row] = [(along_m / self.planting_distance_m).round(), (across_m / self.row_distance_m).round()];
        (self.square(grid, point, [row, plant]) < self.threshold_m * self.threshold_m).then_some([row, plant])
    }

    /// Squared distance of a point from a node \[m^2\].
    fn square(&self, grid: &Grid, point: [f64; 2], [row, plant]: [f64; 2]) -> f64 {
        let [along_m, across_m] = grid.local(point);
        let [dx, dy] = [along_m - plant * self.planting_distance_m, across_m - row * self.row_distance_m];
        dx * dx + dy * dy
    }

    /// The plant of each node: the nearest centroid.
    fn assign(&self, grid: &Grid, centroids: &[[f64; 2]], plants: &mut Vec<OnGrid>) {
        plants.clear();
        for (index, point) in centroids.iter().enumerate() {
            let Some([row, plant]) = self.node(grid, *point) else { continue };
            let square = self.square(grid, *point, [row, plant]);
            match plants.iter_mut().find(|other| other.row == row && other.plant == plant) {
                None => plants.push(OnGrid { index, row, plant }),
                Some(other) if square < self.square(grid, centroids[other.index], [row, plant]) => other.index = index,
                Some(_) => {}
            }
        }
    }

    /// The grid of least squared distances to its plants.
    fn refitted(&self, grid: &Grid, centroids: &[[f64; 2]], plants: &[OnGrid]) -> Option<Grid> {
        if plants.is_empty() {
            return None;
        }
        let n = plants.len() as f64;
        let node = |plant: &OnGrid| [plant.plant * self.planting_distance_m, plant.row * self.row_distance_m];
        let mut means = [[0.0; 2]; 2];
        for plant in plants {
            for (mean, point) in means.iter_mut().zip([node(plant), grid.local(centroids[plant.index])]) {
                *mean = [mean[0] + point[0] / n, mean[1] + point[1] / n];
            }
        }
        let [node_mean, seen_mean] = means;
        let (mut dot, mut cross) = (0.0, 0.0);
        for plant in plants {
            let ([nx, ny], [sx, sy]) = (node(plant), grid.local(centroids[plant.index]));
            let ([nx, ny], [sx, sy]) = ([nx - node_mean[0], ny - node_mean[1]], [sx - seen_mean[0], sy - seen_mean[1]]);
            dot += nx * sx + ny * sy;
            cross += nx * sy - ny * sx;
        }
        let length = (dot * dot + cross * cross).sqrt();
        if length == 0.0 || !length.is_finite() {
            return None;
        }
        let [cos, sin] = [dot / length, cross / length];
        let turned = [cos * node_mean[0] - sin * node_mean[1], sin * node_mean[0] + cos * node_mean[1]];
        let origin = grid.world([seen_mean[0] - turned[0], seen_mean[1] - turned[1]]);
        let [c, s] = grid.along;
        Some(Grid { origin, along: [c * cos - s * sin, s * cos + c * sin] })
    }

    /// Numbers of the grid's rows to the left and to the right of the robot.
    pub(super) fn beside(&self, grid: &Grid) -> [f64; 2] {
        let right = (grid.local([0.0, 0.0])[1] / self.row_distance_m).floor();
        [right + 1.0, right]
    }

    /// A point and the direction of a row.
    pub(super) fn row(&self, grid: &Grid, row: f64) -> ([f64; 2], [f64; 2]) {
        (grid.world([0.0, row * self.row_distance_m]), grid.along)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEARCH: GridSearch =
        GridSearch { row_distance_m: 1.3, planting_distance_m: 0.4, threshold_m: 0.1, pairs: 100 };

    /// Two rows beside the robot, seen from `offset_m` left of the middle and turned by `heading_rad`, and weeds.
    fn centroids(offset_m: f64, heading_rad: f64, weeds: usize, seed: u64) -> Vec<[f64; 2]> {
        let mut random = Stream::new(seed, "grid");
        let (sin, cos) = libm::sincos(-heading_rad);
        let mut points: Vec<_> = [0.65, -0.65]
            .into_iter()
            .flat_map(|y| (0..12).map(move |i| [0.17 + 0.4 * f64::from(i), y - offset_m]))
            .map(|[x, y]| [x + 0.02 * random.normal(), y + 0.02 * random.normal()])
            .collect();
        points.extend((0..weeds).map(|_| [random.between(0.0, 5.0), random.between(-0.5, 0.5)]));
        points.iter().map(|[x, y]| [cos * x - sin * y, sin * x + cos * y]).collect()
    }

    #[test]
    fn the_grid_is_found_among_weeds_and_the_weeds_are_left_out() {
        for seed in 0..50 {
            let (offset_m, heading_rad) = (0.1, 0.15);
            let centroids = centroids(offset_m, heading_rad, 8, seed);
            let mut plants = Vec::new();
            let grid = SEARCH.best(&centroids, None, &mut plants, &mut Stream::new(seed, "search")).unwrap();
            assert!((libm::atan2(grid.along[1], grid.along[0]) + heading_rad).abs() < 0.02);
            assert!(plants.iter().filter(|plant| plant.index < 24).count() >= 22, "{plants:?}");
            let [left, right] = SEARCH.beside(&grid).map(|row| {
                let (point, direction) = SEARCH.row(&grid, row);
                direction[0] * -point[1] + direction[1] * point[0]
            });
            assert!((left + 0.55).abs() < 0.05 && (right - 0.75).abs() < 0.05, "{left} {right}");
        }
    }

    #[test]
    fn nothing_one_point_or_points_on_a_heap_are_no_grid() {
        let mut plants = Vec::new();
        let mut best = |centroids: &[[f64; 2]]| SEARCH.best(centroids, None, &mut plants, &mut Stream::new(1, "grid"));
        assert_eq!(best(&[]), None);
        assert_eq!(best(&[[1.0, 0.5]]), None);
        assert_eq!(best(&[[1.0, 0.5]; 20]), None);
        assert_eq!(best(&[[f64::NAN; 2]; 20]), None);
    }

    #[test]
    fn in_a_square_grid_rows_run_ahead() {
        let search = GridSearch { row_distance_m: 2.0, planting_distance_m: 2.0, threshold_m: 0.3, pairs: 100 };
        let centroids: Vec<_> = (0..4).flat_map(|i| [-1.0, 1.0].map(|y| [2.0 * f64::from(i), y])).collect();
        for seed in 0..20 {
            let grid = search.best(&centroids, None, &mut Vec::new(), &mut Stream::new(seed, "grid")).unwrap();
            assert!((grid.along[0] - 1.0).abs() < 1e-9);
        }
    }
}
