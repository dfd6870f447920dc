//! Our runs beside each published cell.

use std::collections::BTreeMap;

use super::error::PublicationError;
use super::reason::explain;
use super::reference::{Cell, Column, Kind, Reference, find};
use super::verdict::{Pair, Verdict, interval_of_means, judge};
use super::{Comparison, ComparisonCell, Ours, Sums, claims};
use crate::table::{CellData, Pairs, Series, SweepData, summarize};

/// Puts the runs of a sweep beside a published table, or what the paper says in words; without a sweep every verdict
/// is `not-run`. Runs with labels that the paper does not know are left out. For medians, the data must hold the
/// values and not only their moments.
///
/// # Errors
/// Names the publication or the table that is not known, and those that are.
pub fn compare(source: &str, table: &str, data: Option<&SweepData>) -> Result<Comparison, PublicationError> {
    if table == claims::TABLE && claims::exist(source) {
        return claims::check(source, data.as_slice());
    }
    let reference = find(source, table)?;
    let runs: Vec<&CellData> =
        data.map(|data| data.cells.iter().filter(|cell| is_known(reference, cell)).collect()).unwrap_or_default();
    let cells = variants(reference, &runs).iter().flat_map(|variant| block(reference, &runs, variant)).collect();
    Ok(Comparison {
        source: reference.source.to_owned(),
        table: reference.name.to_owned(),
        citation: reference.citation.clone(),
        metric: reference.metric.clone(),
        unit: reference.unit.clone(),
        note: reference.note.clone(),
        program_source: reference.program_source.as_deref(),
        row_factors: reference.row_factors,
        column_factor: reference.column_factor,
        columns: reference.columns.iter().map(|column| column.label.clone()).collect(),
        counts_successes: reference.counts_successes,
        cells,
    })
}

fn label<'a>(cell: &'a CellData, factor: &str) -> &'a str {
    cell.factors.get(factor).map_or("", String::as_str)
}

/// Whether the paper has the row and the column of these runs.
fn is_known(reference: &Reference, cell: &CellData) -> bool {
    let row =
        |row: &Vec<String>| row.iter().zip(reference.row_factors).all(|(level, factor)| label(cell, factor) == level);
    let column = |column: &Column| match column.kind {
        Kind::Level => label(cell, reference.column_factor) == column.label,
        Kind::Measure => true,
        Kind::Mean => false,
    };
    let only = |(factor, label): &(&str, &str)| cell.allows(factor, label);
    reference.rows.iter().any(row) && reference.columns.iter().any(column) && reference.only.iter().all(only)
}

/// The combinations of labels of those further factors in which the runs differ: one empty one if they do not.
fn variants(reference: &Reference, runs: &[&CellData]) -> Vec<BTreeMap<String, String>> {
    let of_table = |factor: &str| factor == reference.column_factor || reference.row_factors.contains(&factor);
    let further = |factor: &&String| !of_table(factor.as_str()) && !reference.pooled.contains(&factor.as_str());
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

/// The labels that the table asks for in further factors which the sweep has.
fn only(reference: &Reference, runs: &[&CellData]) -> BTreeMap<String, String> {
    let has = |factor: &str| runs.first().is_some_and(|cell| cell.factors.contains_key(factor));
    let asked = reference.only.iter().filter(|(factor, _)| has(factor));
    asked.map(|(factor, label)| ((*factor).to_owned(), (*label).to_owned())).collect()
}

/// All cells of the table for one variant.
fn block(reference: &Reference, runs: &[&CellData], variant: &BTreeMap<String, String>) -> Vec<ComparisonCell> {
    let only = only(reference, runs);
    let only = &only;
    let mut cells = Vec::new();
    for row in &reference.rows {
        let mut means = Vec::new();
        for column in reference.columns.iter().filter(|column| column.kind != Kind::Mean) {
            let place = Place { reference, row, column, variant, only };
            let group = Group::of(&place, runs);
            means.extend(group.ours(column));
            cells.push(place.cell(&group));
        }
        for column in reference.columns.iter().filter(|column| column.kind == Kind::Mean) {
            let mut mean = Place { reference, row, column, variant, only }.cell(&Group::default());
            match means.len() {
                0 => {}
                n if n + 1 == reference.columns.len() => mean.ours = Some(mean_of(&means)),
                _ => mean.note = Some("the mean takes runs in all four crops".to_owned()),
            }
            cells.push(mean);
        }
    }
    let verdicts: Vec<Option<Verdict>> = (0..cells.len()).map(|index| verdict(reference, &cells, index)).collect();
    for (cell, verdict) in cells.iter_mut().zip(verdicts) {
        cell.verdict = verdict;
        explain(reference, cell);
    }
    cells
}

/// Where a row meets a column, for runs with the labels of a variant.
struct Place<'a> {
    reference: &'a Reference,
    row: &'a [String],
    column: &'a Column,
    variant: &'a BTreeMap<String, String>,
    /// Labels that all the runs have in further factors.
    only: &'a BTreeMap<String, String>,
}

