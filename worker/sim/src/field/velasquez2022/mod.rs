//! Lanes A to H, production, ES 1 and ES 2 of Velasquez et al. (2022), section 5.
//!
//! A lane begins at the origin and runs along x; rows go from the robot's right to its left, with neighbours beyond
//! the two that bound the lane. Each part of the world has a random stream of its own, so that filled gaps or fewer
//! leaves leave all the rest as it was.

mod course;
mod growth;
mod preset;
mod terrain;

use furrow_navigation::parameters::ParameterType;
use furrow_navigation::random::Stream;

use super::lane::{Foliage, Lane};
use super::{Field, FieldSeed, Plant};
use crate::Pose;
use course::{Course, Row};
use growth::{Along, Sowing};
use preset::{Gaps, Preset, preset};

furrow_navigation::words! {
    /// The lanes of the paper.
    pub enum LaneName {
        /// Continuous and straight, 220 m.
        A = "lane-a",
        /// With twelve gaps of 0.5 to 1 m and one of 2 m, 220 m.
        B = "lane-b",
        /// Internal border: sparse on one side, fallen stalks, hanging leaves, 125 m.
        C = "lane-c",
        /// Another lane like C.
        D = "lane-d",
        /// External border: high grass, weeds, clutter, 125 m.
        E = "lane-e",
        /// Another lane like E.
        F = "lane-f",
        /// Tops cut, bumps in the first 30 of 90 m.
        G = "lane-g",
        /// Tops cut, flat, 90 m.
        H = "lane-h",
        /// Production field with a curve, 300 m.
        Production = "production",
        /// Sections of 5 m between gaps of 1 m, in conditions that the seed draws.
        Es1 = "es-1",
        /// Seventy-five sections of 4.8 m between gaps of 0.5 m, in conditions that the seed draws.
        Es2 = "es-2",
    }
}

furrow_navigation::parameters! {
    /// Parameters of the lanes. Factors vary a lane: 1 is the lane as it is.
    pub struct Velasquez2022Params {
        /// Which lane. Paper: section 5, tables 1 to 6.
        pub lane: LaneName = LaneName::A, "";
        /// Where the lane is drawn from: {"fixed": n} or "job". Ours.
        pub seed: FieldSeed = FieldSeed::Fixed(1), "";
        /// Which of the lanes that one seed gives: a plan that drives lane A three times a seed drives three of them. Ours.
        pub draw: u32 = 0, "1", [0, 1000];
        /// Length of gaps; 0 fills them, 0.5 gives es-1 the gaps of 0.5 m that section 5.3 speaks of. Ours.
        pub gap_factor: f64 = 1.0, "1", [0.0, 4.0];
        /// Number of hanging leaves and fallen stalks. Ours.
        pub leaf_factor: f64 = 1.0, "1", [0.0, 10.0];
        /// Number of weeds. Ours.
        pub weed_factor: f64 = 1.0, "1", [0.0, 10.0];
        /// How far rows wander. Ours.
        pub wander_factor: f64 = 1.0, "1", [0.0, 10.0];
        /// How much the ground tilts and deflects the robot, bumps included. Ours.
        pub roughness_factor: f64 = 1.0, "1", [0.0, 10.0];
    }
}

/// The robot begins so far along the lane \[m\]: all of it is inside. Ours.
const START_ALONG_M: f64 = 0.3;
/// How well the robot is put there: standard deviations across and of the heading \[m\], \[rad\]. Ours.
const START_ACROSS_SD_M: f64 = 0.02;
const START_HEADING_SD_RAD: f64 = 0.035;
/// Neither is farther off than so many standard deviations.
const START_LIMIT: f64 = 2.0;
/// Weeds per metre of a gap in each half of the lane: they grow where there is light. Ours, after section 6.
const GAP_WEEDS_PER_M: f64 = 6.0;
/// Lane B: the first and last of the drawn gaps lie so far from the ends, the one of 2 m so far from the end \[m\]. Ours.
const GAPS_FROM_M: f64 = 10.0;
const BIG_GAP_FROM_END_M: f64 = 15.0;

