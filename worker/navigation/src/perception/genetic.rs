//! The search that the line finders `rg`, `rgop` and `rgoppn` share: a population of lines over one scan.
//!
//! Guyonneau et al. (2022), section 2.2. An iteration draws lines through outliers, fuses same lines, attaches
//! points to lines, removes lines of few points, refits, ranks by fitness and keeps the fittest.

use super::pair_energy::PairWeights;
use super::population::Population;
use super::ranking::Ranking;
use super::sampling::{Fresh, split_by_side};
use super::{Found, Line, LineFinder, Points, Scan};
use crate::random::Stream;

/// What the finders do differently, and their parameters.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rules {
    /// Neighbouring returns closer than this become one point \[m\]; none where each return is a point.
    pub(super) fuse_distance_m: Option<f64>,
    pub(super) iterations: u32,
    /// How many lines are drawn, from which points.
    pub(super) draw: Draw,
    /// Lines aimed at.
    pub(super) lines: u32,
    /// At least this many of the fittest lines stay, or a quarter if that is more.
    pub(super) keep: u32,
    /// A line of this many points or fewer is removed.
    pub(super) tiny: u32,
    /// A point belongs to its nearest line if closer than this \[m\].
    pub(super) attach_distance_m: f64,
    /// tau \[m\] and power of n in the fitness.
    pub(super) fitness_weight: f64,
    pub(super) fitness_power: u32,
    /// rho, energy of a point without a line \[m\].
    pub(super) outlier_penalty: f64,
    /// Whether the lines of the lowest energy are returned, instead of the last ones.
    pub(super) lowest_energy: bool,
    /// Passes over each scan, every one from the lines of the one before.
    pub(super) passes: u32,
}

/// How many lines are drawn, from which points.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Draw {
    /// Through any outliers, until there are as many lines as aimed at.
    FillUp,
    /// Through any outliers, until there are as many as aimed at less those that came from the last scan.
    FillUpLessKept,
    /// As many as aimed at less those that came from the last scan: half of them through outliers to the left, the
    /// rest through outliers to the right.
    HalfEachSide,
}

/// A line finder that searches by these rules.
#[derive(Debug)]
pub(super) struct GeneticFinder {
    points: Points,
    search: Genetic,
}

impl GeneticFinder {
    /// A finder that has seen no scan yet.
    pub(super) fn new(rules: Rules) -> Self {
        Self { points: Points::default(), search: Genetic::new(rules) }
    }
}

impl LineFinder for GeneticFinder {
    fn find(&mut self, scan: &Scan<'_>, random: &mut Stream) -> Found<'_> {
        match self.search.rules.fuse_distance_m {
            Some(distance_m) => self.points.read_scan_fused(scan, distance_m),
            None => self.points.read_scan(scan),
        }
        let lines = self.search.find(&self.points, random);
        Found { points: &self.points, lines }
    }
}

/// The search and its memory.
#[derive(Debug)]
struct Genetic {
    rules: Rules,
    ranking: Ranking,
    population: Population,
    best: Population,
    weights: PairWeights,
    fresh: Fresh,
    outliers: Vec<u32>,
    /// Outliers on the left, then those on the right.
    sides: Vec<u32>,
    lines: Vec<Line>,
}

impl Genetic {
    fn new(rules: Rules) -> Self {
        Self {
            ranking: Ranking::new(rules.fitness_weight, rules.fitness_power, rules.tiny),
            rules,
            population: Population::default(),
            best: Population::default(),
            weights: PairWeights::default(),
            fresh: Fresh::default(),
            outliers: Vec::new(),
            sides: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// The lines over the points of a scan, starting from those over the last one: pass by pass, best first.
    fn find(&mut self, points: &Points, random: &mut Stream) -> &[Line] {
        if self.rules.lowest_energy {
            self.weights.compute(points);
        }
        self.lines.clear();
        for _ in 0..self.rules.passes {
            self.pass(points, random);
            self.lines.extend(self.population.lines.iter());
        }
        &self.lines
    }

    fn pass(&mut self, points: &Points, random: &mut Stream) {
        let kept = self.population.lines.len();
        self.population.detach(points);
        let mut lowest = f64::INFINITY;
        for _ in 0..self.rules.iterations {
            self.draw(points, kept, random);
            self.population.lines.fuse_with(&mut self.fresh);
            self.population.attach(self.rules.attach_distance_m);
            self.select(points);
            if self.rules.lowest_energy {
                lowest = self.keep_lowest(lowest);
            }
        }
    }

    /// Draws fresh lines; `kept` is the number of lines from the last scan.
    fn draw(&mut self, points: &Points, kept: usize, random: &mut Stream) {
        let (present, aim) = (self.population.lines.len(), self.rules.lines as usize);
        self.fresh.clear();
        self.population.outliers(&mut self.outliers);
        if self.rules.draw == Draw::HalfEachSide {
            let left = split_by_side(&mut self.sides, points, self.outliers.iter().copied());
            self.fresh.draw_each_side(points, self.sides.split_at(left), aim.saturating_sub(kept), random);
        } else {
            let kept = if self.rules.draw == Draw::FillUpLessKept { kept } else { 0 };
            self.fresh.draw(points, &self.outliers, aim.saturating_sub(kept + present), random);
        }
        self.fresh.fit();
    }

    /// Refits the lines to their points and keeps the fittest.
    fn select(&mut self, points: &Points) {
        let population = &mut self.population;
        population.sum_points(points);
        for i in 0..population.lines.len() {
            if population.lines.fits[i].has_more_than(self.rules.tiny) {
                population.lines.refit(i);
            }
        }
        population.measure(points);
        population.lines.keep_fittest(&mut self.ranking, self.rules.keep as usize);
        population.follow();
    }

    /// Goes back to the best lines so far if the present ones are worse; returns the lowest energy, eq. 1.
    fn keep_lowest(&mut self, lowest: f64) -> f64 {
        let outliers = self.population.count_outliers() as f64;
        let distances_m: f64 = self.population.lines.energies.iter().sum();
        let pairs = self.weights.between_lines(&self.population.owners);
        let energy = self.rules.outlier_penalty * outliers + pairs + distances_m;
        if energy < lowest {
            self.best.copy_from(&self.population);
            energy
        } else {
            self.population.copy_from(&self.best);
            lowest
        }
    }
}
