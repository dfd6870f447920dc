//! Comma-separated values after RFC 4180.

use std::borrow::Cow;

use super::plain;
use crate::table::grid::{Entry, Grid};

pub(super) fn write(grid: &Grid) -> String {
    let headings = grid.columns.iter().map(|column| guarded(&column.heading)).collect();
    let rows = grid.rows.iter().map(|row| row.iter().map(field).collect());
    std::iter::once(headings).chain(rows).map(line).collect()
}

fn line(fields: Vec<String>) -> String {
    fields.join(",") + "\r\n"
}

fn field(entry: &Entry) -> String {
    match entry {
        Entry::Text(_) | Entry::Lines(_) => guarded(&plain(entry, "; ")),
        _ => plain(entry, ""),
    }
}

/// Text that no spreadsheet runs: one that begins like a formula gets an apostrophe before it, unless it is a number.
pub(crate) fn harmless(text: &str) -> Cow<'_, str> {
    let formula = text.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']) && text.parse::<f64>().is_err();
    if formula { Cow::Owned(format!("'{text}")) } else { Cow::Borrowed(text) }
}

/// Text as a field.
fn guarded(text: &str) -> String {
    let text = harmless(text);
    let quote = text.contains(['"', ',', '\r', '\n']) || text.starts_with(' ') || text.ends_with(' ');
    if quote { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::grid::Column;

    #[test]
    fn separators_and_quotes_are_quoted() {
        assert_eq!(guarded("a,b"), "\"a,b\"");
        assert_eq!(guarded("say \"a\""), "\"say \"\"a\"\"\"");
        assert_eq!(guarded("two\nlines"), "\"two\nlines\"");
        assert_eq!(guarded("crop-1"), "crop-1");
    }

    #[test]
    fn what_looks_like_a_formula_is_no_formula() {
        assert_eq!(guarded("=HYPERLINK(1)"), "'=HYPERLINK(1)");
        assert_eq!(guarded("@a,b"), "\"'@a,b\"");
        assert_eq!(guarded("-0.5"), "-0.5");
        assert_eq!(guarded("-x"), "'-x");
    }

    #[test]
    fn numbers_keep_their_bits_and_nothing_is_an_empty_field() {
        let grid = Grid {
            columns: vec![Column::left("a"), Column::right("b"), Column::right("c")],
            rows: vec![vec![Entry::Empty, Entry::Number(-0.1), Entry::Count(3)]],
            ..Grid::default()
        };
        assert_eq!(write(&grid), "a,b,c\r\n,-0.1,3\r\n");
    }
}
