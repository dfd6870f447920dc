//! A comparison in rows and columns.

use std::collections::BTreeSet;

use super::reference::Kind;
use super::verdict::Verdict;
use super::{Comparison, ComparisonCell, Sums};
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

/// Those of the rows, that of the columns, then any others.
fn factors(comparison: &Comparison) -> Vec<&str> {
    let all: BTreeSet<&str> =
        comparison.cells.iter().flat_map(|cell| cell.factors.keys()).map(String::as_str).collect();
    let of_table = || comparison.row_factors.iter().copied().chain([comparison.column_factor]);
    let further = all.into_iter().filter(|factor| !of_table().any(|other| other == *factor));
    of_table().chain(further).collect()
}

/// The paper's table, and in each cell a line per figure. Rows that did not run are left out, unless none did.
pub(super) fn for_people(comparison: &Comparison) -> Grid {
    let column_factor = comparison.column_factor;
    let factors: Vec<&str> = factors(comparison).into_iter().filter(|factor| *factor != column_factor).collect();
    let mut columns: Vec<Column> = factors.iter().chain([&""]).map(|factor| Column::left(*factor)).collect();
    columns.extend(comparison.columns.iter().map(|label| Column::right(label.as_str())));
    let all: Vec<&[ComparisonCell]> = comparison.cells.chunks(comparison.columns.len().max(1)).collect();
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
    let name = |row: &&[ComparisonCell]| {
        comparison.row_factors.iter().map(|factor| row[0].label(factor)).collect::<Vec<_>>().join(" ")
    };
    let mut left_out: Vec<String> = all.iter().filter(|row| some_ran && !ran(row)).map(name).collect();
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
    Sums,
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
            (Self::Sums, any(|cell| cell.sums.is_some())),
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
            Self::Sums => "sums",
        }
    }
}

fn entry(comparison: &Comparison, cell: &ComparisonCell, figures: &[Figure], footnotes: &mut Vec<String>) -> Entry {
    let decimals = cell.metric().decimals;
    let show = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| finite(value, decimals));
    let ours = cell.ours.as_ref();
    let line = |figure: &Figure| match figure {
        Figure::Ours => show(ours.map(|ours| ours.mean)) + &failures(comparison, cell),
        Figure::Interval => ours.and_then(|ours| ours.ci95).map_or_else(String::new, |ends| interval(ends, decimals)),
        Figure::Paper => paper(comparison, cell, footnotes),
        Figure::Program => show(cell.program),
        Figure::Medians if cell.kind == Kind::Mean => String::new(),
        Figure::Medians => format!("{} / {}", show(ours.and_then(|ours| ours.median)), show(cell.program_median)),
        Figure::Sums => cell.sums.map_or_else(String::new, sums),
    };
    Entry::Lines(figures.iter().map(line).collect())
}

/// A number in a few digits, or that it is beyond all numbers.
fn finite(value: f64, decimals: u8) -> String {
    if value.is_finite() { short(value, decimals) } else { "∞".to_owned() }
}

fn interval([low, high]: [f64; 2], decimals: u8) -> String {
    format!("[{}, {}]", finite(low, decimals), finite(high, decimals))
}

/// `9/18, paper 93/138`: ours, and the published ones where they are known.
fn sums(sums: Sums) -> String {
    let text = |[above, below]: [f64; 2]| format!("{}/{}", short(above, 0), short(below, 0));
    let published = sums.published.map_or_else(String::new, |published| format!(", paper {}", text(published)));
    text(sums.ours) + &published
}

/// The published value with the verdict; a reason goes below the table.
fn paper(comparison: &Comparison, cell: &ComparisonCell, footnotes: &mut Vec<String>) -> String {
    let Some(published) = cell.published else { return "-".to_owned() };
    let mut text = match cell.published_runs {
        Some(runs) => format!("{} (n {runs})", short(published, cell.metric().decimals)),
        None if cell.sums.is_some_and(|sums| sums.published.is_some()) => short(published, cell.metric().decimals),
        None => published.to_string(),
    };
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

/// What the paper says in words: a row per claim.
pub(super) fn of_claims(comparison: &Comparison) -> Grid {
    let columns = ["claim", "verdict", "ours", "95 %", "paper"].map(Column::left).into();
    let row = |cell: &ComparisonCell| {
        let ours = cell.ours.as_ref();
        let interval = ours.and_then(|ours| ours.ci95).map_or_else(String::new, |ends| interval(ends, 2));
        let paper = cell.published.map_or_else(|| "-".to_owned(), |published| short(published, 2));
        let mean = ours.map_or_else(|| "-".to_owned(), |ours| finite(ours.mean, 2));
        let verdict = cell.verdict.map_or("", Verdict::as_str);
        [cell.label(comparison.column_factor), verdict, &mean, &interval, &paper].map(Entry::text).into()
    };
    let name = |cell: &ComparisonCell| cell.label(comparison.column_factor).to_owned();
    let (said, not_run): (Vec<_>, Vec<_>) =
        comparison.cells.iter().partition(|cell| cell.verdict != Some(Verdict::NotRun));
    let say = |cell: &&ComparisonCell| format!("{}: {}.", name(cell), cell.note.as_deref().unwrap_or_default());
    let mut notes = vec![
        "Each claim is a figure made of our runs and the side on which it must lie. It holds or does not hold where the \
         whole 95 % interval (bootstrap over runs) lies on one side, and is undecided otherwise."
            .to_owned(),
    ];
    notes.extend(said.iter().map(say));
    let shown = if said.is_empty() { &not_run } else { &said };
    if !said.is_empty() && !not_run.is_empty() {
        let names: Vec<_> = not_run.iter().map(|cell| name(cell)).collect();
        notes.push(format!("Not run: {}.", names.join(", ")));
    }
    let title = format!("{}: what it says", comparison.citation);
    Grid { title, columns, rows: shown.iter().map(|cell| row(cell)).collect(), notes, footnotes: Vec::new() }
}

fn notes(comparison: &Comparison, figures: &[Figure], left_out: &[String], cites: bool) -> Vec<String> {
    let count = |verdict| comparison.cells.iter().filter(|cell| cell.verdict == Some(verdict)).count();
    let beside = comparison.counts_successes && !comparison.measured().ratio;
    let failures = if beside { " (successful of finished runs if some failed)" } else { "" };
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
    if figures.contains(&Figure::Sums) {
        notes.push("Sums: those whose ratio is compared.".to_owned());
    }
    if comparison.cells.iter().all(|cell| cell.metric().timing) {
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