impl Place<'_> {
    fn row_labels(&self) -> impl Iterator<Item = (&'static str, &String)> {
        self.reference.row_factors.iter().copied().zip(self.row)
    }

    /// The labels of its runs.
    fn labels(&self) -> BTreeMap<String, String> {
        let mut labels = self.variant.clone();
        labels.extend(self.row_labels().map(|(factor, level)| (factor.to_owned(), level.clone())));
        if self.column.kind == Kind::Level {
            labels.insert(self.reference.column_factor.to_owned(), self.column.label.clone());
        }
        labels
    }

    fn cell(&self, group: &Group) -> ComparisonCell {
        let known = self.reference.cell(self.row, self.column);
        let published = known.and_then(|cell: &Cell| cell.published);
        let program = known.and_then(|cell| cell.program);
        let mut factors = self.labels();
        let runs = factors.iter().chain(self.only).map(|(factor, label)| (factor.clone(), label.clone())).collect();
        factors.insert(self.reference.column_factor.to_owned(), self.column.label.clone());
        let missing = group.total.saturating_sub(group.done);
        let sums = Sums { published: published.and_then(|published| published.sums), ours: group.pairs.sums() };
        ComparisonCell {
            factors,
            published: published.map(|published| published.value),
            published_runs: published.and_then(|published| published.runs),
            program: program.map(|program| program.value),
            program_median: program.and_then(|program| program.median),
            program_runs: program.map(|program| program.runs),
            ours: group.ours(self.column),
            sums: (group.pairs.n() > 0 || sums.published.is_some()).then_some(sums),
            verdict: None,
            note: (missing > 0).then(|| format!("{missing} of {} runs have no result (yet)", group.total)),
            reason: None,
            success: group.successes().filter(|_| self.reference.counts_successes),
            kind: self.column.kind,
            measured: self.column.measured.clone(),
            runs,
        }
    }
}

/// Our runs of one cell.
#[derive(Default)]
struct Group {
    total: u64,
    done: u64,
    series: Series,
    pairs: Pairs,
    success: Series,
}

impl Group {
    fn of(place: &Place<'_>, runs: &[&CellData]) -> Self {
        let mut group = Self::default();
        let labels = place.labels();
        let here = |cell: &&&CellData| labels.iter().all(|(factor, level)| label(cell, factor) == level);
        for cell in runs.iter().filter(here) {
            group.total += cell.total;
            group.done += cell.done;
            cell.metrics.get(&place.column.measured).inspect(|series| group.series.merge(series));
            cell.ratios.get(place.column.measured.as_str()).inspect(|pairs| group.pairs.merge(pairs));
            cell.metrics.get("success").inspect(|series| group.success.merge(series));
        }
        group
    }

