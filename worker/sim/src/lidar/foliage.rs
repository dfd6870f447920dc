//! The foliage around a LiDAR, in its frame: upright ribbons that a beam meets if it passes between their edges.

use super::stems::approximate_atan2;
use crate::Pose;
use crate::field::lane::Foliage;
use furrow_navigation::perception::Beams;

/// Foliage is gathered for all places within this distance \[m\]. Ours.
const MARGIN_M: f64 = 0.15;
/// Beams tried beside those that the approximate bearings give.
const SPARE_BEAMS: f32 = 1.0;

/// The ribbons within reach.
#[derive(Debug, Clone)]
pub(super) struct Ribbons {
    range_m: [f64; 2],
    gathered_at: Option<(f64, f64)>,
    near: Vec<Foliage>,
}

/// How the scan plane lies: height of the LiDAR, and how much a beam rises per metre ahead and to the left.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    pub(super) height_m: f64,
    pub(super) ahead: f64,
    pub(super) left: f64,
}

impl Plane {
    /// How much a beam in this direction rises per metre.
    pub(super) fn rise(&self, cos: f64, sin: f64) -> f64 {
        self.ahead * cos + self.left * sin
    }
}

impl Ribbons {
    pub(super) const fn new(range_m: [f64; 2]) -> Self {
        Self { range_m, gathered_at: None, near: Vec::new() }
    }

    /// Shortens the beams from `pose` to the first ribbon in their way. `all` holds all that lies within reach.
    pub(super) fn cut(&mut self, all: &[Foliage], pose: Pose, plane: Plane, beams: &Beams, first_m: &mut [f64]) {
        self.gather(all, pose);
        let local = pose.locals();
        for ribbon in &self.near {
            let from = local(ribbon.from_m[0], ribbon.from_m[1]);
            let to = local(ribbon.to_m[0], ribbon.to_m[1]);
            let mut cut = |first, end| self.meet(from, to, ribbon.height_m, plane, beams, &mut first_m[..end], first);
            let [a, b] = [from, to].map(|(x, y)| approximate_atan2(y as f32, x as f32));
            let (low, high) = (a.min(b), a.max(b));
            if high - low <= std::f32::consts::PI {
                cut(beam_at(beams, low, -SPARE_BEAMS), beam_at(beams, high, 1.0 + SPARE_BEAMS));
            } else {
                // It crosses the line behind the LiDAR.
                cut(0, beam_at(beams, low, 1.0 + SPARE_BEAMS));
                cut(beam_at(beams, high, -SPARE_BEAMS), beams.len());
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

    /// Beams from `first` on against one ribbon, in the LiDAR's frame.
    #[expect(clippy::too_many_arguments, reason = "the geometry of one ray and one ribbon")]
    fn meet(
        &self,
        (x, y): (f64, f64),
        to: (f64, f64),
        [low_m, high_m]: [f64; 2],
        plane: Plane,
        beams: &Beams,
        first_m: &mut [f64],
        first: usize,
    ) {
        let (dx, dy) = (to.0 - x, to.1 - y);
        let cross = x * dy - y * dx;
        for i in first..first_m.len() {
            let (cos, sin) = (beams.cos[i], beams.sin[i]);
            // Not a number or infinite where the beam runs along the ribbon, and then no comparison holds.
            let per = 1.0 / (cos * dy - sin * dx);
            let range_m = cross * per;
            let share = (x * sin - y * cos) * per;
            let height_m = plane.height_m + range_m * plane.rise(cos, sin);
            let hit = (0.0..=1.0).contains(&share)
                && range_m >= self.range_m[0]
                && range_m < first_m[i]
                && (low_m..=high_m).contains(&height_m);
            if hit {
                first_m[i] = range_m;
            }
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

    fn cut(foliage: &[Foliage], beams: &Beams, pose: Pose, plane: Plane) -> Vec<f64> {
        let mut first_m = vec![f64::INFINITY; beams.len()];
        Ribbons::new([0.06, 10.0]).cut(foliage, pose, plane, beams, &mut first_m);
        first_m
    }

    const LEVEL: Plane = Plane { height_m: 0.2, ahead: 0.0, left: 0.0 };

    #[test]
    fn a_leaf_across_the_way_is_met_where_it_is() {
        let beams = Beams::new(3, 0.2);
        let leaf = leaf([2.0, -0.5], [2.0, 0.5], [0.1, 0.3]);
        let ranges = cut(&[leaf], &beams, Pose::default(), LEVEL);
        assert!((ranges[1] - 2.0).abs() < 1e-12 && (ranges[2] - 2.0 / libm::cos(0.1)).abs() < 1e-12);
    }

    #[test]
    fn a_beam_passes_above_and_below() {
        let beams = Beams::new(3, 0.2);
        let high = leaf([2.0, -0.5], [2.0, 0.5], [0.25, 0.3]);
        assert!(cut(&[high], &beams, Pose::default(), LEVEL)[1].is_infinite());
        let rising = Plane { ahead: 0.035, ..LEVEL };
        assert!(cut(&[high], &beams, Pose::default(), rising)[1].is_finite(), "0.2 m + 2 m x 0.035 is 0.27 m");
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
            let ribbons = Ribbons::new([0.06, 10.0]);
            let local = pose.locals();
            for ribbon in &foliage {
                let [from, to] = [ribbon.from_m, ribbon.to_m].map(|[x, y]| local(x, y));
                ribbons.meet(from, to, ribbon.height_m, LEVEL, &beams, &mut all, 0);
            }
            prop_assert_eq!(cut(&foliage, &beams, pose, LEVEL), all);
        }
    }
}
