//! Plain text for a terminal.

use comfy_table::{Cell, CellAlignment, LineStyle, Table, presets};

use super::{plain, printable};
use crate::table::grid::{Align, Entry, Grid};

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
    let notes = grid.notes.iter().map(|note| printable(note));
    title.into_iter().chain([table.trim_fmt()]).chain(notes).map(|part| part + "\n").collect()
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
}
