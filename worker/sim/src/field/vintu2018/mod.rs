//! The 100 simulated nurseries and the test garden of Vintu (2018), section 4.1.
//!
//! The world's frame is that of the planting map. Each part of the world has a random stream of its own, so that more
//! plants in a row or other ground leave all the rest as it was.

mod grow;
mod layout;
mod nursery;
mod shape;
mod terrain;

use furrow_navigation::localization::PlantingMap;
use furrow_navigation::random::Stream;

pub use layout::Species;
pub use nursery::Nursery;
pub use shape::{Crown, Pole, Shape};
pub use terrain::{Standing, Terrain};

use super::{Field, FieldSeed, Polyline};
use crate::Pose;
use crate::lidar::canopy::Canopy;
use layout::Layout;
use terrain::{Hole, Relief};

furrow_navigation::words! {
    /// What the thesis drove in.
    pub enum Site {
        /// One of the 100 simulated nurseries.
        Nursery = "nursery",
        /// The test garden of plastic plants.
        RealGarden = "real-garden",
    }
}

furrow_navigation::parameters! {
    /// Parameters of the nurseries. Factors vary a field: 1 is the field as it is.
    pub struct Vintu2018Params {
        /// A simulated nursery or the test garden. Paper: section 4.1.
        pub site: Site = Site::Nursery, "";
        /// Which nursery: from 0 ever larger beeches, from 50 ever larger cherry laurels. Paper: 100 fields, section 4.1.1.
        pub nursery: u32 = 0, "1", [0, 99];
        /// Where the field is drawn from: {"fixed": n} or "job"; a field is a pure function of its number and this. Ours.
        pub seed: FieldSeed = FieldSeed::Fixed(1), "";
        /// Number of rows; 0 is as drawn. Paper: 5 to 11.
        pub rows: u32 = 0, "1", [0, 100];
        /// Plants per row, missing ones included; 0 is as drawn. Paper: 20 to 40.
        pub plants_per_row: u32 = 0, "1", [0, 100];
        /// Share of missing plants; below 0 it is as drawn. Paper: 0.01 to 0.25.
        pub missing_share: f64 = -1.0, "1", [-1.0, 1.0];
        /// Density of leaves. Ours.
        pub leaf_factor: f64 = 1.0, "1", [0.0, 10.0];
        /// Number of weeds. Ours.
        pub weed_factor: f64 = 1.0, "1", [0.0, 10.0];
        /// How uneven the ground is: slope, undulation and roughness. Ours.
        pub roughness_factor: f64 = 1.0, "1", [0.0, 5.0];
    }
}

/// The robot begins so far ahead of the first plants \[m\], in the middle of the first lane. Ours.
const START_X_M: f64 = -1.0;

/// The field of `params`; a pure function of these and the field's seed.
#[must_use]
pub fn build(params: &Vintu2018Params, job_seed: u64) -> Field {
    let seed = field_seed(params, job_seed);
    let layout = Layout::draw(params, &mut Stream::new(seed, "field-layout"));
    let map = layout.map;
    let grown = grow::grow(&layout, seed);
    let hole = |[x_m, y_m]: &[f64; 2]| Hole { x_m: *x_m, y_m: *y_m, radius_m: layout.hole_radius_m() };
    let holes: Vec<_> = grown.missing_m.iter().map(hole).collect();
    let relief = Relief { roughness_m: layout.roughness_m, factor: params.roughness_factor, holes: &holes };
    let terrain = Terrain::draw(extent_m(&map), &relief, &mut Stream::new(seed, "field-terrain"));
    let shapes = grown.shapes(&layout, params.leaf_factor, &terrain);
    let rows: Vec<_> = (0..map.rows).map(|row| row_line(&map, row)).collect();
    let max_height_m = grown.plants.iter().map(|plant| plant.height_m).fold(0.0, f64::max);
    let canopy = Canopy::new(&shapes, seed);
    Field {
        name: layout.name,
        row_spacing_m: map.row_distance_m,
        middles: Field::middles(&rows),
        rows,
        plants: grown.plants,
        start: Pose { x_m: START_X_M, y_m: map.lane_y_m(0), heading_rad: 0.0 },
        inter_rows: map.lanes(),
        error_range_x_m: None,
        lane: None,
        nursery: Some(Nursery {
            number: number(params),
            map,
            species: layout.species,
            presence: grown.presence,
            shapes,
            terrain,
            canopy,
            max_height_m,
        }),
    }
}

