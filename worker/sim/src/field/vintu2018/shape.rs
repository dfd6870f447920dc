//! Plants in space: stems and rods are upright poles, crowns porous ellipsoids. All numbers are ours.

use super::layout::{Layout, Species};
use crate::field::Plant;

/// Radius of a beech's stem from a seedling's to that of a tree of [`STEM_FULL_M`] \[m\].
const STEM_RADIUS_M: [f64; 2] = [0.01, 0.03];
const STEM_FULL_M: f64 = 4.0;
/// Beeches of this mean height, in their second year and after, have a bamboo rod until they are planted out \[m\].
const ROD_FIELDS_M: [f64; 2] = [0.5, 2.0];
/// Radius of a rod, and its distance from the stem \[m\].
const ROD_RADIUS_M: f64 = 0.006;
const ROD_BESIDE_M: f64 = 0.05;
/// A beech's crown begins at this share of its height, and at so much more per metre of height, but no higher than the last:
/// nurseries clear the stems of standard trees, the thesis' trees have "a clear stem" (section 4.1).
const CROWN_BASE_SHARE: f64 = 0.1;
const CROWN_BASE_PER_M: f64 = 0.2;
const CROWN_BASE_MOST_M: f64 = 1.75;
/// Centre of a shrub's crown as a share of its height: the ground cuts the ellipsoid off where it is still wide.
const SHRUB_CENTRE_SHARE: f64 = 0.4;
/// What rays lose per metre of the smallest and of the largest crowns of a species \[1/m\]: half of the leaf area per volume, for
/// leaves that face anywhere. 6 to 2 m^2 in a cubic metre of a beech, 12 to 6 of a cherry laurel.
const BEECH_PER_M: [f64; 2] = [3.0, 1.0];
const LAUREL_PER_M: [f64; 2] = [6.0, 3.0];
const PLASTIC_PER_M: f64 = 6.0;
const WEED_PER_M: f64 = 6.0;
/// Poles reach so far into the soil: uneven ground leaves no gap below them \[m\].
const IN_SOIL_M: f64 = 0.05;

/// An upright cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pole {
    /// Axis \[m\].
    pub x_m: f64,
    /// Axis \[m\].
    pub y_m: f64,
    /// \[m\]
    pub radius_m: f64,
    /// Lower end, in the soil, in the world's frame \[m\].
    pub foot_z_m: f64,
    /// Upper end \[m\].
    pub top_z_m: f64,
}

/// An upright ellipsoid of leaves above the plant's place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crown {
    /// Centre, in the world's frame \[m\].
    pub z_m: f64,
    /// Horizontal semi-axis \[m\].
    pub radius_m: f64,
    /// Vertical semi-axis \[m\].
    pub half_height_m: f64,
    /// Of a chord of length l a ray survives with probability exp(-`per_m` l) \[1/m\].
    pub per_m: f64,
}

/// A plant in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// Its row; none for weeds.
    pub row: Option<u32>,
    /// Stem, and bamboo rod beside it.
    pub poles: [Option<Pole>; 2],
    /// Leaves.
    pub crown: Crown,
}

impl Shape {
    /// The highest point, in the world's frame \[m\].
    #[must_use]
    pub fn top_z_m(&self) -> f64 {
        let crown = self.crown.z_m + self.crown.half_height_m;
        self.poles.iter().flatten().map(|pole| pole.top_z_m).fold(crown, f64::max)
    }
}

pub(super) fn crop(plant: &Plant, layout: &Layout, rod_bearing_rad: f64, foot_z_m: f64, leaf_factor: f64) -> Shape {
    let [least, most] = layout.species.sizes_m()[0];
    let grown = if most > least { (layout.height_m - least) / (most - least) } else { 0.0 };
    let per_m = |[young, old]: [f64; 2]| leaf_factor * (young + grown * (old - young));
    let row = Some(plant.row);
    match layout.species {
        Species::Beech => {
            let has_rod = (ROD_FIELDS_M[0]..=ROD_FIELDS_M[1]).contains(&layout.height_m);
            let rod = has_rod.then(|| rod(plant, rod_bearing_rad, foot_z_m));
            Shape { row, ..beech(plant, rod, foot_z_m, per_m(BEECH_PER_M)) }
        }
        Species::CherryLaurel => Shape { row, ..shrub(plant, foot_z_m, per_m(LAUREL_PER_M)) },
        Species::Plastic => Shape { row, ..shrub(plant, foot_z_m, leaf_factor * PLASTIC_PER_M) },
    }
}

pub(super) fn weed(plant: &Plant, foot_z_m: f64, leaf_factor: f64) -> Shape {
    shrub(plant, foot_z_m, leaf_factor * WEED_PER_M)
}

/// The stem shows up to the middle of the crown.
fn beech(plant: &Plant, rod: Option<Pole>, foot_z_m: f64, per_m: f64) -> Shape {
    let height_m = plant.height_m;
    let base_m = (height_m * (CROWN_BASE_SHARE + CROWN_BASE_PER_M * height_m)).min(CROWN_BASE_MOST_M);
    let crown = Crown {
        z_m: foot_z_m + 0.5 * (base_m + height_m),
        radius_m: plant.radius_m,
        half_height_m: 0.5 * (height_m - base_m),
        per_m,
    };
    let [thin, thick] = STEM_RADIUS_M;
    let stem = Pole {
        x_m: plant.x_m,
        y_m: plant.y_m,
        radius_m: thin + (thick - thin) * (height_m / STEM_FULL_M).min(1.0),
        foot_z_m: foot_z_m - IN_SOIL_M,
        top_z_m: crown.z_m,
    };
    Shape { x_m: plant.x_m, y_m: plant.y_m, row: None, poles: [Some(stem), rod], crown }
}

/// As tall as its plant.
fn rod(plant: &Plant, bearing_rad: f64, foot_z_m: f64) -> Pole {
    let (sin, cos) = libm::sincos(bearing_rad);
    Pole {
        x_m: plant.x_m + ROD_BESIDE_M * cos,
        y_m: plant.y_m + ROD_BESIDE_M * sin,
        radius_m: ROD_RADIUS_M,
        foot_z_m: foot_z_m - IN_SOIL_M,
        top_z_m: foot_z_m + plant.height_m,
    }
}

fn shrub(plant: &Plant, foot_z_m: f64, per_m: f64) -> Shape {
    let crown = Crown {
        z_m: foot_z_m + SHRUB_CENTRE_SHARE * plant.height_m,
        radius_m: plant.radius_m,
        half_height_m: (1.0 - SHRUB_CENTRE_SHARE) * plant.height_m,
        per_m,
    };
    Shape { x_m: plant.x_m, y_m: plant.y_m, row: None, poles: [None, None], crown }
}
