//! Joint fit: two parallel rows at once, over a grid of headings, then refined by robust least squares.
//!
//! Ours, a baseline that needs no prior. The points are thinned to one per cell, so that a near stem counts no more
//! than a far one. At each heading of the grid, histograms of the distance to either side say where a row would find
//! support, and the pair is chosen together: a row is dense, the lane between the rows is empty, and its width is
//! near the nominal one. The best few pairs are refined with one slope for both rows and Tukey's weights; the one
//! that explains the points best is the view.

mod search;

use super::thinned::Thinned;
use super::{LaneEstimate, LaneFinder, LaneView, Points, Side};
use crate::random::Stream;
use search::Search;

crate::parameters! {
    /// Parameters of [`JointFit`]. Ours.
    pub struct JointFitParams {
        /// Points count from this far ahead. Ours.
        pub front_min_m: f64 = -0.3, "m", [-10.0, 10.0];
        /// Points count up to this far ahead. Ours.
        pub front_max_m: f64 = 2.5, "m", [0.1, 10.0];
        /// Of all points in a square cell of this size, one counts. Ours.
        pub cell_m: f64 = 0.03, "m", [0.01, 0.5];
        /// The grid of headings reaches so far to each side. Ours.
        pub max_heading_rad: f64 = 0.6, "rad", [0.0, 1.2];
        /// Its step. Ours.
        pub heading_step_rad: f64 = 0.04, "rad", [0.005, 0.5];
        /// Standard deviation of a row's points about it. Ours.
        pub row_sd_m: f64 = 0.04, "m", [0.005, 0.5];
        /// Standard deviation of the lane's width about the nominal one. Ours.
        pub width_sd_m: f64 = 0.08, "m", [0.005, 2.0];
        /// How much a point inside the lane speaks against it, as a share of what a point on a row speaks for it. Ours.
        pub inside_weight: f64 = 0.3, "1", [0.0, 10.0];
        /// Pairs of rows that are refined. Ours.
        pub starts: u32 = 3, "1", [1, 10];
        /// Steps of refinement. Ours.
        pub refinements: u32 = 6, "1", [1, 100];
        /// A valid side has so many points on its row, one per cell. Ours.
        pub min_points: u32 = 5, "1", [2, 10000];
        /// They reach at least so far along the lane. Ours.
        pub min_length_m: f64 = 0.4, "m", [0.0, 10.0];
    }
}

/// The finder; carries nothing over from scan to scan.
#[derive(Debug, Clone)]
pub struct JointFit {
    params: JointFitParams,
    lane_width_m: f64,
    thinned: Thinned,
    search: Search,
}

impl JointFit {
    /// A finder for lanes of nominally `lane_width_m`.
    #[must_use]
    pub fn new(params: JointFitParams, lane_width_m: f64) -> Self {
        let reach_m = params.front_max_m.max(params.front_min_m.abs()) + 2.0 * lane_width_m;
        let thinned = Thinned::new(params.cell_m, reach_m);
        let search = Search::new(&params, lane_width_m);
        Self { params, lane_width_m, thinned, search }
    }

    /// The place with the best of the refined pairs; none without points.
    fn best(&mut self) -> Option<LaneEstimate> {
        self.search.run(&self.thinned.points);
        let mut best: Option<(LaneEstimate, f64)> = None;
        for start in self.search.starts() {
            let place = self.refine(start);
            let score = self.score(place);
            if best.is_none_or(|(_, highest)| score > highest) {
                best = Some((place, score));
            }
        }
        best.map(|(place, _)| place)
    }

    /// Weighted least squares with one slope for both rows and a prior on the lane's width.
    fn refine(&self, mut place: LaneEstimate) -> LaneEstimate {
        for _ in 0..self.params.refinements {
            let mut sums = PairSums::with_width(self.lane_width_m, self.params.row_sd_m / self.params.width_sd_m);
            self.each_near(place, |x, away, sign, residual| {
                let share = residual / self.reach_m();
                let weight = (1.0 - share * share) * (1.0 - share * share);
                sums.add(weight, x, away, sign);
            });
            let Some([left_m, right_m, slope]) = sums.solve() else { return place };
            let cos = 1.0 / (1.0 + slope * slope).sqrt();
            place = LaneEstimate {
                left_m: (left_m * cos).max(0.0),
                right_m: (right_m * cos).max(0.0),
                heading_rad: place.heading_rad - libm::atan(slope),
            };
        }
        place
    }

    /// How well the rows explain the points, by the measure of the search.
    fn score(&self, place: LaneEstimate) -> f64 {
        let mut score = 0.0;
        self.each_near(place, |_, _, _, residual| score += self.search.support(residual));
        score - self.search.width_penalty(place.width_m()) - self.params.inside_weight * self.count_inside(place)
    }

    fn count_inside(&self, place: LaneEstimate) -> f64 {
        let reach_m = self.reach_m();
        self.each_ahead(place.heading_rad)
            .filter(|(_, y)| *y < place.left_m - reach_m && *y > reach_m - place.right_m)
            .fold(0.0, |count, _| count + 1.0)
    }

    /// A point counts for a row within so much of it.
    fn reach_m(&self) -> f64 {
        3.0 * self.params.row_sd_m
    }

