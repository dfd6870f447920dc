//! Vintu (2018): parameters of the row detectors over ten fields, what the text says of a hundred, the test garden, times.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::{COMPILED_IN, Cell, Column, Kind, Published, Reference};

pub(super) const SOURCE: &str = "vintu2018";

const COVERED: &str = "covered_rows_percent";
const DAMAGED: &str = "damaged_plants_percent";

/// The parts of table 4.8 that are no row detector, and the metric that is each one's time.
const PARTS: [(&str, &str); 3] = [
    ("filtering", "filtering_time_ms"),
    ("ground-detection", "ground_detection_time_ms"),
    ("localization", "localization_time_ms"),
];

#[derive(Deserialize)]
struct File {
    source: String,
    #[serde(default)]
    metric: String,
    #[serde(default)]
    note: Option<String>,
    #[serde(default)]
    cells: Vec<BTreeMap<String, Value>>,
    #[serde(default)]
    rows: Vec<BTreeMap<String, Value>>,
    #[serde(default)]
    covered_rows_percent: Vec<BTreeMap<String, Value>>,
    #[serde(default)]
    damaged_plants_percent: Vec<BTreeMap<String, Value>>,
}

pub(super) fn tables() -> Vec<Reference> {
    const SAMPLING: &[&str] = &["dist_threshold_m", "max_iteration"];
    const CENTROIDS: &[&str] = &["cluster_limit", "cluster_tolerance_m", "min_cluster_size"];
    const MAP: &[&str] = &["cluster_tolerance_m", "min_cluster_size"];
    const PCL_LINES: &[(&str, &str)] = &[("algorithm", "pcl-lines")];
    const PARALLEL_LINES: &[(&str, &str)] = &[("algorithm", "parallel-lines-ransac")];
    const CENTROID_LINES: &[(&str, &str)] = &[("algorithm", "centroid-lines")];
    const MAP_LINES: &[(&str, &str)] = &[("algorithm", "map-lines")];
    vec![
        grid("table-4-3", include_str!("../../../reference/vintu2018-table-4-3.json"), SAMPLING, PCL_LINES),
        grid("table-4-4", include_str!("../../../reference/vintu2018-table-4-4.json"), SAMPLING, PARALLEL_LINES),
        grid("table-4-5", include_str!("../../../reference/vintu2018-table-4-5.json"), CENTROIDS, CENTROID_LINES),
        grid("table-4-6", include_str!("../../../reference/vintu2018-table-4-6.json"), CENTROIDS, CENTROID_LINES),
        grid("table-4-7", include_str!("../../../reference/vintu2018-table-4-7.json"), MAP, MAP_LINES),
        times(&read(include_str!("../../../reference/vintu2018-table-4-8.json"))),
        said(
            "figure-4-13",
            &read(include_str!("../../../reference/vintu2018-figure-4-13.json")),
            &["algorithm", "localization"],
        ),
        said(
            "real-garden",
            &read(include_str!("../../../reference/vintu2018-real-garden.json")),
            &["algorithm", "field"],
        ),
    ]
}

fn read(text: &str) -> File {
    serde_json::from_str(text).expect(COMPILED_IN)
}

fn measure(label: &str, measured: &str) -> Column {
    Column { label: label.to_owned(), measured: measured.to_owned(), kind: Kind::Measure }
}

