//! The foliage around a LiDAR, in its frame: upright ribbons that a beam meets if it passes between their edges.
//!
//! Ribbons that the scan plane could cut at any pose nearby are gathered once, the nearest first, and kept until the LiDAR has
//! moved on or tilts more. What stands behind all that its beams have met is then left out. All that is approximate
//! here, in single precision, only leaves out what no beam can meet: no range depends on it.

use std::ops::Range;

use super::stems::{GUARD_RAD, approximate_atan2, rounded_up, within};
use crate::Pose;
use crate::field::lane::Foliage;
use furrow_navigation::perception::Beams;

/// Foliage is gathered for all places within this distance \[m\], for all turns \[rad\] and for all tilts that exceed the one there by
/// so much. Ours.
const MARGIN_M: f64 = 0.3;
const MARGIN_RAD: f64 = 0.15;
const MARGIN_TILT: f64 = 0.02;
/// Above the error of places within reach in single precision \[m\].
const GUARD_M: f32 = 1e-4;
/// Beams tried beside those that the approximate bearings and their guard give.
const SPARE_BEAMS: f32 = 1.0;
/// Of so many beams together the farthest range is kept.
const BLOCK: usize = 16;

/// The ribbons within reach.
#[derive(Debug, Clone)]
pub(super) struct Ribbons {
    range_m: [f64; 2],
    gathered: Option<Gathered>,
    /// In the world's frame, the nearest first.
    near: Vec<Foliage>,
    /// Squared distances of their nearer ends where they were gathered, in order, and places in the whole: for the order.
    order: Vec<(f32, u32)>,
    outlines: Outlines,
    /// The farthest range of each block of beams \[m\].
    farthest_m: Vec<f32>,
}

/// Where the ribbons were gathered, and for which tilt.
#[derive(Debug, Clone, Copy)]
struct Gathered {
    pose: Pose,
    steepest: f64,
}

/// The ribbons in single precision, and which beams can meet them.
#[derive(Debug, Clone, Default)]
struct Outlines {
    /// Middle, from where they were gathered \[m\].
    middle_m: [Vec<f32>; 2],
    /// From the middle to one end \[m\], and how far that is.
    half_m: [Vec<f32>; 2],
    half_length_m: Vec<f32>,
    /// Lower and upper edge \[m\].
    height_m: [Vec<f32>; 2],
    /// Below the distance of any of its points \[m\]; infinite for one that no beam can meet.
    nearest_m: Vec<f32>,
    /// First and end of the beams that can meet it.
    window: [Vec<u32>; 2],
    /// Whether it crosses the line behind the LiDAR: then the beams from the first on, and those up to the end.
    is_behind: Vec<bool>,
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

impl Ribbons {
    pub(super) fn new(range_m: [f64; 2]) -> Self {
        Self {
            range_m,
            gathered: None,
            near: Vec::new(),
            order: Vec::new(),
            outlines: Outlines::default(),
            farthest_m: Vec::new(),
        }
    }

    /// Shortens the beams from `pose` to the first ribbon in their way. `all` holds all that lies within reach; `rise`
    /// says how much each beam rises per metre.
    pub(super) fn cut(&mut self, all: &[Foliage], pose: Pose, plane: &Plane<'_>, beams: &Beams, first_m: &mut [f64]) {
        let at = self.gather(all, pose, plane, beams);
        let moved = Pose { x_m: pose.x_m - at.x_m, y_m: pose.y_m - at.y_m, ..pose };
        self.outlines.look(moved, plane, self.range_m[1], beams);
        let local = pose.locals();
        let mut open = Open { farthest_m: &mut self.farthest_m, first_m };
        open.begin();
        for (i, ribbon) in self.near.iter().enumerate() {
            let (nearest_m, windows) = (self.outlines.nearest_m[i], self.outlines.windows(i, beams.len()));
            for window in windows {
                if open.is_hidden(nearest_m, &window) {
                    continue;
                }
                let [from, to] = [ribbon.from_m, ribbon.to_m].map(|[x, y]| local(x, y));
                let ribbon = Ribbon { from, to, height_m: ribbon.height_m, closest_m: self.range_m[0] };
                ribbon.meet(plane, beams, open.first_m, window.clone());
                open.update(&window);
            }
        }
    }

