//! Which crop plants the robot runs over, and how close it comes to the others.

use crate::Pose;
use crate::field::{Field, Plant, PlantKind};
use crate::robot::TwoWheeledParams;

/// Plants are gathered this much beyond the body's reach, and again after the robot has moved so far \[m\].
const MARGIN_M: f64 = 0.5;
/// Half the length of a wheel's patch of contact with the soil \[m\] (ours).
const CONTACT_HALF_M: f64 = 0.05;

/// Touched plants: by the body's rectangle, and by the wheels' footprints.
pub(super) struct Damage<'a> {
    plants: &'a [Plant],
    body_half_m: (f64, f64),
    /// Smallest and largest |y| of the wheels' footprints \[m\].
    wheels_m: (f64, f64),
    touched_by_body: Vec<bool>,
    touched_by_wheel: Vec<bool>,
    closest_m: f64,
    gathered_at: Option<(f64, f64)>,
    near: Vec<usize>,
}

impl<'a> Damage<'a> {
    pub(super) fn new(field: &'a Field, robot: &TwoWheeledParams) -> Self {
        let half_track_m = 0.5 * robot.track_width_m;
        let half_wheel_m = 0.5 * robot.wheel_width_m;
        Self {
            plants: &field.plants,
            body_half_m: (0.5 * robot.body_length_m, 0.5 * robot.body_width_m),
            wheels_m: (half_track_m - half_wheel_m, half_track_m + half_wheel_m),
            touched_by_body: vec![false; field.plants.len()],
            touched_by_wheel: vec![false; field.plants.len()],
            closest_m: f64::INFINITY,
            gathered_at: None,
            near: Vec::new(),
        }
    }

    pub(super) fn observe(&mut self, pose: Pose) {
        self.gather(pose);
        let local = pose.locals();
        for i in &self.near {
            let plant = &self.plants[*i];
            let (x, y) = local(plant.x_m, plant.y_m);
            let gap_m = outside(x, y, self.body_half_m) - plant.radius_m;
            self.closest_m = self.closest_m.min(gap_m.max(0.0));
            self.touched_by_body[*i] |= gap_m <= 0.0;
            let (inner_m, outer_m) = self.wheels_m;
            let across_m = y.abs() - 0.5 * (inner_m + outer_m);
            let wheel_gap_m = outside(x, across_m, (CONTACT_HALF_M, 0.5 * (outer_m - inner_m))) - plant.radius_m;
            self.touched_by_wheel[*i] |= wheel_gap_m <= 0.0;
        }
    }

    fn gather(&mut self, pose: Pose) {
        let squared = |x: f64, y: f64| (pose.x_m - x) * (pose.x_m - x) + (pose.y_m - y) * (pose.y_m - y);
        if self.gathered_at.is_some_and(|(x, y)| squared(x, y) <= MARGIN_M * MARGIN_M) {
            return;
        }
        self.gathered_at = Some((pose.x_m, pose.y_m));
        let body_m = libm::hypot(self.body_half_m.0, self.body_half_m.1.max(self.wheels_m.1));
        let is_near = |plant: &Plant| {
            let reach_m = body_m + plant.radius_m + 3.0 * MARGIN_M;
            plant.kind == PlantKind::Crop && squared(plant.x_m, plant.y_m) <= reach_m * reach_m
        };
        self.near.clear();
        self.near.extend((0..self.plants.len()).filter(|i| is_near(&self.plants[*i])));
    }

    /// Crop plants that the body ran over.
    pub(super) fn body(&self) -> u32 {
        count(&self.touched_by_body)
    }

    /// Crop plants that a wheel ran over.
    pub(super) fn wheels(&self) -> u32 {
        count(&self.touched_by_wheel)
    }

    /// Smallest distance of the body to a crop plant's stem \[m\]; 0 if it was touched, none if all stayed far away.
    pub(super) fn closest_m(&self) -> Option<f64> {
        self.closest_m.is_finite().then_some(self.closest_m)
    }

    /// Indices of the plants that the body ran over.
    pub(super) fn damaged(&self) -> Vec<usize> {
        (0..self.plants.len()).filter(|i| self.touched_by_body[*i]).collect()
    }
}

fn count(flags: &[bool]) -> u32 {
    flags.iter().map(|flag| u32::from(*flag)).sum()
}

/// Distance of (x, y) from a centred rectangle with these half lengths; 0 inside \[m\].
pub(super) fn outside(x: f64, y: f64, (half_x, half_y): (f64, f64)) -> f64 {
    let (dx, dy) = ((x.abs() - half_x).max(0.0), (y.abs() - half_y).max(0.0));
    (dx * dx + dy * dy).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::guyonneau2022::{Guyonneau2022Params, build};

    fn observe(y_m: f64) -> (u32, u32, f64) {
        let field = build(&Guyonneau2022Params { crop: 1, ..Default::default() }, 1);
        let mut damage = Damage::new(&field, &TwoWheeledParams::default());
        for step in 0..200 {
            damage.observe(Pose { x_m: 1.0 + 0.01 * f64::from(step), y_m, heading_rad: 0.0 });
        }
        (damage.body(), damage.wheels(), damage.closest_m().unwrap())
    }

    #[test]
    fn in_the_middle_nothing_is_touched() {
        let (body, wheels, closest_m) = observe(0.0);
        assert_eq!((body, wheels), (0, 0));
        assert!((closest_m - (0.75 - 0.2 - 0.02)).abs() < 1e-12);
    }

    #[test]
    fn a_wheel_touches_before_the_body_does() {
        let (body, wheels, _) = observe(0.40);
        assert_eq!(body, 0);
        assert!(wheels > 0);
        let (body, _, closest_m) = observe(0.60);
        // The body covers x from 0.45 to 3.54 m, the row has a plant every 0.3 m.
        assert_eq!((body, closest_m), (10, 0.0));
    }
}
