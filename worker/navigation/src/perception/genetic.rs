//! What the genetic line finders share: a population of lines over the points of one scan.
//!
//! Guyonneau et al. (2022), sections 2.1 and 2.2. An iteration samples lines from outliers, fuses same lines,
//! attaches points to lines, removes lines of few points, refits, ranks by fitness and keeps the best.

use super::Points;
use super::line::{Line, LineFit, same_line, same_slope, slant};
use crate::random::Stream;

/// A population holds at most this many lines.
pub(super) const CAPACITY: usize = 64;

/// The owner of a point that belongs to no line.
const OUTLIER: u64 = u64::MAX;

/// Pair energy: weight of a pair of points in different lines, times exp(-distance^2 / [`PAIR_RANGE_M2`]).
/// Equations 3 and 5, lambda = 4 and zeta = 3 m.
const PAIR_WEIGHT: f64 = 4.0;
const PAIR_RANGE_M2: f64 = 9.0;

/// Lines and which points belong to them.
#[derive(Debug, Clone)]
pub(super) struct Population {
    lines: Vec<Line>,
    /// Points per line.
    counts: Vec<u32>,
    /// Sum of orthogonal distances of each line's points \[m\], eq. 6.
    energies: Vec<f64>,
    /// Line of each point, or [`OUTLIER`].
    owners: Vec<u64>,
    /// Scratch: each point's smallest distance so far; a permutation; fits per line; names before a fuse pass.
    nearest: Vec<f64>,
    order: Vec<(f64, u64)>,
    fits: Vec<LineFit>,
    names: Vec<u64>,
    outliers: Vec<u32>,
}

impl Population {
    pub(super) fn new() -> Self {
        Self {
            lines: Vec::with_capacity(CAPACITY),
            counts: Vec::with_capacity(CAPACITY),
            energies: Vec::with_capacity(CAPACITY),
            owners: Vec::new(),
            nearest: Vec::new(),
            order: Vec::with_capacity(CAPACITY),
            fits: Vec::with_capacity(CAPACITY),
            names: Vec::with_capacity(CAPACITY),
            outliers: Vec::new(),
        }
    }

    pub(super) fn lines(&self) -> &[Line] {
        &self.lines
    }

    /// Forgets the points of the last scan and keeps the lines; all of `points` are outliers now.
    pub(super) fn detach(&mut self, points: &Points) {
        self.counts.fill(0);
        self.owners.clear();
        self.owners.resize(points.len(), OUTLIER);
    }

    /// Fills up to `target` lines, each the fit of three distinct random outliers, which stay outliers.
    pub(super) fn sample(&mut self, points: &Points, target: usize, random: &mut Stream) {
        if self.lines.len() >= target {
            return;
        }
        self.outliers.clear();
        self.outliers.extend((0..).zip(&self.owners).filter(|(_, owner)| **owner == OUTLIER).map(|(i, _)| i));
        if self.outliers.len() < 3 {
            return;
        }
        for _ in self.lines.len()..target {
            let mut fit = LineFit::default();
            for pick in three_distinct(self.outliers.len() as u32, random) {
                let point = self.outliers[pick as usize] as usize;
                fit.add(points.x_m[point], points.y_m[point]);
            }
            if let Some(line) = fit.line() {
                self.lines.push(line);
                self.counts.push(0);
            }
        }
    }

    /// Merges same lines: the one with fewer points into the other, then refit; ties go to the earlier one.
    pub(super) fn fuse(&mut self, points: &Points) {
        self.names.clear();
        self.names.extend(0..self.lines.len() as u64);
        let mut i = 0;
        while i < self.lines.len() {
            i = self.fuse_from(i, points);
        }
    }

    /// Compares line `i` with all later ones; returns where to go on.
    ///
    /// When line `i` loses to a later one, its predecessor is compared with the lines after the winner, as in
    /// the program behind the tables.
    fn fuse_from(&mut self, mut i: usize, points: &Points) -> usize {
        let mut j = i + 1;
        while j < self.lines.len() {
            if !same_line(self.lines[i], self.lines[j]) {
                j += 1;
            } else if self.counts[i] >= self.counts[j] {
                self.absorb(i, j, points);
            } else {
                self.absorb(j, i, points);
                if i == 0 {
                    return 0;
                }
                i -= 1;
                j += 1;
            }
        }
        i + 1
    }

    /// Moves the points of `loser` to `winner`, refits it if there are any, and removes `loser`.
    fn absorb(&mut self, winner: usize, loser: usize, points: &Points) {
        if self.counts[loser] > 0 {
            let (to, from) = (self.names[winner], self.names[loser]);
            let mut fit = LineFit::default();
            for ((x, y), owner) in points.iter().zip(&mut self.owners) {
                if *owner == from {
                    *owner = to;
                }
                if *owner == to {
                    fit.add(x, y);
                }
            }
            self.counts[winner] += self.counts[loser];
            self.lines[winner] = fit.line().unwrap_or(self.lines[winner]);
        }
        self.lines.remove(loser);
        self.counts.remove(loser);
        self.names.remove(loser);
    }

