//! Ruby genetic one point, positive and negative: as many lines are searched on the left as on the right.
//!
//! Guyonneau et al. (2022), section 2.2.3; constants of the program behind their tables.

use super::Selection;
use super::genetic::{Draw, Rules};

crate::parameters! {
    /// Parameters of the line finder `rgoppn`.
    pub struct RgoppnParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// Lines to draw in an iteration, one less for each that is kept from the scan before. Program: 40.
        pub lines: u32 = 40, "1", [1, 64];
        /// At least this many of the fittest lines stay, or a quarter if that is more. Program: 6.
        pub keep: u32 = 6, "1", [1, 64];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [1, 100];
        /// A point belongs to its nearest line if closer than this. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 10.0];
        /// Neighbouring returns closer than this become one point. Program: 0.05.
        pub fuse_distance_m: f64 = 0.05, "m", [0.0, 10.0];
        /// Weight of the distances against the squared intercept in the fitness, tau of eq. 10. Program: 10.
        pub fitness_weight: f64 = 10.0, "m", [0.0, 1000.0];
        /// Power of the number of points in the fitness. Program: 2; eq. 10 prints 1.
        pub fitness_power: u32 = 2, "1", [1, 2];
        /// Energy of a point without a line, rho of eq. 2 (read by `as-printed`). Program: 3.
        pub outlier_penalty: f64 = 3.0, "m", [0.0, 1000.0];
        /// Which iteration's lines are returned. Program: the last one's, `as-run`.
        pub selection: Selection = Selection::AsRun, "";
        /// Passes over each scan, every one starting from the lines of the one before. Program: 5 to 12, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

impl From<&RgoppnParams> for Rules {
    fn from(params: &RgoppnParams) -> Self {
        Self {
            fuse_distance_m: Some(params.fuse_distance_m),
            iterations: params.iterations,
            draw: Draw::HalfEachSide,
            lines: params.lines,
            keep: params.keep,
            tiny: params.tiny,
            attach_distance_m: params.attach_distance_m,
            fitness_weight: params.fitness_weight,
            fitness_power: params.fitness_power,
            outlier_penalty: params.outlier_penalty,
            lowest_energy: params.selection == Selection::AsPrinted,
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
        conformance::check(&LineFinderSpec::Rgoppn(RgoppnParams::default()));
    }

    #[test]
    fn it_conforms_as_printed_and_with_several_passes() {
        let selection = Selection::AsPrinted;
        conformance::check(&LineFinderSpec::Rgoppn(RgoppnParams {
            selection,
            passes_per_scan: 3,
            ..Default::default()
        }));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("rgoppn");
    }
}
