//! The foliage around a LiDAR, in its frame: upright ribbons that a beam meets if it passes between their edges.

use std::ops::Range;

use super::stems::approximate_atan2;
use crate::Pose;
use crate::field::lane::Foliage;
use furrow_navigation::perception::Beams;

/// Foliage is gathered for all places within this distance \[m\]. Ours.
const MARGIN_M: f64 = 0.15;
/// Above the rounding error of a height \[m\].
const GUARD_M: f64 = 1e-9;
/// Beams tried beside those that the approximate bearings give.
const SPARE_BEAMS: f32 = 1.0;

/// The ribbons within reach.
#[derive(Debug, Clone)]
pub(super) struct Ribbons {
    range_m: [f64; 2],
    gathered_at: Option<(f64, f64)>,
    near: Vec<Foliage>,
}

/// How the scan plane lies.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane<'a> {
    /// Height of the LiDAR above the ground.
    pub(super) height_m: f64,
    /// How much each beam rises per metre.
    pub(super) rise: &'a [f64],
    /// No beam rises or falls by more.
    pub(super) steepest: f64,
}

impl Plane<'_> {
    /// Whether no beam can meet a ribbon between these ends and edges.
    fn misses(&self, (x0, y0): (f64, f64), (x1, y1): (f64, f64), [low_m, high_m]: [f64; 2]) -> bool {
        let farthest2 = (x0 * x0 + y0 * y0).max(x1 * x1 + y1 * y1);
        let rises_m = self.steepest * farthest2.sqrt() + GUARD_M;
        low_m > self.height_m + rises_m || high_m < self.height_m - rises_m
    }
}

impl Ribbons {
    pub(super) const fn new(range_m: [f64; 2]) -> Self {
        Self { range_m, gathered_at: None, near: Vec::new() }
    }

    /// Shortens the beams from `pose` to the first ribbon in their way. `all` holds all that lies within reach; `rise`
    /// says how much each beam rises per metre.
    pub(super) fn cut(&mut self, all: &[Foliage], pose: Pose, plane: &Plane<'_>, beams: &Beams, first_m: &mut [f64]) {
        self.gather(all, pose);
        let local = pose.locals();
        for ribbon in &self.near {
            let from = local(ribbon.from_m[0], ribbon.from_m[1]);
            let to = local(ribbon.to_m[0], ribbon.to_m[1]);
            if plane.misses(from, to, ribbon.height_m) {
                continue;
            }
            let shape = Ribbon { from, to, height_m: ribbon.height_m, closest_m: self.range_m[0] };
            let [a, b] = [from, to].map(|(x, y)| approximate_atan2(y as f32, x as f32));
            let (low, high) = (a.min(b), a.max(b));
            if high - low <= std::f32::consts::PI {
                let window = beam_at(beams, low, -SPARE_BEAMS)..beam_at(beams, high, 1.0 + SPARE_BEAMS);
                shape.meet(plane, beams, first_m, window);
            } else {
                // It crosses the line behind the LiDAR.
                shape.meet(plane, beams, first_m, 0..beam_at(beams, low, 1.0 + SPARE_BEAMS));
                shape.meet(plane, beams, first_m, beam_at(beams, high, -SPARE_BEAMS)..beams.len());
            }
        }
    }

    fn gather(&mut self, all: &[Foliage], pose: Pose) {
        let squared = |x: f64, y: f64| (pose.x_m - x) * (pose.x_m - x) + (pose.y_m - y) * (pose.y_m - y);
        if self.gathered_at.is_some_and(|(x, y)| squared(x, y) <= MARGIN_M * MARGIN_M) {
            return;
        }
        self.gathered_at = Some((pose.x_m, pose.y_m));
        let reach_m = self.range_m[1] + MARGIN_M;
        let is_near = |end: [f64; 2]| squared(end[0], end[1]) <= reach_m * reach_m;
        self.near.clear();
        self.near.extend(all.iter().filter(|ribbon| is_near(ribbon.from_m) || is_near(ribbon.to_m)));
    }
}

/// A ribbon in the LiDAR's frame.
struct Ribbon {
    from: (f64, f64),
    to: (f64, f64),
    height_m: [f64; 2],
    closest_m: f64,
}