    /// Gathers anew if need be; returns where that was last done.
    fn gather(&mut self, all: &[Foliage], pose: Pose, plane: &Plane<'_>, beams: &Beams) -> Pose {
        if let Some(gathered) = self.gathered.filter(|gathered| gathered.holds(pose, plane)) {
            return gathered.pose;
        }
        let steepest = plane.steepest + MARGIN_TILT;
        let reach_m = self.range_m[1] + MARGIN_M;
        let (local, blind) = (pose.locals(), Blind::new(beams));
        self.order.clear();
        for (ribbon, i) in all.iter().zip(0..) {
            let ends = [ribbon.from_m, ribbon.to_m].map(|[x, y]| local(x, y));
            let [a, b] = ends.map(|(x, y)| x * x + y * y);
            let rises_m = steepest * (a.max(b).sqrt() + MARGIN_M);
            let [low_m, high_m] = ribbon.height_m;
            let can_meet = (low_m <= plane.height_m + rises_m) & (high_m >= plane.height_m - rises_m);
            let length_m = libm::hypot(ends[1].0 - ends[0].0, ends[1].1 - ends[0].1);
            // No point of it is nearer than that: half of the way to both ends, less the way between them.
            let nearest_m = 0.5 * (a.sqrt() + b.sqrt() - length_m);
            if can_meet & (nearest_m <= reach_m) && !ends.iter().all(|end| blind.holds(*end)) {
                self.order.push((a.min(b) as f32, i));
            }
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        self.near.clear();
        self.near.extend(self.order.iter().map(|(_, i)| all[*i as usize]));
        self.outlines.take(&self.near, [pose.x_m, pose.y_m]);
        self.gathered = Some(Gathered { pose, steepest });
        pose
    }
}

impl Gathered {
    fn holds(&self, pose: Pose, plane: &Plane<'_>) -> bool {
        let (dx, dy) = (pose.x_m - self.pose.x_m, pose.y_m - self.pose.y_m);
        dx * dx + dy * dy <= MARGIN_M * MARGIN_M
            && (pose.heading_rad - self.pose.heading_rad).abs() <= MARGIN_RAD
            && plane.steepest <= self.steepest
    }
}

/// The cone behind a LiDAR into which no beam goes, for all poses for which foliage is gathered. It is convex: a ribbon with both
/// ends in it is in it.
struct Blind {
    /// Of half the cone.
    sin: f64,
    cos: f64,
}

impl Blind {
    fn new(beams: &Beams) -> Self {
        // Beams lie evenly about straight ahead.
        let (sin, cos) = libm::sincos(std::f64::consts::PI + beams.angle_min_rad);
        Self { sin, cos }
    }

