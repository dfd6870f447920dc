//! Ruby: Pearl from the lines of the last scan, forgiving lines that have parallel ones.
//!
//! Guyonneau et al. (2022), section 2.1; steps and constants of the program behind the tables. See
//! [`pearl`](super::pearl) for the search and its deviation.

use super::pearl::{PearlParams, Search, Variant};
use super::{Found, LineFinder, Points, Scan, Selection};
use crate::random::Stream;

crate::parameters! {
    /// Parameters of [`Ruby`].
    pub struct RubyParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// A line whose points are farther from it than this on average, times the number of lines of its slope, is removed, alpha of eq. 7. Program: 0.7.
        pub bad_distance_m: f64 = 0.7, "m", [0.001, 10.0];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [0, 100];
        /// A point belongs to its nearest line if closer than this. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 10.0];
        /// Energy of a point without a line, rho of eq. 2. Program: 3.
        pub outlier_penalty: f64 = 3.0, "m", [0.0, 1000.0];
        /// Which iteration's lines are returned. Program: by a bound that only rises, `as-run`.
        pub selection: Selection = Selection::AsRun, "";
        /// Passes over each scan, every one starting from the lines of the one before. Program: 1 to 5, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

/// The line finder.
#[derive(Debug)]
pub struct Ruby {
    points: Points,
    search: Search,
}

impl Ruby {
    /// A finder that has seen no scan yet.
    #[must_use]
    pub fn new(params: RubyParams) -> Self {
        let params = PearlParams {
            iterations: params.iterations,
            bad_distance_m: params.bad_distance_m,
            tiny: params.tiny,
            attach_distance_m: params.attach_distance_m,
            outlier_penalty: params.outlier_penalty,
            selection: params.selection,
            passes_per_scan: params.passes_per_scan,
        };
        Self { points: Points::default(), search: Search::new(params, Variant::Ruby) }
    }
}

impl LineFinder for Ruby {
    fn find(&mut self, scan: &Scan<'_>, random: &mut Stream) -> Found<'_> {
        self.points.read_scan(scan);
        let lines = self.search.find(&self.points, random);
        Found { points: &self.points, lines }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::LineFinderSpec;
    use crate::perception::conformance;

    #[test]
    fn it_conforms() {
        conformance::check(&LineFinderSpec::Ruby(RubyParams::default()));
    }

    /// Over all pairs of points the pair energy outweighs the rest, and it is lowest for few lines: often one row.
    #[test]
    fn it_conforms_but_for_success_as_printed() {
        let selection = Selection::AsPrinted;
        let params = RubyParams { selection, passes_per_scan: 3, ..Default::default() };
        conformance::check_but_for_success(&LineFinderSpec::Ruby(params));
    }
}
