//! A planar LiDAR among vertical stems: exact rays against circles, object by object.
//!
//! Beams begin at the closest range, so a stem that the LiDAR has just driven up to hides nothing: the robot
//! passes over weeds, which bend down before it.
//!
//! Each stem is met only by the beams in its angular window, found by an approximate bearing that is never
//! used for more. Stems within reach are gathered once and kept until the LiDAR has moved on.

use furrow_navigation::perception::{Beams, Scan};
use furrow_navigation::random::Stream;

use super::TwoPlanarLidarsParams;
use crate::Pose;
use crate::field::Plant;

/// Stems are gathered this much beyond the range, and again after the LiDAR has moved so far \[m\].
const MARGIN_M: f64 = 0.5;
/// Beams added on each side of a window: the bearing is off by far less than a beam.
const GUARD_BEAMS: f64 = 1.0;

/// The LiDAR and its last scan.
#[derive(Debug, Clone)]
pub struct PlanarLidar {
    beams: Beams,
    ranges_m: Vec<f64>,
    range_min_m: f64,
    range_max_m: f64,
    noise_m: f64,
    gathered_at: Option<(f64, f64)>,
    /// x, y, radius of the stems within reach \[m\].
    near: Vec<[f64; 3]>,
}

impl PlanarLidar {
    /// A LiDAR with these parameters.
    #[must_use]
    pub fn new(params: &TwoPlanarLidarsParams) -> Self {
        let beams = Beams::new(params.beams as usize, params.field_of_view_rad);
        Self {
            ranges_m: vec![f64::INFINITY; beams.len()],
            beams,
            range_min_m: params.range_min_m,
            range_max_m: params.range_max_m,
            noise_m: params.range_noise_m,
            gathered_at: None,
            near: Vec::new(),
        }
    }

    /// The ranges seen from `world_from_lidar`; no return is infinity.
    pub fn scan(&mut self, plants: &[Plant], world_from_lidar: Pose, random: &mut Stream) -> Scan<'_> {
        self.gather(plants, world_from_lidar);
        self.cast(world_from_lidar);
        for range in &mut self.ranges_m {
            if *range <= self.range_max_m {
                *range = (*range + self.noise_m * random.normal()).clamp(self.range_min_m, self.range_max_m);
            } else {
                *range = f64::INFINITY;
            }
        }
        Scan { beams: &self.beams, ranges_m: &self.ranges_m }
    }

    fn gather(&mut self, plants: &[Plant], at: Pose) {
        let moved = |(x, y): (f64, f64)| (at.x_m - x) * (at.x_m - x) + (at.y_m - y) * (at.y_m - y);
        if self.gathered_at.is_some_and(|place| moved(place) <= MARGIN_M * MARGIN_M) {
            return;
        }
        self.gathered_at = Some((at.x_m, at.y_m));
        self.near.clear();
        for plant in plants {
            let reach = self.range_max_m + plant.radius_m + MARGIN_M;
            let (dx, dy) = (plant.x_m - at.x_m, plant.y_m - at.y_m);
            if dx * dx + dy * dy <= reach * reach {
                self.near.push([plant.x_m, plant.y_m, plant.radius_m]);
            }
        }
    }

    /// Distance to the first stem on each beam \[m\]; infinity where there is none.
    fn cast(&mut self, from: Pose) {
        self.ranges_m.fill(f64::INFINITY);
        let (sin, cos) = libm::sincos(from.heading_rad);
        for [plant_x, plant_y, radius] in &self.near {
            let (dx, dy) = (plant_x - from.x_m, plant_y - from.y_m);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let distance2 = x * x + y * y;
            let reach = self.range_max_m + radius;
            if distance2 > reach * reach {
                continue;
            }
            let radius2 = radius * radius;
            if distance2 <= radius2 {
                continue;
            }
            // The half-width asin(r / d) is below tan of itself, r / sqrt(d^2 - r^2).
            let half = radius / (distance2 - radius2).sqrt();
            let bearing = approximate_atan2(y, x);
            let beam = |angle: f64| (angle - self.beams.angle_min_rad) / self.beams.angle_increment_rad;
            let first = (beam(bearing - half) - GUARD_BEAMS).max(0.0) as usize;
            let last = (beam(bearing + half) + GUARD_BEAMS + 1.0).max(0.0) as usize;
            for i in first..last.min(self.ranges_m.len()) {
                let (beam_cos, beam_sin) = (self.beams.cos[i], self.beams.sin[i]);
                let along = x * beam_cos + y * beam_sin;
                let across = x * beam_sin - y * beam_cos;
                let depth2 = radius2 - across * across;
                if depth2 >= 0.0 && along > 0.0 {
                    let range = along - depth2.sqrt();
                    if range >= self.range_min_m && range < self.ranges_m[i] {
                        self.ranges_m[i] = range;
                    }
                }
            }
        }
    }
}

