//! Our runs beside each published cell.

use std::collections::BTreeMap;

use super::error::PublicationError;
use super::reason::explain;
use super::reference::{ALGORITHMS, FIELDS, MEAN, Reference, find};
use super::verdict::{Pair, Verdict, interval_of_means, judge};
use super::{Comparison, ComparisonCell, Ours};
use crate::table::{CellData, Series, SweepData, summarize};

/// Puts the runs of a sweep with the factors `algorithm` and `field` beside a published table; without a sweep
/// every verdict is `not-run`. Runs with labels that the paper does not know are left out. For medians, the
/// data must hold the values and not only their moments.
///
/// # Errors
/// Names the publication or the table that is not known, and those that are.
pub fn compare(source: &str, table: &str, data: Option<&SweepData>) -> Result<Comparison, PublicationError> {
    let (source, reference) = find(source, table)?;
    let runs: Vec<&CellData> =
        data.map(|data| data.cells.iter().filter(|cell| is_known(cell)).collect()).unwrap_or_default();
    let cells = variants(&runs).iter().flat_map(|variant| block(reference, &runs, variant)).collect();
    Ok(Comparison {
        source: source.to_owned(),
        table: reference.name.to_owned(),
        citation: reference.citation().to_owned(),
        metric: reference.metric_name().to_owned(),
        unit: reference.unit().to_owned(),
        note: reference.note().map(str::to_owned),
        program_source: reference.program_source(),
        cells,
    })
}

fn label<'a>(cell: &'a CellData, factor: &str) -> &'a str {
    cell.factors.get(factor).map_or("", String::as_str)
}

fn is_known(cell: &CellData) -> bool {
    ALGORITHMS.contains(&label(cell, "algorithm")) && FIELDS.contains(&label(cell, "field"))
}

/// The combinations of labels of those further factors in which the runs differ: one empty one if they do not.
fn variants(runs: &[&CellData]) -> Vec<BTreeMap<String, String>> {
    let further = |factor: &&String| !matches!(factor.as_str(), "algorithm" | "field");
    let differs = |factor: &&String| runs.iter().any(|cell| label(cell, factor) != label(runs[0], factor));
    let factors: Vec<&String> = runs.first().map(|cell| cell.factors.keys().collect()).unwrap_or_default();
    let factors: Vec<&String> = factors.into_iter().filter(further).filter(differs).collect();
    let mut variants: Vec<BTreeMap<String, String>> = Vec::new();
    for cell in runs {
        let labels = factors.iter().map(|factor| ((*factor).clone(), label(cell, factor).to_owned())).collect();
        if !variants.contains(&labels) {
            variants.push(labels);
        }
    }
    if variants.is_empty() { vec![BTreeMap::new()] } else { variants }
}

/// All cells of the table for one variant.
fn block(reference: &Reference, runs: &[&CellData], variant: &BTreeMap<String, String>) -> Vec<ComparisonCell> {
    let mut cells = Vec::new();
    for algorithm in ALGORITHMS {
        let mut means = Vec::new();
        for field in FIELDS {
            let group = Group::of(reference, runs, algorithm, field, variant);
            means.extend(group.ours(reference));
            cells.push(cell(reference, algorithm, field, variant, &group));
        }
        let mut last = cell(reference, algorithm, MEAN, variant, &Group::default());
        match means.len() {
            0 => {}
            4 => last.ours = Some(mean_of(&means)),
            _ => last.note = Some("the mean takes runs in all four crops".to_owned()),
        }
        cells.push(last);
    }
    let verdicts: Vec<Option<Verdict>> = (0..cells.len()).map(|index| verdict(&cells, index)).collect();
    for (cell, verdict) in cells.iter_mut().zip(verdicts) {
        cell.verdict = verdict;
        explain(reference, cell);
    }
    cells
}

/// Our runs of one cell.
#[derive(Default)]
struct Group {
    total: u64,
    done: u64,
    series: Series,
    success: Series,
}

impl Group {
    fn of(
        reference: &Reference,
        runs: &[&CellData],
        algorithm: &str,
        field: &str,
        variant: &BTreeMap<String, String>,
    ) -> Self {
        let mut group = Self::default();
        let here = |cell: &&&CellData| {
            label(cell, "algorithm") == algorithm
                && label(cell, "field") == field
                && variant.iter().all(|(factor, level)| label(cell, factor) == level)
        };
        for cell in runs.iter().filter(here) {
            group.total += cell.total;
            group.done += cell.done;
            cell.metrics.get(reference.measured()).inspect(|series| group.series.merge(series));
            cell.metrics.get("success").inspect(|series| group.success.merge(series));
        }
        group
    }

    fn ours(&self, reference: &Reference) -> Option<Ours> {
        let statistics = summarize(&self.series, reference.metric().ratio);
        let mean = statistics.mean?;
        Some(Ours { mean, median: statistics.median, ci95: statistics.ci95, n: statistics.n })
    }

    /// Successful and finished runs.
    fn successes(&self) -> Option<(u64, u64)> {
        let statistics = summarize(&self.success, true);
        statistics.mean.map(|mean| ((mean * statistics.n as f64).round() as u64, statistics.n))
    }
}

