//! Two levels of a factor compared in pairs: runs that differ in nothing else.
//!
//! Read in this order: `question` is what a user asks, `pairing` finds the pairs, `compare` makes the answer from what
//! `difference`, `bootstrap`, `mcnemar`, `tango`, `signed_rank`, `sign_flip`, `holm` and `seeds` say, `layout` writes it.
//!
//! # What is said
//! - A *pair* is two runs with the same seed and the same labels of all other factors. In a cell with several scenarios
//!   (a pool) they are also alike in all that the scenarios of both cells differ in. A pair of which a run is missing or
//!   failed is counted, and takes part in no figure.
//! - Success: the 2x2 counts, the exact test of McNemar (1947), two-sided, Tango's (1998)
//!   score interval of the difference, and the odds ratio of matched pairs with its exact interval (Clopper and Pearson).
//! - Ratios of sums: their difference with a bootstrap interval over pairs, and the randomization test (Fisher 1935).
//! - All other metrics: Student's interval of the mean difference, a bootstrap interval beside it, the signed-rank test of
//!   Wilcoxon (1945), Cohen's d_z (mean over deviation of the differences) and the rank-biserial correlation.
//! - p values are also given corrected for all tests of the answer (Holm 1979).
//!
//! Pairs count as drawn independently from one population; that fields differ more among each other than runs do so
//! widens the intervals of what is put together over fields. All of it is a function of the set of runs, and swapping
//! the two sides only changes signs.

mod bootstrap;
mod compare;
mod difference;
mod error;
mod holm;
mod layout;
mod mcnemar;
mod pairing;
mod question;
mod seeds;
mod sign_flip;
mod signed_rank;
mod tango;

pub use compare::{Comparison, GroupComparison, MetricComparison, PairCounts, TwoByTwo, compare};
pub use error::PairedError;
pub(crate) use holm::holm;
#[cfg(test)]
pub(crate) use pairing::tests::test_sweep;
pub use pairing::{Runs, SweepRuns};
pub use question::{Outline, Question, Resolved};