    fn holds(&self, (x, y): (f64, f64)) -> bool {
        // How far a point is from the cone's nearer side; of half a turn and more there is none.
        let inside_m = -x * self.sin - y.abs() * self.cos;
        self.cos > 0.0 && inside_m > MARGIN_M + MARGIN_RAD * libm::sqrt(x * x + y * y)
    }
}

impl Outlines {
    fn take(&mut self, near: &[Foliage], [x_m, y_m]: [f64; 2]) {
        let fill = |values: &mut Vec<f32>, value: &dyn Fn(&Foliage) -> f64| {
            values.clear();
            values.extend(near.iter().map(|ribbon| value(ribbon) as f32));
        };
        for (axis, origin_m) in [x_m, y_m].into_iter().enumerate() {
            fill(&mut self.middle_m[axis], &|ribbon| 0.5 * (ribbon.from_m[axis] + ribbon.to_m[axis]) - origin_m);
            fill(&mut self.half_m[axis], &|ribbon| 0.5 * (ribbon.to_m[axis] - ribbon.from_m[axis]));
        }
        let half_length = |[x0, y0]: [f64; 2], [x1, y1]: [f64; 2]| 0.5 * libm::hypot(x1 - x0, y1 - y0);
        fill(&mut self.half_length_m, &|ribbon| half_length(ribbon.from_m, ribbon.to_m));
        for edge in 0..2 {
            fill(&mut self.height_m[edge], &|ribbon| ribbon.height_m[edge]);
        }
        self.nearest_m.resize(near.len(), 0.0);
        self.window.iter_mut().for_each(|window| window.resize(near.len(), 0));
        self.is_behind.resize(near.len(), false);
    }

    /// Finds what beams from `moved`, relative to where the ribbons were gathered, can meet.
    fn look(&mut self, moved: Pose, plane: &Plane<'_>, range_max_m: f64, beams: &Beams) {
        let (x_m, y_m) = (moved.x_m as f32, moved.y_m as f32);
        let (sin, cos) = libm::sincos(moved.heading_rad);
        let (sin, cos) = (sin as f32, cos as f32);
        let (height_m, steepest) = (plane.height_m as f32, plane.steepest as f32);
        let (range_max_m, n_beams) = (range_max_m as f32, beams.len() as f32);
        let (first_rad, beams_per_rad) = (beams.angle_min_rad as f32, beams.angle_increment_rad.recip() as f32);
        let spare = SPARE_BEAMS + GUARD_RAD * beams_per_rad;
        let n = self.nearest_m.len();
        let [middle_x, middle_y] = self.middle_m.each_ref().map(|values| &values[..n]);
        let [half_x, half_y] = self.half_m.each_ref().map(|values| &values[..n]);
        let [low, high] = self.height_m.each_ref().map(|values| &values[..n]);
        let half_length = &self.half_length_m[..n];
        let [first, end] = self.window.each_mut().map(|values| &mut values[..n]);
        let (nearest, is_behind) = (&mut self.nearest_m[..n], &mut self.is_behind[..n]);
        for i in 0..n {
            let (dx, dy) = (middle_x[i] - x_m, middle_y[i] - y_m);
            let (x, y) = (cos * dx + sin * dy, cos * dy - sin * dx);
            let (hx, hy) = (cos * half_x[i] + sin * half_y[i], cos * half_y[i] - sin * half_x[i]);
            let distance = (x * x + y * y).sqrt();
            let rises = steepest * (distance + half_length[i]) + GUARD_M;
            let nearest_m = distance - half_length[i] - GUARD_M;
            let can_meet = (low[i] <= height_m + rises) & (high[i] >= height_m - rises) & (nearest_m <= range_max_m);
            nearest[i] = if can_meet { nearest_m } else { f32::INFINITY };
            let (a, b) = (approximate_atan2(y - hy, x - hx), approximate_atan2(y + hy, x + hx));
            let (least, most) = (if a < b { a } else { b }, if a < b { b } else { a });
            let behind = most - least > std::f32::consts::PI;
            let (from, to) = if behind { (most, least) } else { (least, most) };
            is_behind[i] = behind;
            first[i] = rounded_up(within((from - first_rad) * beams_per_rad - spare, n_beams));
            end[i] = rounded_up(within((to - first_rad) * beams_per_rad + spare, n_beams));
        }
    }

