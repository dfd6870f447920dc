//! Ruby genetic: a population of lines searched over all points, the lines of the lowest energy kept.
//!
//! Guyonneau et al. (2022), section 2.2.1; constants of the program behind their tables.

use super::Selection;
use super::genetic::{Draw, Rules};

crate::parameters! {
    /// Parameters of the line finder `rg`.
    pub struct RgParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// Lines to fill up to. Program: 40.
        pub lines: u32 = 40, "1", [1, 64];
        /// At least this many of the fittest lines stay, or a quarter if that is more. Program: 6.
        pub keep: u32 = 6, "1", [1, 64];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [1, 100];
        /// A point belongs to its nearest line if closer than this. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 10.0];
        /// Weight of the distances against the squared intercept in the fitness, tau of eq. 10. Program: 10.
        pub fitness_weight: f64 = 10.0, "m", [0.0, 1000.0];
        /// Power of the number of points in the fitness. Program: 2; eq. 10 prints 1.
        pub fitness_power: u32 = 2, "1", [1, 2];
        /// Energy of a point without a line, rho of eq. 2. Program: 3.
        pub outlier_penalty: f64 = 3.0, "m", [0.0, 1000.0];
        /// Which iteration's lines are returned: the same by either word. Program: as the paper prints.
        pub selection: Selection = Selection::AsRun, "";
        /// Passes over each scan, every one starting from the lines of the one before. Program: 3 or 4, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

impl From<&RgParams> for Rules {
    fn from(params: &RgParams) -> Self {
        Self {
            fuse_distance_m: None,
            iterations: params.iterations,
            draw: Draw::FillUp,
            lines: params.lines,
            keep: params.keep,
            tiny: params.tiny,
            attach_distance_m: params.attach_distance_m,
            fitness_weight: params.fitness_weight,
            fitness_power: params.fitness_power,
            outlier_penalty: params.outlier_penalty,
            lowest_energy: true,
            passes: params.passes_per_scan,
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
        conformance::check(&LineFinderSpec::Rg(RgParams::default()));
    }

    #[test]
    fn it_conforms_as_printed_and_with_several_passes() {
        let selection = Selection::AsPrinted;
        conformance::check(&LineFinderSpec::Rg(RgParams { selection, passes_per_scan: 3, ..Default::default() }));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("rg");
    }
}
