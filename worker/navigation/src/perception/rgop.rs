//! Ruby genetic one point: the genetic search over one point per plant.
//!
//! Guyonneau et al. (2022), sections 2.2.1 and 2.2.2; constants of the program behind their tables.

use super::Selection;
use super::genetic::{Draw, Rules};

crate::parameters! {
    /// Parameters of the line finder `rgop`.
    pub struct RgopParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// Lines to fill up to, one less for each that is kept from the scan before. Program: 40.
        pub lines: u32 = 40, "1", [1, 64];
        /// At least this many of the fittest lines stay, or a quarter if that is more. Program: 4.
        pub keep: u32 = 4, "1", [1, 64];
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
        /// Passes over each scan, every one starting from the lines of the one before. Program: 6 to 8, by its clock.
        pub passes_per_scan: u32 = 1, "1", [1, 100];
    }
}

impl From<&RgopParams> for Rules {
    fn from(params: &RgopParams) -> Self {
        Self {
            fuse_distance_m: Some(params.fuse_distance_m),
            iterations: params.iterations,
            draw: Draw::FillUpLessKept,
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
        conformance::check(&LineFinderSpec::Rgop(RgopParams::default()));
    }

    #[test]
    fn it_conforms_as_printed_and_with_several_passes() {
        let selection = Selection::AsPrinted;
        conformance::check(&LineFinderSpec::Rgop(RgopParams { selection, passes_per_scan: 3, ..Default::default() }));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("rgop");
    }
}