/// The angle of (x, y), to 0.0012 rad: a cubic in the smaller ratio, by octants.
fn approximate_atan2(y: f64, x: f64) -> f64 {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let ratio = if large > 0.0 { small / large } else { 0.0 };
    let octant = ratio * (FRAC_PI_4 + (1.0 - ratio) * (0.2447 + 0.0663 * ratio));
    let quadrant = if ax < ay { FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { PI - quadrant } else { quadrant };
    if y < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::PlantKind;
    use proptest::prelude::*;

    fn plant(x_m: f64, y_m: f64, radius_m: f64) -> Plant {
        Plant { x_m, y_m, radius_m, height_m: 1.0, kind: PlantKind::Crop, row: 0 }
    }

    fn exact() -> PlanarLidar {
        PlanarLidar::new(&TwoPlanarLidarsParams { range_noise_m: 0.0, ..Default::default() })
    }

    /// Every beam against every stem, by the quadratic equation.
    fn brute_force(plants: &[Plant], from: Pose) -> Vec<f64> {
        let beams = Beams::new(360, std::f64::consts::PI);
        (0..360)
            .map(|i| {
                let angle = from.heading_rad + beams.angle_min_rad + i as f64 * beams.angle_increment_rad;
                let (uy, ux) = libm::sincos(angle);
                let ranges = plants.iter().map(|p| ray(p, from, ux, uy)).filter(|range| (0.1..=4.0).contains(range));
                ranges.fold(f64::INFINITY, f64::min)
            })
            .collect()
    }

    fn ray(p: &Plant, from: Pose, ux: f64, uy: f64) -> f64 {
        let (dx, dy) = (p.x_m - from.x_m, p.y_m - from.y_m);
        let b = dx * ux + dy * uy;
        let root = b * b - (dx * dx + dy * dy - p.radius_m * p.radius_m);
        if root < 0.0 || b < 0.0 { f64::INFINITY } else { b - root.sqrt() }
    }

    proptest! {
        #[test]
        fn windows_give_what_brute_force_gives(
            places in proptest::collection::vec((-5.0..5.0_f64, -5.0..5.0_f64, 0.005..0.3_f64), 1..60),
            heading_rad in -4.0..4.0_f64,
        ) {
            let from = Pose { x_m: 0.3, y_m: -0.2, heading_rad };
            let plants: Vec<_> = places
                .iter()
                .map(|(x, y, r)| plant(*x, *y, *r))
                .filter(|p| libm::hypot(p.x_m - 0.3, p.y_m + 0.2) > p.radius_m)
                .collect();
            let mut lidar = exact();
            let scan = lidar.scan(&plants, from, &mut Stream::new(1, "lidar"));
            for (windowed, brute) in scan.ranges_m.iter().zip(brute_force(&plants, from)) {
                // At a tangent rounding decides whether a beam hits.
                let same = *windowed == brute || (windowed - brute).abs() < 1e-6;
                prop_assert!(same || grazing(&plants, from, *windowed, brute), "{windowed} {brute}");
            }
        }

        #[test]
        fn the_bearing_is_good_to_a_fraction_of_a_beam(x in -4.0..4.0_f64, y in -4.0..4.0_f64) {
            let gap = approximate_atan2(y, x) - libm::atan2(y, x);
            prop_assert!(gap.abs() < 0.002);
        }
    }

    /// Whether the two ranges can differ because a beam just touches a stem.
    fn grazing(plants: &[Plant], from: Pose, a: f64, b: f64) -> bool {
        let touches = |range: f64| {
            plants.iter().any(|p| {
                let tangent = libm::hypot(p.x_m - from.x_m, p.y_m - from.y_m).powi(2) - p.radius_m * p.radius_m;
                (tangent.sqrt() - range).abs() < 1e-3
            })
        };
        touches(a.min(b))
    }

    #[test]
    fn a_stem_ahead_is_seen_at_its_face_and_one_beyond_the_range_is_not() {
        let mut lidar = exact();
        let plants = [plant(2.0, 0.0, 0.02), plant(-2.0, 0.0, 0.02), plant(0.0, 4.5, 0.02)];
        let scan = lidar.scan(&plants, Pose::default(), &mut Stream::new(1, "lidar"));
        let hits: Vec<f64> = scan.ranges_m.iter().copied().filter(|range| range.is_finite()).collect();
        assert!(!hits.is_empty() && hits.iter().all(|range| (1.98..2.0).contains(range)), "{hits:?}");
    }

    #[test]
    fn noise_has_the_given_spread() {
        let mut lidar = PlanarLidar::new(&TwoPlanarLidarsParams::default());
        let wall: Vec<_> = (0..200).map(|i| plant(2.0, -1.0 + 0.01 * f64::from(i), 0.02)).collect();
        let mut random = Stream::new(1, "lidar");
        let clean = exact().scan(&wall, Pose::default(), &mut random.clone()).ranges_m.to_vec();
        let (mut sum, mut n) = (0.0, 0.0);
        for _ in 0..200 {
            let scan = lidar.scan(&wall, Pose::default(), &mut random);
            for (noisy, clean) in scan.ranges_m.iter().zip(&clean).filter(|(range, _)| range.is_finite()) {
                sum += (noisy - clean) * (noisy - clean);
                n += 1.0;
            }
        }
        let deviation = f64::sqrt(sum / n);
        assert!((deviation - 0.01).abs() < 0.0005, "{deviation}");
    }
}
