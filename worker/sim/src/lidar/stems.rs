//! The stems around a LiDAR, in its frame, and with which of its beams it can meet each.
//!
//! Stems that any pose nearby could see are gathered once and kept until the LiDAR has moved or turned on. All
//! that is approximate here, in single precision, only leaves out what no beam can hit: no range depends on it.

use furrow_navigation::perception::Beams;

use crate::Pose;
use crate::field::Plant;

/// Stems are gathered for all poses within this distance \[m\] and turn \[rad\]. Ours: some 40 scans then share
/// a gathering, and few stems are gathered in vain.
const MARGIN_M: f64 = 0.15;
/// See [`MARGIN_M`].
const MARGIN_RAD: f64 = 0.1;
/// Above the error of a bearing \[rad\]: 1.2e-5 of the polynomial, and a few roundings to 2^-24 of at most pi.
pub(super) const GUARD_RAD: f32 = 3e-5;

/// The stems within reach.
#[derive(Debug, Clone)]
pub(super) struct Stems {
    range_max_m: f64,
    /// x of the backmost point that a beam can reach; 0 unless the field of view exceeds pi \[m\].
    backmost_m: f64,
    gathered_at: Option<Pose>,
    /// In the world's frame \[m\].
    x_m: Vec<f64>,
    y_m: Vec<f64>,
    radius_m: Vec<f64>,
    /// In the LiDAR's frame: x, y, squared radius \[m\], \[m^2\].
    local: Vec<[f64; 3]>,
    windows: Windows,
}

/// First beam and end of the beams that can meet each stem, and what they follow from.
#[derive(Debug, Clone)]
struct Windows {
    angle_min_rad: f32,
    beams_per_rad: f32,
    beams: f32,
    x_m: Vec<f32>,
    y_m: Vec<f32>,
    radius_m: Vec<f32>,
    /// Square of the distance to the points where beams touch the stem; negative for a stem out of sight.
    touch2: Vec<f32>,
    first: Vec<u32>,
    end: Vec<u32>,
}

impl Stems {
    /// No stems yet, for a LiDAR with these beams.
    pub(super) fn new(beams: &Beams, range_max_m: f64) -> Self {
        Self {
            range_max_m,
            backmost_m: range_max_m * beams.cos.iter().copied().fold(0.0, f64::min),
            gathered_at: None,
            x_m: Vec::new(),
            y_m: Vec::new(),
            radius_m: Vec::new(),
            local: Vec::new(),
            windows: Windows::new(beams),
        }
    }

    /// Takes in that the LiDAR is at `pose` among `plants`, of which those in reach are the same in every call.
    pub(super) fn look(&mut self, plants: &[Plant], pose: Pose) {
        if !self.gathered_at.is_some_and(|at| is_near(at, pose)) {
            self.gather(plants, pose);
        }
        self.place(pose);
        self.windows.find();
    }

    /// x, y and squared radius of each stem in the LiDAR's frame, first and end of the beams that can meet it.
    pub(super) fn iter(&self) -> impl Iterator<Item = ([f64; 3], usize, usize)> + '_ {
        let windows = self.windows.first.iter().zip(&self.windows.end);
        self.local.iter().zip(windows).map(|(stem, (first, end))| (*stem, *first as usize, *end as usize))
    }

    fn gather(&mut self, plants: &[Plant], at: Pose) {
        self.gathered_at = Some(at);
        self.x_m.clear();
        self.y_m.clear();
        self.radius_m.clear();
        let (sin, cos) = libm::sincos(at.heading_rad);
        for plant in plants {
            let reach = self.range_max_m + plant.radius_m + MARGIN_M;
            let (dx, dy) = (plant.x_m - at.x_m, plant.y_m - at.y_m);
            let backmost = self.backmost_m - plant.radius_m - MARGIN_M - MARGIN_RAD * reach;
            if dx * dx + dy * dy <= reach * reach && cos * dx + sin * dy >= backmost {
                self.x_m.push(plant.x_m);
                self.y_m.push(plant.y_m);
                self.radius_m.push(plant.radius_m);
            }
        }
        self.local.resize(self.x_m.len(), [0.0; 3]);
        self.windows.resize(&self.radius_m);
    }

    /// Transforms all stems into the frame of a LiDAR at `pose`.
    fn place(&mut self, pose: Pose) {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        let n = self.x_m.len();
        let (x_m, y_m, radius_m) = (&self.x_m[..n], &self.y_m[..n], &self.radius_m[..n]);
        let Windows { x_m: x_out, y_m: y_out, touch2, .. } = &mut self.windows;
        let (local, x_out, y_out, touch2) = (&mut self.local[..n], &mut x_out[..n], &mut y_out[..n], &mut touch2[..n]);
        for i in 0..n {
            let (dx, dy) = (x_m[i] - pose.x_m, y_m[i] - pose.y_m);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let distance2 = x * x + y * y;
            let radius2 = radius_m[i] * radius_m[i];
            let reach = self.range_max_m + radius_m[i];
            let in_sight = (distance2 <= reach * reach) & (distance2 > radius2);
            local[i] = [x, y, radius2];
            x_out[i] = x as f32;
            y_out[i] = y as f32;
            touch2[i] = if in_sight { (distance2 - radius2) as f32 } else { -1.0 };
        }
    }
}

