//! PL: a histogram finds the points of each row, least squares makes them a virtual wall, thresholds judge it.
//!
//! Velasquez et al. (2022), section 3.2, after Higuti et al. (2019). The paper gives the front and back end of the
//! rectangle and the order of the steps; the other thresholds are ours.
//!
//! Deviation: the jump of a slope is taken against the prior heading, which is the one the scan was turned by. The
//! distance a new one may jump grows while a side stays invalid, so that a side that was wrong once can come back.

mod wall;

use super::{LaneEstimate, LaneFinder, LaneView, Points, Side};
use crate::random::Stream;
use wall::{Fit, Wall};

crate::parameters! {
    /// Parameters of [`Pl`].
    pub struct PlParams {
        /// Points count from this far ahead. Paper: 0.1.
        pub front_min_m: f64 = 0.1, "m", [-10.0, 10.0];
        /// Points count up to this far ahead. Paper: 1.9.
        pub front_max_m: f64 = 1.9, "m", [0.1, 10.0];
        /// Points count up to so many nominal lane widths to each side, the paper's D_y. Ours.
        pub side_lanes: f64 = 1.0, "1", [0.5, 3.0];
        /// Width of the histogram's bins. Ours, after Higuti et al. (2019).
        pub bin_m: f64 = 0.05, "m", [0.005, 0.5];
        /// A wall has at least so many points. Ours.
        pub min_points: u32 = 5, "1", [3, 10000];
        /// Its points reach at least so far along the lane. Ours: farther than a few leaves.
        pub min_length_m: f64 = 0.7, "m", [0.0, 10.0];
        /// Its points scatter about it at most so much: standard deviation. Ours: a uniform scatter over three bins has
        /// 0.043; stems that stand 0.02 off their row, seen with noise of 0.01, have 0.022, and a wandering row has more.
        pub max_residual_m: f64 = 0.035, "m", [0.001, 1.0];
        /// It is turned from the prior heading at most so much. Ours.
        pub max_turn_rad: f64 = 0.26, "rad", [0.01, 1.5];
        /// The heading that it means is at most so far from straight along the lane. Ours.
        pub max_heading_rad: f64 = 0.7, "rad", [0.01, 1.5];
        /// Its distance differs from the last valid one at most so much. Ours: a bin.
        pub max_jump_m: f64 = 0.05, "m", [0.001, 5.0];
        /// And so much more for each second since then. Ours: the robot's speed.
        pub jump_growth_m_s: f64 = 0.7, "m/s", [0.0, 5.0];
        /// After so long without a valid side, the prior heading and the last distances are not trusted. Ours: at 1.5 rad/s the
        /// robot then has turned so far that a wall of 1 m no longer fits into three bins.
        pub forget_after_s: f64 = 0.1, "s", [0.0, 100000.0];
    }
}

/// The finder.
#[derive(Debug, Clone)]
pub struct Pl {
    params: PlParams,
    half_width_m: f64,
    left: Wall,
    right: Wall,
    /// Time without a valid side \[s\].
    blind_s: f64,
    /// The last valid heading \[rad\] where the prior is too far from it to be of use, because it was forgotten.
    apart_rad: Option<f64>,
}

impl Pl {
    /// A finder that has seen no scan, for lanes of nominally `lane_width_m`.
    #[must_use]
    pub fn new(params: PlParams, lane_width_m: f64) -> Self {
        let half_width_m = params.side_lanes * lane_width_m;
        let bins = (half_width_m / params.bin_m).ceil().clamp(1.0, 10_000.0) as usize;
        let wall = Wall::new(bins, 0.5 * lane_width_m);
        Self { params, half_width_m, left: wall.clone(), right: wall, blind_s: 0.0, apart_rad: None }
    }

    /// Steps 1 to 3: into the path frame, inside the rectangle in both frames, left and right apart.
    fn sort_in(&mut self, points: &Points, heading_rad: f64) {
        let (sin, cos) = libm::sincos(heading_rad);
        let inside =
            |x: f64, y: f64| x > self.params.front_min_m && x < self.params.front_max_m && y.abs() < self.half_width_m;
        self.left.clear();
        self.right.clear();
        for (x, y) in points.iter() {
            let (path_x, path_y) = (cos * x - sin * y, sin * x + cos * y);
            if inside(x, y) && inside(path_x, path_y) {
                let wall = if path_y > 0.0 { &mut self.left } else { &mut self.right };
                wall.add(path_x, path_y.abs(), self.params.bin_m);
            }
        }
    }
}

impl LaneFinder for Pl {
    fn find(&mut self, points: &Points, prior: LaneEstimate, dt_s: f64, _random: &mut Stream) -> LaneView {
        let lost = self.blind_s >= self.params.forget_after_s;
        let turned_rad = if lost { 0.0 } else { self.apart_rad.unwrap_or(prior.heading_rad) };
        if lost {
            self.left.forget();
            self.right.forget();
        }
        self.sort_in(points, turned_rad);
        // Away from the robot means to the left on one side and to the right on the other.
        let left = self.left.find(&self.params, turned_rad, dt_s);
        let right =
            self.right.find(&self.params, -turned_rad, dt_s).map(|fit| Fit { heading_rad: -fit.heading_rad, ..fit });
        let better = left.into_iter().chain(right).min_by(|a, b| a.slope_variance.total_cmp(&b.slope_variance));
        self.blind_s = if better.is_some() { 0.0 } else { self.blind_s + dt_s };
        if let Some(Fit { heading_rad, .. }) = better {
            let apart = (heading_rad - prior.heading_rad).abs() > self.params.max_turn_rad;
            self.apart_rad = apart.then_some(heading_rad);
        }
        LaneView {
            left: Side { distance_m: self.left.distance_m(), valid: left.is_some() },
            right: Side { distance_m: self.right.distance_m(), valid: right.is_some() },
            heading_rad: better.map_or(prior.heading_rad, |fit| fit.heading_rad),
            heading_valid: better.is_some(),
        }
    }