/// A table without rows; runs in all fields belong to a cell.
fn empty(name: &'static str, file: &File, row_factors: &'static [&'static str]) -> Reference {
    Reference {
        source: SOURCE,
        name,
        citation: file.source.clone(),
        metric: COVERED.to_owned(),
        unit: "%".to_owned(),
        note: file.note.clone(),
        program_source: None,
        row_factors,
        rows: Vec::new(),
        column_factor: "measure",
        columns: Vec::new(),
        pooled: &["field"],
        only: &[],
        unpublished: "not in the thesis",
        counts_successes: false,
        cells: Vec::new(),
    }
}

/// A label as a plan writes it.
fn label(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Tables 4.3 to 4.7: coverage and damage by parameters, means over ten fields.
fn grid(
    name: &'static str,
    text: &str,
    row_factors: &'static [&'static str],
    only: &'static [(&'static str, &'static str)],
) -> Reference {
    let file = read(text);
    let mut table = Reference { only, ..empty(name, &file, row_factors) };
    let both = [(COVERED, &file.covered_rows_percent), (DAMAGED, &file.damaged_plants_percent)];
    let one = [(file.metric.as_str(), &file.cells)];
    let measures = if file.metric.is_empty() { &both[..] } else { &one[..] };
    table.metric = measures[0].0.to_owned();
    for (metric, cells) in measures {
        table.columns.push(measure(metric, metric));
        for cell in *cells {
            table.add(row_factors.iter().map(|factor| label(&cell[*factor])).collect(), metric, &cell["value"]);
        }
    }
    table
}

/// What the text says of coverage and damage.
fn said(name: &'static str, file: &File, row_factors: &'static [&'static str]) -> Reference {
    let mut table = empty(name, file, row_factors);
    for row in &file.rows {
        let labels: Vec<String> = row_factors.iter().map(|factor| label(&row[*factor])).collect();
        for metric in [COVERED, DAMAGED].into_iter().filter(|metric| row.contains_key(*metric)) {
            if !table.columns.iter().any(|column| column.label == metric) {
                table.columns.push(measure(metric, metric));
            }
            table.add(labels.clone(), metric, &row[metric]);
        }
    }
    table
}

/// Table 4.8: the row detectors each in a row of its own, all else in that of `map-lines`, with which it was measured.
fn times(file: &File) -> Reference {
    let mut table = empty("table-4-8", file, &["algorithm"]);
    table.only = &[("localization", "on")];
    table.metric = file.metric.clone();
    table.unit = "ms".to_owned();
    table.note = Some("the text gives 50 ms for the map's lines; the machine is not named".to_owned());
    table.columns.push(measure("row-detection", "row_detection_time_ms"));
    table.columns.extend(PARTS.map(|(part, time)| measure(part, time)));
    for cell in &file.cells {
        let part = label(&cell["part"]);
        match PARTS.iter().find(|(known, _)| *known == part) {
            Some((part, _)) => table.add(vec!["map-lines".to_owned()], part, &cell["mean"]),
            None => table.add(vec![part], "row-detection", &cell["mean"]),
        }
    }
    table
}

impl Reference {
    /// Adds a published value, and its row if it is new.
    fn add(&mut self, row: Vec<String>, column: &str, value: &Value) {
        if !self.rows.contains(&row) {
            self.rows.push(row.clone());
        }
        let published = value.as_f64().map(|value| Published { value, runs: None, sums: None });
        self.cells.push(Cell { row, column: column.to_owned(), published, program: None });
    }
}

#[cfg(test)]
mod tests {
    use super::super::{find, tables};
    use super::*;

    fn published(table: &str, row: &[&str], column: &str) -> f64 {
        let mut cells = find(SOURCE, table).unwrap().cells.iter();
        cells.find(|cell| cell.row == row && cell.column == column).and_then(|cell| cell.published).unwrap().value
    }

    #[test]
    fn the_tables_are_there_with_figure_garden_and_claims() {
        let expected = [
            "table-4-3",
            "table-4-4",
            "table-4-5",
            "table-4-6",
            "table-4-7",
            "table-4-8",
            "figure-4-13",
            "real-garden",
            "claims",
        ];
        assert_eq!(tables(SOURCE).unwrap(), expected);
    }

    #[test]
    fn values_stand_where_the_thesis_has_them() {
        assert_eq!(published("table-4-3", &["0.3", "20"], COVERED), 27.5);
        assert_eq!(published("table-4-4", &["0.1", "20"], DAMAGED), 37.0);
        assert_eq!(published("table-4-5", &["20", "0.1", "10"], COVERED), 73.5);
        assert_eq!(published("table-4-6", &["40", "0.1", "10"], DAMAGED), 28.2);
        assert_eq!(published("table-4-7", &["0.06", "15"], COVERED), 86.3);
        assert_eq!(published("table-4-8", &["map-lines"], "row-detection"), 83.0);
        assert_eq!(published("table-4-8", &["map-lines"], "localization"), 0.8);
        assert_eq!(published("figure-4-13", &["map-lines", "on"], COVERED), 80.0);
        assert_eq!(published("real-garden", &["map-lines", "real-garden"], DAMAGED), 0.0);
        assert_eq!(find(SOURCE, "table-4-5").unwrap().rows.len(), 27);
    }
}
