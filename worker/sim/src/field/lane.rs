//! What a lane has beyond stems: foliage that hides them, uneven ground, and an order along the lane.

use super::{Field, Plant, Polyline};
use crate::Pose;

/// Ground is described in pieces of this length \[m\].
pub const TERRAIN_STEP_M: f64 = 0.1;
/// The lane's direction is that of its middle from here to there ahead of the robot's centre \[m\]: as long as the
/// rectangle in which the paper's perception looks. In a curve it is ahead of the tangent, as what a robot sees is.
const AHEAD_M: [f64; 2] = [0.1, 1.9];

/// Leaves, fallen stalks and weeds: upright ribbons over a straight line on the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foliage {
    /// One end (x, y) \[m\].
    pub from_m: [f64; 2],
    /// The other end \[m\].
    pub to_m: [f64; 2],
    /// Lower and upper edge above the ground \[m\].
    pub height_m: [f64; 2],
    /// What it is.
    pub kind: FoliageKind,
}

/// What hides stems.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FoliageKind {
    /// A leaf that hangs from a stem.
    Leaf,
    /// A fallen stalk.
    Stalk,
    /// Grass or another weed.
    Weed,
}

/// How the ground tilts and deflects a robot at one place. A robot that stands still keeps its course.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Ground {
    /// Left side up \[rad\].
    pub roll_rad: f64,
    /// Nose down \[rad\].
    pub pitch_rad: f64,
    /// Turn per way ahead \[rad/m\], counter-clockwise.
    pub yaw_rad_per_m: f64,
    /// Slip to the left per way ahead \[m/m\].
    pub slip_m_per_m: f64,
}

/// A lane between two rows of a field.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// Index of the row on the right; the one on the left is the next.
    pub right_row: usize,
    /// Of the rows, along the middle \[m\].
    pub length_m: f64,
    /// Stretches along the middle without plants on both sides \[m\].
    pub gaps_m: Vec<[f64; 2]>,
    /// Ordered along the lane.
    pub foliage: Vec<Foliage>,
    /// In pieces of [`TERRAIN_STEP_M`] along the middle.
    pub terrain: Vec<Ground>,
    /// Place along the lane of each of the field's plants, ascending \[m\].
    pub plants_along_m: Vec<f64>,
    /// Likewise of each piece of foliage, or of the plant it hangs from.
    pub foliage_along_m: Vec<f64>,
}

/// Where a point of a robot truly is in a lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Along the lane's middle \[m\].
    pub along_m: f64,
    /// To the left of the middle \[m\].
    pub across_m: f64,
    /// Distance to the centre line of the row on the left \[m\]; negative beyond it.
    pub left_m: f64,
    /// Likewise on the right \[m\].
    pub right_m: f64,
    /// The robot's heading relative to the lane's direction \[rad\], counter-clockwise.
    pub heading_rad: f64,
}

impl Lane {
    /// The lane's middle.
    #[must_use]
    pub fn middle<'a>(&self, field: &'a Field) -> &'a Polyline {
        &field.middles[self.right_row]
    }

    /// Where a sensor at `pose`, `sensor_x_m` ahead of the robot's centre, is; looked for around `near_m` along the lane.
    #[must_use]
    pub fn place(&self, field: &Field, (pose, sensor_x_m): (Pose, f64), near_m: f64) -> Place {
        let middle = self.middle(field);
        let on_middle = middle.project_near(pose.x_m, pose.y_m, near_m);
        let row = |row: usize| field.rows[row].project_near(pose.x_m, pose.y_m, on_middle.along_m).across_m;
        Place {
            along_m: on_middle.along_m,
            across_m: on_middle.across_m,
            left_m: -row(self.right_row + 1),
            right_m: row(self.right_row),
            heading_rad: wrap(pose.heading_rad - direction_rad(middle, on_middle.along_m - sensor_x_m, AHEAD_M)),
        }
    }

    /// On the lane's middle, along it \[m\].
    #[must_use]
    pub fn pose(&self, field: &Field, along_m: f64) -> Pose {
        let middle = self.middle(field);
        let [x_m, y_m] = middle.at(along_m);
        Pose { x_m, y_m, heading_rad: direction_rad(middle, along_m, [-1.0, 1.0]) }
    }

    /// The ground at a place along the lane \[m\].
    #[must_use]
    pub fn ground(&self, along_m: f64) -> Ground {
        let piece = (along_m / TERRAIN_STEP_M).max(0.0) as usize;
        self.terrain.get(piece).copied().unwrap_or_default()
    }

    /// Plants from here to there along the lane \[m\].
    #[must_use]
    pub fn plants_within<'a>(&self, plants: &'a [Plant], from_m: f64, to_m: f64) -> &'a [Plant] {
        within(plants, &self.plants_along_m, from_m, to_m)
    }

    /// Foliage from here to there along the lane \[m\].
    #[must_use]
    pub fn foliage_within(&self, from_m: f64, to_m: f64) -> &[Foliage] {
        within(&self.foliage, &self.foliage_along_m, from_m, to_m)
    }
}

