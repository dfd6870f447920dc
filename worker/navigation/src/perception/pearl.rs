//! Pearl: lines through random outliers, merged, refitted and judged by their energy, from nothing at each scan.
//!
//! Guyonneau et al. (2022), section 2.1 (algorithm 1), after Isack and Boykov's PEARL; steps and constants of the
//! program behind the tables. The search is shared with [`ruby`](super::ruby).
//!
//! Deviation: algorithm 1 starts from an infinite energy and goes back to the last lines when the energy rises.
//! The program starts from the energy of a first set of lines, and its bound only rises: after a worse set it goes
//! back to the best lines, but takes the worse energy as the new bound. `selection` chooses.

use super::line::{LineFit, same_slope};
use super::pair_energy::PairWeights;
use super::population::Population;
use super::{Found, Line, LineFinder, Points, Scan, Selection};
use crate::random::Stream;

crate::parameters! {
    /// Parameters of the line finder `pearl`.
    pub struct PearlParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// A line is removed if the mean distance of its points reaches this, alpha of eq. 7. Program: 0.7.
        pub bad_distance_m: f64 = 0.7, "m", [0.001, 10.0];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [1, 100];
        /// A point belongs to its nearest line if closer than this. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 10.0];
        /// Energy of a point without a line, rho of eq. 2. Program: 3.
        pub outlier_penalty: f64 = 3.0, "m", [0.0, 1000.0];
        /// Which iteration's lines are returned. Program: by a bound that only rises, `as-run`.
        pub selection: Selection = Selection::AsRun, "";
        /// Passes over each scan, every one from nothing. Program: 1 or 2, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

impl From<&PearlParams> for Rules {
    fn from(params: &PearlParams) -> Self {
        Self { variant: Variant::Pearl, params: params.clone() }
    }
}

/// What the two finders do differently, and the parameters of both.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rules {
    pub(super) variant: Variant,
    pub(super) params: PearlParams,
}

/// What the two finders do differently.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Variant {
    /// Starts from nothing at each pass.
    Pearl,
    /// Starts from the lines of the last pass, and forgives lines that have others of the same slope (eq. 7).
    Ruby,
}

/// An outlier in this many gives a line: half of them are used up, three each.
const OUTLIERS_PER_LINE: usize = 6;

/// A line finder that searches by these rules.
#[derive(Debug)]
pub(super) struct PearlFinder {
    points: Points,
    search: Search,
}

impl PearlFinder {
    /// A finder that has seen no scan yet.
    pub(super) fn new(rules: Rules) -> Self {
        Self { points: Points::default(), search: Search::new(rules) }
    }
}