/// The field of `params`; a pure function of the lane and the field's seed.
#[must_use]
pub fn build(params: &Velasquez2022Params, job_seed: u64) -> Field {
    let seed = seed_of(params, job_seed);
    let preset = preset(params.lane, seed);
    let course = Course::new(&preset);
    let gaps_m = gaps(&preset, params.gap_factor, &mut Stream::new(seed, "field-gaps"));
    let right_row = preset.neighbours[0];
    let rows = lay_rows(&preset, params, seed);
    let mut plants: Along<Plant> = Vec::new();
    let mut foliage: Along<Foliage> = Vec::new();
    for (index, row) in rows.iter().enumerate() {
        let side = usize::from(index > right_row);
        let bounds = index == right_row || index == right_row + 1;
        let sowing = Sowing {
            preset: &preset,
            course: &course,
            row,
            index: index as u32,
            gaps_m: if bounds || preset.gaps_everywhere { &gaps_m } else { &[] },
            bare_share: if bounds { preset.bare_share[side] } else { 0.0 },
            leaf_factor: params.leaf_factor,
            leaves_per_m: params.leaf_factor * preset.leaves_per_m[side],
            stalks_per_m: params.leaf_factor * preset.stalks_per_m[side],
        };
        sowing.grow(seed, &mut plants, &mut foliage);
    }
    let half_m = 0.5 * preset.row_spacing_m;
    for (side, across_m) in [[-half_m, 0.0], [0.0, half_m]].into_iter().enumerate() {
        let mut random = Stream::new(seed, ["field-weeds-right", "field-weeds-left"][side]);
        let per_m = params.weed_factor * preset.weeds_per_m[side];
        growth::weeds(&course, [0.0, preset.length_m], across_m, per_m, &mut random, &mut foliage);
        let mut random = Stream::new(seed, ["field-gap-weeds-right", "field-gap-weeds-left"][side]);
        for gap_m in &gaps_m {
            let per_m = params.weed_factor * GAP_WEEDS_PER_M;
            growth::weeds(&course, *gap_m, across_m, per_m, &mut random, &mut foliage);
        }
    }
    let (plants_along_m, plants) = sorted(plants);
    let (foliage_along_m, foliage) = sorted(foliage);
    let factor = params.roughness_factor;
    let terrain = terrain::terrain(preset.length_m, preset.tilt_rad, preset.bumps_m, factor, seed);
    let length_m = preset.length_m;
    let mut field = Field {
        name: LaneName::WORDS[params.lane as usize].to_owned(),
        row_spacing_m: preset.row_spacing_m,
        middles: rows.windows(2).map(|pair| Row::middle(&pair[0], &pair[1], &course)).collect(),
        rows: rows.iter().map(|row| row.line(&course)).collect(),
        plants,
        start: Pose::default(),
        inter_rows: 1,
        error_range_x_m: None,
        lane: Some(Lane { right_row, length_m, gaps_m, foliage, terrain, plants_along_m, foliage_along_m }),
        nursery: None,
    };
    field.start = start(&field, &mut Stream::new(seed, "field-start"));
    field
}

/// Where all of the lane is drawn from: lanes of one kind differ, too.
fn seed_of(params: &Velasquez2022Params, job_seed: u64) -> u64 {
    params.seed.resolve(job_seed) ^ ((params.lane as u64) << 40) ^ (u64::from(params.draw) << 48)
}

fn lay_rows(preset: &Preset, params: &Velasquez2022Params, seed: u64) -> Vec<Row> {
    let mut random = Stream::new(seed, "field-rows");
    let [right, left] = preset.neighbours;
    let wander_m = params.wander_factor * preset.wander_m;
    let row = |index: usize| {
        let across_m = preset.row_spacing_m * (index as f64 - right as f64 - 0.5);
        Row::new(preset, across_m, wander_m, &mut random)
    };
    (0..right + 2 + left).map(row).collect()
}

/// Gaps along the lane, in order, each `factor` times as long about its middle.
fn gaps(preset: &Preset, factor: f64, random: &mut Stream) -> Vec<[f64; 2]> {
    let gaps: Vec<[f64; 2]> = match preset.gaps {
        Gaps::None => Vec::new(),
        Gaps::Regular { section_m, gap_m } => {
            let n = ((preset.length_m - section_m) / (section_m + gap_m)).ceil() as usize;
            (1..=n).map(|i| i as f64 * (section_m + gap_m) - 0.5 * gap_m).map(|middle_m| [middle_m, gap_m]).collect()
        }
        Gaps::Drawn => {
            let big_m = preset.length_m - BIG_GAP_FROM_END_M;
            let share_m = (big_m - 2.0 * GAPS_FROM_M) / 12.0;
            let small = |i: u32| {
                let middle_m = GAPS_FROM_M + share_m * (f64::from(i) + random.between(0.2, 0.8));
                [middle_m, random.between(0.5, 1.0)]
            };
            (0..12).map(small).chain([[big_m, 2.0]]).collect()
        }
    };
    let stretch = |[middle_m, gap_m]: [f64; 2]| [middle_m - 0.5 * factor * gap_m, middle_m + 0.5 * factor * gap_m];
    if factor > 0.0 { gaps.into_iter().map(stretch).collect() } else { Vec::new() }
}

