//! Planting and growing: where the plants of a field stand, which are missing, and how large each is.

use std::f64::consts::TAU;

use furrow_navigation::random::Stream;

use super::layout::Layout;
use super::shape::{self, Shape};
use super::terrain::Terrain;
use crate::field::{Plant, PlantKind};

/// A size below this share of its mean is drawn anew: the normal distribution is cut off there. Ours.
const LEAST_SHARE: f64 = 0.1;
/// Height and radius of a weed \[m\]. Ours.
const WEED_HEIGHT_M: [f64; 2] = [0.05, 0.4];
const WEED_RADIUS_M: [f64; 2] = [0.02, 0.12];
/// Weeds grow up to so far around the planting positions \[m\]. Ours.
const WEED_MARGIN_M: f64 = 0.5;

/// What stands in a field.
pub(super) struct Grown {
    /// Crops row by row, then weeds.
    pub plants: Vec<Plant>,
    /// Direction from each plant to its rod, if it has one \[rad\].
    rod_bearing_rad: Vec<f64>,
    /// Of all planting positions, row by row.
    pub presence: Vec<bool>,
    /// Planting positions (x, y) of missing plants \[m\].
    pub missing_m: Vec<[f64; 2]>,
}

pub(super) fn grow(layout: &Layout, seed: u64) -> Grown {
    let mut grown =
        Grown { plants: Vec::new(), rod_bearing_rad: Vec::new(), presence: Vec::new(), missing_m: Vec::new() };
    for row in 0..layout.map.rows {
        grown.plant_row(layout, row, seed);
    }
    grown.sow_weeds(layout, &mut Stream::new(seed, "field-weeds"));
    grown
}

impl Grown {
    /// A missing plant is drawn all the same.
    fn plant_row(&mut self, layout: &Layout, row: u32, seed: u64) {
        let [mut plants, mut missing] =
            ["plants", "missing"].map(|name| Stream::new(seed, &format!("field-{name}-{row}")));
        let y_m = layout.map.row_y_m(row);
        for place in 0..layout.map.plants_per_row {
            let x_m = f64::from(place) * layout.map.planting_distance_m;
            let [dx, dy] = [plants.normal(), plants.normal()].map(|deviate| layout.position_sd_m * deviate);
            let [height_m, radius_m] =
                [layout.height_m, layout.radius_m].map(|mean| size(mean, layout.size_sd, &mut plants));
            let bearing_rad = plants.between(0.0, TAU);
            let present = missing.uniform() >= layout.missing_share;
            self.presence.push(present);
            if present {
                let kind = PlantKind::Crop;
                self.plants.push(Plant { x_m: x_m + dx, y_m: y_m + dy, radius_m, height_m, kind, row });
                self.rod_bearing_rad.push(bearing_rad);
            } else {
                self.missing_m.push([x_m, y_m]);
            }
        }
    }

    fn sow_weeds(&mut self, layout: &Layout, random: &mut Stream) {
        let [[x0, y0], [x1, y1]] = super::extent_m(&layout.map);
        let margin = WEED_MARGIN_M;
        let area_m2 = (x1 - x0 + 2.0 * margin) * (y1 - y0 + 2.0 * margin);
        for _ in 0..(layout.weeds_per_m2 * area_m2 + random.uniform()) as u32 {
            let (x_m, y_m) = (random.between(x0 - margin, x1 + margin), random.between(y0 - margin, y1 + margin));
            let [height_m, radius_m] = [WEED_HEIGHT_M, WEED_RADIUS_M].map(|[low, high]| random.between(low, high));
            self.plants.push(Plant { x_m, y_m, radius_m, height_m, kind: PlantKind::Weed, row: 0 });
            self.rod_bearing_rad.push(0.0);
        }
    }

    /// The plants in space, in the same order, each on the ground where it stands.
    pub(super) fn shapes(&self, layout: &Layout, leaf_factor: f64, terrain: &Terrain) -> Vec<Shape> {
        let shape = |(plant, rod_bearing_rad): (&Plant, &f64)| {
            let foot_z_m = terrain.height_m(plant.x_m, plant.y_m);
            match plant.kind {
                PlantKind::Crop => shape::crop(plant, layout, *rod_bearing_rad, foot_z_m, leaf_factor),
                PlantKind::Weed => shape::weed(plant, foot_z_m, leaf_factor),
            }
        };
        self.plants.iter().zip(&self.rod_bearing_rad).map(shape).collect()
    }
}

/// A height or radius about its mean.
fn size(mean: f64, sd_share: f64, random: &mut Stream) -> f64 {
    loop {
        let share = 1.0 + sd_share * random.normal();
        if share >= LEAST_SHARE {
            return mean * share;
        }
    }
}
