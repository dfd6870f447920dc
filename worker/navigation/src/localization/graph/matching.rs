//! Which row of the map a detected line is, and which planting position a plant.

use super::GraphParams;
use super::edges::wrap;
use super::measurement::Measurement;
use crate::Pose;
use crate::localization::PlantingMap;
use crate::perception::rows::{DetectedRows, RowLine};

/// Plants taken of a scan at most, in the order in which the detector gives them.
pub const MOST_PLANTS: usize = 64;

/// The gates around the map, seen from a pose.
#[derive(Debug, Clone, Copy)]
pub struct Matcher<'a> {
    params: &'a GraphParams,
    map: &'a PlantingMap,
    map_from_robot: Pose,
}

impl<'a> Matcher<'a> {
    /// At the pose that the robot probably has.
    #[must_use]
    pub const fn new(params: &'a GraphParams, map: &'a PlantingMap, map_from_robot: Pose) -> Self {
        Self { params, map, map_from_robot }
    }

    /// Hands on the matches of the lines' points.
    ///
    /// A line is matched with the row nearest to the mean of its points taken, if that is within the gate, if the line
    /// runs along the rows, and if the robot is not further beyond the rows' ends than allowed. Of its points those
    /// count that are themselves within the gate of the row, from its first plant to its last.
    pub fn lines(&self, rows: &DetectedRows<'_>, mut take: impl FnMut(Measurement)) {
        if !self.is_among_rows() {
            return;
        }
        for (line, support) in rows.lines.iter().zip(rows.supports) {
            let Some(row_y_m) = line.and_then(|line| self.row(line, support)) else { continue };
            let share = 1.0 / self.chosen(support).count() as f64;
            let matched = |seen: &[f64; 2]| self.is_near_row(self.on_map(*seen), row_y_m);
            self.chosen(support).filter(matched).for_each(|seen| take(Measurement::RowPoint { seen, row_y_m, share }));
        }
    }

    /// Hands on the matches of the plants that are within the gate of a planting position.
    pub fn plants(&self, rows: &DetectedRows<'_>, mut take: impl FnMut(Measurement)) {
        for &seen in rows.plants.iter().take(MOST_PLANTS) {
            let at = self.on_map(seen);
            let planted = nearest_planting_position(self.map, at);
            let (dx, dy) = (at[0] - planted[0], at[1] - planted[1]);
            if (dx * dx + dy * dy).sqrt() <= self.params.plant_gate(self.map) {
                take(Measurement::Plant { seen, planted });
            }
        }
    }

    /// y of the row that `line` is; none if it is none.
    fn row(&self, line: RowLine, support: &[[f64; 2]]) -> Option<f64> {
        let angle = self.map_from_robot.heading_rad + libm::atan2(line.direction[1], line.direction[0]);
        // A row has two directions.
        if (0.5 * wrap(2.0 * angle)).abs() > self.params.line_gate_rad {
            return None;
        }
        let (sum, n) = self.chosen(support).fold((0.0, 0.0), |(sum, n), seen| (sum + self.on_map(seen)[1], n + 1.0));
        let y_m = sum / n;
        let row_y_m = self.map.row_y_m(nearest_row(self.map, y_m));
        ((y_m - row_y_m).abs() <= self.params.line_gate_m).then_some(row_y_m)
    }

    /// As many of a line's points as are taken, evenly spaced in their order; those that are not finite left out.
    fn chosen<'b>(&self, support: &'b [[f64; 2]]) -> impl Iterator<Item = [f64; 2]> + use<'b> {
        let taken = support.len().min(self.params.line_points as usize);
        let chosen = (0..taken).map(move |i| support[i * support.len() / taken]);
        chosen.filter(|[x, y]| x.is_finite() && y.is_finite())
    }

    fn on_map(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        self.map_from_robot.world(x_m, y_m)
    }

    fn is_among_rows(&self) -> bool {
        let beyond = self.params.beyond_rows_m;
        (-beyond..=self.map.row_length_m() + beyond).contains(&self.map_from_robot.x_m)
    }

    fn is_near_row(&self, [x_m, y_m]: [f64; 2], row_y_m: f64) -> bool {
        let gate = self.params.line_gate_m;
        (y_m - row_y_m).abs() <= gate && (-gate..=self.map.row_length_m() + gate).contains(&x_m)
    }
}

/// The row nearest to `y_m`.
fn nearest_row(map: &PlantingMap, y_m: f64) -> u32 {
    nearest(y_m * map.towards_next() / map.row_distance_m + 0.5, map.rows)
}

fn nearest_planting_position(map: &PlantingMap, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
    let plant = nearest(x_m / map.planting_distance_m, map.plants_per_row);
    [f64::from(plant) * map.planting_distance_m, map.row_y_m(nearest_row(map, y_m))]
}

