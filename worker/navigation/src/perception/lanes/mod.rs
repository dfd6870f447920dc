//! Inner loops over many points and lines, with the vector instructions that the machine has.
//!
//! The bits do not depend on these: every lane does the same operations in the same order whatever their number, no
//! product is fused with a sum, and numbers are added up over lanes in a fixed order or where they are whole.
//!
//! Which line a point is nearest to, whether two lines are the same, and how near two points are, is computed in
//! single precision, in twice as many lanes: that is good to a micrometre at the range of these LiDARs. Lines are
//! fitted in double precision.

mod bands;
mod nearest;
mod pairs;
mod same;
#[cfg(test)]
mod tests;

pub(super) use bands::BandSums;
pub(super) use nearest::NearestLines;
pub(super) use pairs::{ONE, SumApart, Weights};
pub(super) use same::{CountParallel, FitTriples, GROUP, SameLines};

/// The largest number that [`from_whole`] takes.
pub(super) const LARGEST: u32 = (1 << 23) - 1;

/// A whole number up to [`LARGEST`] as 2^23 and itself, so that its bits are the low ones.
pub(super) const fn from_whole(number: u32) -> f32 {
    debug_assert!(number <= LARGEST);
    f32::from_bits(0x4b00_0000 | number)
}

/// The whole number that [`from_whole`] took.
pub(super) const fn to_whole(number: f32) -> u32 {
    number.to_bits() & LARGEST
}
