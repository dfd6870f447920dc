//! The observer of a robot in a nursery: Vintu (2018), section 4.1.1.

mod damage;
mod errors;
mod lanes;

use std::collections::BTreeMap;

use furrow_navigation::localization::PlantingMap;
use furrow_navigation::mission::NurseryStep;

use super::{LimitsSpec, Mean, SimulatedTimeParams, digest};
use crate::Pose;
use crate::field::{Field, Nursery};
use crate::run::{Outcome, RunResult};

use damage::Damage;
use errors::Errors;
use lanes::{Lanes, Violation};

furrow_navigation::parameters! {
    /// Parameters of the observer of a nursery.
    pub struct NurseryObserverParams {
        /// The robot is too far away at this distance from the nearest planting position. Paper: 4.
        pub too_far_m: f64 = 4.0, "m", [0.1, 1000.0];
        /// The robot is stuck if it has moved less than this for `limits.stuck_after_s`. Paper: 0.1.
        pub stuck_m: f64 = 0.1, "m", [0.001, 10.0];
    }
}

/// The trajectory's error is sampled at 10 Hz, and the observer looks at 20 Hz.
const SAMPLES_PER_ERROR: u32 = 2;

/// The observer of one run.
pub(crate) struct NurseryObserver<'a> {
    params: NurseryObserverParams,
    limits: SimulatedTimeParams,
    nursery: &'a Nursery,
    lanes: Lanes,
    damage: Damage<'a>,
    body_width_m: f64,
    errors: Errors,
    samples: u32,
    located: Mean,
    anchor: (f64, Pose),
    trajectory: blake3::Hasher,
}

impl<'a> NurseryObserver<'a> {
    /// An observer at the start; `body` is the robot's length and width \[m\].
    pub(crate) fn new(
        params: &NurseryObserverParams,
        limits: &LimitsSpec,
        (field, nursery): (&'a Field, &'a Nursery),
        body: [f64; 2],
    ) -> Self {
        let LimitsSpec::SimulatedTime(limits) = limits;
        Self {
            params: params.clone(),
            limits: limits.clone(),
            nursery,
            lanes: Lanes::new(nursery.map),
            damage: Damage::new(&field.plants, nursery.map, body),
            body_width_m: body[1],
            errors: Errors::default(),
            samples: 0,
            located: Mean::default(),
            anchor: (0.0, field.start),
            trajectory: blake3::Hasher::new(),
        }
    }

    /// Takes in the true pose, at 20 Hz; says how the run ends, if it does.
    pub(crate) fn observe(&mut self, time_s: f64, world_from_robot: Pose) -> Option<Outcome> {
        for value in [world_from_robot.x_m, world_from_robot.y_m, world_from_robot.heading_rad] {
            self.trajectory.update(&value.to_bits().to_le_bytes());
        }
        let violation = self.lanes.observe(world_from_robot);
        self.damage.observe(world_from_robot, self.lanes.active());
        self.sample_error(world_from_robot);
        match violation {
            Some(Violation::OutOfOrder) => return Some(Outcome::WrongRow),
            Some(Violation::Crossed) => return Some(Outcome::CrossedRow),
            Some(Violation::Again) => return Some(Outcome::SameRow),
            None => {}
        }
        if from_plants_m(&self.nursery.map, world_from_robot) > self.params.too_far_m {
            return Some(Outcome::TooFar);
        }
        if self.is_stuck(time_s, world_from_robot) {
            return Some(Outcome::Stuck);
        }
        (time_s >= self.limits.max_time_s).then_some(Outcome::Time)
    }

    /// Takes in where the robot believes to be in the map, at the same time as it truly is at `world_from_robot`.
    pub(crate) fn hear(&mut self, map_from_robot: Pose, world_from_robot: Pose) {
        let (dx, dy) = (map_from_robot.x_m - world_from_robot.x_m, map_from_robot.y_m - world_from_robot.y_m);
        self.located.add(dx * dx + dy * dy);
    }

    fn sample_error(&mut self, pose: Pose) {
        self.samples += 1;
        let inside = (0.0..=self.nursery.map.row_length_m()).contains(&pose.x_m);
        if let Some(lane) = self.lanes.active()
            && inside
            && self.samples.is_multiple_of(SAMPLES_PER_ERROR)
        {
            self.errors.add(pose.y_m - self.nursery.map.lane_y_m(lane));
        }
    }

