//! From the lines of many scans to the rows around the robot.

pub mod merge;
pub mod row_filter;

pub use merge::MergedLines;
pub use row_filter::{RowFilter, RowFilterParams, Rows};

crate::kinds! {
    /// How the robot places itself among the rows.
    pub enum LocalizationSpec {
        /// The rows around the robot, kept by the filter of Guyonneau et al. (2022), algorithm 4.
        RowFilter(RowFilterParams) = "row-filter",
    }
}