/// The one of 0 to `n` - 1 that is nearest to `place`.
fn nearest(place: f64, n: u32) -> u32 {
    // The cast saturates; NaN becomes 0.
    (libm::round(place) as u32).min(n.saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn map() -> PlantingMap {
        PlantingMap {
            row_distance_m: 1.3,
            planting_distance_m: 0.4,
            rows: 5,
            plants_per_row: 21,
            lanes_to_the_left: true,
        }
    }

    fn line(y_m: f64, angle_rad: f64) -> (RowLine, Vec<[f64; 2]>) {
        let (sin, cos) = libm::sincos(angle_rad);
        let points = (0..50).map(|i| 0.5 + 0.05 * f64::from(i)).map(|along| [cos * along, y_m + sin * along]).collect();
        (RowLine { point: [0.0, y_m], direction: [cos, sin] }, points)
    }

    /// Matches of one line at y = `y_m` and `angle_rad` in the robot's frame.
    fn matches(map_from_robot: Pose, y_m: f64, angle_rad: f64) -> Vec<Measurement> {
        let (line, points) = line(y_m, angle_rad);
        let rows = DetectedRows { lines: [None, Some(line)], supports: [&[], &points], plants: &[] };
        let params = GraphParams { line_gate_m: 0.35, ..GraphParams::default() };
        let mut found = Vec::new();
        Matcher::new(&params, &map(), map_from_robot).lines(&rows, |one| found.push(one));
        found
    }

    fn rows_of(matches: &[Measurement]) -> Vec<f64> {
        matches
            .iter()
            .map(|one| match one {
                Measurement::RowPoint { row_y_m, .. } => *row_y_m,
                other => panic!("{other:?}"),
            })
            .collect()
    }

    #[test]
    fn a_line_is_the_row_that_is_nearest_to_it_and_twenty_points_of_it_count() {
        let robot = Pose { x_m: 2.0, y_m: 1.4, heading_rad: 0.0 };
        let matches = matches(robot, 0.6, 0.0);
        assert_eq!(rows_of(&matches), [map().row_y_m(2); 20]);
        let Measurement::RowPoint { share, .. } = matches[0] else { panic!("{matches:?}") };
        assert_eq!(share, 0.05);
    }

    #[test]
    fn a_robot_that_comes_back_matches_the_same_rows() {
        let robot = Pose { x_m: 6.0, y_m: 1.3, heading_rad: std::f64::consts::PI };
        assert_eq!(rows_of(&matches(robot, 0.6, 0.05)), [map().row_y_m(1); 20]);
    }

    #[test]
    fn lines_too_far_off_or_askew_are_no_rows() {
        let robot = Pose { x_m: 2.0, ..Pose::default() };
        assert!(matches(robot, 0.65 + 0.36, 0.0).is_empty());
        let turned = |degrees: f64| {
            let angle = degrees.to_radians();
            matches(robot, 0.65 - 1.7 * libm::sin(angle), angle)
        };
        assert!(turned(15.5).is_empty() && turned(-15.5).is_empty());
        assert!(turned(14.5).len() == 20 && turned(-14.5).len() == 20);
    }

    #[test]
    fn beyond_the_rows_ends_there_are_no_lines() {
        for (x_m, points) in [(-1.01, 0), (-0.99, 18), (7.01, 7), (9.01, 0)] {
            let found = matches(Pose { x_m, ..Pose::default() }, 0.65, 0.0);
            assert_eq!(found.len(), points, "{x_m}");
        }
    }

    #[test]
    fn a_plant_is_matched_within_two_fifths_of_the_planting_distance() {
        let robot = Pose { x_m: 2.0, ..Pose::default() };
        let plants = [[0.8 + 0.15, 0.65], [0.8 + 0.17, 0.65], [0.0, -0.65 - 0.15], [1.2, f64::NAN], [30.0, 0.65]];
        let rows = DetectedRows { plants: &plants, ..DetectedRows::default() };
        let mut found = Vec::new();
        Matcher::new(&GraphParams::default(), &map(), robot).plants(&rows, |one| found.push(one));
        let [Measurement::Plant { planted: first, .. }, Measurement::Plant { planted: second, .. }] = found[..] else {
            panic!("{found:?}")
        };
        assert!((first[0] - 2.8).abs() < 1e-12 && first[1] == 0.65 && second[1] == -0.65, "{found:?}");
    }

    proptest! {
        #[test]
        fn the_nearest_planting_position_is_no_further_than_any_other(x_m in -3.0..12.0, y_m in -4.0..9.0, left: bool) {
            let map = PlantingMap { lanes_to_the_left: left, ..map() };
            let distance2 = |[x, y]: [f64; 2]| (x - x_m) * (x - x_m) + (y - y_m) * (y - y_m);
            let nearest = distance2(nearest_planting_position(&map, [x_m, y_m]));
            for (row, plant) in (0..map.rows).flat_map(|row| (0..map.plants_per_row).map(move |plant| (row, plant))) {
                let other = [f64::from(plant) * map.planting_distance_m, map.row_y_m(row)];
                prop_assert!(nearest <= distance2(other) + 1e-9);
            }
        }
    }
}
