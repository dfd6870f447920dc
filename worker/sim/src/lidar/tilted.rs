//! A planar LiDAR in a lane, on a robot that rolls and pitches: stems, foliage between the scan plane's heights, ground.
//!
//! Deviation: for the small tilts of a driving robot ranges are measured as in the ground plane (0.5 % at 6 degrees),
//! and stems are met at any height.

use furrow_navigation::perception::{Beams, Scan};
use furrow_navigation::random::Stream;

use super::foliage::{Plane, Ribbons};
use super::{OnePlanarLidarParams, PlanarLidar};
use crate::Pose;
use crate::field::lane::Ground;
use crate::field::{Field, Lane};

/// Along the lane so much beyond its range may lie what the LiDAR sees, in a curve of 8 m radius \[m\].
const ALONG_MARGIN_M: f64 = 4.0;

/// The LiDAR and its last scan.
#[derive(Debug, Clone)]
pub struct TiltedLidar {
    params: OnePlanarLidarParams,
    planar: PlanarLidar,
    ribbons: Ribbons,
    /// How much each beam rises per metre.
    rise: Vec<f64>,
    /// Distance to the first stem on each beam \[m\].
    stems_m: Vec<f64>,
    /// Whether each beam's return is a stem.
    from_stem: Vec<bool>,
}

impl TiltedLidar {
    /// A LiDAR with these parameters.
    #[must_use]
    pub fn new(params: &OnePlanarLidarParams) -> Self {
        let beams = Beams::new(params.beams as usize, params.field_of_view_rad);
        let range_m = [params.range_min_m, params.range_max_m];
        Self {
            rise: vec![0.0; beams.len()],
            stems_m: vec![f64::INFINITY; beams.len()],
            from_stem: vec![false; beams.len()],
            planar: PlanarLidar::with_beams(beams, range_m, params.range_noise_m),
            ribbons: Ribbons::new(range_m),
            params: params.clone(),
        }
    }

    /// The ranges seen from `world_from_lidar`, `along_m` along the lane, on tilted ground; no return is infinity.
    /// Beside them, for observers, whether each beam met a stem.
    pub fn scan(
        &mut self,
        (field, lane): (&Field, &Lane),
        world_from_lidar: Pose,
        along_m: f64,
        ground: Ground,
        random: &mut Stream,
    ) -> (Scan<'_>, &[bool]) {
        let reach_m = self.params.range_max_m + ALONG_MARGIN_M;
        let (from_m, to_m) = (along_m - reach_m, along_m + reach_m);
        self.planar.cast(lane.plants_within(&field.plants, from_m, to_m), world_from_lidar);
        let (beams, first_m) = self.planar.beams_and_first();
        for ((rise, cos), sin) in self.rise.iter_mut().zip(&beams.cos).zip(&beams.sin) {
            *rise = ground.roll_rad * sin - ground.pitch_rad * cos;
        }
        let steepest = libm::hypot(ground.roll_rad, ground.pitch_rad);
        let plane = Plane { height_m: self.params.height_m, rise: &self.rise, steepest };
        self.stems_m.copy_from_slice(first_m);
        self.ribbons.cut(lane.foliage_within(from_m, to_m), world_from_lidar, &plane, beams, first_m);
        for (first_m, rise) in first_m.iter_mut().zip(&self.rise) {
            // Never met by a beam that rises.
            let ground_m = if *rise < 0.0 { self.params.height_m / -rise } else { f64::INFINITY };
            *first_m = first_m.min(ground_m);
        }
        for ((from_stem, stem_m), first_m) in self.from_stem.iter_mut().zip(&self.stems_m).zip(first_m.iter()) {
            *from_stem = stem_m.is_finite() & (stem_m <= first_m);
        }
        (self.planar.read(random), &self.from_stem)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::FieldSpec;
    use crate::field::velasquez2022::{LaneName, Velasquez2022Params};
    use furrow_navigation::perception::Points;

    fn scan(ground: Ground, leaf_factor: f64) -> (Points, usize) {
        let params = Velasquez2022Params { lane: LaneName::H, leaf_factor, weed_factor: 0.0, ..Default::default() };
        let field = FieldSpec::Velasquez2022(params).build(1);
        let lane = field.lane.as_ref().unwrap();
        let mut lidar = TiltedLidar::new(&OnePlanarLidarParams { range_noise_m: 0.0, ..Default::default() });
        let at = lane.pose(&field, 30.0);
        let mut points = Points::default();
        let (scan, from_stem) = lidar.scan((&field, lane), at, 30.0, ground, &mut Stream::new(1, "lidar"));
        points.read_scan(&scan);
        (points, from_stem.iter().filter(|stem| **stem).count())
    }

    #[test]
    fn on_level_ground_without_foliage_all_returns_are_stems_of_the_rows() {
        let (points, stems) = scan(Ground::default(), 0.0);
        assert_eq!(points.len(), stems);
        let near = points.iter().filter(|(x, y)| (0.1..1.9).contains(x) && y.abs() < 0.75);
        let (n, off) = near.fold((0, 0.0_f64), |(n, off), (_, y)| (n + 1, off.max((y.abs() - 0.375).abs())));
        assert!(n > 100 && off < 0.16, "{n} points, up to {off} m off");
    }

    #[test]
    fn nose_down_by_six_degrees_the_ground_shows_two_metres_ahead() {
        let (points, _) = scan(Ground { pitch_rad: 0.1, ..Ground::default() }, 0.0);
        let ahead = points.iter().filter(|(_, y)| y.abs() < 0.15).map(|(x, _)| x).fold(0.0, f64::max);
        assert!((ahead - 2.0).abs() < 0.01, "{ahead}");
    }

    #[test]
    fn with_the_left_side_up_the_ground_shows_on_the_right() {
        let (points, stems) = scan(Ground { roll_rad: 0.6, ..Ground::default() }, 0.0);
        assert!(points.len() > stems);
        let nearest = |side: f64| points.iter().map(|(_, y)| side * y).filter(|y| *y > 0.0).fold(0.0, f64::max);
        assert!(nearest(-1.0) < 0.34 && nearest(1.0) > 0.36);
    }

    #[test]
    fn leaves_hide_stems() {
        let (_, clear) = scan(Ground::default(), 0.0);
        let (_, hidden) = scan(Ground::default(), 10.0);
        assert!(hidden < clear, "{hidden} {clear}");
    }
}
