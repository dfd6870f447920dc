//! A comparison in rows and columns.

use std::collections::BTreeSet;

use super::reference::{FIELDS, MEAN};
use super::verdict::Verdict;
use super::{Comparison, ComparisonCell};
use crate::table::{Column, Entry, Grid, short, superscript};

/// One row per cell, in full precision.
pub(super) fn for_programs(comparison: &Comparison) -> Grid {
    let factors = factors(comparison);
    let mut columns: Vec<Column> = factors.iter().map(|factor| Column::left(*factor)).collect();
    let numbers = ["published", "program", "program_median", "ours_mean", "ours_median", "ours_ci95_low"];
    columns.extend(numbers.into_iter().chain(["ours_ci95_high", "ours_n"]).map(Column::right));
    columns.extend(["verdict", "note"].map(Column::left));
    let row = |cell: &ComparisonCell| {
        let mut row: Vec<Entry> = factors.iter().map(|factor| Entry::text(cell.label(factor))).collect();
        let ours = cell.ours.as_ref();
        let end = |at: usize| ours.and_then(|ours| ours.ci95).map(|ends| ends[at]);
        let numbers = [cell.published, cell.program, cell.program_median, ours.map(|ours| ours.mean)];
        row.extend(numbers.map(Entry::number));
        row.extend([ours.and_then(|ours| ours.median), end(0), end(1)].map(Entry::number));
        row.push(ours.map_or(Entry::Empty, |ours| Entry::Count(ours.n)));
        row.push(Entry::text(cell.verdict.map_or("", Verdict::as_str)));
        row.push(Entry::text(cell.note.as_deref().unwrap_or_default()));
        row
    };
    Grid { columns, rows: comparison.cells.iter().map(row).collect(), ..Grid::default() }
}

/// `algorithm`, `field`, then any others.
fn factors(comparison: &Comparison) -> Vec<&str> {
    let all: BTreeSet<&str> =
        comparison.cells.iter().flat_map(|cell| cell.factors.keys()).map(String::as_str).collect();
    let further = all.into_iter().filter(|factor| !matches!(*factor, "algorithm" | "field"));
    ["algorithm", "field"].into_iter().chain(further).collect()
}

/// The paper's table: a row per algorithm, a column per crop and their mean, and in each cell a line per figure.
///
/// Algorithms that did not run are left out, unless none did.
pub(super) fn for_people(comparison: &Comparison) -> Grid {
    let factors: Vec<&str> = factors(comparison).into_iter().filter(|factor| *factor != "field").collect();
    let mut columns: Vec<Column> = factors.iter().chain([&""]).map(|factor| Column::left(*factor)).collect();
    columns.extend(FIELDS.into_iter().chain([MEAN]).map(Column::right));
    let all: Vec<&[ComparisonCell]> = comparison.cells.chunks(FIELDS.len() + 1).collect();
    let ran = |row: &&&[ComparisonCell]| row.iter().any(|cell| cell.ours.is_some());
    let some_ran = all.iter().any(|row| ran(&row));
    let figures = Figure::of(comparison);
    let mut footnotes = Vec::new();
    let mut rows = Vec::new();
    for cells in all.iter().filter(|row| !some_ran || ran(row)) {
        let mut row: Vec<Entry> = factors.iter().map(|factor| Entry::text(cells[0].label(factor))).collect();
        row.push(Entry::Lines(figures.iter().map(|figure| figure.label().to_owned()).collect()));
        row.extend(cells.iter().map(|cell| entry(comparison, cell, &figures, &mut footnotes)));
        rows.push(row);
    }
    let mut left_out: Vec<&str> =
        all.iter().filter(|row| some_ran && !ran(row)).map(|row| row[0].label("algorithm")).collect();
    left_out.dedup();
    let notes = notes(comparison, &figures, &left_out, !footnotes.is_empty());
    Grid { title: title(comparison), columns, rows, notes, footnotes }
}

fn title(comparison: &Comparison) -> String {
    let number = comparison.table.replace('-', " ");
    format!("{}, {number}: {}", comparison.citation, comparison.measured().heading())
}

/// A line of each cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Figure {
    Ours,
    Interval,
    Paper,
    Program,
    Medians,
}