    /// Gives each point to its nearest line if that is closer than `distance_m`; the first line wins ties.
    pub(super) fn attach(&mut self, points: &Points, distance_m: f64) {
        self.nearest.clear();
        self.nearest.resize(points.len(), distance_m);
        self.owners.fill(OUTLIER);
        for (line, index) in self.lines.iter().zip(0_u64..) {
            let scale = 1.0 / line.slant();
            let (a, b) = (line.slope * scale, line.intercept_m * scale);
            let coordinates = points.x_m.iter().zip(&points.y_m);
            for ((x, y), (nearest, owner)) in coordinates.zip(self.nearest.iter_mut().zip(&mut self.owners)) {
                let distance = (a * x - scale * y + b).abs();
                let closer = distance < *nearest;
                *nearest = if closer { distance } else { *nearest };
                *owner = if closer { index } else { *owner };
            }
        }
    }

    /// Removes lines of `tiny` points or fewer, refits the others to their points, ranks them by fitness and
    /// keeps the best: a quarter of them, but at least `keep`. Points of removed lines become outliers.
    ///
    /// Fitness is (b^2 + `tau` E) / (n^`power` psi), the smaller the better; psi counts the lines of the same slope,
    /// this one included (eq. 10 prints n; the program behind the tables squares it).
    pub(super) fn select(&mut self, points: &Points, tiny: u32, keep: usize, tau: f64, power: u32) {
        self.refit(points, tiny);
        self.measure(points);
        self.rank(tau, power);
        let kept = (self.order.len() / 4).max(keep).min(self.order.len());
        self.order.truncate(kept);
        self.keep_ranked();
    }

    /// Fits every line of more than `tiny` points to its points; the others' count becomes 0.
    fn refit(&mut self, points: &Points, tiny: u32) {
        self.fits.clear();
        self.fits.resize(self.lines.len(), LineFit::default());
        self.counts.fill(0);
        for ((x, y), owner) in points.iter().zip(&self.owners) {
            if *owner != OUTLIER {
                self.fits[*owner as usize].add(x, y);
                self.counts[*owner as usize] += 1;
            }
        }
        for ((line, count), fit) in self.lines.iter_mut().zip(&mut self.counts).zip(&self.fits) {
            if *count <= tiny {
                *count = 0;
            } else if let Some(fitted) = fit.line() {
                *line = fitted;
            }
        }
    }

    /// Sums the orthogonal distances of each line's points.
    fn measure(&mut self, points: &Points) {
        self.energies.clear();
        self.energies.resize(self.lines.len(), 0.0);
        for ((x, y), owner) in points.iter().zip(&self.owners) {
            if *owner != OUTLIER {
                let line = &self.lines[*owner as usize];
                self.energies[*owner as usize] += (line.slope * x - y + line.intercept_m).abs();
            }
        }
        for (energy, line) in self.energies.iter_mut().zip(&self.lines) {
            *energy /= slant(line.slope);
        }
    }

    /// Puts (fitness, line) of every line with points into `order`, best first.
    fn rank(&mut self, tau: f64, power: u32) {
        self.order.clear();
        for (i, line) in self.lines.iter().enumerate().filter(|(i, _)| self.counts[*i] > 0) {
            let n = f64::from(self.counts[i]);
            let weight = if power == 1 { n } else { n * n };
            let numerator = line.intercept_m * line.intercept_m + tau * self.energies[i];
            self.order.push((numerator / (weight * f64::from(self.parallel(i))), i as u64));
        }
        self.order.sort_by(|a, b| a.0.total_cmp(&b.0));
    }

    /// Lines with points and of the same slope as line `i`, itself included.
    fn parallel(&self, i: usize) -> u32 {
        let same = |j: usize| same_slope(self.lines[i.min(j)].slope, self.lines[i.max(j)].slope);
        1 + (0..self.lines.len()).map(|j| u32::from(j != i && self.counts[j] > 0 && same(j))).sum::<u32>()
    }

    /// Keeps the lines in `order`, in that order.
    fn keep_ranked(&mut self) {
        let mut new_index = [OUTLIER; CAPACITY];
        let mut kept = [(Line::default(), 0, 0.0); CAPACITY];
        for (rank, (_, old)) in self.order.iter().enumerate() {
            let old = *old as usize;
            new_index[old] = rank as u64;
            kept[rank] = (self.lines[old], self.counts[old], self.energies[old]);
        }
        self.lines.clear();
        self.counts.clear();
        self.energies.clear();
        for (line, count, energy) in &kept[..self.order.len()] {
            self.lines.push(*line);
            self.counts.push(*count);
            self.energies.push(*energy);
        }
        for owner in self.owners.iter_mut().filter(|owner| **owner != OUTLIER) {
            *owner = new_index[*owner as usize];
        }
    }