impl LineFinder for PearlFinder {
    fn find(&mut self, scan: &Scan<'_>, random: &mut Stream) -> Found<'_> {
        self.points.read_scan(scan);
        let lines = self.search.find(&self.points, random);
        Found { points: &self.points, lines }
    }
}

/// The search and its memory.
#[derive(Debug)]
struct Search {
    params: PearlParams,
    variant: Variant,
    population: Population,
    best: Population,
    weights: PairWeights,
    outliers: Vec<u32>,
    lines: Vec<Line>,
}

impl Search {
    fn new(Rules { params, variant }: Rules) -> Self {
        Self {
            params,
            variant,
            population: Population::default(),
            best: Population::default(),
            weights: PairWeights::default(),
            outliers: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// The lines over the points of a scan, pass by pass.
    fn find(&mut self, points: &Points, random: &mut Stream) -> &[Line] {
        self.weights.compute(points);
        self.lines.clear();
        for _ in 0..self.params.passes_per_scan {
            self.pass(points, random);
            let lines = &self.population.lines;
            let with_points = (0..lines.len()).filter(|i| lines.fits[*i].points() >= 2.0);
            self.lines.extend(with_points.map(|i| lines.line(i)));
        }
        &self.lines
    }

    fn pass(&mut self, points: &Points, random: &mut Stream) {
        if self.variant == Variant::Pearl {
            self.population.lines.clear();
        }
        self.population.detach(points);
        if points.len() < OUTLIERS_PER_LINE {
            return;
        }
        let mut bound = match self.params.selection {
            Selection::AsRun => self.begin(points, random),
            Selection::AsPrinted => f64::INFINITY,
        };
        for _ in 0..self.params.iterations {
            self.draw(points, random);
            self.population.lines.fuse();
            self.population.follow();
            self.remove_bad(points);
            self.attach(points);
            let energy = self.energy();
            bound = self.accept(energy, bound);
        }
    }

    /// The first lines, through half of the points, those with most points kept; returns their energy.
    ///
    /// As the program does, it adds up the pair energy before it lets go of small lines.
    fn begin(&mut self, points: &Points, random: &mut Stream) -> f64 {
        let drawn = self.draw(points, random);
        self.attach(points);
        let pairs = self.weights.between_lines(&self.population.owners);
        self.remove_tiny((1.5 * drawn as f64).floor());
        self.best.copy_from(&self.population);
        pairs + self.energy_of_points()
    }

    /// Draws a line through every six outliers, three each, which become its points; returns how many.
    fn draw(&mut self, points: &Points, random: &mut Stream) -> usize {
        self.population.outliers(&mut self.outliers);
        let drawn = self.outliers.len() / OUTLIERS_PER_LINE;
        for _ in 0..drawn {
            let three = [(); 3].map(|()| {
                let pick = random.below(self.outliers.len() as u32);
                self.outliers.swap_remove(pick as usize) as usize
            });
            let mut fit = LineFit::default();
            three.iter().for_each(|point| fit.add(points.x_m[*point], points.y_m[*point]));
            if let Some(line) = fit.line() {
                three.iter().for_each(|point| self.population.owners[*point] = self.population.lines.len() as u32);
                self.population.lines.push(line, fit);
            }
        }
        drawn
    }

    /// Refits every line to its points and removes those that are too far from them, eq. 7. Points are attached
    /// anew next, so those of lines that are gone need not be told.
    fn remove_bad(&mut self, points: &Points) {
        (0..self.population.lines.len()).for_each(|i| self.population.lines.refit(i));
        self.population.measure(points);
        let (limit_m, variant) = (self.params.bad_distance_m, self.variant);
        self.population.lines.retain(|lines, i| {
            let same = |j: usize| j != i && same_slope(lines.slopes[i.min(j)], lines.slopes[i.max(j)]);
            let parallel = match variant {
                Variant::Pearl => 1,
                Variant::Ruby => 1 + (0..lines.len()).filter(|j| same(*j)).count(),
            };
            lines.energies[i] < limit_m * lines.fits[i].points() * parallel as f64 || lines.fits[i].points() == 0.0
        });
    }

    /// Attaches all points anew and removes lines of few points.
    fn attach(&mut self, points: &Points) {
        self.population.attach(self.params.attach_distance_m);
        self.population.sum_points(points);
        self.remove_tiny(f64::from(self.params.tiny));
    }

    fn remove_tiny(&mut self, points: f64) {
        self.population.lines.retain(|lines, i| lines.fits[i].points() > points);
        self.population.follow();
    }

    /// Eq. 1. The lines are not refitted after points have been attached to them.
    fn energy(&self) -> f64 {
        self.weights.between_lines(&self.population.owners) + self.energy_of_points()
    }

    /// Outliers and distances, eqs. 2 and 6; a line without points adds nothing.
    fn energy_of_points(&self) -> f64 {
        let outliers = self.population.count_outliers() as f64;
        self.params.outlier_penalty * outliers + self.population.attached_energy_m()
    }

    /// Keeps the present lines or goes back to the best ones; returns the new bound.
    fn accept(&mut self, energy: f64, bound: f64) -> f64 {
        if energy > bound {
            self.population.copy_from(&self.best);
        } else {
            self.best.copy_from(&self.population);
        }
        match self.params.selection {
            Selection::AsRun => bound.max(energy),
            Selection::AsPrinted => bound.min(energy),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::LineFinderSpec;
    use crate::perception::conformance;

    #[test]
    fn it_conforms() {
        conformance::check(&LineFinderSpec::Pearl(PearlParams::default()));
    }

    /// Over all pairs of points the pair energy outweighs the rest, and it is lowest for few lines: often one row.
    #[test]
    fn it_conforms_but_for_success_as_printed() {
        let selection = Selection::AsPrinted;
        let params = PearlParams { selection, passes_per_scan: 3, ..Default::default() };
        conformance::check_but_for_success(&LineFinderSpec::Pearl(params));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("pearl");
    }
}
