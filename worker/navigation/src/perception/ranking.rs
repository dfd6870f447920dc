//! Fitness of lines, and their order by it.

use super::lanes::CountParallel;
use super::line::{LineFit, slope_tolerance};

/// Ranks lines by fitness, the smaller the better: (b^2 + tau E) / (n^power psi).
///
/// Guyonneau et al. (2022), eq. 10, where n is the number of a line's points, E the sum of their distances, b the
/// intercept and psi the number of lines of the same slope, the line itself included. The paper prints n; the
/// program behind the tables squares it. psi is counted anew at each ranking.
#[derive(Debug, Clone, Default)]
pub(super) struct Ranking {
    tau_m: f64,
    /// Of n: 1 or 2.
    power: u32,
    /// A line of this many points or fewer is left out.
    tiny: u32,
    /// (fitness, line), best first.
    order: Vec<(f64, u32)>,
    /// Scratch: of the lines that are not left out.
    slopes: Vec<f64>,
    tolerances: Vec<f64>,
    parallel: Vec<f64>,
}

impl Ranking {
    pub(super) fn new(tau_m: f64, power: u32, tiny: u32) -> Self {
        Self { tau_m, power, tiny, ..Self::default() }
    }

    /// (fitness, line) of the lines that are not left out, best first.
    pub(super) fn rank(
        &mut self,
        slopes: &[f64],
        intercepts_m: &[f64],
        fits: &[LineFit],
        energies: &[f64],
    ) -> &[(f64, u32)] {
        self.order.clear();
        self.slopes.clear();
        for (i, fit) in (0..).zip(fits).filter(|(_, fit)| fit.has_more_than(self.tiny)) {
            self.order.push((fit.points(), i));
            self.slopes.push(slopes[i as usize]);
        }
        self.tolerances.clear();
        self.tolerances.extend(self.slopes.iter().map(|slope| slope_tolerance(*slope)));
        self.parallel.clear();
        self.parallel.resize(self.slopes.len(), 1.0);
        CountParallel { slopes: &self.slopes, tolerances: &self.tolerances, counts: &mut self.parallel }.count();
        for ((fitness, i), parallel) in self.order.iter_mut().zip(&self.parallel) {
            let (n, b, energy) = (*fitness, intercepts_m[*i as usize], energies[*i as usize]);
            let divisor = if self.power == 1 { n } else { n * n };
            *fitness = (b * b + self.tau_m * energy) / (divisor * parallel);
        }
        self.order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        &self.order
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(points: u32) -> LineFit {
        let mut fit = LineFit::default();
        (0..points).map(f64::from).for_each(|x| fit.add(x, 0.0));
        fit
    }

    #[test]
    fn fitness_is_that_of_the_formula_and_tiny_lines_are_left_out() {
        let mut ranking = Ranking::new(10.0, 2, 3);
        let fits = [fit(4), fit(3), fit(10), fit(5)];
        let order = ranking.rank(&[0.0, 0.0, 0.05, 2.0], &[0.5, 0.5, -0.5, 1.0], &fits, &[0.1, 0.1, 0.2, 0.3]);
        // psi: lines 0 and 2 are of the same slope, line 3 is alone.
        let expected = [(2, 2.25 / (100.0 * 2.0)), (0, 1.25 / (16.0 * 2.0)), (3, 4.0 / (25.0 * 1.0))];
        assert_eq!(order.len(), 3);
        for ((fitness, line), (expected_line, expected_fitness)) in order.iter().zip(expected) {
            assert!(*line == expected_line && (fitness - expected_fitness).abs() < 1e-15, "{order:?}");
        }
    }

    #[test]
    fn the_printed_fitness_does_not_square_n() {
        let mut ranking = Ranking::new(10.0, 1, 3);
        assert_eq!(ranking.rank(&[0.0], &[1.0], &[fit(4)], &[0.3]), [(1.0, 0)]);
    }
}
