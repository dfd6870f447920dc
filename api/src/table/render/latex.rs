//! A LaTeX tabular with the rules of the package booktabs.

use super::{plain, printable};
use crate::table::grid::{Align, Entry, Grid};

pub(super) fn write(grid: &Grid) -> String {
    let align: String = grid.columns.iter().map(|column| if column.align == Align::Left { 'l' } else { 'r' }).collect();
    let headings = grid.columns.iter().map(|column| escaped(&column.heading)).collect();
    let mut lines = Vec::new();
    if !grid.title.is_empty() {
        lines.push(format!("% {}", printable(&grid.title)));
    }
    lines.extend([format!("\\begin{{tabular}}{{{align}}}"), "\\toprule".to_owned(), line(headings)]);
    lines.push("\\midrule".to_owned());
    lines.extend(grid.rows.iter().map(|row| line(row.iter().map(field).collect())));
    lines.extend(["\\bottomrule".to_owned(), "\\end{tabular}".to_owned()]);
    lines.extend(grid.notes.iter().map(|note| format!("% {}", printable(note))));
    lines.join("\n") + "\n"
}

fn line(fields: Vec<String>) -> String {
    format!("{} \\\\", fields.join(" & "))
}

fn field(entry: &Entry) -> String {
    // A bracket at the start of a row would be read as an option of the line break before it.
    let text = escaped(&plain(entry, "; "));
    if text.starts_with('[') { format!("{{}}{text}") } else { text }
}

/// Text in which no character has a meaning to TeX.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in printable(text).chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => out.push_str("\\textasciicircum{}"),
            '\\' => out.push_str("\\textbackslash{}"),
            '<' | '>' | '|' => out.extend(['$', c, '$']),
            '±' => out.push_str("$\\pm$"),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_label_is_a_command() {
        assert_eq!(escaped("\\input{x} 5% a_b"), "\\textbackslash{}input\\{x\\} 5\\% a\\_b");
        assert_eq!(escaped("mm^2"), "mm\\textasciicircum{}2");
    }

    #[test]
    fn a_bracket_does_not_become_an_option() {
        assert_eq!(field(&Entry::text("[1, 2]")), "{}[1, 2]");
    }
}
