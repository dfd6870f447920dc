//! Plants that the robot passes, and those that it damages: Vintu (2018), section 4.1.1.

use furrow_navigation::localization::PlantingMap;

use crate::Pose;
use crate::field::{Plant, PlantKind};
use crate::observer::damage::outside;

/// A plant is damaged where the body reaches inside this share of its radius.
const SAFE_SHARE: f64 = 0.5;
/// Plants are gathered this much beyond the body's reach, and again after the robot has moved so far \[m\].
const MARGIN_M: f64 = 0.5;

/// Length and width of a body \[m\].
pub(super) type Body = [f64; 2];

/// What became of each crop plant.
#[derive(Debug, Clone)]
pub(super) struct Damage<'a> {
    plants: &'a [Plant],
    half_body_m: (f64, f64),
    map: PlantingMap,
    passed: Vec<bool>,
    damaged: Vec<bool>,
    /// Passed plants that also a drive along the very middle of the lane would damage.
    unavoidable: Vec<bool>,
    gathered_at: Option<(f64, f64)>,
    near: Vec<usize>,
}

impl<'a> Damage<'a> {
    pub(super) fn new(plants: &'a [Plant], map: PlantingMap, [length_m, width_m]: Body) -> Self {
        let none = vec![false; plants.len()];
        Self {
            plants,
            half_body_m: (0.5 * length_m, 0.5 * width_m),
            map,
            passed: none.clone(),
            damaged: none.clone(),
            unavoidable: none,
            gathered_at: None,
            near: Vec::new(),
        }
    }

    /// Takes in a pose, in lane `lane` or between lanes.
    pub(super) fn observe(&mut self, pose: Pose, lane: Option<u32>) {
        self.gather(pose);
        let local = pose.locals();
        let middle_m = lane.map(|lane| self.map.lane_y_m(lane));
        for i in &self.near {
            let plant = &self.plants[*i];
            let (x, y) = local(plant.x_m, plant.y_m);
            let reach_m = SAFE_SHARE * plant.radius_m;
            self.damaged[*i] |= outside(x, y, self.half_body_m) < reach_m;
            // Abeam of the body, in a row beside it.
            let is_abeam = x.abs() <= self.half_body_m.0 && y.abs() <= self.map.row_distance_m;
            self.passed[*i] |= is_abeam || self.damaged[*i];
            let in_the_way =
                middle_m.is_some_and(|middle_m| (plant.y_m - middle_m).abs() - reach_m < self.half_body_m.1);
            self.unavoidable[*i] |= is_abeam && in_the_way;
        }
    }

    fn gather(&mut self, pose: Pose) {
        let squared = |x: f64, y: f64| (pose.x_m - x) * (pose.x_m - x) + (pose.y_m - y) * (pose.y_m - y);
        if self.gathered_at.is_some_and(|(x, y)| squared(x, y) <= MARGIN_M * MARGIN_M) {
            return;
        }
        self.gathered_at = Some((pose.x_m, pose.y_m));
        let body_m = libm::hypot(self.half_body_m.0, self.half_body_m.1.max(self.map.row_distance_m));
        let is_near = |plant: &Plant| {
            let reach_m = body_m + plant.radius_m + 2.0 * MARGIN_M;
            plant.kind == PlantKind::Crop && squared(plant.x_m, plant.y_m) <= reach_m * reach_m
        };
        self.near.clear();
        self.near.extend((0..self.plants.len()).filter(|i| is_near(&self.plants[*i])));
    }

    pub(super) fn passed(&self) -> u32 {
        count(&self.passed)
    }

    pub(super) fn damaged(&self) -> u32 {
        count(&self.damaged)
    }

    pub(super) fn unavoidable(&self) -> u32 {
        count(&self.unavoidable)
    }

    /// Indices of the damaged plants.
    pub(super) fn damaged_plants(&self) -> Vec<usize> {
        (0..self.plants.len()).filter(|i| self.damaged[*i]).collect()
    }
}

fn count(flags: &[bool]) -> u32 {
    flags.iter().map(|flag| u32::from(*flag)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: Body = [1.15, 0.9];

    /// A lane of 1.3 m with a plant of radius 0.5 m every metre on both sides, driven `y_m` beside its middle.
    fn drive(y_m: f64) -> (u32, u32, u32) {
        let map = PlantingMap {
            row_distance_m: 1.3,
            planting_distance_m: 1.0,
            rows: 3,
            plants_per_row: 11,
            lanes_to_the_left: true,
        };
        let plant =
            |x_m: f64, y_m: f64| Plant { x_m, y_m, radius_m: 0.5, height_m: 1.0, kind: PlantKind::Crop, row: 0 };
        let plants: Vec<_> = (0..11).map(f64::from).flat_map(|x| [-0.65, 0.65, 1.95].map(|y| plant(x, y))).collect();
        let mut damage = Damage::new(&plants, map, BODY);
        for step in -50..=600 {
            damage.observe(Pose { x_m: 0.02 * f64::from(step), y_m, heading_rad: 0.0 }, Some(0));
        }
        (damage.passed(), damage.damaged(), damage.unavoidable())
    }

    #[test]
    fn in_the_middle_bodies_reach_into_circles_that_are_nearer_than_half_the_width() {
        // Half the lane, 0.65 m, less half the radius, 0.25 m, leaves 0.4 m of the 0.45 m that are needed.
        assert_eq!(drive(0.0), (22, 22, 22));
    }

    #[test]
    fn plants_beyond_the_rows_beside_the_robot_are_not_passed() {
        assert_eq!(drive(0.1), (22, 11, 22));
    }
}
