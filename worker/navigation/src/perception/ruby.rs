//! Ruby: Pearl from the lines of the last scan, forgiving lines that have parallel ones.
//!
//! Guyonneau et al. (2022), section 2.1; steps and constants of the program behind the tables. See
//! [`pearl`](super::pearl) for the search and its deviation.

use super::Selection;
use super::pearl::{PearlParams, Rules, Variant};

crate::parameters! {
    /// Parameters of the line finder `ruby`.
    pub struct RubyParams {
        /// Iterations per pass. Program: 10.
        pub iterations: u32 = 10, "1", [1, 1000];
        /// A line is removed if the mean distance of its points, divided by the number of lines of its slope, reaches
        /// this, alpha of eq. 7. Program: 0.7.
        pub bad_distance_m: f64 = 0.7, "m", [0.001, 10.0];
        /// A line of this many points or fewer is removed. Program: 3.
        pub tiny: u32 = 3, "1", [1, 100];
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

impl From<&RubyParams> for Rules {
    fn from(params: &RubyParams) -> Self {
        let params = PearlParams {
            iterations: params.iterations,
            bad_distance_m: params.bad_distance_m,
            tiny: params.tiny,
            attach_distance_m: params.attach_distance_m,
            outlier_penalty: params.outlier_penalty,
            selection: params.selection,
            passes_per_scan: params.passes_per_scan,
        };
        Self { variant: Variant::Ruby, params }
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

    #[test]
    fn it_conforms_as_printed_and_with_several_passes() {
        let selection = Selection::AsPrinted;
        let params = RubyParams { selection, passes_per_scan: 3, ..Default::default() };
        conformance::check(&LineFinderSpec::Ruby(params));
    }

    #[test]
    fn it_bears_the_ends_of_its_ranges() {
        conformance::check_extremes("ruby");
    }
}
