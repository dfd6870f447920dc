//! The runs that a verdict `different` cites.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use furrow_coordinator::view::RunValue;
use furrow_coordinator::{Coordinator, StoreError};
use furrow_schema::id::{JobKey, SweepId};
use furrow_schema::sweep::Sweep;

use super::reason::add;
use super::reference::Kind;
use super::verdict::Verdict;
use super::{Comparison, ComparisonCell, compare, tables_of};
use crate::table::{Metric, SweepData, median, metric, short};

/// The outcome of a run that reached its end without damage.
const SUCCESS: &str = "success";

/// So many failed runs are named.
const FAILED_NAMED: usize = 3;

/// So many digits of a key are given; any beginning of a key that is no other's finds its job.
const KEY_DIGITS: usize = 12;

/// The published tables in which there is anything of a sweep, with the runs that verdicts `different` cite.
///
/// # Errors
/// The store's.
pub async fn of_sweep(
    coordinator: &Coordinator,
    sweep: &Sweep,
    data: &SweepData,
) -> Result<Vec<Comparison>, StoreError> {
    let mut comparisons = Vec::new();
    for (source, table) in tables_of(&sweep.plan, data) {
        let Ok(mut comparison) = compare(source, table, Some(data)) else { continue };
        if comparison.cells.iter().any(|cell| cell.ours.is_some()) {
            cite(coordinator, sweep.id, &mut comparison).await?;
            comparisons.push(comparison);
        }
    }
    Ok(comparisons)
}

/// Adds to each verdict `different` how many runs failed and by which outcome, and the keys of runs to look at:
/// nearest to the median, farthest from it, failed. `sweep` is the one that was compared; only the runs of such
/// cells are fetched.
///
/// # Errors
/// The store's.
pub async fn cite(coordinator: &Coordinator, sweep: SweepId, comparison: &mut Comparison) -> Result<(), StoreError> {
    for index in 0..comparison.cells.len() {
        if comparison.cells[index].verdict != Some(Verdict::Different) {
            continue;
        }
        let metric = of_one_run(comparison.cells[index].metric());
        let (labels, prefix) = runs_of(&comparison.cells, index);
        let runs = coordinator.runs(sweep, &labels, &metric.name).await?;
        if let Some(text) = evidence(&runs, &metric) {
            add(&mut comparison.cells[index], &(prefix + &text));
        }
    }
    Ok(())
}

/// What to look at in a run: of a ratio of sums, which no run has, the count below the line.
fn of_one_run(of_cell: Metric) -> Metric {
    of_cell.of_sums.map_or(of_cell, |of| metric(of.denominator))
}

/// Where the runs behind a cell are: for a mean over the crops in the crop that is farthest from the published one.
fn runs_of(cells: &[ComparisonCell], index: usize) -> (BTreeMap<String, String>, String) {
    if cells[index].kind != Kind::Mean {
        return (cells[index].runs.clone(), String::new());
    }
    let labels = cells[index].factors.clone();
    let same_row = |cell: &&ComparisonCell| {
        cell.kind != Kind::Mean
            && cell.factors.iter().all(|(factor, label)| factor == "field" || labels.get(factor) == Some(label))
    };
    let apart = |cell: &ComparisonCell| Some((cell.ours?.mean - cell.published?).abs());
    let crops = cells.iter().filter(same_row).filter_map(|cell| Some((apart(cell)?, cell.label("field"))));
    let Some((_, crop)) = crops.max_by(|a, b| a.0.total_cmp(&b.0)) else { return (labels, String::new()) };
    let prefix = format!("farthest apart in {crop}, where ");
    let crop = crop.to_owned();
    (labels.into_iter().map(|(k, v)| if k == "field" { (k, crop.clone()) } else { (k, v) }).collect(), prefix)
}

/// The failures by outcome, and the runs to look at.
fn evidence(runs: &[RunValue], metric: &Metric) -> Option<String> {
    let mut cited: Vec<&RunValue> = Vec::new();
    let mut words = Vec::new();
    for (role, run) in chosen(runs, metric) {
        if !cited.iter().any(|other| other.key == run.key) {
            cited.push(run);
            words.push(format!("{role}{} ({})", digits(run.key), described(run, metric)));
        }
    }
    (!words.is_empty()).then(|| format!("{}; runs: {}", failures(runs), words.join(", ")))
}

