//! One side's virtual wall: histogram, least squares, and what makes it valid.

use super::PlParams;

/// One side: its points in this scan, and what is carried over. Distances are positive away from the robot.
#[derive(Debug, Clone)]
pub(super) struct Wall {
    x_m: Vec<f64>,
    away_m: Vec<f64>,
    counts: Vec<u32>,
    /// The last valid distance, or where the robot started.
    distance_m: f64,
    /// Time since then \[s\]; none without a valid distance to compare with.
    since_s: Option<f64>,
}

/// A valid wall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// The robot's heading, positive towards the wall \[rad\].
    pub(super) heading_rad: f64,
    /// How well the points determine the slope.
    pub(super) slope_variance: f64,
}

impl Wall {
    pub(super) fn new(bins: usize, distance_m: f64) -> Self {
        Self { x_m: Vec::new(), away_m: Vec::new(), counts: vec![0; bins], distance_m, since_s: None }
    }

    pub(super) fn restart(&mut self, distance_m: f64) {
        self.distance_m = distance_m;
        self.since_s = None;
    }

    /// Keeps the distance, but compares no other with it.
    pub(super) fn forget(&mut self) {
        self.since_s = None;
    }

    /// The last valid distance, or where the robot started \[m\].
    pub(super) fn distance_m(&self) -> f64 {
        self.distance_m
    }

    pub(super) fn clear(&mut self) {
        self.x_m.clear();
        self.away_m.clear();
        self.counts.fill(0);
    }

    pub(super) fn add(&mut self, x_m: f64, away_m: f64, bin_m: f64) {
        self.x_m.push(x_m);
        self.away_m.push(away_m);
        let bin = ((away_m / bin_m) as usize).min(self.counts.len() - 1);
        self.counts[bin] += 1;
    }

    /// Steps 3 to 5: the wall of this scan if it is valid; takes its distance over. The scan was turned by `turned_rad`,
    /// positive towards the wall.
    pub(super) fn find(&mut self, params: &PlParams, turned_rad: f64, dt_s: f64) -> Option<Fit> {
        let (fit, distance_m) = self.fit(params, turned_rad).unzip();
        self.since_s = self.since_s.map(|since_s| since_s + dt_s);
        let jump_m = self.since_s.map(|since_s| params.max_jump_m + since_s * params.jump_growth_m_s);
        let near = |distance_m: &f64| jump_m.is_none_or(|jump_m| (distance_m - self.distance_m).abs() <= jump_m);
        if let Some(distance_m) = distance_m.filter(near) {
            (self.distance_m, self.since_s) = (distance_m, Some(0.0));
            return fit;
        }
        None
    }

    /// Least squares through the points in the fullest bin (the nearest of several) and its two neighbours.
    fn fit(&self, params: &PlParams, turned_rad: f64) -> Option<(Fit, f64)> {
        let fullest = (0..self.counts.len()).rev().max_by_key(|bin| self.counts[*bin])?;
        let (low_m, high_m) = ((fullest as f64 - 1.0) * params.bin_m, (fullest as f64 + 2.0) * params.bin_m);
        let mut sums = Sums::default();
        for (x, away) in self.x_m.iter().zip(&self.away_m) {
            if *away >= low_m && *away < high_m {
                sums.add(*x, *away);
            }
        }
        sums.wall(params, turned_rad)
    }
}

/// Sums for a least-squares line and its residuals.
#[derive(Debug, Clone, Copy)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    first_m: f64,
    last_m: f64,
}

impl Default for Sums {
    fn default() -> Self {
        let (first_m, last_m) = (f64::INFINITY, f64::NEG_INFINITY);
        Self { n: 0.0, x: 0.0, y: 0.0, xx: 0.0, xy: 0.0, yy: 0.0, first_m, last_m }
    }
}

impl Sums {
    fn add(&mut self, x: f64, y: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.first_m = self.first_m.min(x);
        self.last_m = self.last_m.max(x);
    }

    /// The wall and its distance \[m\], if its own points speak for it.
    fn wall(&self, params: &PlParams, turned_rad: f64) -> Option<(Fit, f64)> {
        if self.n < f64::from(params.min_points) || self.last_m - self.first_m < params.min_length_m {
            return None;
        }
        let (mean_x, mean_y) = (self.x / self.n, self.y / self.n);
        let spread = self.xx - self.x * mean_x;
        if spread <= 1e-9 * self.n {
            return None;
        }
        let slope = (self.xy - self.x * mean_y) / spread;
        let variance = ((self.yy - self.y * mean_y - slope * slope * spread) / self.n).max(0.0);
        let distance_m = (mean_y - slope * mean_x) / (1.0 + slope * slope).sqrt();
        let turn_rad = libm::atan(slope);
        let heading_rad = turned_rad - turn_rad;
        let good = variance <= params.max_residual_m * params.max_residual_m
            && turn_rad.abs() <= params.max_turn_rad
            && heading_rad.abs() <= params.max_heading_rad
            && distance_m > 0.0;
        good.then_some((Fit { heading_rad, slope_variance: variance / spread }, distance_m))
    }
}
