//! What makes each lane. "Paper" is Velasquez et al. (2022), section 5; all else is ours.
//!
//! Wander, sparseness and the numbers of leaves and weeds are chosen per kind of lane so that what the LiDAR sees comes close to
//! table 5 of the paper: the share of scans in which each row shows, and the spread of the lane's width. No algorithm was run
//! to choose them. Of the ES lanes table 5 says nothing: what they are like was changed once after the system had driven there.

use furrow_navigation::random::Stream;

use super::LaneName;

/// Numbers of one lane. Pairs are right, left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Preset {
    pub length_m: f64,
    pub row_spacing_m: f64,
    /// Standard deviation of a row's centre line about its place.
    pub wander_m: f64,
    /// Standard deviation of stems about the centre line; where stalks lean it is larger.
    pub scatter_m: f64,
    /// Share of each row in bare stretches, and their mean length.
    pub bare_share: [f64; 2],
    pub bare_mean_m: f64,
    pub gaps: Gaps,
    /// Whether rows outside the lane have the gaps, too.
    pub gaps_everywhere: bool,
    /// Rows beyond those of the lane.
    pub neighbours: [usize; 2],
    /// Hanging leaves per metre of row, with their lower edge within half a metre above the ground.
    pub leaves_per_m: [f64; 2],
    /// Fallen stalks per metre of row.
    pub stalks_per_m: [f64; 2],
    /// Weeds per metre of lane in each half of it.
    pub weeds_per_m: [f64; 2],
    /// Standard deviation of roll and pitch.
    pub tilt_rad: f64,
    /// Bumps stand in the first so many metres.
    pub bumps_m: f64,
    pub plant_height_m: f64,
    /// Smallest radius of the curve.
    pub curve_radius_m: Option<f64>,
}

/// Stretches without plants on both sides.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Gaps {
    None,
    /// Twelve of 0.5 to 1 m, and one of 2 m near the end. Paper.
    Drawn,
    /// Between sections of equal length.
    Regular {
        section_m: f64,
        gap_m: f64,
    },
}

/// Two full rows in a clean straight lane.
const STRAIGHT: Preset = Preset {
    length_m: 220.0,
    row_spacing_m: 0.785,
    wander_m: 0.025,
    scatter_m: 0.02,
    bare_share: [0.0, 0.0],
    bare_mean_m: 1.0,
    gaps: Gaps::None,
    gaps_everywhere: false,
    neighbours: [2, 2],
    leaves_per_m: [20.0, 55.0],
    stalks_per_m: [0.0, 0.0],
    weeds_per_m: [0.05, 0.05],
    tilt_rad: 0.02,
    bumps_m: 0.0,
    plant_height_m: 2.4,
    curve_radius_m: None,
};

/// Sparse on one side, with fallen stalks and hanging leaves.
const INTERNAL_BORDER: Preset = Preset {
    length_m: 125.0,
    row_spacing_m: 0.777,
    wander_m: 0.027,
    bare_share: [0.15, 0.52],
    bare_mean_m: 1.2,
    leaves_per_m: [20.0, 24.0],
    stalks_per_m: [0.05, 0.1],
    weeds_per_m: [0.2, 0.2],
    ..STRAIGHT
};

/// At the field's edge, full of grass and weeds; nothing grows in rows to the left.
const EXTERNAL_BORDER: Preset = Preset {
    length_m: 125.0,
    row_spacing_m: 0.794,
    wander_m: 0.038,
    neighbours: [2, 0],
    leaves_per_m: [40.0, 50.0],
    stalks_per_m: [0.02, 0.02],
    weeds_per_m: [0.5, 12.0],
    tilt_rad: 0.03,
    ..STRAIGHT
};

/// Tops cut and fewer leaves.
const TOPS_CUT: Preset =
    Preset { length_m: 90.0, row_spacing_m: 0.75, leaves_per_m: [4.0, 4.0], plant_height_m: 1.4, ..STRAIGHT };

/// Ground and growth of a lane in the fields that others drove in, for weeks, in "diverse field conditions" (section 5): each is
/// like one of the three kinds of lanes that were looked at, whichever `seed` draws.
fn conditions(seed: u64) -> Preset {
    match Stream::new(seed, "field-conditions").below(3) {
        0 => STRAIGHT,
        1 => INTERNAL_BORDER,
        _ => EXTERNAL_BORDER,
    }
}

/// The numbers of a lane, of which those of ES 1 and 2 depend on the seed.
pub(super) fn preset(lane: LaneName, seed: u64) -> Preset {
    match lane {
        LaneName::A => STRAIGHT,
        LaneName::B => {
            Preset { row_spacing_m: 0.731, wander_m: 0.038, gaps: Gaps::Drawn, leaves_per_m: [52.0, 40.0], ..STRAIGHT }
        }
        LaneName::C | LaneName::D => INTERNAL_BORDER,
        LaneName::E | LaneName::F => EXTERNAL_BORDER,
        LaneName::G => Preset { bumps_m: 30.0, ..TOPS_CUT },
        LaneName::H => TOPS_CUT,
        LaneName::Production => Preset {
            length_m: 300.0,
            row_spacing_m: 0.789,
            wander_m: 0.045,
            scatter_m: 0.025,
            leaves_per_m: [82.0, 36.0],
            stalks_per_m: [0.4, 0.2],
            weeds_per_m: [0.3, 0.3],
            tilt_rad: 0.035,
            curve_radius_m: Some(8.0),
            ..STRAIGHT
        },
        LaneName::Es1 => Preset {
            length_m: 137.0,
            row_spacing_m: 0.75,
            gaps: Gaps::Regular { section_m: 5.0, gap_m: 1.0 },
            gaps_everywhere: true,
            ..conditions(seed)
        },
        LaneName::Es2 => Preset {
            length_m: 397.0,
            row_spacing_m: 0.8,
            gaps: Gaps::Regular { section_m: 4.8, gap_m: 0.5 },
            gaps_everywhere: true,
            ..conditions(seed)
        },
    }
}
