//! What grows in a lane: stems, the leaves and fallen stalks of them, and weeds.

use std::f64::consts::PI;

use furrow_navigation::random::Stream;

use super::course::{Course, Row};
use super::preset::Preset;
use crate::field::lane::{Foliage, FoliageKind};
use crate::field::{Plant, PlantKind};

/// From one plant to the next: mean (paper) and standard deviation (ours) \[m\].
const SPACING_M: f64 = 0.1;
const SPACING_SD_M: f64 = 0.02;
/// Plants never stand closer \[m\]. Ours.
const SPACING_MIN_M: f64 = 0.03;
/// Radius of a stem: mean, and largest difference from it \[m\]. Ours.
const RADIUS_M: f64 = 0.0125;
const RADIUS_HALF_RANGE_M: f64 = 0.0025;
/// Share of plants that did not come up. Ours.
const FAILED_SHARE: f64 = 0.05;
/// Plants this near to a gap \[m\] get light from there and keep their lowest leaves: so many more leaves each, on average.
/// Ours, after section 6: hanging leaves at the lane's entrance block the scan.
const EDGE_M: f64 = 0.25;
const EDGE_LEAVES: f64 = 2.0;
/// A blade hangs so far from its stem, on average and at most \[m\], and a level plane cuts it on so much of its width. Ours, after
/// scans of real maize: see docs/velasquez2022.md.
const LEAF_REACH_M: f64 = 0.12;
const LEAF_REACH_MAX_M: f64 = 0.6;
const LEAF_WIDTH_M: [f64; 2] = [0.03, 0.2];
/// How high its lower edge hangs, and how far it reaches up from there \[m\]. Ours.
const LEAF_LOW_M: [f64; 2] = [0.0, 0.5];
const LEAF_EXTENT_M: [f64; 2] = [0.1, 0.4];
/// Length of a fallen stalk, and the height of its upper edge \[m\]. Ours.
const STALK_LENGTH_M: [f64; 2] = [0.8, 1.8];
const STALK_HIGH_M: [f64; 2] = [0.02, 0.4];
/// Width and height of a weed \[m\]. Ours.
const WEED_WIDTH_M: [f64; 2] = [0.02, 0.15];
const WEED_HIGH_M: [f64; 2] = [0.05, 0.45];

/// Things with their place along the lane \[m\].
pub(super) type Along<T> = Vec<(f64, T)>;

/// What one row is made of.
pub(super) struct Sowing<'a> {
    pub(super) preset: &'a Preset,
    pub(super) course: &'a Course,
    pub(super) row: &'a Row,
    /// Index of the row in the field.
    pub(super) index: u32,
    pub(super) gaps_m: &'a [[f64; 2]],
    pub(super) bare_share: f64,
    pub(super) leaf_factor: f64,
    pub(super) leaves_per_m: f64,
    pub(super) stalks_per_m: f64,
}

