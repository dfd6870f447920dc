//! How likely a scan's points are, seen from a place in a lane.

use super::{Particle, ParticleFilterParams};
use crate::perception::Points;
use crate::perception::lane::thinned::Thinned;

/// The field of two rows, and the points of a scan.
#[derive(Debug, Clone)]
pub(super) struct LikelihoodField {
    thinned: Thinned,
    /// The points that count: the same for all particles, or their likelihoods could not be compared.
    points: Points,
    front_m: [f64; 2],
    side_m: f64,
    /// From a sum of squared distances \[m^2\] to a log-likelihood.
    factor: f64,
    /// Largest squared distance beyond a row and inside the lane \[m^2\].
    most_m2: [f64; 2],
}

impl LikelihoodField {
    pub(super) fn new(params: &ParticleFilterParams, lane_width_m: f64) -> Self {
        let side_m = 1.5 * lane_width_m;
        let reach_m = params.front_max_m.max(params.front_min_m.abs()).max(side_m);
        let most_m2 = [params.cut_off, params.cut_off_inside].map(|cut_off| {
            let distance_m = cut_off * params.row_sd_m;
            distance_m * distance_m
        });
        Self {
            thinned: Thinned::new(params.cell_m, reach_m),
            points: Points::default(),
            front_m: [params.front_min_m, params.front_max_m],
            side_m,
            factor: -0.5 * params.point_weight / (params.row_sd_m * params.row_sd_m),
            most_m2,
        }
    }

    /// Replaces the points by those of a scan.
    pub(super) fn take(&mut self, points: &Points) {
        self.thinned.fill(points);
        self.points.clear();
        for (x, y) in self.thinned.points.iter() {
            if x > self.front_m[0] && x < self.front_m[1] && y.abs() < self.side_m {
                self.points.push(x, y);
            }
        }
    }

    /// The log-likelihood of the points, up to a constant. In four lanes, which are added up in a fixed order.
    pub(super) fn log_likelihood(&self, particle: Particle) -> f64 {
        let (sin, cos) = libm::sincos(particle.heading_rad);
        let (offset_m, row_m) = (particle.offset_m, 0.5 * particle.width_m);
        let [beyond_m2, inside_m2] = self.most_m2;
        let square = |x: f64, y: f64| {
            let off_m = (offset_m + sin * x + cos * y).abs() - row_m;
            (off_m * off_m).min(if off_m > 0.0 { beyond_m2 } else { inside_m2 })
        };
        let (x, x_rest) = self.points.x_m.as_chunks::<4>();
        let (y, y_rest) = self.points.y_m.as_chunks::<4>();
        let mut sums = [0.0; 4];
        for (x, y) in x.iter().zip(y) {
            for lane in 0..4 {
                sums[lane] += square(x[lane], y[lane]);
            }
        }
        let rest: f64 = x_rest.iter().zip(y_rest).map(|(x, y)| square(*x, *y)).sum();
        self.factor * ((sums[0] + sums[1]) + (sums[2] + sums[3]) + rest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(points: &[(f64, f64)]) -> LikelihoodField {
        let mut field = LikelihoodField::new(&ParticleFilterParams::default(), 0.75);
        let (x_m, y_m) = points.iter().copied().unzip();
        field.take(&Points { x_m, y_m });
        field
    }

    fn at(offset_m: f64, heading_rad: f64) -> Particle {
        Particle { offset_m, heading_rad, width_m: 0.75 }
    }

    #[test]
    fn points_on_the_rows_are_the_likeliest_and_one_deviation_costs_half_its_weight() {
        let on_rows = [(1.0, 0.375), (0.5, -0.375), (2.0, 0.375)];
        assert_eq!(field(&on_rows).log_likelihood(at(0.0, 0.0)), 0.0);
        // 0.05 m to the left: all three points are one standard deviation off.
        assert!((field(&on_rows).log_likelihood(at(0.05, 0.0)) + 3.0 * 0.5 * 0.3).abs() < 1e-12);
    }

    #[test]
    fn far_points_cost_a_fixed_amount_and_more_inside_the_lane() {
        let worth = |y: f64| field(&[(1.0, y)]).log_likelihood(at(0.0, 0.0));
        assert!((worth(0.6) - worth(0.9)).abs() < 1e-12 && (worth(0.6) + 0.5 * 0.3 * 2.25).abs() < 1e-12);
        assert!((worth(0.0) + 0.5 * 0.3 * 4.0).abs() < 1e-12);
    }

    #[test]
    fn mirrored_points_are_as_likely_from_the_mirrored_place() {
        let points: Vec<(f64, f64)> = (0..23).map(|i| (0.1 * f64::from(i), 0.4 - 0.07 * f64::from(i % 11))).collect();
        let mirrored: Vec<(f64, f64)> = points.iter().map(|(x, y)| (*x, -y)).collect();
        let (plain, mirrored) = (field(&points), field(&mirrored));
        assert_eq!(plain.log_likelihood(at(0.07, 0.2)), mirrored.log_likelihood(at(-0.07, -0.2)));
    }
}