/// `2 of 5 runs failed (1 crushed, 1 lost)`.
fn failures(runs: &[RunValue]) -> String {
    let mut outcomes: BTreeMap<&str, usize> = BTreeMap::new();
    for run in runs.iter().filter(|run| run.outcome != SUCCESS) {
        *outcomes.entry(&run.outcome).or_default() += 1;
    }
    let failed: usize = outcomes.values().sum();
    if failed == 0 {
        return "no run failed".to_owned();
    }
    let words: Vec<String> = outcomes.into_iter().map(|(outcome, count)| format!("{count} {outcome}")).collect();
    format!("{failed} of {} runs failed ({})", runs.len(), words.join(", "))
}

/// Runs with the reason why they are named. A value that is 0 or 1 has no extreme: there one that went well.
fn chosen<'a>(runs: &'a [RunValue], metric: &Metric) -> Vec<(&'static str, &'a RunValue)> {
    let mut chosen = Vec::new();
    if metric.ratio {
        chosen.extend(runs.iter().find(|run| run.outcome == SUCCESS).map(|run| ("", run)));
    } else {
        let by_distance = by_distance_from_median(runs);
        chosen.extend(by_distance.first().map(|run| ("nearest our median ", *run)));
        chosen.extend(by_distance.last().map(|run| ("farthest from it ", *run)));
    }
    let failed = runs.iter().filter(|run| run.outcome != SUCCESS);
    chosen.extend(failed.take(FAILED_NAMED).map(|run| ("", run)));
    chosen
}

/// Those with a value; equally far ones by seed, then key.
fn by_distance_from_median(runs: &[RunValue]) -> Vec<&RunValue> {
    let values: Vec<f64> = runs.iter().filter_map(|run| run.value).collect();
    let Some(median) = median(&values) else { return Vec::new() };
    let mut known: Vec<&RunValue> = runs.iter().filter(|run| run.value.is_some()).collect();
    let distance = |run: &RunValue| run.value.map_or(f64::INFINITY, |value| (value - median).abs());
    let order = |a: &&RunValue, b: &&RunValue| -> Ordering { distance(a).total_cmp(&distance(b)) };
    known.sort_by(order);
    known
}

fn digits(key: JobKey) -> String {
    key.to_string().chars().take(KEY_DIGITS).collect()
}

/// The value, unless it only says how the run ended; and how that was, if not well.
fn described(run: &RunValue, metric: &Metric) -> String {
    let value = run.value.filter(|_| !metric.ratio).map(|value| short(value, metric.decimals));
    let outcome = (run.outcome != SUCCESS || metric.ratio).then(|| run.outcome.clone());
    value.into_iter().chain(outcome).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(seed: u8, outcome: &str, value: f64) -> RunValue {
        RunValue { key: JobKey([seed; 32]), seed: seed.into(), outcome: outcome.to_owned(), value: Some(value) }
    }

    #[test]
    fn the_run_nearest_the_median_the_farthest_and_failed_ones_are_named_once_each() {
        let runs = [
            run(1, "success", 60.0),
            run(2, "success", 65.0),
            run(3, "lost", 900.0),
            run(4, "crushed", 66.0),
            run(5, "lost", 64.0),
            run(6, "stuck", 70.0),
        ];
        let text = evidence(&runs, &metric("mean_squared_error_mm2")).unwrap();
        let expected = "4 of 6 runs failed (1 crushed, 2 lost, 1 stuck); runs: nearest our median 020202020202 (65.0), \
                        farthest from it 030303030303 (900.0, lost), 040404040404 (66.0, crushed), 050505050505 (64.0, lost)";
        assert_eq!(text, expected);
    }

    #[test]
    fn of_successes_and_failures_one_that_went_well_and_those_that_did_not_are_named() {
        let runs = [run(1, "lost", 0.0), run(2, "success", 1.0), run(3, "success", 1.0)];
        let text = evidence(&runs, &metric("success")).unwrap();
        assert_eq!(text, "1 of 3 runs failed (1 lost); runs: 020202020202 (success), 010101010101 (lost)");
        assert!(evidence(&runs[1..], &metric("success")).unwrap().starts_with("no run failed; runs: 0202"));
        assert_eq!(evidence(&[], &metric("success")), None);
    }
}