impl Sowing<'_> {
    /// Grows the row. What stands elsewhere does not depend on gaps or on how many leaves there are.
    pub(super) fn grow(&self, seed: u64, plants: &mut Along<Plant>, foliage: &mut Along<Foliage>) {
        let stream = |name: &str| Stream::new(seed, &format!("field-{name}-{}", self.index));
        let [mut stems, mut leaves, mut stalks, mut edges] = ["stems", "leaves", "stalks", "edges"].map(stream);
        let bare_m = self.bare_stretches(&mut stream("bare"));
        let mut hanging = Vec::new();
        let mut along_m = stems.between(0.0, SPACING_M);
        while along_m <= self.preset.length_m {
            let plant = self.plant(along_m, &mut stems);
            let fails = stems.uniform() < FAILED_SHARE;
            // On average as many as there should be: a whole number, and one more by chance.
            let n = (self.leaves_per_m * SPACING_M + leaves.uniform()) as usize;
            hanging.clear();
            hanging.extend((0..n).map(|_| (along_m, leaf(&plant, &mut leaves))));
            if self.is_at_edge(along_m) {
                let n = (self.leaf_factor * EDGE_LEAVES + edges.uniform()) as usize;
                hanging.extend((0..n).map(|_| (along_m, leaf(&plant, &mut edges))));
            }
            let stalk = self.stalk(&plant, &mut stalks);
            let is_in = |stretches: &[[f64; 2]]| stretches.iter().any(|[from, to]| (*from..*to).contains(&along_m));
            if !fails && !is_in(self.gaps_m) && !is_in(&bare_m) {
                plants.push((along_m, plant));
                foliage.append(&mut hanging);
            }
            if !is_in(self.gaps_m) {
                foliage.extend(stalk.map(|stalk| (along_m, stalk)));
            }
            along_m += (SPACING_M + SPACING_SD_M * stems.normal()).max(SPACING_MIN_M);
        }
    }

    fn is_at_edge(&self, along_m: f64) -> bool {
        self.gaps_m.iter().any(|[from_m, to_m]| (from_m - EDGE_M..to_m + EDGE_M).contains(&along_m))
    }

    fn plant(&self, along_m: f64, random: &mut Stream) -> Plant {
        let across_m = self.row.across_m(along_m) + self.preset.scatter_m * random.normal();
        let [x_m, y_m] = self.course.at(along_m, across_m);
        let radius_m = RADIUS_M + random.between(-RADIUS_HALF_RANGE_M, RADIUS_HALF_RANGE_M);
        let height_m = self.preset.plant_height_m;
        Plant { x_m, y_m, radius_m, height_m, kind: PlantKind::Crop, row: self.index }
    }

    /// Bare stretches: planted and bare ones alternate, each of exponential length.
    fn bare_stretches(&self, random: &mut Stream) -> Vec<[f64; 2]> {
        let mut stretches = Vec::new();
        if self.bare_share <= 0.0 {
            return stretches;
        }
        let mut length = |mean_m: f64| -mean_m * libm::log(random.uniform());
        let planted_mean_m = self.preset.bare_mean_m * (1.0 - self.bare_share) / self.bare_share;
        let mut from_m = length(planted_mean_m);
        while from_m < self.preset.length_m {
            let to_m = from_m + length(self.preset.bare_mean_m);
            stretches.push([from_m, to_m]);
            from_m = to_m + length(planted_mean_m);
        }
        stretches
    }

    fn stalk(&self, plant: &Plant, random: &mut Stream) -> Option<Foliage> {
        let falls = random.uniform() < self.stalks_per_m * SPACING_M;
        let (length_m, high_m) = (pick(STALK_LENGTH_M, random), pick(STALK_HIGH_M, random));
        let direction_rad = random.between(-PI, PI);
        let stalk = ribbon([plant.x_m, plant.y_m], direction_rad, length_m, [0.0, high_m], FoliageKind::Stalk);
        falls.then_some(stalk)
    }
}

/// A blade that hangs down: at one place from its stem, turned anyhow.
fn leaf(plant: &Plant, random: &mut Stream) -> Foliage {
    let reach_m = (-LEAF_REACH_M * libm::log(random.uniform())).min(LEAF_REACH_MAX_M);
    let (bearing_rad, direction_rad) = (random.between(-PI, PI), random.between(-PI, PI));
    let (width_m, low_m) = (pick(LEAF_WIDTH_M, random), pick(LEAF_LOW_M, random));
    let high_m = low_m + pick(LEAF_EXTENT_M, random);
    let middle = towards([plant.x_m, plant.y_m], bearing_rad, reach_m);
    let from_m = towards(middle, direction_rad, -0.5 * width_m);
    ribbon(from_m, direction_rad, width_m, [low_m, high_m], FoliageKind::Leaf)
}

/// Weeds in a stretch of the lane between `across_m`, on average `per_m` of them a metre \[1/m\].
pub(super) fn weeds(
    course: &Course,
    [from_m, to_m]: [f64; 2],
    across_m: [f64; 2],
    per_m: f64,
    random: &mut Stream,
    foliage: &mut Along<Foliage>,
) {
    if per_m <= 0.0 {
        return;
    }
    let mut along_m = from_m;
    loop {
        along_m -= libm::log(random.uniform()) / per_m;
        if along_m > to_m {
            return;
        }
        let at = course.at(along_m, pick(across_m, random));
        let direction_rad = random.between(-PI, PI);
        let (width_m, high_m) = (pick(WEED_WIDTH_M, random), pick(WEED_HIGH_M, random));
        foliage.push((along_m, ribbon(at, direction_rad, width_m, [0.0, high_m], FoliageKind::Weed)));
    }
}

fn ribbon(from_m: [f64; 2], direction_rad: f64, length_m: f64, height_m: [f64; 2], kind: FoliageKind) -> Foliage {
    Foliage { from_m, to_m: towards(from_m, direction_rad, length_m), height_m, kind }
}

/// The point `by_m` from `from_m` in a direction from the x axis.
fn towards(from_m: [f64; 2], direction_rad: f64, by_m: f64) -> [f64; 2] {
    let (sin, cos) = libm::sincos(direction_rad);
    [from_m[0] + by_m * cos, from_m[1] + by_m * sin]
}

fn pick([low, high]: [f64; 2], random: &mut Stream) -> f64 {
    random.between(low, high)
}
