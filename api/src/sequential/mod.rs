//! More seeds until a question is decided, with an error rate that looking several times does not raise.
//!
//! Read in this order: [`goal`] is what a user asks for, `width` and `order` judge it on what there is so far,
//! [`Judgement`] is what they say.
//!
//! # Why looking does not hurt
//! Look k, counted from 1, gets the share 1 / (k (k + 1)) of the error rate of 5 %, as it were the only one. These shares
//! add up to 1, so by Boole's inequality the chance that any look, however many there are, leads astray stays below 5 %:
//! that an order which is called decided is none, or that a cell's interval at the look that ended the search misses.
//! Seeds grow by half from look to look, so that there are few.
//!
//! - Order: every two levels are compared in pairs of runs (see [`paired`](crate::paired)), corrected for all of them
//!   (Holm). The tests are exact or, of many runs, nearly so.
//! - Width: of a ratio the exact interval (Clopper and Pearson 1934), of a mean Student's, of a ratio of sums Student's on
//!   the standard error of its linear approximation. The last two hold for means of enough runs, not for two or three.

pub mod goal;
mod order;
mod width;

use serde::Serialize;

pub use goal::Goal;
pub use order::{Order, order};
pub use width::{CellWidth, widths};

/// The chance of a false answer, over all looks together.
pub const ERROR_RATE: f64 = 0.05;

/// The error rate of look `look`, counted from 1.
#[must_use]
pub fn error_rate_of(look: u32) -> f64 {
    let k = f64::from(look.max(1));
    ERROR_RATE / (k * (k + 1.0))
}

/// How many seeds to look at after `seeds`: half as many more, and no more than `most`.
#[must_use]
pub fn next_seeds(seeds: u64, most: u64) -> u64 {
    seeds.saturating_add((seeds / 2).max(1)).min(most)
}

/// What is said of a goal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// The goal, as it was written.
    pub goal: String,
    /// The metric that it is about.
    pub metric: String,
    /// Whether it is reached.
    pub reached: bool,
    /// Looks so far.
    pub looks: u32,
    /// Seeds of the last one.
    pub seeds: u64,
    /// The error rate of the last look alone.
    pub error_rate_of_look: f64,
    /// The error rate of all looks together.
    pub error_rate: f64,
    /// The interval of each cell, of a goal about widths.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub widths: Vec<CellWidth>,
    /// The order of every two levels, of a goal about that.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub orders: Vec<Order>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_looks_share_the_error_rate() {
        assert_eq!(error_rate_of(1), 0.025);
        let all: f64 = (1..100_000).map(error_rate_of).sum();
        assert!(all <= ERROR_RATE && all > 0.0499, "{all}");
    }

    #[test]
    fn seeds_grow_by_half_up_to_the_most() {
        let mut seeds = vec![1];
        while *seeds.last().unwrap() < 50 {
            seeds.push(next_seeds(*seeds.last().unwrap(), 50));
        }
        assert_eq!(seeds, [1, 2, 3, 4, 6, 9, 13, 19, 28, 42, 50]);
    }
}
