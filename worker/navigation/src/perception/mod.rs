//! From a scan to lines: one file per line finder.
//!
//! A new line finder is one new file, and here three lines: its module, its variant of [`LineFinderSpec`] and
//! its arm in [`LineFinderSpec::build`].

mod genetic;
pub mod line;
pub mod rgop;
pub mod scan;

#[cfg(test)]
mod conformance;

pub use line::Line;
pub use scan::{Beams, Points, Scan};

use crate::random::Stream;

/// What a line finder found in a scan, in the LiDAR's frame.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// The points it worked on: all returns (Z) or one per run of returns (Z*).
    pub points: &'a Points,
    /// The lines, best first, from every pass over the scan.
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
        /// Ruby genetic one point.
        Rgop(rgop::RgopParams) = "rgop",
    }
}

impl LineFinderSpec {
    /// A finder that has seen no scan yet.
    #[must_use]
    pub fn build(&self) -> Box<dyn LineFinder> {
        match self {
            Self::Rgop(params) => Box::new(rgop::Rgop::new(params.clone())),
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
