//! A comparison in rows and columns.

use std::collections::BTreeSet;

use super::reference::{FIELDS, MEAN};
use super::verdict::Verdict;
use super::{Comparison, ComparisonCell};
use crate::table::{Column, Entry, Grid, metric, short};

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

/// The paper's table: a row per algorithm, a column per crop and their mean; ours above, the paper's below.
///
/// Algorithms that did not run are left out, unless none did.
pub(super) fn for_people(comparison: &Comparison) -> Grid {
    let factors: Vec<&str> = factors(comparison).into_iter().filter(|factor| *factor != "field").collect();
    let mut columns: Vec<Column> = factors.iter().map(|factor| Column::left(*factor)).collect();
    columns.extend(FIELDS.into_iter().chain([MEAN]).map(Column::right));
    let all: Vec<&[ComparisonCell]> = comparison.cells.chunks(FIELDS.len() + 1).collect();
    let ran = |row: &&&[ComparisonCell]| row.iter().any(|cell| cell.ours.is_some());
    let some_ran = all.iter().any(|row| ran(&row));
    let shown = all.iter().filter(|row| !some_ran || ran(row));
    let row = |cells: &&[ComparisonCell]| {
        let labels = factors.iter().map(|factor| Entry::text(cells[0].label(factor)));
        labels.chain(cells.iter().map(|cell| entry(comparison, cell))).collect()
    };
    let rows = shown.map(row).collect();
    let left_out: Vec<&str> =
        all.iter().filter(|row| some_ran && !ran(row)).map(|row| row[0].label("algorithm")).collect();
    Grid { title: title(comparison), columns, rows, notes: notes(comparison, &left_out) }
}

fn title(comparison: &Comparison) -> String {
    let number = comparison.table.replace('-', " ");
    format!("{}, {number}: {}", comparison.citation, measured(comparison).heading())
}

fn measured(comparison: &Comparison) -> crate::table::Metric {
    metric(if comparison.metric == "success_ratio" { "success" } else { &comparison.metric })
}

/// Our mean, its interval, and the paper's value with the verdict: a line each.
fn entry(comparison: &Comparison, cell: &ComparisonCell) -> Entry {
    let show = |value| short(value, measured(comparison).decimals);
    let mut lines = Vec::new();
    match cell.ours {
        Some(ours) => {
            lines.push(format!("{}{}", show(ours.mean), failures(comparison, cell)));
            lines.extend(ours.ci95.map(|[low, high]| format!("[{}, {}]", show(low), show(high))));
        }
        None => lines.push("-".to_owned()),
    }
    lines.extend(match (cell.published, cell.program, cell.verdict) {
        (Some(published), _, None | Some(Verdict::NotRun)) => Some(published.to_string()),
        (Some(published), _, Some(verdict)) => Some(format!("{published} {}", verdict.as_str())),
        (None, Some(program), _) => Some(format!("program {}", show(program))),
        (None, None, _) => None,
    });
    Entry::Lines(lines)
}

/// Successful of finished runs beside an average, unless all were, or the average is the success ratio itself.
fn failures(comparison: &Comparison, cell: &ComparisonCell) -> String {
    match cell.success {
        Some((successes, runs)) if successes < runs && comparison.metric != "success_ratio" => {
            format!(" ({successes}/{runs})")
        }
        _ => String::new(),
    }
}

fn notes(comparison: &Comparison, left_out: &[&str]) -> Vec<String> {
    let count = |verdict| comparison.cells.iter().filter(|cell| cell.verdict == Some(verdict)).count();
    let failures =
        if comparison.metric == "success_ratio" { "" } else { " (successful of finished runs if some failed)" };
    let mut notes = vec![
        format!("Ours: mean{failures} and 95 % interval. Last line: the paper's value and the verdict."),
        format!(
            "Of the paper's values {} are inside our interval, {} keep their ranking, {} differ.",
            count(Verdict::Inside),
            count(Verdict::SameRanking),
            count(Verdict::Different),
        ),
    ];
    let mut left_out = left_out.to_vec();
    left_out.dedup();
    if !left_out.is_empty() {
        notes.push(format!("Not run: {}.", left_out.join(", ")));
    }
    notes.extend(comparison.note.as_ref().map(|note| format!("The paper: {note}.")));
    notes
}