    fn restart(&mut self, start: LaneEstimate) {
        self.left.restart(start.left_m);
        self.right.restart(start.right_m);
        (self.blind_s, self.apart_rad) = (0.0, None);
    }
}

#[cfg(test)]
mod tests {
    use super::super::LaneFinderSpec;
    use super::super::conformance::{check, place};
    use super::super::simulated::Scene;
    use super::*;

    fn pl() -> Pl {
        Pl::new(PlParams::default(), 0.75)
    }

    fn find(pl: &mut Pl, points: &Points, prior: LaneEstimate) -> LaneView {
        pl.find(points, prior, 0.025, &mut Stream::new(1, "line-finder"))
    }

    /// Two walls of points, 5 cm apart, `left_m` and `right_m` away in the frame of a robot along them.
    fn walls(left_m: f64, right_m: f64) -> Points {
        let x_m: Vec<f64> = (3..37).map(|i| 0.05 * f64::from(i)).collect();
        let y_m = [vec![left_m; x_m.len()], vec![-right_m; x_m.len()]].concat();
        Points { x_m: [x_m.clone(), x_m].concat(), y_m }
    }

    #[test]
    fn it_does_what_every_lane_finder_must() {
        check(&LaneFinderSpec::Pl(PlParams::default()), Some(0.07));
    }

    #[test]
    fn exact_walls_give_exact_distances_and_heading() {
        let view = find(&mut pl(), &walls(0.31, 0.44), LaneEstimate::middle(0.75));
        assert!((view.left.distance_m - 0.31).abs() < 1e-12 && (view.right.distance_m - 0.44).abs() < 1e-12);
        assert!(view.left.valid && view.right.valid && view.heading_valid && view.heading_rad.abs() < 1e-12);
    }

    #[test]
    fn a_wrong_prior_heading_is_corrected_by_the_walls_slope() {
        let view = find(&mut pl(), &walls(0.31, 0.44), place(0.0, 0.03));
        assert!(view.heading_rad.abs() < 1e-12, "{view:?}");
        assert!((view.left.distance_m - 0.31).abs() < 1e-12);
    }

    #[test]
    fn points_behind_and_far_ahead_do_not_count() {
        let mut points = walls(0.31, 0.44);
        for i in 0..200 {
            points.push(-0.01 * f64::from(i), 0.2);
            points.push(1.9 + 0.01 * f64::from(i), 0.2);
        }
        assert_eq!(find(&mut pl(), &points, place(0.0, 0.0)), find(&mut pl(), &walls(0.31, 0.44), place(0.0, 0.0)));
    }

    #[test]
    fn a_jump_is_invalid_and_hands_the_last_valid_distance_on_until_the_robot_could_have_moved_so_far() {
        // 0.2 m are allowed 0.15 m / 0.7 m/s after the last valid distance, whatever the rate of scans.
        for (dt_s, expected) in [(0.025, 9), (0.1, 3), (0.2, 2)] {
            let mut pl = pl();
            let mut see = |left_m| pl.find(&walls(left_m, 0.45), place(0.0, 0.0), dt_s, &mut Stream::new(1, "pl"));
            see(0.3);
            for scan in 1..=expected {
                let view = see(0.5);
                assert_eq!(view.left.valid, scan == expected, "{dt_s} {scan}");
                let distance_m = if view.left.valid { 0.5 } else { 0.3 };
                assert!((view.left.distance_m - distance_m).abs() < 1e-12 && view.right.valid);
            }
        }
    }

    #[test]
    fn short_crooked_and_thin_walls_are_invalid() {
        let valid = |points: &Points| find(&mut pl(), points, place(0.0, 0.0)).left.valid;
        let only = |keep: &dyn Fn(f64) -> bool, wave_m: f64| {
            let (mut points, all) = (Points::default(), walls(0.31, 0.44));
            all.iter().filter(|(x, _)| keep(*x)).for_each(|(x, y)| points.push(x, y + wave_m * libm::sin(20.0 * x)));
            points
        };
        assert!(valid(&only(&|x| x < 0.9, 0.0)) && !valid(&only(&|x| x < 0.8, 0.0)));
        let strict = PlParams { max_residual_m: 0.005, ..PlParams::default() };
        let wavy = only(&|_| true, 0.02);
        assert!(valid(&wavy) && !find(&mut Pl::new(strict, 0.75), &wavy, place(0.0, 0.0)).left.valid);
        assert!(!valid(&only(&|x| (x / 0.45).fract() < 0.1, 0.0)));
    }

    #[test]
    fn a_heading_that_fits_nothing_is_forgotten_after_a_while_even_if_the_prior_stays() {
        let mut pl = pl();
        let points = Scene::new(place(0.0, 0.0), 0.0).scan(&mut Stream::new(1, "scan"));
        let wrong = place(0.0, 1.2);
        for _ in 0..(PlParams::default().forget_after_s / 0.025) as u32 {
            assert_eq!(find(&mut pl, &points, wrong).heading_rad, 1.2);
        }
        for _ in 0..3 {
            let view = find(&mut pl, &points, wrong);
            assert!(view.heading_valid && view.heading_rad.abs() < 0.03, "{view:?}");
        }
    }
}
