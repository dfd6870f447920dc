//! The cells of a table.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::table::{Cell, Statistics};
use serde_json::{Value, json};

use super::data::{CellData, Series, SweepData};
use super::error::TableError;
use super::grid::Grid;
use super::layout::{for_people, for_programs};
use super::metric::{Metric, SUCCESS, listed, metric, order};
use super::pairs::Pairs;
use super::query::{Format, Query, Statistic};
use super::render::render;
use super::statistics::{summarize, with_sum_and_percentiles};

/// A table: cells, and what to show of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// The factors that make up a cell, in the order of the question.
    pub factors: Vec<String>,
    /// The metrics, in the order of the question.
    pub metrics: Vec<Metric>,
    /// The cells, in the plan's order of levels, the last factor running fastest.
    pub cells: Vec<Cell>,
    /// Success by cell, also where it was not asked for: no average stands without its failures.
    pub(super) success: Vec<Option<Statistics>>,
    /// The factor whose levels become columns.
    pub(super) columns: Option<String>,
    /// The statistics asked for.
    pub(super) statistics: Option<Vec<Statistic>>,
}

/// Makes the table that `query` asks for.
///
/// # Errors
/// Names the factor or metric that the sweep does not have, and those it has.
pub fn tabulate(data: &SweepData, query: &Query) -> Result<Table, TableError> {
    let factors = factors(data, query)?;
    if let Some(columns) = &query.columns {
        known("columns", "factor", columns, &factors)?;
    }
    let names = metrics(data, query)?;
    let metrics: Vec<Metric> = names.iter().map(|name| metric(name)).collect();
    let groups = group(data, &factors, &names);
    let of_success = |group: &CellData| group.metrics.get(SUCCESS).map(|series| summarize(series, true));
    Ok(Table {
        success: groups.iter().map(of_success).collect(),
        cells: groups.into_iter().map(|group| cell(group, &metrics, query.statistics.as_deref())).collect(),
        columns: query.columns.clone(),
        statistics: query.statistics.clone(),
        factors,
        metrics,
    })
}

fn known(key: &'static str, what: &'static str, word: &str, known: &[String]) -> Result<(), TableError> {
    if known.iter().any(|other| other == word) { Ok(()) } else { Err(TableError::new(key, what, word, known)) }
}

fn factors(data: &SweepData, query: &Query) -> Result<Vec<String>, TableError> {
    let Some(asked) = &query.group_by else { return Ok(data.factors.clone()) };
    let mut factors: Vec<String> = Vec::new();
    for factor in asked {
        known("group_by", "factor", factor, &data.factors)?;
        if !factors.contains(factor) {
            factors.push(factor.clone());
        }
    }
    Ok(factors)
}

/// The metrics asked for, `success_ratio` standing for `success` too; all that are there when none is named.
/// One that has a place in tables but no values (yet) is not unknown.
fn metrics(data: &SweepData, query: &Query) -> Result<Vec<String>, TableError> {
    let of_cell = |cell: &CellData| -> Vec<String> {
        cell.metrics.keys().cloned().chain(cell.ratios.keys().map(|name| (*name).to_owned())).collect()
    };
    let mut present: Vec<String> = data.cells.iter().flat_map(of_cell).collect();
    sort_metrics(&mut present);
    let Some(asked) = &query.metrics else { return Ok(present) };
    let mut allowed: Vec<String> = listed().map(str::to_owned).chain(present).collect();
    sort_metrics(&mut allowed);
    let mut names: Vec<String> = Vec::new();
    for name in asked {
        let name = if name == "success_ratio" { SUCCESS } else { name };
        known("metric", "metric", name, &allowed)?;
        if !names.iter().any(|other| other == name) {
            names.push(name.to_owned());
        }
    }
    Ok(names)
}

fn sort_metrics(names: &mut Vec<String>) {
    names.sort_by(|a, b| order(a).cmp(&order(b)));
    names.dedup();
}