    fn is_stuck(&mut self, time_s: f64, pose: Pose) -> bool {
        let (since_s, anchor) = self.anchor;
        if libm::hypot(pose.x_m - anchor.x_m, pose.y_m - anchor.y_m) >= self.params.stuck_m {
            self.anchor = (time_s, pose);
            return false;
        }
        time_s - since_s >= self.limits.stuck_after_s
    }

    /// How the run ends if the mission says that it does.
    pub(crate) fn judge(&self, step: NurseryStep) -> Option<Outcome> {
        match step {
            NurseryStep::Drive(_) => None,
            NurseryStep::Finished if self.lanes.is_complete() => Some(Outcome::Success),
            NurseryStep::Finished => Some(Outcome::EndedEarly),
        }
    }

    /// The result of a run that ended at `time_s` with `outcome`.
    pub(crate) fn result(self, time_s: f64, outcome: Outcome) -> RunResult {
        let mut metrics: BTreeMap<&'static str, f64> = BTreeMap::new();
        metrics.insert("success", f64::from(u8::from(outcome == Outcome::Success)));
        metrics.insert("rows_completed", f64::from(self.lanes.whole()));
        metrics.insert("simulated_s", time_s);
        metrics.extend(self.lanes.covered_percent().map(|percent| ("covered_rows_percent", percent)));
        metrics.insert("passed_plants", f64::from(self.damage.passed()));
        metrics.insert("damaged_plants", f64::from(self.damage.damaged()));
        if self.damage.passed() > 0 {
            let percent = |plants: u32| 100.0 * f64::from(plants) / f64::from(self.damage.passed());
            metrics.insert("damaged_plants_percent", percent(self.damage.damaged()));
            metrics.insert("unavoidable_damage_percent", percent(self.damage.unavoidable()));
        }
        let passable = self.nursery.passable_lanes_share(self.body_width_m);
        if self.nursery.map.lanes() > 0 {
            metrics.insert("passable_lanes_percent", 100.0 * passable);
        }
        metrics.insert("passable_field", f64::from(u8::from(passable == 1.0)));
        metrics.extend(self.located.value().map(|square| ("localization_error_rms_m", square.sqrt())));
        if let Some(summary) = self.errors.summary() {
            metrics.insert("trajectory_error_mean_m", summary.mean_m);
            metrics.extend(summary.std_m.map(|std_m| ("trajectory_error_std_m", std_m)));
            metrics.insert("trajectory_error_p99_m", summary.p99_m);
            metrics.insert("trajectory_error_max_m", summary.max_m);
        }
        let digest = digest(self.trajectory, outcome, &metrics);
        RunResult { digest, outcome, metrics, damaged: self.damage.damaged_plants(), interventions: Vec::new() }
    }
}

/// Distance from the nearest planting position, whether or not a plant stands there \[m\].
fn from_plants_m(map: &PlantingMap, pose: Pose) -> f64 {
    let nearest = |value: f64, count: u32| value.round().clamp(0.0, f64::from(count.saturating_sub(1)));
    let plant = nearest(pose.x_m / map.planting_distance_m, map.plants_per_row);
    let row = nearest(pose.y_m * map.towards_next() / map.row_distance_m + 0.5, map.rows);
    libm::hypot(pose.x_m - plant * map.planting_distance_m, pose.y_m - map.row_y_m(row as u32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_count_from_the_nearest_planting_position() {
        for lanes_to_the_left in [true, false] {
            let map = PlantingMap {
                row_distance_m: 2.0,
                planting_distance_m: 2.0,
                rows: 5,
                plants_per_row: 20,
                lanes_to_the_left,
            };
            let at =
                |x_m: f64, y_m: f64| from_plants_m(&map, Pose { x_m, y_m: y_m * map.towards_next(), heading_rad: 0.0 });
            assert!((at(-3.0, -1.0) - 3.0).abs() < 1e-12);
            assert!((at(5.0, -1.0) - 1.0).abs() < 1e-12);
            assert!((at(38.0 + 3.0, 7.0 + 4.0) - 5.0).abs() < 1e-12);
            assert!(at(7.0, 0.0) <= 2.0_f64.sqrt() + 1e-12);
        }
    }
}
