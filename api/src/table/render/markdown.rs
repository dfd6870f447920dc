//! A Markdown table.

use super::{plain, printable};
use crate::table::grid::{Align, Entry, Grid};

pub(super) fn write(grid: &Grid) -> String {
    let headings: Vec<String> = grid.columns.iter().map(|column| escaped(&column.heading)).collect();
    let rule = grid.columns.iter().map(|column| match column.align {
        Align::Left => "---".to_owned(),
        Align::Right => "--:".to_owned(),
    });
    let mut lines = Vec::new();
    if !grid.title.is_empty() {
        lines.extend([format!("**{}**", escaped(&grid.title)), String::new()]);
    }
    lines.extend([line(headings), line(rule.collect())]);
    lines.extend(grid.rows.iter().map(|row| line(row.iter().map(field).collect())));
    for note in &grid.notes {
        lines.extend([String::new(), escaped(note)]);
    }
    if !grid.footnotes.is_empty() {
        lines.push(String::new());
        lines.extend(grid.footnotes.iter().enumerate().map(|(i, note)| format!("{}. {}", i + 1, escaped(note))));
    }
    lines.join("\n") + "\n"
}

fn line(fields: Vec<String>) -> String {
    format!("| {} |", fields.join(" | "))
}

fn field(entry: &Entry) -> String {
    match entry {
        Entry::Lines(lines) => lines.iter().map(|line| escaped(line)).collect::<Vec<_>>().join("<br>"),
        _ => escaped(&plain(entry, " ")),
    }
}

/// Text in which no character has a meaning to Markdown or HTML.
pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let text = printable(text);
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            // A bracket is plain unless a link follows it.
            ']' if matches!(chars.peek(), Some('(' | '[' | ':')) => out.push_str("\\]"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            '|' | '\\' | '`' | '*' | '_' | '~' => out.extend(['\\', c]),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_label_cannot_break_out_of_its_field() {
        assert_eq!(escaped("a|b\n<script>"), "a\\|b &lt;script&gt;");
        assert_eq!(escaped("`x` *y*"), "\\`x\\` \\*y\\*");
        assert_eq!(escaped("[0, 1] [x](y)"), "[0, 1] [x\\](y)");
    }

    #[test]
    fn footnotes_are_an_ordered_list() {
        let grid = Grid { footnotes: vec!["a*".into(), "b".into()], ..Grid::default() };
        assert!(write(&grid).ends_with("\n\n1. a\\*\n2. b\n"));
    }
}