/// The cells put together by `factors`, in the plan's order of levels.
fn group(data: &SweepData, factors: &[String], metrics: &[String]) -> Vec<CellData> {
    let ranks: Vec<HashMap<&str, usize>> = factors.iter().map(|factor| ranks(data, factor)).collect();
    let mut groups: BTreeMap<Vec<usize>, CellData> = BTreeMap::new();
    for cell in &data.cells {
        let labels: Vec<&str> = factors.iter().map(|factor| label(cell, factor)).collect();
        let key = labels.iter().zip(&ranks).map(|(label, ranks)| ranks[label]).collect();
        let group = groups.entry(key).or_insert_with(|| CellData {
            factors: factors.iter().cloned().zip(labels.iter().map(|label| (*label).to_owned())).collect(),
            ..CellData::default()
        });
        add(group, cell, metrics);
    }
    groups.into_values().collect()
}

/// A cell's label, empty where it has none.
fn label<'a>(cell: &'a CellData, factor: &str) -> &'a str {
    cell.factors.get(factor).map_or("", String::as_str)
}

/// The place of each label of a factor, by first appearance.
fn ranks<'a>(data: &'a SweepData, factor: &str) -> HashMap<&'a str, usize> {
    let mut ranks = HashMap::new();
    for cell in &data.cells {
        let next = ranks.len();
        ranks.entry(label(cell, factor)).or_insert(next);
    }
    ranks
}

fn add(group: &mut CellData, cell: &CellData, metrics: &[String]) {
    group.total += cell.total;
    group.done += cell.done;
    group.failed += cell.failed;
    let wanted = |name: &String| name == SUCCESS || metrics.contains(name);
    for (name, series) in cell.metrics.iter().filter(|(name, _)| wanted(name)) {
        group.metrics.entry(name.clone()).or_default().merge(series);
    }
    for (name, pairs) in cell.ratios.iter().filter(|(name, _)| metrics.iter().any(|asked| asked == **name)) {
        group.ratios.entry(name).or_default().merge(pairs);
    }
}

fn cell(group: CellData, metrics: &[Metric], asked: Option<&[Statistic]>) -> Cell {
    let empty = Series::default();
    let of = |metric: &Metric| {
        if metric.of_sums.is_some() {
            let pairs = group.ratios.get(metric.name.as_ref()).map(Pairs::summarize);
            return (metric.name.to_string(), pairs.unwrap_or_default());
        }
        let series = group.metrics.get(metric.name.as_ref()).unwrap_or(&empty);
        let statistics = with_sum_and_percentiles(summarize(series, metric.ratio), series, asked.unwrap_or_default());
        (metric.name.to_string(), statistics)
    };
    let metrics = metrics.iter().map(of).collect();
    Cell { n: group.done, missing: group.total.saturating_sub(group.done), factors: group.factors, metrics }
}

impl Table {
    /// The table as text in `format`.
    #[must_use]
    pub fn write(&self, format: Format) -> String {
        match format {
            Format::Json => self.to_json().to_string(),
            Format::Csv => render(&for_programs(self), format),
            Format::Md | Format::Latex | Format::Text => render(&for_people(self), format),
        }
    }

    /// The names of its first few metrics, and of all times where they were measured.
    #[must_use]
    pub fn first_metrics(&self, few: usize) -> Vec<String> {
        let (times, others): (Vec<&Metric>, Vec<&Metric>) = self.metrics.iter().partition(|metric| metric.timing);
        others.into_iter().take(few).chain(times).map(|metric| metric.name.to_string()).collect()
    }

    /// The table as rows and columns for programs, in full precision.
    #[must_use]
    pub fn exact_grid(&self) -> Grid {
        for_programs(self)
    }

    /// The table as rows and columns for people.
    #[must_use]
    pub fn grid(&self) -> Grid {
        for_people(self)
    }

