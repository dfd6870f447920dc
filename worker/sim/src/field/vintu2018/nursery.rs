//! What a nursery has beyond a field's plants: the map, plants in space, the ground, and which lanes a robot fits through.

use std::f64::consts::FRAC_PI_2;

use furrow_navigation::localization::PlantingMap;

use super::layout::Species;
use super::shape::Shape;
use super::terrain::Terrain;
use crate::lidar::canopy::Canopy;

/// A nursery; the world's frame is that of its map.
#[derive(Debug, Clone, PartialEq)]
pub struct Nursery {
    /// Which one of the hundred; the garden comes after the last.
    pub number: u32,
    /// What is known beforehand.
    pub map: PlantingMap,
    /// What grows there.
    pub species: Species,
    /// Whether a plant stands at each planting position, row by row along x.
    pub presence: Vec<bool>,
    /// The field's plants in space, in the same order.
    pub shapes: Vec<Shape>,
    /// The ground.
    pub terrain: Terrain,
    /// The plants, ready for rays.
    pub canopy: Canopy,
    /// Height of the tallest plant, weeds included \[m\].
    pub max_height_m: f64,
}

/// A plant as a robot must spare it: x, y, half the radius of its crown \[m\].
type Circle = [f64; 3];

impl Nursery {
    /// Whether a straight corridor of `width_m` between the two rows of `lane` is free of the circles of half the
    /// crown's radius around their plants. There is none in a lane beyond the last.
    #[must_use]
    pub fn passable_lane(&self, lane: u32, width_m: f64) -> bool {
        if lane >= self.map.lanes() {
            return false;
        }
        let towards_left = self.map.lanes_to_the_left;
        let (right, left) = if towards_left { (lane, lane + 1) } else { (lane + 1, lane) };
        has_corridor(&self.circles(right), &self.circles(left), width_m)
    }

    /// Share of the lanes that are [passable](Self::passable_lane); 1 where there is no lane.
    #[must_use]
    pub fn passable_lanes_share(&self, width_m: f64) -> f64 {
        let lanes = self.map.lanes();
        let passable = (0..lanes).filter(|lane| self.passable_lane(*lane, width_m)).count();
        if lanes == 0 { 1.0 } else { passable as f64 / f64::from(lanes) }
    }

    fn circles(&self, row: u32) -> Vec<Circle> {
        let of_row = self.shapes.iter().filter(|shape| shape.row == Some(row));
        of_row.map(|shape| [shape.x_m, shape.y_m, 0.5 * shape.crown.radius_m]).collect()
    }
}

/// Whether some strip of `width_m`, in a direction within a right angle of x, has all circles `right` on its right and
/// all `left` on its left.
///
/// In direction a, circles p on the right and q on the left leave (q - p) . n - r_p - r_q between them, n = (-sin a, cos a):
/// as much as `width_m` where a lies within acos((`width_m` + r_p + r_q) / |q - p|) of a certain direction. All these
/// intervals must share one.
fn has_corridor(right: &[Circle], left: &[Circle], width_m: f64) -> bool {
    let mut shared = (-FRAC_PI_2, FRAC_PI_2);
    for [px, py, p_radius] in right {
        for [qx, qy, q_radius] in left {
            let (dx, dy) = (qx - px, qy - py);
            let share = (width_m + p_radius + q_radius) / libm::hypot(dx, dy);
            if share.is_nan() || share > 1.0 {
                return false;
            }
            let (best, half) = (libm::atan2(-dx, dy), libm::acos(share));
            shared = (shared.0.max(best - half), shared.1.min(best + half));
        }
    }
    shared.0 <= shared.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn row(y: f64, radius: f64) -> Vec<Circle> {
        (0..10).map(|i| [f64::from(i) * 0.5, y, radius]).collect()
    }

    #[test]
    fn a_straight_lane_is_as_wide_as_what_its_circles_leave() {
        let (right, left) = (row(-0.65, 0.1), row(0.65, 0.2));
        assert!(has_corridor(&right, &left, 0.9995) && !has_corridor(&right, &left, 1.0005));
        assert!(!has_corridor(&left, &right, 0.0), "rows the wrong way round leave nothing");
    }

    #[test]
    fn a_corridor_may_run_askew() {
        // Two plants alone: across the line between them.
        let (right, left) = (vec![[4.0, -0.1, 0.05]], vec![[0.0, 0.1, 0.05]]);
        let widest = libm::hypot(4.0, 0.2) - 0.1;
        assert!(has_corridor(&right, &left, widest - 0.001) && !has_corridor(&right, &left, widest + 0.001));
        let (right, left) = (row(-0.65, 0.1), vec![[2.0, 0.3, 0.1]]);
        assert!(has_corridor(&right, &left, 0.749) && !has_corridor(&right, &left, 0.751));
    }

    #[test]
    fn an_empty_row_is_in_nobodys_way() {
        assert!(has_corridor(&[], &row(0.0, 1.0), 50.0));
    }

    proptest! {
        #[test]
        fn no_direction_does_better(
            scatter in proptest::collection::vec((-0.15..0.15_f64, 0.0..0.3_f64), 20),
            width_m in 0.4..1.2_f64,
        ) {
            let circle = |(i, (dy, radius)): (usize, &(f64, f64))| {
                [0.5 * (i % 10) as f64, dy + if i < 10 { -0.65 } else { 0.65 }, *radius]
            };
            let circles: Vec<Circle> = scatter.iter().enumerate().map(circle).collect();
            let (right, left) = circles.split_at(10);
            let free = |a: f64| {
                let (sin, cos) = libm::sincos(a);
                let edge = |[x, y, r]: &Circle, side: f64| side * (cos * y - sin * x) - r;
                let to = left.iter().map(|c| edge(c, 1.0)).fold(f64::INFINITY, f64::min);
                to + right.iter().map(|c| edge(c, -1.0)).fold(f64::INFINITY, f64::min)
            };
            let widest = (-5_000..5_000).map(|i| free(f64::from(i) * 1e-4)).fold(f64::NEG_INFINITY, f64::max);
            prop_assume!((widest - width_m).abs() > 0.001);
            prop_assert_eq!(has_corridor(right, left, width_m), widest > width_m);
        }
    }
}
