//! A grid as text: a file per format.

mod csv;
mod latex;
mod markdown;
mod parquet;
mod text;

pub(crate) use csv::harmless;
pub(crate) use markdown::escaped as markdown_text;
pub(crate) use parquet::parquet;
use serde_json::{Map, Value};

use super::grid::{Entry, Grid};
use super::number::exact;
use super::query::Format;

/// Writes `grid` in `format`; in JSON as an array of objects by heading.
#[must_use]
pub fn render(grid: &Grid, format: Format) -> String {
    match format {
        Format::Json => json(grid),
        Format::Csv => csv::write(grid),
        Format::Md => markdown::write(grid),
        Format::Latex => latex::write(grid),
        Format::Text => text::write(grid),
    }
}

fn json(grid: &Grid) -> String {
    let value = |entry: &Entry| match entry {
        Entry::Empty => Value::Null,
        Entry::Number(number) => Value::from(*number),
        Entry::Count(count) => Value::from(*count),
        Entry::Text(_) | Entry::Lines(_) => Value::from(plain(entry, "\n")),
    };
    let object = |row: &Vec<Entry>| {
        let pairs = grid.columns.iter().zip(row).map(|(column, entry)| (column.heading.clone(), value(entry)));
        Value::Object(pairs.collect::<Map<String, Value>>())
    };
    Value::from(grid.rows.iter().map(object).collect::<Vec<Value>>()).to_string()
}

/// An entry as text, its lines joined by `joint`.
fn plain(entry: &Entry, joint: &str) -> String {
    match entry {
        Entry::Empty => String::new(),
        Entry::Text(text) => text.clone(),
        Entry::Lines(lines) => lines.join(joint),
        Entry::Number(number) => exact(*number),
        Entry::Count(count) => count.to_string(),
    }
}

/// `text` without control characters: they could move a terminal's cursor or break a line of a table.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