    /// `{"factors": [..], "metrics": [{"name", "title", "unit", ..}], "cells": [..]}`; of the statistics only
    /// those asked for, and always `n`.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({"factors": self.factors, "metrics": self.metrics, "cells": self.cells_json()})
    }

    /// The cells alone, as JSON.
    #[must_use]
    pub fn cells_json(&self) -> Vec<Value> {
        let mut cells: Vec<Value> = self.cells.iter().map(|cell| json!(cell)).collect();
        if let Some(statistics) = &self.statistics {
            let keep = |key: &str| key == "n" || statistics.iter().any(|statistic| statistic.as_str() == key);
            let metrics = cells.iter_mut().filter_map(|cell| cell["metrics"].as_object_mut());
            let each = metrics.flat_map(|metrics| metrics.values_mut());
            each.filter_map(Value::as_object_mut).for_each(|object| object.retain(|key, _| keep(key)));
        }
        cells
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(algorithm: &str, field: &str, total: u64, errors: &[f64], successes: &[f64]) -> CellData {
        CellData {
            factors: BTreeMap::from([("algorithm".into(), algorithm.into()), ("field".into(), field.into())]),
            total,
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
                cell("rgop", "crop-1", 2, &[65.0, 67.5], &[1.0, 1.0]),
                cell("rgop", "crop-2", 2, &[276.25, 282.0], &[1.0, 0.0]),
                cell("rg", "crop-1", 2, &[60.5], &[0.0]),
                cell("rg", "crop-2", 2, &[], &[]),
            ],
        }
    }

    fn table(group_by: Option<&str>, metric: Option<&str>, columns: Option<&str>, statistic: Option<&str>) -> Table {
        tabulate(&data(), &Query::from_words(group_by, metric, columns, statistic).unwrap()).unwrap()
    }

    #[test]
    fn a_cell_is_exactly_as_clients_know_it() {
        let cells = table(None, None, None, None).cells_json();
        let expected = json!({
            "factors": {"algorithm": "rgop", "field": "crop-1"},
            "n": 2,
            "metrics": {
                "mean_squared_error_mm2": {
                    "n": 2, "mean": 66.25, "std": 3.125_f64.sqrt(), "median": 66.25, "min": 65.0, "max": 67.5,
                    "ci95": [50.367_244_079_781_635, 82.132_755_920_218_36]
                },
                "success": {
                    "n": 2, "mean": 1.0, "std": 0.0, "median": 1.0, "min": 1.0, "max": 1.0,
                    "ci95": [0.342_380_227_506_653_03, 1.0]
                }
            }
        });
        assert_eq!(cells[0], expected);
        assert_eq!(cells[3]["n"], json!(0));
        assert_eq!(cells[3]["missing"], json!(2));
        assert_eq!(cells[3]["metrics"]["success"]["ci95"], Value::Null);
    }

    #[test]
    fn only_the_statistics_asked_for_are_in_the_json() {
        let cells = table(None, Some("success_ratio"), None, Some("mean")).cells_json();
        assert_eq!(cells[1]["metrics"], json!({"success": {"n": 2, "mean": 0.5}}));
    }

    #[test]
    fn cells_come_together_by_the_factors_asked_for_in_the_plans_order() {
        let by_field = table(Some("field"), Some("success"), None, None);
        let labels: Vec<&str> = by_field.cells.iter().map(|cell| cell.factors["field"].as_str()).collect();
        assert_eq!(labels, ["crop-1", "crop-2"]);
        assert_eq!((by_field.cells[0].n, by_field.cells[0].missing), (3, 1));
        assert_eq!(by_field.cells[0].metrics["success"].mean, Some(2.0 / 3.0));

        let all = table(Some(""), None, None, None);
        assert_eq!((all.cells.len(), all.cells[0].n), (1, 5));
        let turned = table(Some("field,algorithm"), None, None, None);
        assert_eq!(turned.cells[1].factors["algorithm"], "rg");
    }

    #[test]
    fn unknown_factors_and_metrics_are_refused_with_the_known_ones() {
        let refusal = |group_by, metric, columns| {
            let query = Query::from_words(group_by, metric, columns, None).unwrap();
            tabulate(&data(), &query).unwrap_err().to_string()
        };
        let error = refusal(Some("crop"), None, None);
        assert_eq!(error, "group_by: unknown factor `crop`: allowed are algorithm, field");
        let error = refusal(Some("algorithm"), None, Some("field"));
        assert_eq!(error, "columns: unknown factor `field`: allowed are algorithm");
        let error = refusal(None, Some("mse"), None);
        assert!(error.starts_with("metric: unknown metric `mse`: allowed are success, mean_squared"), "{error}");
    }

    #[test]
    fn a_metric_that_has_no_values_yet_is_there_with_none() {
        let times = table(None, Some("line_finding_time_ms"), None, None);
        assert_eq!(times.cells[0].metrics["line_finding_time_ms"], Statistics::default());
    }

    /// Two lanes, one with an intervention every 50 m, one with a longer run and none.
    fn lanes() -> SweepData {
        let lane = |field: &str, pairs: &[[f64; 2]]| CellData {
            factors: BTreeMap::from([("field".into(), field.into())]),
            total: pairs.len() as u64,
            done: pairs.len() as u64,
            metrics: BTreeMap::from([("distance_m".into(), Series::of(pairs.iter().map(|[distance, _]| *distance)))]),
            ratios: BTreeMap::from([("distance_per_intervention_m", Pairs::of(pairs.iter().copied()))]),
            ..CellData::default()
        };
        let cells = vec![lane("lane-a", &[[100.0, 2.0], [100.0, 2.0]]), lane("lane-b", &[[400.0, 0.0]])];
        SweepData { factors: vec!["field".into()], cells }
    }

    #[test]
    fn a_ratio_of_sums_pools_the_sums_of_the_cells_put_together() {
        let of = |group_by| {
            let query = Query::from_words(group_by, Some("distance_per_intervention_m"), None, None).unwrap();
            tabulate(&lanes(), &query).unwrap().cells_json()
        };
        let single = of(None);
        let expected =
            json!({"n": 2, "mean": 50.0, "std": null, "median": null, "min": null, "max": null, "ci95": [50.0, 50.0]});
        assert_eq!(single[0]["metrics"]["distance_per_intervention_m"], expected);
        let without = &single[1]["metrics"]["distance_per_intervention_m"];
        assert_eq!((&without["n"], &without["mean"], &without["ci95"]), (&json!(1), &json!(null), &json!(null)));
        let pooled = &of(Some(""))[0]["metrics"]["distance_per_intervention_m"];
        assert_eq!((&pooled["n"], &pooled["mean"]), (&json!(3), &json!(150.0)), "600 m and 4 interventions");
    }

    #[test]
    fn a_ratio_of_sums_is_in_every_format_without_being_asked_for() {
        let table = tabulate(&lanes(), &Query::default()).unwrap();
        assert!(table.write(Format::Csv).contains("distance_per_intervention_m_mean"));
        for format in [Format::Md, Format::Latex, Format::Text] {
            let text = table.write(format);
            assert!(text.contains("distance per intervention [m]") && text.contains("50.0"), "{text}");
        }
    }

    fn assert_formats(name: &str, table: &Table) {
        insta::with_settings!({prepend_module_to_snapshot => false}, {
            for format in [Format::Csv, Format::Md, Format::Latex, Format::Text] {
                insta::assert_snapshot!(format!("{name}_{}", format.as_str()), table.write(format));
            }
        });
    }

    #[test]
    fn a_table_in_every_format() {
        assert_formats("list", &table(None, None, None, None));
    }

    #[test]
    fn a_table_with_the_fields_as_columns_in_every_format() {
        assert_formats("pivot", &table(None, Some("mean_squared_error_mm2"), Some("field"), Some("mean,std")));
    }

    #[test]
    fn a_sweep_without_cells_gives_an_empty_table() {
        let empty = tabulate(&SweepData::default(), &Query::default()).unwrap();
        assert_eq!(empty.to_json(), json!({"factors": [], "metrics": [], "cells": []}));
        for format in Format::ALL {
            assert!(!empty.write(format).is_empty());
        }
    }
}