fn mean_of(means: &[Ours]) -> Ours {
    Ours {
        mean: means.iter().map(|ours| ours.mean).sum::<f64>() / means.len() as f64,
        median: None,
        ci95: interval_of_means(means),
        n: means.iter().map(|ours| ours.n).sum(),
    }
}

fn cell(
    reference: &Reference,
    algorithm: &str,
    field: &str,
    variant: &BTreeMap<String, String>,
    group: &Group,
) -> ComparisonCell {
    let program = reference.program(algorithm, field);
    let mut factors = variant.clone();
    factors.insert("algorithm".to_owned(), algorithm.to_owned());
    factors.insert("field".to_owned(), field.to_owned());
    let missing = group.total.saturating_sub(group.done);
    ComparisonCell {
        factors,
        published: reference.value(algorithm, field),
        program: program.map(|program| program.value),
        program_median: program.and_then(|program| program.median),
        program_runs: program.map(|program| program.runs),
        ours: group.ours(reference),
        verdict: None,
        note: (missing > 0).then(|| format!("{missing} of {} runs have no result (yet)", group.total)),
        reason: None,
        success: group.successes(),
    }
}

fn verdict(cells: &[ComparisonCell], index: usize) -> Option<Verdict> {
    match (cells[index].published, &cells[index].ours) {
        (_, None) => Some(Verdict::NotRun),
        (Some(published), Some(ours)) => Some(judge(published, ours, &others(cells, index))),
        (None, Some(_)) => None,
    }
}