impl Windows {
    fn new(beams: &Beams) -> Self {
        Self {
            angle_min_rad: beams.angle_min_rad as f32,
            beams_per_rad: beams.angle_increment_rad.recip() as f32,
            beams: beams.len() as f32,
            x_m: Vec::new(),
            y_m: Vec::new(),
            radius_m: Vec::new(),
            touch2: Vec::new(),
            first: Vec::new(),
            end: Vec::new(),
        }
    }

    fn resize(&mut self, radius_m: &[f64]) {
        let n = radius_m.len();
        self.radius_m.clear();
        self.radius_m.extend(radius_m.iter().map(|radius| *radius as f32));
        for values in [&mut self.x_m, &mut self.y_m, &mut self.touch2] {
            values.resize(n, 0.0);
        }
        self.first.resize(n, 0);
        self.end.resize(n, 0);
    }

    fn find(&mut self) {
        let n = self.x_m.len();
        let (x_m, y_m, radius_m, touch2) = (&self.x_m[..n], &self.y_m[..n], &self.radius_m[..n], &self.touch2[..n]);
        let (first, end) = (&mut self.first[..n], &mut self.end[..n]);
        for i in 0..n {
            // The half-width asin(r / d) is below tan of itself, r / sqrt(d^2 - r^2). Not a number if out of sight.
            let half = radius_m[i] / touch2[i].sqrt() + GUARD_RAD;
            let from_first = approximate_atan2(y_m[i], x_m[i]) - self.angle_min_rad;
            first[i] = rounded_up(within((from_first - half) * self.beams_per_rad, self.beams));
            end[i] = rounded_up(within((from_first + half) * self.beams_per_rad, self.beams));
        }
    }
}

fn is_near(a: Pose, b: Pose) -> bool {
    let (dx, dy) = (a.x_m - b.x_m, a.y_m - b.y_m);
    dx * dx + dy * dy <= MARGIN_M * MARGIN_M && (a.heading_rad - b.heading_rad).abs() <= MARGIN_RAD
}

/// `value` between -0.5 and `n` - 0.5; the lower bound for what is not a number.
#[inline]
pub(super) fn within(value: f32, n: f32) -> f32 {
    let from_below = if value > -0.5 { value } else { -0.5 };
    if from_below < n - 0.5 { from_below } else { n - 0.5 }
}

/// The smallest integer not below `value`, or at an integer perhaps the next one; from -0.5 to 2^22.
///
/// At 2^23 floats are integers: the sum rounds, and its low bits are the answer. Unlike a cast it vectorises.
#[inline]
pub(super) fn rounded_up(value: f32) -> u32 {
    const TWO_23: f32 = 8_388_608.0;
    (value + 0.5 + TWO_23).to_bits() - TWO_23.to_bits()
}

/// The angle of (x, y), to 1.2e-5 rad. Abramowitz and Stegun (1964), eq. 4.4.49, after atan(t) = pi/4 + atan((t - 1) / (t + 1)).
#[inline]
pub(super) fn approximate_atan2(y: f32, x: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (ax, ay) = (x.abs(), y.abs());
    let ratio = (ay - ax) / (ay + ax);
    let t = ratio * ratio;
    let above = ratio * (0.999_866 + t * (-0.330_299_5 + t * (0.180_141 + t * (-0.085_133 + t * 0.020_835_1))));
    (FRAC_PI_2 - (FRAC_PI_4 - above).copysign(x)).copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_bearing_is_better_than_its_guard(x in -4.0..4.0_f64, y in -4.0..4.0_f64) {
            let gap = f64::from(approximate_atan2(y as f32, x as f32)) - libm::atan2(y, x);
            prop_assert!(gap.abs() < 0.6 * f64::from(GUARD_RAD), "{gap}");
        }

        #[test]
        fn an_index_is_rounded_up(value in -0.5..10_000.0_f32) {
            prop_assert!((value..=value + 1.0).contains(&(rounded_up(value) as f32)));
        }
    }
}
