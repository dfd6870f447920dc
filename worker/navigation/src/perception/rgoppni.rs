//! Ruby genetic one point, positive, negative and infinity: a point may belong to any number of lines.
//!
//! Guyonneau et al. (2022), section 2.2.4; constants of the program behind their tables. Lines are drawn as in
//! [`rgoppn`](super::rgoppn), but through all points and not only through outliers, of which there are none here.

use super::candidates::{Candidates, GONE};
use super::line::LineFit;
use super::overlap::Band;
use super::pair_energy::PairWeights;
use super::ranking::Ranking;
use super::sampling::{Fresh, split_by_side};
use super::{Found, Line, LineFinder, Points, Scan, Selection};
use crate::random::Stream;

crate::parameters! {
    /// Parameters of [`Rgoppni`].
    pub struct RgoppniParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// Lines to draw in an iteration, one less for each that is kept from the scan before. Program: 40.
        pub lines: u32 = 40, "1", [1, 64];
        /// At least this many of the fittest lines stay, or a quarter if that is more. Program: 6.
        pub keep: u32 = 6, "1", [1, 64];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [1, 100];
        /// A point belongs to every line closer than this. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 10.0];
        /// Neighbouring returns closer than this become one point. Program: 0.05.
        pub fuse_distance_m: f64 = 0.05, "m", [0.0, 10.0];
        /// Weight of the distances against the squared intercept in the fitness, tau of eq. 10. Program: 10.
        pub fitness_weight: f64 = 10.0, "m", [0.0, 1000.0];
        /// Power of the number of points in the fitness. Program: 2; eq. 10 prints 1.
        pub fitness_power: u32 = 2, "1", [1, 2];
        /// Which iteration's lines are returned. Program: the last one's, `as-run`.
        pub selection: Selection = Selection::AsRun, "";
        /// Passes over each scan, every one starting from the lines of the one before. Program: 3 to 6, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

/// The line finder.
#[derive(Debug)]
pub struct Rgoppni {
    params: RgoppniParams,
    points: Points,
    candidates: Candidates,
    best: Candidates,
    ranking: Ranking,
    fresh: Fresh,
    weights: PairWeights,
    /// All points, those to the left first.
    by_side: Vec<u32>,
    /// How many of them are on the left.
    left: usize,
    /// The points of each line before its last fit.
    bands: Vec<Band>,
    /// Scratch: the lines of each point, a bit each.
    masks: Vec<u64>,
    lines: Vec<Line>,
}

impl Rgoppni {
    /// A finder that has seen no scan yet.
    #[must_use]
    pub fn new(params: RgoppniParams) -> Self {
        Self {
            ranking: Ranking::new(params.fitness_weight, params.fitness_power, params.tiny),
            params,
            points: Points::default(),
            candidates: Candidates::default(),
            best: Candidates::default(),
            fresh: Fresh::default(),
            weights: PairWeights::default(),
            by_side: Vec::new(),
            left: 0,
            bands: Vec::new(),
            masks: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// One search from the lines of the last one.
    fn pass(&mut self, random: &mut Stream) {
        let lines = (self.params.lines as usize).saturating_sub(self.candidates.len());
        let mut lowest = f64::INFINITY;
        for _ in 0..self.params.iterations {
            self.fresh.clear();
            let sides = self.by_side.split_at(self.left);
            self.fresh.draw_each_side(&self.points, sides, lines, random);
            self.fresh.fit();
            self.candidates.detach();
            self.candidates.fuse_with(&mut self.fresh);
            self.fit_to_bands();
            self.candidates.keep_fittest(&mut self.ranking, self.params.keep as usize);
            if self.params.selection == Selection::AsPrinted {
                lowest = self.keep_lowest(lowest);
            }
        }
    }

    /// Gives every line all points in the band around it, refits it, and sums their distances.
    fn fit_to_bands(&mut self) {
        self.bands.clear();
        self.bands.extend(self.candidates.iter().map(|line| Band::new(line, self.params.attach_distance_m)));
        for (i, band) in self.bands.iter().enumerate() {
            self.candidates.fits[i] = LineFit::from_sums(band.moments(&self.points));
            if self.candidates.fits[i].has_more_than(self.params.tiny) {
                self.candidates.refit(i);
                self.candidates.energies[i] = band.distances_m(&self.points, self.candidates.line(i));
            }
        }
    }

    /// Goes back to the best lines so far if the present ones are worse; returns the lowest energy.
    fn keep_lowest(&mut self, lowest: f64) -> f64 {
        let energy = self.energy();
        if energy < lowest {
            self.best.copy_from(&self.candidates);
            energy
        } else {
            self.candidates.copy_from(&self.best);
            lowest
        }
    }

    /// Eq. 1 without outliers; the kept lines' points are those of the bands before their last fit.
    fn energy(&mut self) -> f64 {
        self.masks.clear();
        self.masks.resize(self.points.len(), 0);
        let moved = self.bands.iter().zip(self.candidates.moved());
        for (band, kept) in moved.filter(|(_, kept)| **kept != GONE) {
            // At most 64 lines are kept: the largest `keep`, or a quarter of all.
            debug_assert!(*kept < 64);
            for ((x, y), mask) in self.points.iter().zip(&mut self.masks) {
                *mask |= u64::from(band.holds(x, y)) << kept;
            }
        }
        self.candidates.energies.iter().sum::<f64>() + self.weights.between_overlapping(&self.masks)
    }
}

impl LineFinder for Rgoppni {
    fn find(&mut self, scan: &Scan<'_>, random: &mut Stream) -> Found<'_> {
        self.points.read_scan_fused(scan, self.params.fuse_distance_m);
        self.left = split_by_side(&mut self.by_side, &self.points, 0..self.points.len() as u32);
        if self.params.selection == Selection::AsPrinted {
            self.weights.compute(&self.points);
        }
        self.lines.clear();
        for _ in 0..self.params.passes_per_scan {
            self.pass(random);
            self.lines.extend(self.candidates.iter());
        }
        Found { points: &self.points, lines: &self.lines }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::LineFinderSpec;
    use crate::perception::conformance;

    #[test]
    fn it_conforms() {
        conformance::check(&LineFinderSpec::Rgoppni(RgoppniParams::default()));
    }

    #[test]
    fn it_conforms_as_printed_and_with_several_passes() {
        let selection = Selection::AsPrinted;
        let params = RgoppniParams { selection, passes_per_scan: 3, ..Default::default() };
        conformance::check(&LineFinderSpec::Rgoppni(params));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("rgoppni");
    }
}