impl Ribbon {
    /// A window of beams against the ribbon, without branches, so that the compiler makes vector instructions of it.
    fn meet(&self, plane: &Plane<'_>, beams: &Beams, first_m: &mut [f64], window: Range<usize>) {
        let ((x, y), [low_m, high_m]) = (self.from, self.height_m);
        let (dx, dy) = (self.to.0 - x, self.to.1 - y);
        let cross = x * dy - y * dx;
        let window = window.start.min(window.end)..window.end;
        let directions = beams.cos[window.clone()].iter().zip(&beams.sin[window.clone()]);
        let beams = directions.zip(&plane.rise[window.clone()]).zip(&mut first_m[window]);
        for (((cos, sin), rise), first_m) in beams {
            // Not a number or infinite where the beam runs along the ribbon, and then no comparison holds.
            let per = 1.0 / (cos * dy - sin * dx);
            let range_m = cross * per;
            let share = (x * sin - y * cos) * per;
            let height_m = plane.height_m + range_m * rise;
            let on_it = (0.0..=1.0).contains(&share) & (low_m..=high_m).contains(&height_m);
            let hit = on_it & (range_m >= self.closest_m) & (range_m < *first_m);
            *first_m = if hit { range_m } else { *first_m };
        }
    }
}

/// Index of the first beam at or beyond a bearing, moved by so many beams and kept within them.
fn beam_at(beams: &Beams, bearing_rad: f32, moved: f32) -> usize {
    let beam = (bearing_rad - beams.angle_min_rad as f32) / beams.angle_increment_rad as f32 + moved;
    (beam.max(0.0) as usize).min(beams.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::lane::FoliageKind;
    use proptest::prelude::*;

    fn leaf(from_m: [f64; 2], to_m: [f64; 2], height_m: [f64; 2]) -> Foliage {
        Foliage { from_m, to_m, height_m, kind: FoliageKind::Leaf }
    }

    fn cut(foliage: &[Foliage], beams: &Beams, pose: Pose, rise: f64) -> Vec<f64> {
        let mut first_m = vec![f64::INFINITY; beams.len()];
        let rise = vec![rise; beams.len()];
        let plane = Plane { height_m: 0.2, rise: &rise, steepest: rise[0].abs() };
        Ribbons::new([0.06, 10.0]).cut(foliage, pose, &plane, beams, &mut first_m);
        first_m
    }

    #[test]
    fn a_leaf_across_the_way_is_met_where_it_is() {
        let beams = Beams::new(3, 0.2);
        let leaf = leaf([2.0, -0.5], [2.0, 0.5], [0.1, 0.3]);
        let ranges = cut(&[leaf], &beams, Pose::default(), 0.0);
        assert!((ranges[1] - 2.0).abs() < 1e-12 && (ranges[2] - 2.0 / libm::cos(0.1)).abs() < 1e-12);
    }

    #[test]
    fn a_beam_passes_above_and_below() {
        let beams = Beams::new(3, 0.2);
        let high = leaf([2.0, -0.5], [2.0, 0.5], [0.25, 0.3]);
        assert!(cut(&[high], &beams, Pose::default(), 0.0)[1].is_infinite());
        assert!(cut(&[high], &beams, Pose::default(), 0.035)[1].is_finite(), "0.2 m + 2 m x 0.035 is 0.27 m");
        assert!(cut(&[high], &beams, Pose::default(), 0.06)[1].is_infinite());
    }

    proptest! {
        #[test]
        fn windows_leave_no_beam_out(
            ends in proptest::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 1..20),
            heading_rad in -3.0..3.0_f64,
        ) {
            let beams = Beams::new(1081, 1.5 * std::f64::consts::PI);
            let foliage: Vec<_> =
                ends.iter().map(|(x, y, dx, dy)| leaf([*x, *y], [x + dx, y + dy], [0.0, 1.0])).collect();
            let pose = Pose { x_m: 0.2, y_m: -0.1, heading_rad };
            let mut all = vec![f64::INFINITY; beams.len()];
            let rise = [0.0; 1081];
            let plane = Plane { height_m: 0.2, rise: &rise, steepest: 0.0 };
            let local = pose.locals();
            for ribbon in &foliage {
                let [from, to] = [ribbon.from_m, ribbon.to_m].map(|[x, y]| local(x, y));
                let shape = Ribbon { from, to, height_m: ribbon.height_m, closest_m: 0.06 };
                shape.meet(&plane, &beams, &mut all, 0..1081);
            }
            prop_assert_eq!(cut(&foliage, &beams, pose, 0.0), all);
        }
    }
}