    /// The beams that can meet ribbon `i`.
    fn windows(&self, i: usize, beams: usize) -> [Range<usize>; 2] {
        if self.nearest_m[i] == f32::INFINITY {
            return [0..0, 0..0];
        }
        let [first, end] = self.window.each_ref().map(|values| values[i] as usize);
        if self.is_behind[i] { [0..end, first..beams] } else { [first..end, 0..0] }
    }
}

/// What beams have not met yet.
struct Open<'a> {
    /// The farthest range of each block of beams \[m\], rounded up.
    farthest_m: &'a mut Vec<f32>,
    first_m: &'a mut [f64],
}

impl Open<'_> {
    fn begin(&mut self) {
        self.farthest_m.clear();
        self.farthest_m.extend(self.first_m.chunks(BLOCK).map(farthest));
    }

    /// Whether all beams of a window have met something nearer, or there is none.
    fn is_hidden(&self, nearest_m: f32, window: &Range<usize>) -> bool {
        window.is_empty() || self.farthest_m[blocks(window)].iter().all(|farthest_m| nearest_m > *farthest_m)
    }

    fn update(&mut self, window: &Range<usize>) {
        let blocks = blocks(window);
        let beams = blocks.start * BLOCK..(blocks.end * BLOCK).min(self.first_m.len());
        for (farthest_m, ranges_m) in self.farthest_m[blocks].iter_mut().zip(self.first_m[beams].chunks(BLOCK)) {
            *farthest_m = farthest(ranges_m);
        }
    }
}

/// The blocks of a window that is not empty.
fn blocks(window: &Range<usize>) -> Range<usize> {
    window.start / BLOCK..(window.end - 1) / BLOCK + 1
}

fn farthest(ranges_m: &[f64]) -> f32 {
    let farthest_m = ranges_m.iter().fold(0.0, |farthest: f64, m| if *m > farthest { *m } else { farthest });
    farthest_m as f32 + GUARD_M
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
        /// Whatever is left out for its place, its tilt, its bearing or what hides it: no range depends on it.
        #[test]
        fn no_beam_is_left_out(
            ends in proptest::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64, -1.0..1.0_f64, -1.0..1.0_f64), 1..60),
            edges in proptest::collection::vec((0.0..0.5_f64, 0.0..0.4_f64), 60),
            met_m in proptest::collection::vec(0.5..9.0_f64, 1081),
            (fov_rad, heading_rad, range_max_m) in (1.0..6.2_f64, -3.0..3.0_f64, 0.3..10.0_f64),
            moves in proptest::collection::vec((-0.2..0.2_f64, -0.2..0.2_f64, -0.1..0.1_f64, 0.0..0.1_f64), 1..4),
        ) {
            let beams = Beams::new(1081, fov_rad);
            let ends = ends.iter().zip(&edges);
            let foliage: Vec<_> =
                ends.map(|((x, y, dx, dy), (low, up))| leaf([*x, *y], [x + dx, y + dy], [*low, low + up])).collect();
            let mut ribbons = Ribbons::new([0.06, range_max_m]);
            let mut pose = Pose { x_m: 0.2, y_m: -0.1, heading_rad };
            for (dx, dy, turn_rad, steepest) in moves {
                pose = Pose { x_m: pose.x_m + dx, y_m: pose.y_m + dy, heading_rad: pose.heading_rad + turn_rad };
                let rise: Vec<_> = beams.sin.iter().map(|sin| steepest * sin).collect();
                let plane = Plane { height_m: 0.2, rise: &rise, steepest };
                let local = pose.locals();
                let [mut all, mut some] = [met_m.clone(), met_m.clone()];
                for ribbon in &foliage {
                    let [from, to] = [ribbon.from_m, ribbon.to_m].map(|[x, y]| local(x, y));
                    let shape = Ribbon { from, to, height_m: ribbon.height_m, closest_m: 0.06 };
                    shape.meet(&plane, &beams, &mut all, 0..1081);
                }
                ribbons.cut(&foliage, pose, &plane, &beams, &mut some);
                // A beam that goes farther has no return.
                some.iter_mut().chain(&mut all).for_each(|range_m| *range_m = range_m.min(range_max_m));
                prop_assert_eq!(some, all);
            }
        }
    }
}
