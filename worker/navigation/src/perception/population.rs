//! Candidate lines and the points of one scan, each of which belongs to one line or to none.

use super::Points;
use super::candidates::{Candidates, GONE};
use super::lanes::{NearestLines, from_whole, to_whole};
use super::line::{LineFit, slant};

/// The owner of a point that belongs to no line.
pub(super) const OUTLIER: u32 = GONE;

/// Lines and which points belong to them.
#[derive(Debug, Default)]
pub(super) struct Population {
    pub(super) lines: Candidates,
    /// Line of each point, or [`OUTLIER`].
    pub(super) owners: Vec<u32>,
    /// Distance of each point to its line when it was attached \[m\]; what it may be at most for an outlier.
    nearest_m: Vec<f32>,
    /// Coordinates of the points in single precision \[m\].
    x_m: Vec<f32>,
    y_m: Vec<f32>,
    /// Scratch: slope, 1 and intercept of each line, divided by its slant, and its index.
    normals: Vec<[f32; 4]>,
    /// Scratch: line of each point.
    numbers: Vec<f32>,
    /// Scratch: sums over the points of each line, then of the outliers.
    sums: Vec<[f64; 5]>,
    distances_m: Vec<f64>,
}

impl Population {
    /// Takes over the lines of `other` and whose each point is.
    pub(super) fn copy_from(&mut self, other: &Self) {
        self.lines.copy_from(&other.lines);
        self.owners.clone_from(&other.owners);
    }

    /// Forgets the points of the last scan and keeps the lines; all of `points` are outliers now.
    pub(super) fn detach(&mut self, points: &Points) {
        self.lines.detach();
        self.owners.clear();
        self.owners.resize(points.len(), OUTLIER);
        points.in_single_precision(&mut self.x_m, &mut self.y_m);
    }

    /// Collects the points that belong to no line, in order.
    pub(super) fn outliers(&self, outliers: &mut Vec<u32>) {
        // Without a branch: which points these are is hard to predict.
        outliers.resize(self.owners.len(), 0);
        let mut n = 0;
        for (i, owner) in (0..).zip(&self.owners) {
            outliers[n] = i;
            n += usize::from(*owner == OUTLIER);
        }
        outliers.truncate(n);
    }

    /// How many points belong to no line.
    pub(super) fn count_outliers(&self) -> usize {
        self.owners.iter().map(|owner| usize::from(*owner == OUTLIER)).sum()
    }

    /// Gives each point to its nearest line if that is closer than `distance_m`; the first line wins ties.
    pub(super) fn attach(&mut self, distance_m: f64) {
        self.normals.clear();
        self.normals.extend((0..).zip(self.lines.iter()).map(|(i, line)| {
            let scale = 1.0 / line.slant();
            [(line.slope * scale) as f32, scale as f32, (line.intercept_m * scale) as f32, from_whole(i)]
        }));
        self.nearest_m.clear();
        self.nearest_m.resize(self.x_m.len(), distance_m as f32);
        self.numbers.clear();
        self.numbers.resize(self.x_m.len(), from_whole(OUTLIER));
        let (nearest_m, numbers) = (&mut self.nearest_m, &mut self.numbers);
        NearestLines { lines: &self.normals, x_m: &self.x_m, y_m: &self.y_m, nearest_m, numbers }.find();
        self.owners.clear();
        self.owners.extend(self.numbers.iter().map(|number| to_whole(*number)));
    }

    /// Sums up the points of each line, for a fit.
    pub(super) fn sum_points(&mut self, points: &Points) {
        let n = self.lines.len();
        self.sums.clear();
        self.sums.resize(n + 1, [0.0; 5]);
        for ((x, y), owner) in points.iter().zip(&self.owners) {
            let sums = &mut self.sums[(*owner as usize).min(n)];
            for (sum, term) in sums.iter_mut().zip([1.0, x, y, x * x, x * y]) {
                *sum += term;
            }
        }
        for (fit, sums) in self.lines.fits.iter_mut().zip(&self.sums) {
            *fit = LineFit::from_sums(*sums);
        }
    }

    /// Sums the orthogonal distances of each line's points.
    pub(super) fn measure(&mut self, points: &Points) {
        let n = self.lines.len();
        self.distances_m.clear();
        self.distances_m.resize(n, 0.0);
        for ((x, y), owner) in points.iter().zip(&self.owners) {
            let i = *owner as usize;
            if i < n {
                self.distances_m[i] += (self.lines.slopes[i] * x - y + self.lines.intercepts_m[i]).abs();
            }
        }
        for ((energy, slope), distance_m) in
            self.lines.energies.iter_mut().zip(&self.lines.slopes).zip(&self.distances_m)
        {
            *energy = distance_m / slant(*slope);
        }
    }

    /// Follows the last change of the lines; the points of lines that are gone become outliers.
    pub(super) fn follow(&mut self) {
        let moved = self.lines.moved();
        for owner in &mut self.owners {
            *owner = moved.get(*owner as usize).copied().unwrap_or(OUTLIER);
        }
    }

    /// Sum of the distances of all points to the lines that they have just been attached to \[m\].
    pub(super) fn attached_energy_m(&self) -> f64 {
        let inliers = self.owners.iter().zip(&self.nearest_m).filter(|(owner, _)| **owner != OUTLIER);
        inliers.map(|(_, distance_m)| f64::from(*distance_m)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::Line;

    fn two_rows() -> Points {
        let mut points = Points::default();
        for i in 0..12 {
            points.push(0.3 * f64::from(i), if i % 2 == 0 { 0.5 } else { -0.5 });
        }
        points
    }

    fn with_lines(points: &Points, lines: &[(f64, f64)]) -> Population {
        let mut population = Population::default();
        population.detach(points);
        for (slope, intercept) in lines {
            population.lines.push(Line::new(*slope, *intercept), LineFit::default());
        }
        population
    }

    #[test]
    fn points_go_to_their_nearest_line_and_far_ones_to_none() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.6), (0.0, 0.45)]);
        population.attach(0.2);
        assert_eq!(population.owners[..2], [1, OUTLIER]);
        assert!((population.attached_energy_m() - 6.0 * 0.05).abs() < 1e-6);
    }

    #[test]
    fn sums_and_distances_are_those_of_each_lines_points() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.45), (0.0, -0.6)]);
        population.attach(0.2);
        population.sum_points(&points);
        population.measure(&points);
        assert!(
            (population.lines.energies[0] - 0.3).abs() < 1e-12 && (population.lines.energies[1] - 0.6).abs() < 1e-12
        );
        population.lines.refit(1);
        let line = population.lines.line(1);
        assert!(population.lines.fits[1].points() == 6.0);
        assert!(line.slope.abs() < 1e-12 && (line.intercept_m + 0.5).abs() < 1e-12);
    }

    #[test]
    fn points_of_lines_that_are_gone_become_outliers() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.5), (0.0, -0.5)]);
        population.attach(0.2);
        population.lines.retain(|_, i| i == 1);
        population.follow();
        assert_eq!(population.owners[..3], [OUTLIER, 0, OUTLIER]);
        let mut outliers = Vec::new();
        population.outliers(&mut outliers);
        assert_eq!(outliers, [0, 2, 4, 6, 8, 10]);
        assert_eq!(population.count_outliers(), 6);
    }
}
