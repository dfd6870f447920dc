//! Rows and columns, before a format is chosen.

/// A table as rows and columns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Grid {
    /// A line above the table; empty for none. Not part of CSV.
    pub title: String,
    /// The columns.
    pub columns: Vec<Column>,
    /// The rows, each with an entry per column.
    pub rows: Vec<Vec<Entry>>,
    /// Lines below the table. Not part of CSV.
    pub notes: Vec<String>,
    /// Numbered notes from 1 below those, to which entries refer by `superscript`. Not part of CSV.
    pub footnotes: Vec<String>,
}

/// A column's heading.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// The heading.
    pub heading: String,
    /// Where its entries stand.
    pub align: Align,
}

impl Column {
    /// A column of words.
    pub fn left(heading: impl Into<String>) -> Self {
        Self { heading: heading.into(), align: Align::Left }
    }

    /// A column of numbers.
    pub fn right(heading: impl Into<String>) -> Self {
        Self { heading: heading.into(), align: Align::Right }
    }
}

/// Where a column's entries stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Align {
    /// Words.
    Left,
    /// Numbers.
    Right,
}

/// What stands where a row meets a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    /// Nothing.
    Empty,
    /// Words, or a number as it is shown to people.
    Text(String),
    /// Several lines of words.
    Lines(Vec<String>),
    /// A number in full precision, for programs.
    Number(f64),
    /// A count.
    Count(u64),
}

impl Entry {
    /// Words.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text(text.into())
    }

    /// A number, or nothing.
    #[must_use]
    pub fn number(value: Option<f64>) -> Self {
        value.map_or(Self::Empty, Self::Number)
    }
}