fn field_seed(params: &Vintu2018Params, job_seed: u64) -> u64 {
    seed_in(number(params), params.seed.resolve(job_seed))
}

/// The garden comes after the last nursery.
const fn number(params: &Vintu2018Params) -> u32 {
    match params.site {
        Site::Nursery => params.nursery,
        Site::RealGarden => layout::NURSERIES,
    }
}

/// What `seed` is in nursery `number`: those of one seed differ, in how they grow and in what a robot meets there.
#[must_use]
pub const fn seed_in(number: u32, seed: u64) -> u64 {
    seed ^ ((number as u64) << 40)
}

/// The rectangle of the planting positions: from, to (x, y) \[m\].
fn extent_m(map: &PlantingMap) -> [[f64; 2]; 2] {
    let (first, last) = (map.row_y_m(0), map.row_y_m(map.rows.saturating_sub(1)));
    [[0.0, first.min(last)], [map.row_length_m(), first.max(last)]]
}

/// A row's centre line; that of a single plant is as long as its planting distance.
fn row_line(map: &PlantingMap, row: u32) -> Polyline {
    let y_m = map.row_y_m(row);
    Polyline::new(vec![[0.0, y_m], [map.row_length_m().max(map.planting_distance_m), y_m]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{FieldSpec, PlantKind};

    fn params(nursery: u32) -> Vintu2018Params {
        Vintu2018Params { nursery, ..Default::default() }
    }

    fn nursery(params: &Vintu2018Params) -> (Field, Nursery) {
        let mut field = build(params, 7);
        let nursery = field.nursery.take().unwrap();
        (field, nursery)
    }

    fn crops(field: &Field) -> usize {
        field.plants.iter().filter(|plant| plant.kind == PlantKind::Crop).count()
    }

    #[test]
    fn a_nursery_depends_on_its_number_and_field_seed_alone() {
        for number in [3, 77] {
            let by_job = Vintu2018Params { seed: FieldSeed::Job, ..params(number) };
            assert_eq!(build(&by_job, 1), build(&params(number), 99));
            assert_ne!(build(&by_job, 1), build(&by_job, 2));
        }
        let garden = Vintu2018Params { site: Site::RealGarden, ..params(0) };
        assert_eq!(build(&garden, 1), build(&Vintu2018Params { nursery: 50, ..garden }, 1));
    }

    #[test]
    fn fields_are_as_the_tables_say() {
        for number in 0..100 {
            let (field, nursery) = nursery(&params(number));
            let map = nursery.map;
            assert!((5..=11).contains(&map.rows) && (20..=40).contains(&map.plants_per_row));
            let planted = [map.row_distance_m, map.planting_distance_m];
            let share = f64::from(number % 50) / 49.0;
            if number < 50 {
                assert_eq!(nursery.species, Species::Beech);
                let first = 0.1 + share * 3.9 <= 2.0;
                let later = [1.5, 1.6].contains(&planted[0]) && [1.2, 1.4, 1.5, 1.6].contains(&planted[1]);
                assert!(if first { planted == [1.3, 0.4] } else { later }, "{number}: {planted:?}");
            } else {
                assert_eq!(nursery.species, Species::CherryLaurel);
                assert_eq!(planted, if 0.1 + share * 2.9 <= 1.25 { [1.3, 0.4] } else { [2.0, 2.0] });
            }
            let missing = 1.0 - crops(&field) as f64 / nursery.presence.len() as f64;
            assert!(missing < 0.35, "{number}: {missing}");
            assert_eq!((field.rows.len(), field.inter_rows), (map.rows as usize, map.rows - 1));
        }
    }

    #[test]
    fn mean_sizes_grow_over_their_range() {
        let mean = |number, of: fn(&super::super::Plant) -> f64| {
            let (field, _) = nursery(&params(number));
            let sizes: Vec<_> = field.plants.iter().filter(|plant| plant.kind == PlantKind::Crop).map(of).collect();
            sizes.iter().sum::<f64>() / sizes.len() as f64
        };
        for (number, height_m, radius_m) in
            [(0, 0.1, 0.04), (49, 4.0, 0.81), (50, 0.1, 0.06), (99, 3.0, 0.76), (10, 0.896, 0.197)]
        {
            assert!((mean(number, |plant| plant.height_m) / height_m - 1.0).abs() < 0.06, "{number}");
            assert!((mean(number, |plant| plant.radius_m) / radius_m - 1.0).abs() < 0.06, "{number}");
        }
    }

    #[test]
    fn plants_stand_near_their_places_and_missing_ones_leave_holes() {
        let (field, nursery) = nursery(&params(30));
        let map = nursery.map;
        let mut plants = field.plants.iter();
        for (i, present) in nursery.presence.iter().enumerate() {
            let (row, place) = (i as u32 / map.plants_per_row, i as u32 % map.plants_per_row);
            let (x, y) = (f64::from(place) * map.planting_distance_m, map.row_y_m(row));
            if *present {
                let plant = plants.next().unwrap();
                assert!(plant.row == row && libm::hypot(plant.x_m - x, plant.y_m - y) < 0.4, "{plant:?}");
            } else {
                let around = nursery.terrain.height_m(x - 0.4, y).min(nursery.terrain.height_m(x + 0.4, y));
                assert!(nursery.terrain.height_m(x, y) < around, "{x} {y}");
            }
        }
        assert!(nursery.presence.contains(&false));
        assert!(plants.all(|plant| plant.kind == PlantKind::Weed));
    }

    #[test]
    fn the_garden_is_four_rows_of_nine_with_gaps() {
        for seed in 1..10 {
            let garden = Vintu2018Params { site: Site::RealGarden, seed: FieldSeed::Fixed(seed), ..Default::default() };
            let (field, nursery) = nursery(&garden);
            let map = nursery.map;
            assert_eq!((map.rows, map.plants_per_row), (4, 9));
            assert_eq!((map.row_distance_m, map.planting_distance_m), (1.0, 0.7));
            assert!((26..=36).contains(&crops(&field)), "{}", crops(&field));
            assert_eq!(nursery.passable_lanes_share(0.43), 1.0);
        }
    }

    #[test]
    fn odd_fields_can_be_built() {
        let (single, nursery_of_one) = nursery(&Vintu2018Params { rows: 1, plants_per_row: 1, ..params(0) });
        assert_eq!((single.rows.len(), single.middles.len(), single.inter_rows), (1, 0, 0));
        assert_eq!(nursery_of_one.passable_lanes_share(0.9), 1.0);
        let (bare, without) = nursery(&Vintu2018Params { missing_share: 1.0, weed_factor: 0.0, ..params(60) });
        assert!(bare.plants.is_empty() && without.shapes.is_empty() && !without.presence.contains(&true));
        let (full, _) = nursery(&Vintu2018Params { missing_share: 0.0, rows: 3, plants_per_row: 7, ..params(60) });
        assert_eq!(crops(&full), 21);
    }

    #[test]
    fn more_rows_leave_the_first_ones_as_they_were() {
        let (two, _) = nursery(&Vintu2018Params { rows: 2, weed_factor: 0.0, ..params(40) });
        let (five, _) = nursery(&Vintu2018Params { rows: 5, weed_factor: 0.0, ..params(40) });
        assert!(five.plants.starts_with(&two.plants) && !two.plants.is_empty());
    }

    #[test]
    fn a_robot_cannot_take_it_for_a_field_of_inter_rows() {
        assert!(!FieldSpec::Vintu2018(params(0)).among_rows());
    }

    #[test]
    fn half_of_the_lanes_and_two_fifths_of_the_fields_are_passable() {
        let shares: Vec<_> = (0..100).map(|number| nursery(&params(number)).1.passable_lanes_share(0.9)).collect();
        let lanes = shares.iter().sum::<f64>() / 100.0;
        let fields = shares.iter().filter(|share| **share == 1.0).count();
        assert!((0.4..0.6).contains(&lanes) && (33..=47).contains(&fields), "{lanes} {fields}");
    }
}