/// Places and things, in the order of the places.
fn sorted<T>(mut things: Along<T>) -> (Vec<f64>, Vec<T>) {
    things.sort_by(|a, b| a.0.total_cmp(&b.0));
    things.into_iter().unzip()
}

fn start(field: &Field, random: &mut Stream) -> Pose {
    let lane = field.lane.as_ref().expect("it has just been made");
    let pose = lane.pose(field, START_ALONG_M);
    let [across_m, turn_rad] =
        [START_ACROSS_SD_M, START_HEADING_SD_RAD].map(|sd| sd * random.normal().clamp(-START_LIMIT, START_LIMIT));
    let (sin, cos) = libm::sincos(pose.heading_rad);
    Pose { x_m: pose.x_m - across_m * sin, y_m: pose.y_m + across_m * cos, heading_rad: pose.heading_rad + turn_rad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::lane::FoliageKind;

    const LANES: [LaneName; 11] = [
        LaneName::A,
        LaneName::B,
        LaneName::C,
        LaneName::D,
        LaneName::E,
        LaneName::F,
        LaneName::G,
        LaneName::H,
        LaneName::Production,
        LaneName::Es1,
        LaneName::Es2,
    ];

    fn params(lane: LaneName) -> Velasquez2022Params {
        Velasquez2022Params { lane, ..Default::default() }
    }

    fn lane(params: &Velasquez2022Params) -> (Field, Lane) {
        let field = build(params, 1);
        let lane = field.lane.clone().unwrap();
        (field, lane)
    }

    #[test]
    fn lanes_have_the_published_lengths_and_gaps() {
        let lengths = [220.0, 220.0, 125.0, 125.0, 125.0, 125.0, 90.0, 90.0, 300.0, 137.0, 397.0];
        let gaps = [0, 13, 0, 0, 0, 0, 0, 0, 0, 22, 74];
        for ((name, length_m), gaps) in LANES.into_iter().zip(lengths).zip(gaps) {
            let (_, lane) = lane(&params(name));
            assert_eq!((lane.length_m, lane.gaps_m.len()), (length_m, gaps), "{name:?}");
        }
    }

    #[test]
    fn gaps_of_lane_b_are_as_long_as_the_paper_says() {
        for seed in 1..20 {
            let (_, lane) = lane(&Velasquez2022Params { seed: FieldSeed::Fixed(seed), ..params(LaneName::B) });
            let lengths: Vec<_> = lane.gaps_m.iter().map(|[from, to]| to - from).collect();
            assert!(lengths[..12].iter().all(|m| (0.5..=1.0).contains(m)) && (lengths[12] - 2.0).abs() < 1e-9);
            assert!(lane.gaps_m.windows(2).all(|pair| pair[1][0] - pair[0][1] > 2.0));
        }
    }

    #[test]
    fn nothing_stands_in_gaps_and_filling_them_changes_nothing_else() {
        let (field, with_gaps) = lane(&params(LaneName::B));
        let (filled, without) = lane(&Velasquez2022Params { gap_factor: 0.0, ..params(LaneName::B) });
        let in_gap = |along: &f64| with_gaps.gaps_m.iter().any(|[from, to]| (*from..*to).contains(along));
        let bounds = |plant: &Plant| plant.row == 2 || plant.row == 3;
        let stands = |(plant, along): &(&Plant, &f64)| !(bounds(plant) && in_gap(along));
        let kept: Vec<_> = filled.plants.iter().zip(&without.plants_along_m).filter(stands).map(|(p, _)| *p).collect();
        assert_eq!(field.plants, kept);
        assert!(filled.plants.len() > field.plants.len() + 150);
        assert_eq!((with_gaps.terrain, field.start), (without.terrain, filled.start));
    }

    #[test]
    fn leaves_are_denser_at_the_ends_of_rows_and_weeds_in_gaps() {
        let of = |lane: &Lane, kind: FoliageKind, near_m: [f64; 2]| {
            let along = |gap: &[f64; 2], at_m: f64| at_m >= gap[0] - near_m[0] && at_m < gap[1] + near_m[1];
            let foliage = lane.foliage.iter().zip(&lane.foliage_along_m);
            let near =
                foliage.filter(|(part, at_m)| part.kind == kind && lane.gaps_m.iter().any(|gap| along(gap, **at_m)));
            near.count() as f64 / lane.gaps_m.len() as f64
        };
        let like_lane_a = |lane: &Velasquez2022Params| {
            preset(lane.lane, seed_of(lane, 1)).neighbours == [2, 2]
                && preset(lane.lane, seed_of(lane, 1)).bare_share == [0.0, 0.0]
        };
        let seeds = (1..).map(|seed| Velasquez2022Params { seed: FieldSeed::Fixed(seed), ..params(LaneName::Es2) });
        let (_, lane) = lane(&seeds.into_iter().find(like_lane_a).unwrap());
        // Six rows with 9.5 plants a metre, 0.25 m at both ends: 2 and 5.5 leaves a plant as everywhere, and two more.
        let leaves = of(&lane, FoliageKind::Leaf, [0.25, 0.25]);
        assert!((leaves / (6.0 * 9.5 * 0.5) - 5.75).abs() < 0.3, "{leaves}");
        let weeds = of(&lane, FoliageKind::Weed, [0.0, 0.0]);
        assert!((weeds - 2.0 * 0.5 * GAP_WEEDS_PER_M).abs() < 1.0, "{weeds} in 0.5 m");
    }

    #[test]
    fn a_third_of_the_es_lanes_each_is_like_a_straight_an_internal_and_an_external_one() {
        let mut kinds = [0; 3];
        for seed in 1..=300 {
            let lane = Velasquez2022Params { seed: FieldSeed::Fixed(seed), ..params(LaneName::Es1) };
            let es = preset(LaneName::Es1, seed_of(&lane, 1));
            let like = |other| {
                let other = preset(other, 1);
                (es.weeds_per_m, es.bare_share, es.neighbours)
                    == (other.weeds_per_m, other.bare_share, other.neighbours)
            };
            let kind = [LaneName::A, LaneName::C, LaneName::E].into_iter().position(like);
            kinds[kind.expect("it is like one of them")] += 1;
            assert_eq!((es.length_m, es.row_spacing_m), (137.0, 0.75));
        }
        assert!(kinds.iter().all(|n| (75..=125).contains(n)), "{kinds:?}");
    }

    #[test]
    fn one_seed_gives_several_lanes() {
        let drawn = |draw| build(&Velasquez2022Params { draw, ..params(LaneName::A) }, 1);
        assert!(drawn(0) == build(&params(LaneName::A), 1) && drawn(0) != drawn(1) && drawn(1) != drawn(2));
    }

    #[test]
    fn fewer_leaves_leave_all_stems_where_they_are() {
        let (field, _) = lane(&params(LaneName::Production));
        let (bare, lane) =
            lane(&Velasquez2022Params { leaf_factor: 0.0, weed_factor: 0.0, ..params(LaneName::Production) });
        assert_eq!(field.plants, bare.plants);
        assert!(lane.foliage.is_empty());
    }

    #[test]
    fn a_lane_depends_on_its_name_and_field_seed_alone() {
        for name in LANES {
            let by_job = Velasquez2022Params { seed: FieldSeed::Job, ..params(name) };
            assert_eq!(build(&by_job, 1), build(&params(name), 99));
            assert_ne!(build(&by_job, 1), build(&by_job, 2));
        }
    }

    #[test]
    fn stems_stand_as_densely_as_they_should() {
        let (field, lane) = lane(&params(LaneName::A));
        let of_row = |row| field.plants.iter().filter(|plant| plant.row == row).count() as f64;
        // One every 0.1 m, of which one in twenty did not come up.
        assert!((of_row(2) / lane.length_m - 9.5).abs() < 0.3, "{}", of_row(2));
        assert!(field.plants.iter().all(|plant| (0.01..=0.015).contains(&plant.radius_m)));
    }
}
