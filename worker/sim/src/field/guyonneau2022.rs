//! Crops 1 to 4 of Guyonneau et al. (2022), section 4.1.2; numbers of the authors' simulator.
//!
//! Six rows at y = d (i - 1/2), five inter-rows at y = 0, d, .. 4 d; the robot starts at the origin.

use super::{Field, FieldSeed, Plant, PlantKind, Polyline};
use crate::Pose;
use furrow_navigation::random::Stream;

furrow_navigation::parameters! {
    /// Parameters of the four crops.
    pub struct Guyonneau2022Params {
        /// Which crop, from the easiest to the hardest. Paper: section 4.1.2.
        pub crop: u32 = 1, "1", [1, 4];
        /// Where plants and weeds are drawn from: {"fixed": n} or "job". Ours.
        pub seed: FieldSeed = FieldSeed::Fixed(1), "";
    }
}

/// Rows of each crop.
const ROWS: usize = 6;
/// Radius of every stem, weeds included \[m\].
const STEM_RADIUS_M: f64 = 0.02;
/// Height of every stem \[m\]; the LiDARs look across below it.
const STEM_HEIGHT_M: f64 = 1.0;
/// Weeds keep this distance from every plant and from the outer rows \[m\].
const WEED_DISTANCE_M: f64 = 0.15;

