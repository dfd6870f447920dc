//! A crown and a pole against rays.

use std::f32::consts::FRAC_PI_2;

use super::leaves::Leaves;
use super::window::{ALL, Grid, View, Window};
use crate::field::vintu2018::{Pole, Shape};

/// The window of a pole allows for so many times its radius: it may be nearer between its ends than at these.
const POLE_SPARE: f64 = 1.25;

/// A crown.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Foliage {
    centre: [f64; 3],
    radius_m: f64,
    half_height_m: f64,
    per_m: f64,
    /// What its leaves are drawn from.
    seed: u32,
}

impl Foliage {
    pub(super) fn new(shape: &Shape, seed: u32) -> Self {
        let crown = &shape.crown;
        let centre = [shape.x_m, shape.y_m, crown.z_m];
        Self { centre, radius_m: crown.radius_m, half_height_m: crown.half_height_m, per_m: crown.per_m, seed }
    }

    /// From the view to the crown's centre \[m\]; none if all of it is out of range or behind.
    pub(super) fn distance(&self, view: &View) -> Option<f32> {
        view.distance(self.centre, self.radius_m.max(self.half_height_m))
    }

    /// Which rays can meet it: as wide as its shadow along the LiDAR's upright axis, as high as the sphere around it.
    pub(super) fn window(&self, view: &View, grid: &Grid) -> Option<Window> {
        let (r2, h2) = (self.radius_m * self.radius_m, self.half_height_m * self.half_height_m);
        let width_m = (r2 + view.tilt2 * h2).sqrt();
        let [azimuth, elevation] = view.bearings(self.centre, [width_m, self.radius_m.max(self.half_height_m)]);
        grid.window(azimuth, elevation)
    }

    /// From where to where a ray passes the crown \[m\]; none where it does not.
    #[inline]
    pub(super) fn chord(&self, [ox, oy, oz]: [f64; 3], [dx, dy, dz]: [f64; 3]) -> Option<[f64; 2]> {
        let (horizontal, vertical) = (self.half_height_m * self.half_height_m, self.radius_m * self.radius_m);
        let (x, y, z) = (ox - self.centre[0], oy - self.centre[1], oz - self.centre[2]);
        let a = horizontal * (dx * dx + dy * dy) + vertical * (dz * dz);
        let b = horizontal * (x * dx + y * dy) + vertical * (z * dz);
        let c = horizontal * (x * x + y * y) + vertical * (z * z) - horizontal * vertical;
        let square = b * b - a * c;
        if square <= 0.0 {
            return None;
        }
        let (root, per) = (square.sqrt(), 1.0 / a);
        Some([(-b - root) * per, (root - b) * per])
    }

    /// Where a ray first meets a leaf within `from` and `to`; infinity where it gets through.
    #[inline]
    pub(super) fn meet(&self, origin: [f64; 3], direction: [f64; 3], [from, to]: [f64; 2], leaves: &Leaves) -> f64 {
        let Some([enter, leave]) = self.chord(origin, direction) else { return f64::INFINITY };
        leaves.meet((origin, direction), [from.max(enter), to.min(leave)], self.per_m, self.seed)
    }
}

/// A pole.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stem(Pole);

impl Stem {
    pub(super) const fn new(pole: Pole) -> Self {
        Self(pole)
    }

    /// Which rays can meet it: those between the bearings of its ends, and as much beside them as it is thick. Between ends at
    /// azimuths that far apart a straight line rises above both and falls below both by less than half of that; over more
    /// than a quarter of a turn it may pass on either side.
    pub(super) fn window(&self, view: &View, grid: &Grid) -> Option<Window> {
        let Pole { x_m, y_m, radius_m, foot_z_m, top_z_m } = self.0;
        let (middle_z_m, half_m) = (0.5 * (foot_z_m + top_z_m), 0.5 * (top_z_m - foot_z_m).max(0.0));
        view.distance([x_m, y_m, middle_z_m], half_m + radius_m)?;
        let ends = [foot_z_m, top_z_m].map(|z_m| view.bearings([x_m, y_m, z_m], [POLE_SPARE * radius_m; 2]));
        let hull = |axis: usize| {
            let [a, b] = ends.map(|end| end[axis]);
            [a[0].min(b[0]), a[1].max(b[1])]
        };
        let (azimuth, [low, high]) = (hull(0), hull(1));
        let turn = azimuth[1] - azimuth[0];
        if turn > FRAC_PI_2 {
            return grid.window(ALL, ALL);
        }
        grid.window(azimuth, [low - 0.5 * turn, high + 0.5 * turn])
    }

    /// Where a ray meets it from outside within `from` and `to`; infinity where it does not.
    #[inline]
    pub(super) fn meet(&self, [ox, oy, oz]: [f64; 3], [dx, dy, dz]: [f64; 3], [from, to]: [f64; 2]) -> f64 {
        let pole = &self.0;
        let (x, y) = (ox - pole.x_m, oy - pole.y_m);
        let (a, b, c) = (dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - pole.radius_m * pole.radius_m);
        let square = b * b - a * c;
        if square <= 0.0 {
            return f64::INFINITY;
        }
        let t = (-b - square.sqrt()) / a;
        let z = oz + t * dz;
        let hit = t >= from && t < to && z >= pole.foot_z_m && z <= pole.top_z_m;
        if hit { t } else { f64::INFINITY }
    }
}