/// The other finders of the same column that have both a published value and ours.
fn others(cells: &[ComparisonCell], index: usize) -> Vec<Pair> {
    let field = cells[index].label("field");
    let same = cells.iter().enumerate().filter(|(other, cell)| *other != index && cell.label("field") == field);
    same.filter_map(|(_, cell)| Some((cell.published?, cell.ours?.mean))).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::publication::{is_of_times, tables_of, unmeasured_tables_of};
    use crate::table::Format;

    fn run(algorithm: &str, field: &str, errors: &[f64], successes: &[f64]) -> CellData {
        CellData {
            factors: BTreeMap::from([("algorithm".into(), algorithm.into()), ("field".into(), field.into())]),
            total: 4,
            done: errors.len() as u64,
            failed: 0,
            metrics: BTreeMap::from([
                ("mean_squared_error_mm2".into(), Series::of(errors.iter().copied())),
                ("success".into(), Series::of(successes.iter().copied())),
            ]),
        }
    }

    fn data() -> SweepData {
        SweepData {
            factors: vec!["algorithm".into(), "field".into()],
            cells: vec![
                run("oracle", "crop-1", &[1.0; 4], &[1.0; 4]),
                run("pearl", "crop-1", &[65.0, 66.0, 64.5, 66.5], &[1.0; 4]),
                run("rg", "crop-1", &[60.0, 61.0, 60.5, 60.0], &[1.0, 1.0, 0.0, 0.0]),
                run("rgop", "crop-1", &[64.0, 65.0, 66.0, 67.0], &[1.0; 4]),
                run("rgop", "crop-2", &[276.0, 277.0, 281.0, 282.0], &[1.0; 4]),
                run("rgop", "crop-3", &[45.0, 45.5, 46.0], &[1.0; 3]),
                run("rgop", "crop-4", &[600.0, 700.0, 1_800.0, 650.0], &[1.0, 1.0, 0.0, 1.0]),
                run("rgop", "south-end", &[9.0; 4], &[1.0; 4]),
                run("rgoppn", "crop-2", &[300.0, 290.0, 295.0, 310.0], &[1.0; 4]),
            ],
        }
    }

    fn find_cell<'a>(comparison: &'a Comparison, algorithm: &str, field: &str) -> &'a ComparisonCell {
        let here = |cell: &&ComparisonCell| cell.label("algorithm") == algorithm && cell.label("field") == field;
        comparison.cells.iter().find(here).unwrap()
    }

    #[test]
    fn a_cell_is_exactly_as_clients_know_it() {
        let errors = compare("guyonneau2022", "table-3", Some(&data())).unwrap();
        let json = json!(errors);
        assert_eq!(json["source"], "guyonneau2022");
        assert_eq!(json["table"], "table-3");
        assert_eq!(json["metric"], "mean_squared_error_mm2");
        assert_eq!(json["unit"], "mm^2");
        let cell = &json["cells"][15];
        assert_eq!(cell["factors"], json!({"algorithm": "rgop", "field": "crop-1"}));
        assert_eq!((&cell["published"], &cell["program"]), (&json!(65.0), &json!(67.0)));
        assert_eq!((&cell["program_median"], &cell["program_runs"]), (&json!(66.3), &json!(7)));
        assert_eq!((&cell["ours"]["mean"], &cell["ours"]["n"]), (&json!(65.5), &json!(4)));
        assert_eq!((&cell["verdict"], &cell["note"]), (&json!("inside"), &json!(null)));
        assert_eq!(json["cells"][5]["ours"], json!(null));
        assert_eq!(json["cells"][5]["verdict"], "not-run");
    }

    #[test]
    fn the_verdict_says_inside_same_ranking_or_different() {
        let errors = compare("guyonneau2022", "table-3", Some(&data())).unwrap();
        let verdict = |algorithm, field| find_cell(&errors, algorithm, field).verdict;
        assert_eq!(verdict("rgop", "crop-1"), Some(Verdict::Inside));
        assert_eq!(verdict("rgop", "crop-2"), Some(Verdict::SameRanking));
        assert_eq!(verdict("rgop", "crop-3"), Some(Verdict::Different));
        assert_eq!(verdict("rg", "crop-1"), Some(Verdict::Different));
        assert_eq!(verdict("pearl", "crop-1"), None);
        assert_eq!(verdict("ruby", "crop-1"), Some(Verdict::NotRun));
        let note = find_cell(&errors, "rgop", "crop-3").note.clone().unwrap();
        let reason = "1 of 4 runs have no result (yet); ours agrees with the authors' own program \
                      (45.5, median 45.4, 7 runs), which does not reproduce the published value either";
        assert_eq!(note, format!("ours 45.5 (n 3, 95 % interval 44.3 to 46.7), published 67; {reason}"));
        assert_eq!(find_cell(&errors, "rgop", "crop-3").reason.as_deref(), Some(reason));
        let note = find_cell(&errors, "ruby", "crop-1").note.clone().unwrap();
        assert_eq!(note, "the authors' own program gives 62.90 here, not 2900");
    }

    #[test]
    fn the_mean_column_takes_all_four_crops() {
        let success = compare("guyonneau2022", "table-2", Some(&data())).unwrap();
        let mean = find_cell(&success, "rgop", "mean");
        let ours = mean.ours.unwrap();
        assert_eq!((ours.mean, ours.median, ours.n), (0.9375, None, 15));
        let [low, high] = ours.ci95.unwrap();
        assert!(0.68 < low && 0.98 < high && high < 1.0, "[{low}, {high}]");
        assert_eq!(mean.verdict, Some(Verdict::Different));
        assert_eq!(find_cell(&success, "rgoppn", "mean").ours, None);
        assert!(find_cell(&success, "rgoppn", "mean").note.is_some());
    }

    #[test]
    fn without_a_sweep_the_published_values_stand_alone() {
        let times = compare("guyonneau2022", "table-4", None).unwrap();
        assert_eq!(times.cells.len(), 30);
        assert!(times.cells.iter().all(|cell| cell.verdict == Some(Verdict::NotRun) && cell.program.is_none()));
        assert_eq!(times.cells.iter().filter(|cell| cell.published.is_some()).count(), 25);
    }

    #[test]
    fn runs_that_differ_in_a_further_factor_are_not_put_together() {
        let mut data = data();
        let mut printed = run("rgop", "crop-1", &[100.0, 101.0], &[1.0, 1.0]);
        data.cells.iter_mut().for_each(|cell| drop(cell.factors.insert("selection".into(), "as-run".into())));
        printed.factors.insert("selection".into(), "as-printed".into());
        data.cells.push(printed);
        let errors = compare("guyonneau2022", "table-3", Some(&data)).unwrap();
        assert_eq!(errors.cells.len(), 60);
        let of = |selection: &str| {
            let mut cells = errors.cells.iter().filter(|cell| cell.label("selection") == selection);
            cells.find(|cell| cell.label("algorithm") == "rgop").and_then(|cell| cell.ours).map(|ours| ours.mean)
        };
        assert_eq!((of("as-run"), of("as-printed")), (Some(65.5), Some(100.5)));
    }

    #[test]
    fn tables_of_times_belong_to_a_sweep_that_measured_times() {
        let mut data = data();
        let names = |data: &SweepData| {
            tables_of("guyonneau2022/bounds", data).into_iter().map(|(_, table)| table).collect::<Vec<_>>()
        };
        assert_eq!(names(&data), ["table-2", "table-3", "table-5"]);
        assert_eq!(unmeasured_tables_of("guyonneau2022/bounds", &data), ["table-4", "table-6"]);
        data.cells[0].metrics.insert("line_finding_time_ms".into(), Series::of([0.03]));
        assert_eq!(names(&data), ["table-2", "table-3", "table-4", "table-5"]);
        assert_eq!(tables_of("mine", &data), []);
        assert!(unmeasured_tables_of("mine", &data).is_empty());
        assert!(is_of_times("guyonneau2022", "table-6") && !is_of_times("guyonneau2022", "table-5"));
    }

    #[test]
    fn a_comparison_in_every_format() {
        let errors = compare("guyonneau2022", "table-3", Some(&data())).unwrap();
        insta::with_settings!({prepend_module_to_snapshot => false}, {
            for format in [Format::Csv, Format::Md, Format::Latex, Format::Text] {
                insta::assert_snapshot!(format!("table_3_{}", format.as_str()), errors.write(format));
            }
        });
    }
}
