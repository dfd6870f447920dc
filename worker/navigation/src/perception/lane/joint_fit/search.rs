//! The search: at each heading of a grid, the pair of rows with the most support.

use super::JointFitParams;
use crate::perception::{LaneEstimate, Points};

/// Histogram bins per standard deviation of a row.
const BINS_PER_SD: f64 = 2.0;
/// The kernel reaches so many bins to each side: three standard deviations.
const REACH: usize = 6;
/// More bins than this are never needed.
const MOST_BINS: usize = 4096;

/// The grid search and its memory.
#[derive(Debug, Clone)]
pub(super) struct Search {
    params: JointFitParams,
    lane_width_m: f64,
    bin_m: f64,
    /// What a point so many bins off adds to a row's support.
    kernel: [f64; REACH + 1],
    sides: [Histogram; 2],
    /// The best pair at each heading.
    found: Vec<(f64, LaneEstimate)>,
    /// Indices into `found`.
    peaks: Vec<usize>,
}

/// One side: counts by distance, and what a row there would be worth.
#[derive(Debug, Clone)]
struct Histogram {
    counts: Vec<f64>,
    worth: Vec<f64>,
}

impl Search {
    pub(super) fn new(params: &JointFitParams, lane_width_m: f64) -> Self {
        let bin_m = params.row_sd_m / BINS_PER_SD;
        // A row is at most one lane width and three deviations away.
        let bins = ((lane_width_m + 3.0 * params.width_sd_m) / bin_m) as usize + 1;
        let bins = bins.min(MOST_BINS);
        let histogram = Histogram { counts: vec![0.0; bins + REACH], worth: vec![0.0; bins] };
        let kernel = std::array::from_fn(|i| kernel(i as f64 / BINS_PER_SD));
        Self {
            params: params.clone(),
            lane_width_m,
            bin_m,
            kernel,
            sides: [histogram.clone(), histogram],
            found: Vec::new(),
            peaks: Vec::new(),
        }
    }

    /// Looks at all headings.
    pub(super) fn run(&mut self, points: &Points) {
        let steps = (self.params.max_heading_rad / self.params.heading_step_rad) as i32;
        self.found.clear();
        for step in -steps..=steps {
            let heading_rad = f64::from(step) * self.params.heading_step_rad;
            self.count(points, heading_rad);
            let best = self.best_pair(heading_rad);
            self.found.push(best);
        }
        self.sort_peaks();
    }

    /// The best pairs, of headings that are better than their neighbours on the grid; best first.
    pub(super) fn starts(&self) -> impl Iterator<Item = LaneEstimate> + '_ {
        self.peaks.iter().take(self.params.starts as usize).map(|i| self.found[*i].1)
    }

    /// What a point with this residual adds to a row's support.
    pub(super) fn support(&self, residual_m: f64) -> f64 {
        kernel(residual_m / self.params.row_sd_m)
    }

    /// What a lane of this width loses.
    pub(super) fn width_penalty(&self, width_m: f64) -> f64 {
        let deviations = (width_m - self.lane_width_m) / self.params.width_sd_m;
        0.5 * deviations * deviations
    }

    fn count(&mut self, points: &Points, heading_rad: f64) {
        let (sin, cos) = libm::sincos(heading_rad);
        self.sides.iter_mut().for_each(|side| side.counts.fill(0.0));
        for (x, y) in points.iter() {
            let (lane_x, lane_y) = (cos * x - sin * y, sin * x + cos * y);
            if lane_x > self.params.front_min_m && lane_x < self.params.front_max_m {
                let side = &mut self.sides[usize::from(lane_y <= 0.0)];
                if let Some(count) = side.counts.get_mut((lane_y.abs() / self.bin_m) as usize) {
                    *count += 1.0;
                }
            }
        }
        let inside_weight = self.params.inside_weight;
        self.sides.iter_mut().for_each(|side| side.weigh(&self.kernel, inside_weight));
    }

    fn best_pair(&self, heading_rad: f64) -> (f64, LaneEstimate) {
        let middle = |bin: usize| (bin as f64 + 0.5) * self.bin_m;
        let most_right = self.sides[1].worth.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut best = (f64::NEG_INFINITY, LaneEstimate::middle(self.lane_width_m));
        for (left, left_worth) in self.sides[0].worth.iter().enumerate() {
            if left_worth + most_right <= best.0 {
                continue;
            }
            for (right, right_worth) in self.sides[1].worth.iter().enumerate() {
                let worth = left_worth + right_worth;
                if worth <= best.0 {
                    continue;
                }
                let (left_m, right_m) = (middle(left), middle(right));
                let worth = worth - self.width_penalty(left_m + right_m);
                if worth > best.0 {
                    best = (worth, LaneEstimate { left_m, right_m, heading_rad });
                }
            }
        }
        best
    }

    fn sort_peaks(&mut self) {
        let worth = |i: usize| self.found.get(i).map_or(f64::NEG_INFINITY, |found| found.0);
        let is_peak = |i: &usize| worth(*i) >= worth(i + 1) && (*i == 0 || worth(*i) >= worth(i - 1));
        self.peaks.clear();
        self.peaks.extend((0..self.found.len()).filter(is_peak));
        self.peaks.sort_unstable_by(|a, b| worth(*b).total_cmp(&worth(*a)).then(a.cmp(b)));
    }
}

impl Histogram {
    /// A row's worth: its support, less the points on its inner side, which would be inside the lane.
    fn weigh(&mut self, kernel: &[f64; REACH + 1], inside_weight: f64) {
        let mut inside = 0.0;
        for bin in 0..self.worth.len() {
            let mut support = kernel[0] * self.counts[bin];
            for (off, share) in kernel.iter().enumerate().skip(1) {
                let before = if bin >= off { self.counts[bin - off] } else { 0.0 };
                support += share * (self.counts[bin + off] + before);
            }
            if bin > REACH {
                inside += self.counts[bin - REACH - 1];
            }
            self.worth[bin] = support - inside_weight * inside;
        }
    }
}

/// A normal density's shape, cut off at three deviations.
fn kernel(deviations: f64) -> f64 {
    if deviations.abs() > 3.0 { 0.0 } else { libm::exp(-0.5 * deviations * deviations) }
}
