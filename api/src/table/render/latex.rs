//! A LaTeX tabular with the rules of the package booktabs.

use super::{plain, printable};
use crate::table::grid::{Align, Entry, Grid};
use crate::table::number::SUPERSCRIPTS;

pub(super) fn write(grid: &Grid) -> String {
    let align: String = grid.columns.iter().map(|column| if column.align == Align::Left { 'l' } else { 'r' }).collect();
    let headings = grid.columns.iter().map(|column| escaped(&column.heading)).collect();
    let mut lines = Vec::new();
    if !grid.title.is_empty() {
        lines.push(format!("% {}", printable(&grid.title)));
    }
    lines.extend([format!("\\begin{{tabular}}{{{align}}}"), "\\toprule".to_owned(), line(headings)]);
    lines.push("\\midrule".to_owned());
    let tall = grid.rows.iter().flatten().any(|entry| matches!(entry, Entry::Lines(_)));
    for (i, row) in grid.rows.iter().enumerate() {
        lines.extend((tall && i > 0).then(|| "\\addlinespace".to_owned()));
        lines.extend((0..height(row)).map(|at| line(row.iter().map(|entry| field(entry, at)).collect())));
    }
    lines.extend(["\\bottomrule".to_owned(), "\\end{tabular}".to_owned()]);
    lines.extend(grid.notes.iter().map(|note| format!("% {}", printable(note))));
    if !grid.footnotes.is_empty() {
        lines.push("\\begin{enumerate}\\footnotesize".to_owned());
        lines.extend(grid.footnotes.iter().map(|note| format!("\\item {}", guarded(escaped(note)))));
        lines.push("\\end{enumerate}".to_owned());
    }
    lines.join("\n") + "\n"
}

fn line(fields: Vec<String>) -> String {
    format!("{} \\\\", fields.join(" & "))
}

/// How many lines of the document a row takes: an entry's lines stand below each other.
fn height(row: &[Entry]) -> usize {
    let height = |entry: &Entry| if let Entry::Lines(lines) = entry { lines.len() } else { 1 };
    row.iter().map(height).max().unwrap_or(1).max(1)
}

/// Line `at` of an entry.
fn field(entry: &Entry, at: usize) -> String {
    guarded(escaped(&match entry {
        Entry::Lines(lines) => lines.get(at).cloned().unwrap_or_default(),
        _ if at > 0 => String::new(),
        _ => plain(entry, " "),
    }))
}

/// A bracket at the start would be read as an option of the command before it.
fn guarded(text: String) -> String {
    if text.starts_with('[') { format!("{{}}{text}") } else { text }
}

/// Text in which no character has a meaning to TeX.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let text = printable(text);
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '~' => out.push_str("\\textasciitilde{}"),
            '^' => match rest.next_if(char::is_ascii_digit) {
                Some(digit) => out.push_str(&raised(digit)),
                None => out.push_str("\\textasciicircum{}"),
            },
            '\\' => out.push_str("\\textbackslash{}"),
            '<' | '>' | '|' => out.extend(['$', c, '$']),
            c if SUPERSCRIPTS.contains(&c) => out.push_str(&raised(c)),
            '∞' => out.push_str("$\\infty$"),
            '±' => out.push_str("$\\pm$"),
            _ => out.push(c),
        }
    }
    out
}

/// A digit above the line, which few fonts have as a character.
fn raised(c: char) -> String {
    let digit = SUPERSCRIPTS.iter().position(|raised| *raised == c).map_or(c.to_string(), |digit| digit.to_string());
    format!("\\textsuperscript{{{digit}}}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_label_is_a_command() {
        assert_eq!(escaped("\\input{x} 5% a_b"), "\\textbackslash{}input\\{x\\} 5\\% a\\_b");
        assert_eq!(escaped("a^b"), "a\\textasciicircum{}b");
    }

    #[test]
    fn a_unit_squared_stands_as_in_print() {
        assert_eq!(escaped("[mm^2] ∞"), "[mm\\textsuperscript{2}] $\\infty$");
    }

    #[test]
    fn a_bracket_does_not_become_an_option() {
        assert_eq!(field(&Entry::text("[1, 2]"), 0), "{}[1, 2]");
    }

    #[test]
    fn the_lines_of_an_entry_stand_below_each_other() {
        let row = vec![Entry::text("a"), Entry::Lines(vec!["b".into(), "c¹".into()])];
        let grid = Grid { rows: vec![row.clone(), row], footnotes: vec!["why".into()], ..Grid::default() };
        let text = write(&grid);
        let row = "a & b \\\\\n & c\\textsuperscript{1} \\\\\n";
        assert!(text.contains(&format!("{row}\\addlinespace\n{row}")), "{text}");
        assert!(text.ends_with("\\begin{enumerate}\\footnotesize\n\\item why\n\\end{enumerate}\n"), "{text}");
    }
}