impl Figure {
    /// Those of which the table has any. Medians only where the program's is known, too: where means are carried
    /// by a few runs.
    fn of(comparison: &Comparison) -> Vec<Self> {
        let any = |has: fn(&ComparisonCell) -> bool| comparison.cells.iter().any(has);
        let shown = [
            (Self::Ours, true),
            (Self::Interval, any(|cell| cell.ours.is_some())),
            (Self::Paper, true),
            (Self::Program, any(|cell| cell.program.is_some())),
            (Self::Medians, any(|cell| cell.program_median.is_some())),
        ];
        shown.into_iter().filter(|(_, shown)| *shown).map(|(figure, _)| figure).collect()
    }

    const fn label(self) -> &'static str {
        match self {
            Self::Ours => "ours",
            Self::Interval => "95 %",
            Self::Paper => "paper",
            Self::Program => "program",
            Self::Medians => "medians",
        }
    }
}

fn entry(comparison: &Comparison, cell: &ComparisonCell, figures: &[Figure], footnotes: &mut Vec<String>) -> Entry {
    let show =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| short(value, comparison.measured().decimals));
    let ours = cell.ours.as_ref();
    let line = |figure: &Figure| match figure {
        Figure::Ours => show(ours.map(|ours| ours.mean)) + &failures(comparison, cell),
        Figure::Interval => ours
            .and_then(|ours| ours.ci95)
            .map_or_else(String::new, |[low, high]| format!("[{}, {}]", show(Some(low)), show(Some(high)))),
        Figure::Paper => paper(comparison, cell, footnotes),
        Figure::Program => show(cell.program),
        Figure::Medians if cell.label("field") == MEAN => String::new(),
        Figure::Medians => format!("{} / {}", show(ours.and_then(|ours| ours.median)), show(cell.program_median)),
    };
    Entry::Lines(figures.iter().map(line).collect())
}

/// The published value with the verdict; a reason goes below the table.
fn paper(comparison: &Comparison, cell: &ComparisonCell, footnotes: &mut Vec<String>) -> String {
    let Some(published) = cell.published else { return "-".to_owned() };
    let mut text = published.to_string();
    if let Some(verdict) = cell.verdict.filter(|verdict| *verdict != Verdict::NotRun) {
        text += &format!(" {}", verdict.as_str());
    }
    if let Some(reason) = &cell.reason {
        let labels: Vec<&str> = factors(comparison).into_iter().map(|factor| cell.label(factor)).collect();
        footnotes.push(format!("{}: {reason}.", labels.join(", ")));
        text += &superscript(footnotes.len());
    }
    text
}

/// Successful of finished runs beside an average, unless all were, or the average is the success ratio itself.
fn failures(comparison: &Comparison, cell: &ComparisonCell) -> String {
    match cell.success {
        Some((successes, runs)) if successes < runs && !comparison.measured().ratio => {
            format!(" ({successes}/{runs})")
        }
        _ => String::new(),
    }
}

fn notes(comparison: &Comparison, figures: &[Figure], left_out: &[&str], cites: bool) -> Vec<String> {
    let count = |verdict| comparison.cells.iter().filter(|cell| cell.verdict == Some(verdict)).count();
    let failures = if comparison.measured().ratio { "" } else { " (successful of finished runs if some failed)" };
    let mut notes = vec![
        format!("Ours: mean{failures} and its 95 % interval. Paper: its value and the verdict."),
        format!(
            "Of the paper's values {} are inside our interval, {} keep their ranking, {} differ.",
            count(Verdict::Inside),
            count(Verdict::SameRanking),
            count(Verdict::Different),
        ),
    ];
    notes.extend(comparison.program_source.map(|source| format!("Program: {source}.")));
    if figures.contains(&Figure::Medians) {
        notes.push("Medians: ours / the program's.".to_owned());
    }
    if comparison.measured().timing {
        notes.push("Times are of the machines that ran the sweep, the paper's of its authors' machine.".to_owned());
    }
    if !left_out.is_empty() {
        notes.push(format!("Not run: {}.", left_out.join(", ")));
    }
    notes.extend(comparison.note.as_ref().map(|note| format!("The paper: {note}.")));
    notes.extend(
        cites.then(|| "Runs are cited by the first digits of their keys: furrow job KEY shows one.".to_owned()),
    );
    notes
}