/// Direction of `line` between two places relative to `along_m`, from the x axis \[rad\].
fn direction_rad(line: &Polyline, along_m: f64, [from_m, to_m]: [f64; 2]) -> f64 {
    let ([x0, y0], [x1, y1]) = (line.at(along_m + from_m), line.at(along_m + to_m));
    libm::atan2(y1 - y0, x1 - x0)
}

/// The same angle within pi of zero.
fn wrap(angle_rad: f64) -> f64 {
    libm::remainder(angle_rad, std::f64::consts::TAU)
}

fn within<'a, T>(items: &'a [T], along_m: &[f64], from_m: f64, to_m: f64) -> &'a [T] {
    let first = along_m.partition_point(|along| *along < from_m);
    let end = along_m.partition_point(|along| *along <= to_m).max(first);
    &items[first..end]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::FieldSpec;
    use crate::field::velasquez2022::{LaneName, Velasquez2022Params};

    fn field(lane: LaneName) -> Field {
        FieldSpec::Velasquez2022(Velasquez2022Params { lane, ..Default::default() }).build(3)
    }

    #[test]
    fn a_pose_on_the_middle_is_as_far_from_either_row_and_straight_ahead() {
        let field = field(LaneName::A);
        let lane = field.lane.as_ref().unwrap();
        for along_m in [5.0, 100.25, 199.0] {
            let place = lane.place(&field, (lane.pose(&field, along_m), 0.0), along_m + 1.0);
            assert!((place.along_m - along_m).abs() < 0.01 && place.across_m.abs() < 1e-9);
            assert!((place.left_m - place.right_m).abs() < 0.02, "{place:?}");
            assert!(place.heading_rad.abs() < 0.06);
        }
    }

    #[test]
    fn to_the_left_the_left_row_is_nearer_and_counter_clockwise_is_positive() {
        let field = field(LaneName::A);
        let lane = field.lane.as_ref().unwrap();
        let middle = lane.place(&field, (lane.pose(&field, 50.0), 0.0), 50.0);
        let mut pose = lane.pose(&field, 50.0);
        pose.y_m += 0.1;
        pose.heading_rad += 0.2;
        let place = lane.place(&field, (pose, 0.0), 50.0);
        assert!((place.across_m - 0.1).abs() < 0.005 && (place.left_m - middle.left_m + 0.1).abs() < 0.005);
        assert!((place.right_m - middle.right_m - 0.1).abs() < 0.005);
        assert!((place.heading_rad - middle.heading_rad - 0.2).abs() < 0.01);
    }

    #[test]
    fn in_a_curve_to_the_left_a_robot_on_the_tangent_heads_to_the_right_of_what_lies_ahead() {
        let field = field(LaneName::Production);
        let lane = field.lane.as_ref().unwrap();
        let heading = |along_m| lane.place(&field, (lane.pose(&field, along_m), 0.0), along_m).heading_rad;
        let mean = |from: i32| (0..10).map(|i| heading(f64::from(from + i) * 0.1)).sum::<f64>() / 10.0;
        // Chord one metre ahead at a radius of about eight and a half.
        assert!((mean(1585) + 0.115).abs() < 0.05, "{}", mean(1585));
        assert!(mean(1000).abs() < 0.05);
    }

    #[test]
    fn what_lies_within_a_stretch_is_all_that_does() {
        let field = field(LaneName::Production);
        let lane = field.lane.as_ref().unwrap();
        let near = lane.plants_within(&field.plants, 20.0, 25.0);
        assert_eq!(near.len(), lane.plants_along_m.iter().filter(|along| (20.0..=25.0).contains(*along)).count());
        assert!(near.len() > 200);
        assert!(lane.foliage_within(30.0, 20.0).is_empty());
    }
}
