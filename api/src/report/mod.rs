//! A sweep as one document that stands alone: what was run and how to run it again, tables, figures, failures.
//!
//! Read in this order: `Material` is what a report is made of, `contents` puts it together from [`Block`]s with the
//! drawings of `plot`, `command` is how to do it all again, and `html` and `markdown` write it. The report of a sweep
//! depends on its results only: the same results give the same bytes.

mod command;
mod contents;
mod html;
mod markdown;
mod plot;

use furrow_schema::id::{Digest, JobId, JobKey};
use furrow_schema::sweep::Sweep;
use serde_json::Value;

use crate::publication::Comparison;
use crate::table::{Grid, SweepData};

pub use contents::compose;

/// What a report is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// One page, drawings included.
    Html,
    /// Markdown, drawings included as data.
    Markdown,
}

/// What a report is made of.
#[derive(Debug)]
pub struct Material {
    /// The sweep.
    pub sweep: Sweep,
    /// What was asked, as the body of a submission.
    pub request: Value,
    /// Its results.
    pub data: SweepData,
    /// Of all results together; none before there is one.
    pub digest: Option<Digest>,
    /// Published tables and claims beside its results.
    pub comparisons: Vec<Comparison>,
    /// How runs ended.
    pub endings: Vec<Ending>,
    /// Jobs that were given up on.
    pub given_up: Vec<GivenUp>,
    /// Drawings of single runs, with what there is to see.
    pub drawings: Vec<(String, String)>,
}

/// One way to end, in one cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ending {
    /// The cell's labels, in the order of the factors.
    pub labels: Vec<String>,
    /// The outcome.
    pub outcome: String,
    /// Whether such runs are successes; none where a run is no success or failure.
    pub success: Option<bool>,
    /// So many runs.
    pub runs: u64,
    /// The first of them: its job and seed.
    pub example: (JobId, u64),
}

/// A job that was given up on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GivenUp {
    /// Its key.
    pub key: JobKey,
    /// Its labels, in the order of the factors.
    pub labels: Vec<String>,
    /// Its seed.
    pub seed: u64,
    /// Why its last attempt ended.
    pub reason: String,
}

/// A report, before a form is chosen.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Report {
    /// The heading.
    pub title: String,
    /// What follows, in order.
    pub blocks: Vec<Block>,
}

/// A part of a report.
#[derive(Debug, Clone, PartialEq)]
pub enum Block {
    /// A heading of a section.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Names and what they are.
    Facts(Vec<(&'static str, String)>),
    /// A table with its notes.
    Table(Grid),
    /// A drawing (SVG) and what it shows.
    Figure {
        /// The drawing.
        svg: String,
        /// What it shows.
        caption: String,
    },
    /// Lines to be typed or copied as they are.
    Code(String),
}

impl Report {
    /// The report as a file.
    #[must_use]
    pub fn write(&self, form: Form) -> String {
        match form {
            Form::Html => html::write(self),
            Form::Markdown => markdown::write(self),
        }
    }
}