/// What makes a crop.
struct Crop {
    row_spacing_m: f64,
    row_length_m: f64,
    plants_per_row: usize,
    /// Regular plants stand this far apart \[m\]; none: x is uniform.
    regular_m: Option<f64>,
    /// Full width of the scatter across the row \[m\].
    band_m: f64,
    min_spacing_m: f64,
    weeds: usize,
    /// Stretches of x that are planted, by row \[m\]; empty: all.
    planted_m: [&'static [[f64; 2]]; ROWS],
    /// Weeds also keep this distance from the rows' centre lines \[m\].
    weed_row_distance_m: f64,
    error_range_x_m: [f64; 2],
}

const EVERYWHERE: [&[[f64; 2]]; ROWS] = [&[]; ROWS];

const CROPS: [Crop; 4] = [
    Crop {
        row_spacing_m: 1.5,
        row_length_m: 11.7,
        plants_per_row: 40,
        regular_m: Some(0.3),
        band_m: 0.0,
        min_spacing_m: 0.0,
        weeds: 0,
        planted_m: EVERYWHERE,
        weed_row_distance_m: 0.0,
        error_range_x_m: [1.0, 11.0],
    },
    Crop {
        row_spacing_m: 1.0,
        row_length_m: 10.0,
        plants_per_row: 60,
        regular_m: None,
        band_m: 0.2,
        min_spacing_m: 0.10,
        weeds: 0,
        planted_m: EVERYWHERE,
        weed_row_distance_m: 0.0,
        error_range_x_m: [1.0, 9.0],
    },
    Crop {
        row_spacing_m: 1.3,
        row_length_m: 10.0,
        plants_per_row: 40,
        regular_m: None,
        band_m: 0.1,
        min_spacing_m: 0.15,
        weeds: 50,
        planted_m: EVERYWHERE,
        weed_row_distance_m: 0.0,
        error_range_x_m: [1.0, 8.0],
    },
    Crop {
        row_spacing_m: 1.0,
        row_length_m: 25.0,
        plants_per_row: 100,
        regular_m: None,
        band_m: 0.1,
        min_spacing_m: 0.15,
        weeds: 100,
        planted_m: [
            &[],
            &[[0.0, 5.0], [15.0, 20.0]],
            &[[0.0, 10.0], [20.0, 25.0]],
            &[[0.0, 5.0], [10.0, 15.0]],
            &[[10.0, 20.0]],
            &[],
        ],
        // Half the band and 0.1 m, as in the authors' own field.
        weed_row_distance_m: 0.15,
        error_range_x_m: [1.0, 23.0],
    },
];

/// The field of `params`; a pure function of the crop and the field's seed.
#[must_use]
pub fn build(params: &Guyonneau2022Params, job_seed: u64) -> Field {
    let crop = &CROPS[(params.crop.clamp(1, 4) - 1) as usize];
    let mut random = Stream::new(params.seed.resolve(job_seed), "field");
    let mut plants = Vec::new();
    for row in 0..ROWS {
        plant_row(crop, row, &mut plants, &mut random);
    }
    sow_weeds(crop, &mut plants, &mut random);
    let rows: Vec<_> = (0..ROWS).map(|row| row_line(crop, row)).collect();
    Field {
        name: format!("crop-{}", params.crop),
        row_spacing_m: crop.row_spacing_m,
        middles: Field::middles(&rows),
        rows,
        plants,
        start: Pose::default(),
        inter_rows: ROWS as u32 - 1,
        error_range_x_m: Some(crop.error_range_x_m),
        lane: None,
        nursery: None,
    }
}

fn row_y_m(crop: &Crop, row: usize) -> f64 {
    crop.row_spacing_m * (row as f64 - 0.5)
}

fn row_line(crop: &Crop, row: usize) -> Polyline {
    let y = row_y_m(crop, row);
    Polyline::new(vec![[0.0, y], [crop.row_length_m, y]])
}

/// Draws the plants of a row; one that falls into a hole counts but is not planted.
fn plant_row(crop: &Crop, row: usize, plants: &mut Vec<Plant>, random: &mut Stream) {
    let first = plants.len();
    let stem = |x_m: f64, y_m: f64| stem(x_m, y_m, PlantKind::Crop, row as u32);
    for i in 0..crop.plants_per_row {
        let y = row_y_m(crop, row);
        if let Some(spacing) = crop.regular_m {
            plants.push(stem(spacing * i as f64, y));
            continue;
        }
        // The rows are far from full (at most 60 % where random packing jams at 75 %): a place is soon found.
        let plant = loop {
            let half = 0.5 * crop.band_m;
            let plant = stem(random.between(0.0, crop.row_length_m), y + random.between(-half, half));
            if is_clear(&plants[first..], &plant, crop.min_spacing_m) {
                break plant;
            }
        };
        let stretches = crop.planted_m[row];
        if stretches.is_empty() || stretches.iter().any(|[from, to]| (*from..=*to).contains(&plant.x_m)) {
            plants.push(plant);
        }
    }
}

fn sow_weeds(crop: &Crop, plants: &mut Vec<Plant>, random: &mut Stream) {
    let (low, high) = (row_y_m(crop, 0) + WEED_DISTANCE_M, row_y_m(crop, ROWS - 1) - WEED_DISTANCE_M);
    for _ in 0..crop.weeds {
        let weed = loop {
            let weed = stem(random.between(0.0, crop.row_length_m), random.between(low, high), PlantKind::Weed, 0);
            let off_rows = (0..ROWS).all(|row| (weed.y_m - row_y_m(crop, row)).abs() >= crop.weed_row_distance_m);
            if off_rows && is_clear(plants, &weed, WEED_DISTANCE_M) {
                break weed;
            }
        };
        plants.push(weed);
    }
}

const fn stem(x_m: f64, y_m: f64, kind: PlantKind, row: u32) -> Plant {
    Plant { x_m, y_m, radius_m: STEM_RADIUS_M, height_m: STEM_HEIGHT_M, kind, row }
}

fn is_clear(plants: &[Plant], new: &Plant, distance_m: f64) -> bool {
    plants.iter().all(|plant| {
        let (dx, dy) = (plant.x_m - new.x_m, plant.y_m - new.y_m);
        dx * dx + dy * dy >= distance_m * distance_m
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(crop: u32, seed: u64) -> Field {
        build(&Guyonneau2022Params { crop, seed: FieldSeed::Fixed(seed) }, 99)
    }

    fn count(field: &Field, kind: PlantKind) -> usize {
        field.plants.iter().filter(|plant| plant.kind == kind).count()
    }

    #[test]
    fn crops_have_the_published_numbers_of_plants_and_weeds() {
        for (crop, crops, weeds) in [(1, 240, 0), (2, 360, 0), (3, 240, 50)] {
            let field = field(crop, 1);
            assert_eq!((count(&field, PlantKind::Crop), count(&field, PlantKind::Weed)), (crops, weeds));
        }
        let field = field(4, 1);
        assert_eq!(count(&field, PlantKind::Weed), 100);
        // 100 draws a row over 25 m, of which 25, 10, 15, 10, 10 and 25 m are planted. Draws into holes are never
        // refused for their spacing, so fewer than 380 are planted; the authors' own field has 334.
        assert!((310..=358).contains(&count(&field, PlantKind::Crop)));
    }

    #[test]
    fn a_field_depends_on_crop_and_field_seed_alone() {
        assert_eq!(field(3, 5), field(3, 5));
        assert_ne!(field(3, 5), field(3, 6));
        let by_job = Guyonneau2022Params { crop: 3, seed: FieldSeed::Job };
        assert_eq!(build(&by_job, 5), field(3, 5));
    }

    #[test]
    fn plants_keep_their_distances_and_holes_stay_empty() {
        for seed in 1..20 {
            for (crop, spacing) in [(2, 0.10), (3, 0.15), (4, 0.15)] {
                let field = field(crop, seed);
                for (i, plant) in field.plants.iter().enumerate() {
                    let others = field.plants[..i]
                        .iter()
                        .filter(|other| other.row == plant.row || plant.kind == PlantKind::Weed);
                    for other in others {
                        let gap = libm::hypot(other.x_m - plant.x_m, other.y_m - plant.y_m);
                        assert!(gap >= spacing, "{plant:?} {other:?}");
                    }
                }
            }
            let holes = field(4, seed);
            let in_row_4 = holes.plants.iter().filter(|p| p.kind == PlantKind::Crop && p.row == 4);
            assert!(in_row_4.map(|p| p.x_m).all(|x| (10.0..=20.0).contains(&x)));
        }
    }
}
