//! From a scan to lines, one file per line finder; in [`lane`] from a scan to the lane between two rows.
//!
//! A new line finder is one new file, and here three lines: its module, its variant of [`LineFinderSpec`] and
//! its arm in [`LineFinderSpec::build`].

mod candidates;
pub mod cloud;
mod genetic;
pub mod lane;
mod lanes;
pub mod line;
mod overlap;
mod pair_energy;
pub mod pearl;
mod population;
mod ranking;
pub mod rg;
pub mod rgop;
pub mod rgoppn;
pub mod rgoppni;
pub mod rows;
pub mod ruby;
mod sampling;
pub mod scan;

#[cfg(test)]
mod conformance;

pub use lane::{LaneEstimate, LaneFinder, LaneFinderSpec, LaneView};
pub use line::Line;
pub use scan::{Beams, Points, Scan};

use crate::random::Stream;

/// What a line finder found in a scan, in the LiDAR's frame.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// The points it worked on: all returns (Z) or one per run of returns (Z*).
    pub points: &'a Points,
    /// The lines, pass by pass over the scan; best first where the finder ranks them.
    pub lines: &'a [Line],
}

/// Finds lines in the scans of one LiDAR; may carry lines over from scan to scan.
pub trait LineFinder: Send {
    /// The lines in `scan`.
    fn find(&mut self, scan: &Scan<'_>, random: &mut Stream) -> Found<'_>;
}

crate::kinds! {
    /// Which line finder to run, with its parameters.
    pub enum LineFinderSpec {
        /// Lines through random points, judged by their energy, from nothing at each scan.
        Pearl(pearl::PearlParams) = "pearl",
        /// Pearl from the lines of the last scan.
        Ruby(ruby::RubyParams) = "ruby",
        /// Ruby genetic: a population of lines.
        Rg(rg::RgParams) = "rg",
        /// Ruby genetic one point.
        Rgop(rgop::RgopParams) = "rgop",
        /// Ruby genetic one point, positive and negative: half of the lines on each side.
        Rgoppn(rgoppn::RgoppnParams) = "rgoppn",
        /// Ruby genetic one point, positive, negative and infinity: a point may belong to several lines.
        Rgoppni(rgoppni::RgoppniParams) = "rgoppni",
    }
}

impl LineFinderSpec {
    /// A finder that has seen no scan yet.
    #[must_use]
    pub fn build(&self) -> Box<dyn LineFinder> {
        match self {
            Self::Pearl(params) => Box::new(pearl::PearlFinder::new(params.into())),
            Self::Ruby(params) => Box::new(pearl::PearlFinder::new(params.into())),
            Self::Rg(params) => Box::new(genetic::GeneticFinder::new(params.into())),
            Self::Rgop(params) => Box::new(genetic::GeneticFinder::new(params.into())),
            Self::Rgoppn(params) => Box::new(genetic::GeneticFinder::new(params.into())),
            Self::Rgoppni(params) => Box::new(rgoppni::Rgoppni::new(params.clone())),
        }
    }
}

crate::words! {
    /// Which iteration's lines a finder returns.
    pub enum Selection {
        /// As the program behind the published tables does.
        AsRun = "as-run",
        /// Those of the lowest energy, as the paper prints.
        AsPrinted = "as-printed",
    }
}
