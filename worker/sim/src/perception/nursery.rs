//! Perception in a nursery: the front end with a row detector, and the oracle that sees the true rows.

use furrow_navigation::localization::PlantingMap;
use furrow_navigation::perception::cloud::{FrontEnd, Point3};
use furrow_navigation::perception::rows::{DetectedRows, PlantPoints, RowDetector, RowDetectorSpec, RowLine};
use furrow_navigation::random::Stream;

use super::{PerceptionSpec, SimulatedPerception};
use crate::Pose;
use crate::lidar::Fx10Params;
use crate::run::Seed;

/// What finds the rows.
pub(crate) enum RowPerception {
    Detector(Box<RowSight>),
    Oracle(RowOracle),
}

impl RowPerception {
    /// In a nursery planted by `map`; plant points farther ahead of the robot's centre than `end_m` tell the mission that its row goes on.
    pub(crate) fn new(spec: &PerceptionSpec, sensors: &Fx10Params, map: &PlantingMap, end_m: f64, seed: Seed) -> Self {
        match spec {
            PerceptionSpec::Simulated(SimulatedPerception::Oracle(_)) => Self::Oracle(RowOracle { map: *map, end_m }),
            PerceptionSpec::RowDetector(spec) => Self::Detector(Box::new(RowSight::new(spec, sensors, map, seed))),
            _ => unreachable!("a scenario is checked"),
        }
    }
}

/// The front end, and the row detector behind it.
pub(crate) struct RowSight {
    pub(crate) front_end: FrontEnd,
    ground_random: Stream,
    detector: Box<dyn RowDetector>,
    random: Stream,
}

impl RowSight {
    fn new(spec: &RowDetectorSpec, sensors: &Fx10Params, map: &PlantingMap, seed: Seed) -> Self {
        Self {
            front_end: FrontEnd::new(&spec.front_end(), sensors.mount()),
            ground_random: Stream::new(seed.0, "ground"),
            detector: spec.build(map),
            random: Stream::new(seed.0, "row-detector"),
        }
    }

    /// Finds the ground in the filtered scan.
    pub(crate) fn find_ground(&mut self) {
        self.front_end.find_ground(&mut self.ground_random);
    }

    /// The points above the ground, and the rows in them; the robot is where its odometry says.
    pub(crate) fn detect(&mut self, odometry_from_robot: Pose) -> (&[Point3], DetectedRows<'_>) {
        let points = self.front_end.plants();
        (points, self.detector.detect(PlantPoints { points, odometry_from_robot }, &mut self.random))
    }
}

/// Knows the rows beside the robot, and whether there are more plants ahead.
pub(crate) struct RowOracle {
    map: PlantingMap,
    /// From the robot's centre \[m\].
    end_m: f64,
}

impl RowOracle {
    /// The rows beside `truth`, and as many plant points ahead as no mission asks for, or none.
    pub(crate) fn see(&self, truth: Pose) -> (DetectedRows<'static>, u32) {
        let lane = (truth.y_m * self.map.towards_next() / self.map.row_distance_m).round();
        let lane = lane.clamp(0.0, f64::from(self.map.lanes().saturating_sub(1))) as u32;
        let (sin, cos) = libm::sincos(truth.heading_rad);
        let row = |row: u32| {
            let (x, y) = truth.local(truth.x_m, self.map.row_y_m(row));
            RowLine::along([x, y], [cos, -sin])
        };
        let ahead_m = if cos >= 0.0 { self.map.row_length_m() - truth.x_m } else { truth.x_m };
        let points = if ahead_m > self.end_m { u32::MAX } else { 0 };
        (DetectedRows { lines: [row(lane), row(lane + 1)], ..DetectedRows::default() }, points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oracle_sees_the_rows_beside_the_robot_and_their_end() {
        let map = PlantingMap {
            row_distance_m: 1.3,
            planting_distance_m: 0.4,
            rows: 5,
            plants_per_row: 21,
            lanes_to_the_left: false,
        };
        let oracle = RowOracle { map, end_m: 1.7 };
        let at = |x_m: f64, heading_rad: f64| oracle.see(Pose { x_m, y_m: -1.2, heading_rad });
        for heading_rad in [0.1, std::f64::consts::PI + 0.1] {
            let (rows, _) = at(4.0, heading_rad);
            let mut distances = rows.lines.map(|line| line.unwrap().left_of([0.0, 0.0]));
            distances.sort_by(f64::total_cmp);
            let expected = if heading_rad < 1.0 { [-0.55, 0.75] } else { [-0.75, 0.55] };
            assert!(distances.iter().zip(expected).all(|(is, should)| (is - should).abs() < 1e-9), "{distances:?}");
            assert!(rows.lines.iter().all(|line| line.unwrap().direction[0] > 0.9));
        }
        assert_eq!([at(6.2, 0.0).1, at(6.4, 0.0).1, at(1.8, 3.1).1, at(1.6, 3.1).1], [u32::MAX, 0, u32::MAX, 0]);
    }
}
