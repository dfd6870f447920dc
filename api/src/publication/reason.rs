//! What there is to say about a cell in words: why a verdict is what it is.
//!
//! All of it follows from the numbers; no sentence knows a cell.

use super::reference::{ProgramValue, Reference};
use super::verdict::{Verdict, agree, interval_of_program};
use super::{ComparisonCell, Ours};
use crate::table::short;

/// Fills in note and, for a verdict `different`, the reason; the note may hold what was said before.
pub(super) fn explain(reference: &Reference, cell: &mut ComparisonCell) {
    let decimals = cell.metric().decimals;
    let different = cell.verdict == Some(Verdict::Different);
    let program = if different { beside_program(reference, cell) } else { apart_from_program(cell) };
    let reasons = [failures(cell), cell.note.take(), program, unpublished(reference, cell)];
    let reasons = joined(reasons.into_iter().flatten());
    cell.note = joined([beside(cell, decimals), reasons.clone()].into_iter().flatten());
    cell.reason = reasons.filter(|_| different);
}

/// Adds what became known of a cell's runs to its note and reason.
pub(super) fn add(cell: &mut ComparisonCell, more: &str) {
    for text in [&mut cell.note, &mut cell.reason] {
        *text = joined(text.take().into_iter().chain([more.to_owned()]));
    }
}

fn joined(parts: impl Iterator<Item = String>) -> Option<String> {
    let parts: Vec<String> = parts.collect();
    (!parts.is_empty()).then(|| parts.join("; "))
}

/// Both values in words, where they do not agree.
fn beside(cell: &ComparisonCell, decimals: u8) -> Option<String> {
    if !matches!(cell.verdict, Some(Verdict::Different | Verdict::SameRanking)) {
        return None;
    }
    let (published, ours) = (cell.published?, cell.ours?);
    let interval = ours.ci95.map_or_else(String::new, |[low, high]| {
        format!(", 95 % interval {} to {}", short(low, decimals), short(high, decimals))
    });
    Some(format!("ours {} (n {}{interval}), published {published}", short(ours.mean, decimals), ours.n))
}

/// No average stands without its failures; the reason of a verdict `different` gets them by outcome.
fn failures(cell: &ComparisonCell) -> Option<String> {
    if cell.verdict == Some(Verdict::Different) {
        return None;
    }
    let (successes, runs) = cell.success.filter(|(successes, runs)| successes < runs)?;
    (cell.measured != "success").then(|| format!("{successes} of {runs} runs successful"))
}

/// Where paper and program disagree by more than a factor of two, ours cannot meet both.
fn apart_from_program(cell: &ComparisonCell) -> Option<String> {
    let (published, program) = (cell.published?, cell.program?);
    let apart = published.max(program) > 2.0 * published.min(program);
    apart.then(|| format!("the authors' own program gives {} here, not {published}", short(program, 2)))
}

/// How ours and the published value compare with what the authors' program gave.
fn beside_program(reference: &Reference, cell: &ComparisonCell) -> Option<String> {
    let (published, ours) = (cell.published?, cell.ours?);
    if reference.is_timing() {
        return Some("times of different machines".to_owned());
    }
    let program = program(reference, cell)?;
    let named = format!("the authors' own program ({})", described(&program, cell.metric().decimals));
    let Some((ours_agrees, paper_agrees)) = agreement(published, &ours, &program) else {
        return Some(format!("one run is too few to tell whether it agrees with {named}"));
    };
    Some(match (ours_agrees, paper_agrees) {
        (true, false) => format!("ours agrees with {named}, which does not reproduce the published value either"),
        (true, true) => format!("both ours and the published value lie within the spread of {named}"),
        (false, true) => format!("the published value lies within the spread of {named}, ours does not"),
        (false, false) => {
            format!("neither ours nor the published value agrees with {named}{}", times(published, &ours, &program))
        }
    })
}

fn program(reference: &Reference, cell: &ComparisonCell) -> Option<ProgramValue> {
    let at = |factor: &&str| cell.label(factor).to_owned();
    let row: Vec<String> = reference.row_factors.iter().map(at).collect();
    let column = cell.label(reference.column_factor);
    reference.cells.iter().find(|known| known.row == row && known.column == column)?.program
}

fn described(program: &ProgramValue, decimals: u8) -> String {
    let median = program.median.map_or_else(String::new, |median| format!("median {}, ", short(median, decimals)));
    format!("{}, {median}{} runs", short(program.value, decimals), program.runs)
}

/// Whether ours, and whether the published value, agrees with the program; unknown without an interval of ours.
fn agreement(published: f64, ours: &Ours, program: &ProgramValue) -> Option<(bool, bool)> {
    let interval = interval_of_program(program, ours)?;
    let ours_agrees = agree((ours.mean, ours.ci95?), (program.value, interval));
    Some((ours_agrees, (interval[0]..=interval[1]).contains(&published)))
}

/// How far both are from the program: by the medians where both are known, since few runs carry the means.
fn times(published: f64, ours: &Ours, program: &ProgramValue) -> String {
    if program.value <= 0.0 {
        return String::new();
    }
    let of_ours = match (ours.median, program.median) {
        (Some(ours), Some(program)) if program > 0.0 => {
            format!("our median is {} times its median", factor(ours / program))
        }
        _ => format!("ours is {} times its value", factor(ours.mean / program.value)),
    };
    format!(": {of_ours}, the published value {} times its value", factor(published / program.value))
}

fn factor(factor: f64) -> String {
    short(factor, if factor >= 10.0 { 0 } else { 2 })
}

fn unpublished(reference: &Reference, cell: &ComparisonCell) -> Option<String> {
    cell.published.is_none().then(|| reference.unpublished.to_owned())
}