    fn ours(&self, column: &Column) -> Option<Ours> {
        let metric = column.metric();
        if metric.of_sums.is_some() {
            return Ours::of_pairs(&self.pairs);
        }
        let statistics = summarize(&self.series, metric.ratio);
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

fn verdict(reference: &Reference, cells: &[ComparisonCell], index: usize) -> Option<Verdict> {
    match (cells[index].published, &cells[index].ours) {
        (_, None) => Some(Verdict::NotRun),
        (Some(published), Some(ours)) => Some(judge(published, ours, &others(reference, cells, index))),
        (None, Some(_)) => None,
    }
}

/// The other cells of the same column that have both a published value and ours.
fn others(reference: &Reference, cells: &[ComparisonCell], index: usize) -> Vec<Pair> {
    let column = |cell: &ComparisonCell| cell.label(reference.column_factor).to_owned();
    let here = column(&cells[index]);
    let same = cells.iter().enumerate().filter(|(other, cell)| *other != index && column(cell) == here);
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
            ratios: BTreeMap::new(),
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

    fn lane_run(labels: &[(&str, &str)], interventions: &[f64]) -> CellData {
        let pairs = || interventions.iter().map(|count| [100.0, count - 1.0]);
        let shares = interventions.iter().map(|count| [(count - 1.0) / 2.0, count - 1.0]);
        CellData {
            factors: labels.iter().map(|(factor, label)| ((*factor).to_owned(), (*label).to_owned())).collect(),
            total: interventions.len() as u64,
            done: interventions.len() as u64,
            metrics: BTreeMap::from([("interventions".into(), Series::of(interventions.iter().copied()))]),
            ratios: BTreeMap::from([
                ("distance_per_intervention_m", Pairs::of(pairs())),
                ("gap_share", Pairs::of(shares)),
            ]),
            ..CellData::default()
        }
    }

    fn lanes(cells: Vec<CellData>) -> SweepData {
        SweepData { factors: cells[0].factors.keys().cloned().collect(), cells }
    }

    #[test]
    fn rows_and_columns_may_be_of_any_factors() {
        let at =
            |hz, counts: &[f64]| lane_run(&[("algorithm", "pl-lgg"), ("field", "lane-b"), ("lidar_hz", hz)], counts);
        let data = lanes(vec![at("40", &[4.0, 6.0, 5.0]), at("10", &[7.0, 9.0, 8.0]), at("20", &[6.0, 6.0])]);
        let rates = compare("velasquez2022", "table-2", Some(&data)).unwrap();
        assert_eq!(rates.cells.len(), 12);
        let ran: Vec<&ComparisonCell> = rates.cells.iter().filter(|cell| cell.ours.is_some()).collect();
        let of = |cell: &&ComparisonCell| (cell.label("lidar_hz").to_owned(), cell.ours.unwrap().mean, cell.verdict);
        let inside = Some(Verdict::Inside);
        assert_eq!(ran.iter().map(of).collect::<Vec<_>>(), [("40".into(), 5.0, inside), ("10".into(), 8.0, inside)]);
        assert_eq!(ran[0].published_runs, Some(1));
        let text = rates.write(Format::Text);
        assert!(text.contains("lidar_hz") && text.contains("5.00 (n 1) inside"), "{text}");

        let gaps = compare("velasquez2022", "table-1", Some(&data)).unwrap();
        let ran: Vec<&ComparisonCell> = gaps.cells.iter().filter(|cell| cell.ours.is_some()).collect();
        assert_eq!((ran.len(), ran[0].ours.unwrap().n), (1, 3), "table 1 is of 40 Hz");
        assert_eq!(ran[0].runs["lidar_hz"], "40");
    }

    #[test]
    fn a_distance_without_an_intervention_is_beside_the_published_one() {
        let none = lane_run(&[("algorithm", "pl-ekf-lgg"), ("field", "iaf")], &[1.0; 20]);
        let pl = lane_run(&[("algorithm", "pl-lgg"), ("field", "iaf")], &[3.0, 4.0, 2.0]);
        let figure = compare("velasquez2022", "figure-18", Some(&lanes(vec![none, pl]))).unwrap();
        let cell = find_cell(&figure, "pl-ekf-lgg", "iaf");
        let [low, high] = cell.ours.unwrap().ci95.unwrap();
        assert!((low - 542.2).abs() < 0.1 && high == f64::INFINITY, "2,000 m / 3.689: {low}");
        assert_eq!(json!(cell)["ours"]["mean"], json!(null));
        assert_eq!(cell.verdict, Some(Verdict::SameRanking), "400 m is less");
        let pl = find_cell(&figure, "pl-lgg", "iaf");
        assert_eq!((pl.ours.unwrap().mean, pl.sums.unwrap().ours), (50.0, [300.0, 6.0]));
        assert_eq!(pl.verdict, Some(Verdict::Inside));
        let unpublished = find_cell(&figure, "pl-lgg", "es-1");
        assert!(unpublished.note.as_ref().unwrap().contains("not in the paper's table"));
        assert!(figure.write(Format::Text).contains("∞"));
    }

    #[test]
    fn columns_may_be_metrics_of_the_same_runs() {
        let es = lane_run(&[("algorithm", "pl-ekf-lgg"), ("field", "es-1")], &[5.0, 7.0, 9.0]);
        let other = lane_run(&[("algorithm", "pl-lgg"), ("field", "es-1")], &[50.0; 3]);
        let causes = compare("velasquez2022", "table-6", Some(&lanes(vec![other, es]))).unwrap();
        let gap = causes.cells.iter().find(|cell| cell.label("cause") == "gap").unwrap();
        assert_eq!(gap.ours.map(|ours| (ours.mean, ours.n)), Some((0.5, 3)), "the table is of the full system");
        assert_eq!(gap.sums, Some(Sums { published: Some([93.0, 138.0]), ours: [9.0, 18.0] }));
        assert_eq!(gap.runs["algorithm"], "pl-ekf-lgg");
        assert!(causes.write(Format::Md).contains("9/18, paper 93/138"));
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