    /// The energy of the whole, eq. 1: outliers, pairs of points in different lines, distances.
    ///
    /// Deviation: the paper's neighbourhood is all pairs here, as in the program behind the tables.
    pub(super) fn energy(&self, weights: &PairWeights, outlier_penalty: f64) -> f64 {
        let outliers = self.owners.iter().filter(|owner| **owner == OUTLIER).count() as f64;
        outlier_penalty * outliers + self.energies.iter().sum::<f64>() + weights.between_lines(&self.owners)
    }
}

fn three_distinct(n: u32, random: &mut Stream) -> [u32; 3] {
    let first = random.below(n);
    let mut second = random.below(n);
    while second == first {
        second = random.below(n);
    }
    let mut third = random.below(n);
    while third == first || third == second {
        third = random.below(n);
    }
    [first, second, third]
}

/// The weights exp(-distance^2 / 9) of all pairs of points of a scan, eq. 5: computed once per scan.
#[derive(Debug, Clone, Default)]
pub(super) struct PairWeights {
    /// Row by row, the pairs (i, j) with j < i.
    weights: Vec<f64>,
}

impl PairWeights {
    pub(super) fn compute(&mut self, points: &Points) {
        self.weights.clear();
        for (i, (x, y)) in points.iter().enumerate() {
            self.weights.extend(points.iter().take(i).map(|(other_x, other_y)| {
                let (dx, dy) = (x - other_x, y - other_y);
                libm::exp(-(dx * dx + dy * dy) / PAIR_RANGE_M2)
            }));
        }
    }

    /// Pair energy, eq. 3: over all pairs of points that belong to two different lines.
    fn between_lines(&self, owners: &[u64]) -> f64 {
        let mut rows = self.weights.as_slice();
        let mut sum = 0.0;
        for (i, owner) in owners.iter().enumerate() {
            let (row, rest) = rows.split_at(i);
            rows = rest;
            for (weight, other) in row.iter().zip(owners) {
                let apart = (*owner != OUTLIER) & (*other != OUTLIER) & (owner != other);
                sum += if apart { *weight } else { 0.0 };
            }
        }
        PAIR_WEIGHT * sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_rows() -> Points {
        let mut points = Points::default();
        for i in 0..12 {
            points.push(0.3 * f64::from(i), if i % 2 == 0 { 0.5 } else { -0.5 });
        }
        points
    }

    fn with_lines(points: &Points, lines: &[(f64, f64)]) -> Population {
        let mut population = Population::new();
        population.detach(points);
        for (slope, intercept) in lines {
            population.lines.push(Line::new(*slope, *intercept));
            population.counts.push(0);
        }
        population
    }

    #[test]
    fn points_go_to_their_nearest_line_and_far_ones_to_none() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.6), (0.0, 0.45)]);
        population.attach(&points, 0.2);
        assert_eq!(population.owners[0], 1);
        assert_eq!(population.owners[1], OUTLIER);
    }

    #[test]
    fn same_lines_fuse_and_others_stay() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.5), (0.05, 0.6), (0.0, -0.5), (0.02, 0.4)]);
        population.fuse(&points);
        assert_eq!(population.lines, [Line::new(0.0, 0.5), Line::new(0.0, -0.5)]);
    }

    #[test]
    fn a_line_with_points_wins_over_an_earlier_one_without() {
        let points = two_rows();
        let mut population = with_lines(&points, &[(0.0, 0.6), (0.0, 0.5)]);
        population.owners[0] = 1;
        population.counts[1] = 1;
        population.fuse(&points);
        assert_eq!(population.lines, [Line::new(0.0, 0.5)]);
    }

    #[test]
    fn selection_refits_ranks_and_lets_tiny_lines_go() {
        let mut points = two_rows();
        points.push(1.0, 3.0);
        let mut population = with_lines(&points, &[(0.0, 3.0), (0.01, -0.52), (0.0, 0.48)]);
        population.attach(&points, 0.2);
        population.select(&points, 3, 4, 10.0, 2);
        let intercepts: Vec<f64> = population.lines.iter().map(|line| (line.intercept_m * 1e9).round() / 1e9).collect();
        assert_eq!(intercepts.len(), 2);
        assert!(intercepts.contains(&0.5) && intercepts.contains(&-0.5));
        assert_eq!(population.owners[12], OUTLIER);
    }

    #[test]
    fn the_energy_counts_outliers_distances_and_pairs_across_lines() {
        let mut points = Points::default();
        for (x, y) in [(0.0, 0.1), (0.0, -0.9), (5.0, 9.0)] {
            points.push(x, y);
        }
        let mut weights = PairWeights::default();
        weights.compute(&points);
        let mut population = with_lines(&points, &[(0.0, 0.0), (0.0, -1.0)]);
        population.attach(&points, 0.2);
        population.measure(&points);
        let expected = 3.0 + 0.2 + 4.0 * libm::exp(-1.0 / 9.0);
        assert!((population.energy(&weights, 3.0) - expected).abs() < 1e-12);
    }
}
