//! What is drawn once for a field: tables 4.1 and 4.2 of Vintu (2018).

use furrow_navigation::localization::PlantingMap;
use furrow_navigation::random::Stream;

use super::{Site, Vintu2018Params};

/// Simulated nurseries, half of them of each species.
pub(super) const NURSERIES: u32 = 100;
const NURSERIES_PER_SPECIES: u32 = NURSERIES / 2;

/// Rows and plants per row, both ends included. Paper.
const ROWS: [u32; 2] = [5, 11];
const PLANTS_PER_ROW: [u32; 2] = [20, 40];
/// Standard deviation of a plant's size as a share of the mean. Paper.
const SIZE_SD: [f64; 2] = [0.05, 0.3];
/// Standard deviation of a plant's place \[m\]. Paper.
const POSITION_SD_M: [f64; 2] = [0.01, 0.08];
/// Share of missing plants. Paper: 0.01 to 0.25 "percent", meant as a share.
const MISSING_SHARE: [f64; 2] = [0.01, 0.25];
/// Weeds per area \[1/m^2\]. Ours.
const WEEDS_PER_M2: [f64; 2] = [0.02, 0.15];
/// Standard deviation of the ground's roughness \[m\]. Ours.
const ROUGHNESS_M: [f64; 2] = [0.01, 0.03];
/// Mean height up to which beeches and cherry laurels stand in their first field \[m\]. Paper: table 4.1.
const BEECH_FIRST_FIELD_M: f64 = 2.0;
const LAUREL_FIRST_FIELD_M: f64 = 1.25;
/// Row and planting distance of a first field \[m\]. Paper: table 4.1.
const FIRST_FIELD_M: [f64; 2] = [1.3, 0.4];
/// Those of larger beeches, one of each, and of larger cherry laurels \[m\]. Paper: table 4.2.
const BEECH_ROWS_M: [f64; 2] = [1.5, 1.6];
const BEECH_PLANTING_M: [f64; 4] = [1.2, 1.4, 1.5, 1.6];
const LAUREL_SECOND_FIELD_M: [f64; 2] = [2.0, 2.0];
/// Size of a plastic plant, its spread, how exactly it is put there and the share of gaps. Ours: a Jackal passes.
const GARDEN_HEIGHT_M: f64 = 0.5;
const GARDEN_RADIUS_M: f64 = 0.2;
const GARDEN_SIZE_SD: f64 = 0.05;
const GARDEN_POSITION_SD_M: f64 = 0.02;
const GARDEN_MISSING_SHARE: f64 = 0.1;

/// What grows in a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Species {
    /// A tree with one stem.
    Beech,
    /// A shrub, leaves down to the ground.
    CherryLaurel,
    /// A plastic shrub of the test garden.
    Plastic,
}

impl Species {
    /// Mean height and radius of a field's plants, the smallest and the largest \[m\]. Paper: table 4.2.
    pub(super) const fn sizes_m(self) -> [[f64; 2]; 2] {
        match self {
            Self::Beech => [[0.1, 4.0], [0.04, 0.81]],
            Self::CherryLaurel => [[0.1, 3.0], [0.06, 0.76]],
            Self::Plastic => [[GARDEN_HEIGHT_M; 2], [GARDEN_RADIUS_M; 2]],
        }
    }
}

/// What holds for all of a field.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    pub name: String,
    pub map: PlantingMap,
    pub species: Species,
    /// Means of the plants \[m\].
    pub height_m: f64,
    pub radius_m: f64,
    /// Standard deviation of a size as a share of its mean.
    pub size_sd: f64,
    /// Standard deviation of a place, along and across \[m\].
    pub position_sd_m: f64,
    pub missing_share: f64,
    pub weeds_per_m2: f64,
    pub roughness_m: f64,
}

impl Layout {
    /// Draws everything, and only then puts what the user wants in its place.
    pub(super) fn draw(params: &Vintu2018Params, random: &mut Stream) -> Self {
        let mut layout = match params.site {
            Site::Nursery => nursery(params.nursery.min(NURSERIES - 1), random),
            Site::RealGarden => garden(random),
        };
        if params.rows > 0 {
            layout.map.rows = params.rows;
        }
        if params.plants_per_row > 0 {
            layout.map.plants_per_row = params.plants_per_row;
        }
        if params.missing_share >= 0.0 {
            layout.missing_share = params.missing_share;
        }
        layout.weeds_per_m2 *= params.weed_factor;
        layout
    }

    /// Radius of the hole that a plant leaves \[m\]. Ours: the root ball grows with the crown.
    pub(super) fn hole_radius_m(&self) -> f64 {
        0.12 + 0.2 * self.radius_m
    }
}

fn nursery(number: u32, random: &mut Stream) -> Layout {
    let species = if number < NURSERIES_PER_SPECIES { Species::Beech } else { Species::CherryLaurel };
    let grown = f64::from(number % NURSERIES_PER_SPECIES) / f64::from(NURSERIES_PER_SPECIES - 1);
    let [height_m, radius_m] = species.sizes_m().map(|[least, most]| least + grown * (most - least));
    let [rows, plants_per_row] = [ROWS, PLANTS_PER_ROW].map(|[from, to]| from + random.below(to - from + 1));
    let lanes_to_the_left = random.below(2) == 1;
    let beech_m = [BEECH_ROWS_M[random.below(2) as usize], BEECH_PLANTING_M[random.below(4) as usize]];
    let [row_distance_m, planting_distance_m] = match species {
        Species::Beech if height_m > BEECH_FIRST_FIELD_M => beech_m,
        Species::CherryLaurel if height_m > LAUREL_FIRST_FIELD_M => LAUREL_SECOND_FIELD_M,
        _ => FIRST_FIELD_M,
    };
    let [size_sd, position_sd_m, missing_share, weeds_per_m2, roughness_m] =
        [SIZE_SD, POSITION_SD_M, MISSING_SHARE, WEEDS_PER_M2, ROUGHNESS_M].map(|[low, high]| random.between(low, high));
    Layout {
        name: format!("nursery-{number}"),
        map: PlantingMap { row_distance_m, planting_distance_m, rows, plants_per_row, lanes_to_the_left },
        species,
        height_m,
        radius_m,
        size_sd,
        position_sd_m,
        missing_share,
        weeds_per_m2,
        roughness_m,
    }
}

/// Paper: section 4.1.2.
fn garden(random: &mut Stream) -> Layout {
    Layout {
        name: "real-garden".to_owned(),
        map: PlantingMap {
            row_distance_m: 1.0,
            planting_distance_m: 0.7,
            rows: 4,
            plants_per_row: 9,
            lanes_to_the_left: random.below(2) == 1,
        },
        species: Species::Plastic,
        height_m: GARDEN_HEIGHT_M,
        radius_m: GARDEN_RADIUS_M,
        size_sd: GARDEN_SIZE_SD,
        position_sd_m: GARDEN_POSITION_SD_M,
        missing_share: GARDEN_MISSING_SHARE,
        weeds_per_m2: 0.0,
        roughness_m: random.between(ROUGHNESS_M[0], ROUGHNESS_M[1]),
    }
}
