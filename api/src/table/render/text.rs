//! Plain text for a terminal.

use comfy_table::{Cell, CellAlignment, LineStyle, Table, presets};

use super::{plain, printable};
use crate::table::grid::{Align, Entry, Grid};
use crate::table::number::superscript;

/// Notes are no narrower than this many characters, however narrow the table is.
const NARROWEST_NOTE: usize = 100;

pub(super) fn write(grid: &Grid) -> String {
    let mut table = Table::new();
    let style = presets::UTF8_HORIZONTAL_ONLY;
    let tall = grid.rows.iter().flatten().any(|entry| matches!(entry, Entry::Lines(_)));
    table.load_style(if tall { style } else { style.row_separator(LineStyle::none()) });
    table.set_header(grid.columns.iter().map(|column| aligned(printable(&column.heading), column.align)));
    for row in &grid.rows {
        let cells = row.iter().zip(&grid.columns).map(|(entry, column)| aligned(content(entry), column.align));
        table.add_row(cells.collect::<Vec<Cell>>());
    }
    let title = Some(printable(&grid.title)).filter(|title| !title.is_empty());
    let table = table.trim_fmt();
    let width = table.lines().map(|line| line.chars().count()).fold(NARROWEST_NOTE, usize::max);
    let notes = grid.notes.iter().map(|note| wrapped(&printable(note), 0, width));
    let footnotes = grid.footnotes.iter().enumerate().map(|(i, note)| {
        let mark = superscript(i + 1);
        wrapped(&format!("{mark} {}", printable(note)), mark.chars().count() + 1, width)
    });
    title.into_iter().chain([table]).chain(notes).chain(footnotes).map(|part| part + "\n").collect()
}

/// A note in lines of at most `width` characters, as far as its words allow, all but the first indented.
fn wrapped(note: &str, indent: usize, width: usize) -> String {
    let mut text = String::new();
    let mut column = 0;
    for word in note.split_whitespace() {
        let length = word.chars().count();
        if column > indent && column + 1 + length > width {
            text.push('\n');
            text.extend(std::iter::repeat_n(' ', indent));
            column = indent;
        } else if column > 0 {
            text.push(' ');
            column += 1;
        }
        text += word;
        column += length;
    }
    text
}

fn aligned(text: String, align: Align) -> Cell {
    let alignment = match align {
        Align::Left => CellAlignment::Left,
        Align::Right => CellAlignment::Right,
    };
    Cell::new(text).set_alignment(alignment)
}

fn content(entry: &Entry) -> String {
    match entry {
        Entry::Lines(lines) => lines.iter().map(|line| printable(line)).collect::<Vec<_>>().join("\n"),
        _ => printable(&plain(entry, " ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::grid::Column;

    #[test]
    fn a_label_cannot_steer_the_terminal() {
        let grid = Grid {
            columns: vec![Column::left("a\u{1b}[31m")],
            rows: vec![vec![Entry::text("x\u{7}\ny")]],
            ..Grid::default()
        };
        let text = write(&grid);
        assert!(!text.contains(['\u{1b}', '\u{7}']), "{text:?}");
    }

    #[test]
    fn a_note_is_broken_between_words() {
        assert_eq!(wrapped("¹ one two three", 2, 10), "¹ one two\n  three");
        assert_eq!(wrapped("one-two-three four five", 0, 10), "one-two-three\nfour five");
    }
}
