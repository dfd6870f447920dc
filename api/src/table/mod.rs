//! From the results of a sweep to tables.
//!
//! Read in this order: `data` is what the store knows of a sweep, `query` what a user asks of it, `metric`
//! what is measured, `statistics` what is said of many values, `tabulate` makes the cells, `layout` sets
//! them in rows and columns as a `grid`, and `render` writes a grid as CSV, Markdown, LaTeX or text.
//!
//! A table is a function of the set of results: the order in which they came leaves no trace.

mod binomial;
mod bootstrap;
mod data;
mod error;
mod grid;
mod layout;
mod metric;
mod number;
mod pairs;
mod query;
mod render;
mod statistics;
mod tabulate;

pub use data::{CellData, Series, SweepData};
pub use error::TableError;
pub use grid::{Align, Column, Entry, Grid};
pub use metric::{Metric, OfSums, metric};
pub use pairs::Pairs;
pub use query::{Format, Query, Statistic};
pub use render::render;
pub(crate) use render::{harmless, parquet};
pub use statistics::{student_interval, student_interval_at, summarize, wilson_interval};
pub use tabulate::{Table, tabulate};

pub(crate) use binomial::{at_most, clopper_pearson_interval};
pub(crate) use bootstrap::{Contrast, Draws, NORMAL_FROM, RESAMPLES, Z_975, accelerated_ends, acceleration, interval};
pub(crate) use metric::{SUCCESS, listed, order};
pub(crate) use number::{exact, short, superscript};
pub(crate) use query::list;
pub(crate) use render::markdown_text;
pub(crate) use statistics::median;