    /// The points in the lane's frame, as far as they lie between front_min and front_max.
    fn each_ahead(&self, heading_rad: f64) -> impl Iterator<Item = (f64, f64)> + '_ {
        let (sin, cos) = libm::sincos(heading_rad);
        let turned = self.thinned.points.iter().map(move |(x, y)| (cos * x - sin * y, sin * x + cos * y));
        turned.filter(|(x, _)| *x > self.params.front_min_m && *x < self.params.front_max_m)
    }

    /// Calls with x, the distance to the side, the side's sign and the residual of each point near its row.
    fn each_near(&self, place: LaneEstimate, mut take: impl FnMut(f64, f64, f64, f64)) {
        for (x, y) in self.each_ahead(place.heading_rad) {
            let (away, sign, row_m) = if y > 0.0 { (y, 1.0, place.left_m) } else { (-y, -1.0, place.right_m) };
            if (away - row_m).abs() < self.reach_m() {
                take(x, away, sign, away - row_m);
            }
        }
    }

    /// Whether enough points lie on the row to the left (1) or right (-1).
    fn is_valid(&self, place: LaneEstimate, side: f64) -> bool {
        let (mut n, mut first_m, mut last_m) = (0, f64::INFINITY, f64::NEG_INFINITY);
        self.each_near(place, |x, _, sign, _| {
            if sign == side {
                n += 1;
                first_m = first_m.min(x);
                last_m = last_m.max(x);
            }
        });
        n >= self.params.min_points && last_m - first_m >= self.params.min_length_m
    }
}

impl LaneFinder for JointFit {
    fn find(&mut self, points: &Points, prior: LaneEstimate, _dt_s: f64, _random: &mut Stream) -> LaneView {
        self.thinned.fill(points);
        let Some(place) = self.best() else { return LaneView::nothing(prior) };
        let (left, right) = (self.is_valid(place, 1.0), self.is_valid(place, -1.0));
        if !left && !right {
            return LaneView::nothing(prior);
        }
        LaneView {
            left: Side { distance_m: place.left_m, valid: left },
            right: Side { distance_m: place.right_m, valid: right },
            heading_rad: place.heading_rad,
            heading_valid: true,
        }
    }

    fn restart(&mut self, _start: LaneEstimate) {}
}

/// Normal equations of away = left + slope x on the left and away = right - slope x on the right.
#[derive(Debug, Clone, Copy)]
struct PairSums {
    matrix: [[f64; 3]; 3],
    rhs: [f64; 3],
}

impl PairSums {
    /// Only knows that left + right is `width_m`, with `ratio` of a point's standard deviation to that.
    fn with_width(width_m: f64, ratio: f64) -> Self {
        let (prior, weak) = (ratio * ratio, 1e-6);
        let matrix = [[prior + weak, prior, 0.0], [prior, prior + weak, 0.0], [0.0, 0.0, weak]];
        let half = (prior + 0.5 * weak) * width_m;
        Self { matrix, rhs: [half, half, 0.0] }
    }

    fn add(&mut self, weight: f64, x: f64, away: f64, sign: f64) {
        let side = if sign > 0.0 { 0 } else { 1 };
        self.matrix[side][side] += weight;
        self.matrix[side][2] += weight * sign * x;
        self.matrix[2][2] += weight * x * x;
        self.rhs[side] += weight * away;
        self.rhs[2] += weight * sign * x * away;
    }

    /// Left, right and slope, by elimination of left and right.
    fn solve(&self) -> Option<[f64; 3]> {
        let [[a, b, c], [_, d, e], [_, _, f]] = self.matrix;
        let [p, q, r] = self.rhs;
        let determinant = a * d - b * b;
        let solve2 = |u: f64, v: f64| ((d * u - b * v) / determinant, (a * v - b * u) / determinant);
        let (rest, turn) = (solve2(p, q), solve2(c, e));
        let slope = (r - c * rest.0 - e * rest.1) / (f - c * turn.0 - e * turn.1);
        let solution = [rest.0 - slope * turn.0, rest.1 - slope * turn.1, slope];
        solution.iter().all(|value| value.is_finite()).then_some(solution)
    }
}

#[cfg(test)]
mod tests {
    use super::super::LaneFinderSpec;
    use super::super::conformance::{check, place};
    use super::super::simulated::Scene;
    use super::*;

    fn find(points: &Points) -> LaneView {
        let mut finder = JointFit::new(JointFitParams::default(), 0.75);
        finder.find(points, LaneEstimate::middle(0.75), 0.025, &mut Stream::new(1, "line-finder"))
    }

    #[test]
    fn it_does_what_every_lane_finder_must_without_a_prior() {
        check(&LaneFinderSpec::JointFit(JointFitParams::default()), None);
    }

    #[test]
    fn exact_rows_are_fitted_exactly_at_headings_off_the_grid() {
        let width_m = 0.75;
        for (left_m, heading_rad) in [(0.31, 0.231_f64), (0.45, -0.333)] {
            let (sin, cos) = heading_rad.sin_cos();
            let mut points = Points::default();
            for i in 0..40 {
                for y in [left_m, left_m - width_m] {
                    let x = 0.05 * f64::from(i);
                    points.push(cos * x + sin * y, cos * y - sin * x);
                }
            }
            let view = find(&points);
            assert!((view.heading_rad - heading_rad).abs() < 1e-6, "{view:?}");
            assert!((view.left.distance_m - left_m).abs() < 1e-6, "{view:?}");
            assert!((view.right.distance_m - (width_m - left_m)).abs() < 1e-6, "{view:?}");
        }
    }

    #[test]
    fn a_missing_row_is_assumed_at_the_nominal_width() {
        let scene = Scene { rows: [false, true], ..Scene::new(place(0.1, -0.1), 0.0) };
        let view = find(&scene.scan(&mut Stream::new(3, "scan")));
        assert!((view.left.distance_m + view.right.distance_m - 0.75).abs() < 0.01, "{view:?}");
        assert!(!view.left.valid && (view.right.distance_m - 0.475).abs() < 0.03, "{view:?}");
    }
}
