//! Velasquez et al. (2022): interventions by system and lane, the lanes as the LiDAR sees them, causes, times, and
//! distances per intervention.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::{COMPILED_IN, Cell, Column, Kind, Published, Reference};

pub(super) const SOURCE: &str = "velasquez2022";

/// The causes of table 6, and the metric that is each one's share.
const CAUSES: [(&str, &str, &str); 4] = [
    ("bad-start", "bad_start", "bad_start_share"),
    ("control", "control", "control_share"),
    ("gap", "gap", "gap_share"),
    ("perception", "perception", "perception_share"),
];

/// The parts of section 5.4, and the metric that is each one's time.
const PARTS: [(&str, &str); 3] =
    [("pl", "lane_finding_time_ms"), ("ekf", "lane_estimation_time_ms"), ("lgg", "control_time_ms")];

/// Tables 1 to 4: each run is published, of which the mean is compared.
const RUNS: &str = "of the published runs the mean is compared; one intervention a run is the end of the lane";

/// The full system, of which tables 5 and 6 and the times are.
const FULL: (&str, &str) = ("algorithm", "pl-ekf-lgg");

#[derive(Deserialize)]
struct File {
    source: String,
    #[serde(default)]
    metric: String,
    unit: Option<String>,
    hardware: Option<String>,
    #[serde(default)]
    cells: Vec<BTreeMap<String, Value>>,
    #[serde(default)]
    columns: Vec<String>,
    #[serde(default)]
    rows: Vec<Vec<Value>>,
}

pub(super) fn tables() -> Vec<Reference> {
    const AT_40_HZ: &[(&str, &str)] = &[("lidar_hz", "40")];
    vec![
        lanes("table-1", include_str!("../../../reference/velasquez2022-table-1.json"), &["algorithm"], AT_40_HZ),
        lanes(
            "table-2",
            include_str!("../../../reference/velasquez2022-table-2.json"),
            &["algorithm", "lidar_hz"],
            &[],
        ),
        lanes("table-3", include_str!("../../../reference/velasquez2022-table-3.json"), &["algorithm"], AT_40_HZ),
        lanes("table-4", include_str!("../../../reference/velasquez2022-table-4.json"), &["algorithm"], AT_40_HZ),
        views(read(include_str!("../../../reference/velasquez2022-table-5.json"))),
        causes(read(include_str!("../../../reference/velasquez2022-table-6.json"))),
        times(read(include_str!("../../../reference/velasquez2022-times.json"))),
        distances(read(include_str!("../../../reference/velasquez2022-figure-18.json"))),
    ]
}

fn read(text: &str) -> File {
    serde_json::from_str(text).expect(COMPILED_IN)
}

fn column(label: &str, measured: &str, kind: Kind) -> Column {
    Column { label: label.to_owned(), measured: measured.to_owned(), kind }
}

/// A table without rows and columns.
fn empty(name: &'static str, file: &File) -> Reference {
    Reference {
        source: SOURCE,
        name,
        citation: file.source.clone(),
        metric: file.metric.clone(),
        unit: file.unit.clone().unwrap_or_else(|| "1".to_owned()),
        note: None,
        program_source: None,
        row_factors: &["algorithm"],
        rows: Vec::new(),
        column_factor: "field",
        columns: Vec::new(),
        pooled: &[],
        only: &[],
        unpublished: "not in the paper's table",
        counts_successes: false,
        cells: Vec::new(),
    }
}

/// A label as a plan writes it.
fn label(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

fn add<T: PartialEq>(list: &mut Vec<T>, item: T) {
    if !list.contains(&item) {
        list.push(item);
    }
}

/// Tables 1 to 4: interventions of single runs.
fn lanes(
    name: &'static str,
    text: &str,
    row_factors: &'static [&'static str],
    only: &'static [(&'static str, &'static str)],
) -> Reference {
    let file = read(text);
    let note = Some(RUNS.to_owned());
    let mut table = Reference { row_factors, only, note, ..empty(name, &file) };
    for run in &file.cells {
        let row: Vec<String> = row_factors.iter().map(|factor| label(&run[*factor])).collect();
        let lane = label(&run["field"]);
        let value = run["value"].as_f64().expect(COMPILED_IN);
        add(&mut table.rows, row.clone());
        add(&mut table.columns, column(&lane, &file.metric, Kind::Level));
        match table.cells.iter_mut().find(|cell| cell.row == row && cell.column == lane) {
            Some(Cell { published: Some(Published { value: sum, runs: Some(runs), .. }), .. }) => {
                (*sum, *runs) = (*sum + value, *runs + 1);
            }
            _ => {
                let published = Some(Published { value, runs: Some(1), sums: None });
                table.cells.push(Cell { row, column: lane, published, program: None });
            }
        }
    }
    for published in table.cells.iter_mut().filter_map(|cell| cell.published.as_mut()) {
        published.value /= published.runs.unwrap_or(1) as f64;
    }
    table
}

/// Table 5: each lane as a person sees it in the LiDAR's scans; its columns are names of metrics.
fn views(file: File) -> Reference {
    let columns: Vec<Column> = file.columns[1..].iter().map(|name| column(name, name, Kind::Measure)).collect();
    let note = "a person's labels; ours of every 10th scan of the full system";
    let mut table =
        Reference { row_factors: &["field"], column_factor: "view", only: &[FULL], ..empty("table-5", &file) };
    table.note = Some(note.to_owned());
    for row in &file.rows {
        let field = vec![label(&row[0])];
        table.rows.push(field.clone());
        table.cells.extend(columns.iter().zip(&row[1..]).map(|(column, value)| Cell {
            row: field.clone(),
            column: column.label.clone(),
            published: value.as_f64().map(|value| Published { value, runs: None, sums: None }),
            program: None,
        }));
    }
    Reference { columns, ..table }
}

/// Table 6: causes of interventions in early-stage corn as shares of all of them.
fn causes(file: File) -> Reference {
    let mut table =
        Reference { row_factors: &["field"], column_factor: "cause", only: &[FULL], ..empty("table-6", &file) };
    table.note = Some("of its counts the shares are compared, since its runs are not counted".to_owned());
    table.columns = CAUSES.map(|(cause, _, share)| column(cause, share, Kind::Measure)).into();
    for cell in &file.cells {
        let count = |key: &str| cell[key].as_f64().expect(COMPILED_IN);
        let field = vec![label(&cell["field"])];
        table.rows.push(field.clone());
        table.cells.extend(CAUSES.map(|(cause, key, _)| {
            let sums = [count(key), count("total")];
            let published = Some(Published { value: sums[0] / sums[1], runs: None, sums: Some(sums) });
            Cell { row: field.clone(), column: cause.to_owned(), published, program: None }
        }));
    }
    table
}

/// Section 5.4: computing time a scan of the full system.
fn times(file: File) -> Reference {
    let mut table = Reference { column_factor: "part", only: &[FULL], ..empty("times", &file) };
    let hardware = file.hardware.unwrap_or_default();
    table.note = Some(format!("its times are those of a {hardware}; ours of lgg are with the controller"));
    let row = vec![FULL.1.to_owned()];
    table.rows.push(row.clone());
    for cell in &file.cells {
        let part = label(&cell["part"]);
        let (_, time) = PARTS.iter().find(|(name, _)| *name == part).expect(COMPILED_IN);
        let published = cell["value"].as_f64().map(|value| Published { value, runs: None, sums: None });
        table.columns.push(column(&part, time, Kind::Measure));
        table.cells.push(Cell { row: row.clone(), column: part, published, program: None });
    }
    table
}

/// Figure 18: distance per intervention; in ES-2 without the bad starts, as its value is published.
fn distances(file: File) -> Reference {
    let mut table = empty("figure-18", &file);
    let note = "the value of es-2 is without bad starts, those of the others with them; from the counts of tables 1 to 3 \
                one gets 52.5 and 356 m in iaf";
    table.note = Some(note.to_owned());
    for cell in &file.cells {
        let (row, field) = (vec![label(&cell["algorithm"])], label(&cell["field"]));
        let without = "distance_per_intervention_without_bad_starts_m";
        let measured = if field == "es-2" { without } else { &file.metric };
        let published = cell["value"].as_f64().map(|value| Published { value, runs: None, sums: None });
        add(&mut table.rows, row.clone());
        add(&mut table.columns, column(&field, measured, Kind::Level));
        table.cells.push(Cell { row, column: field, published, program: None });
    }
    table
}

#[cfg(test)]
mod tests {
    use super::super::{find, tables};
    use super::*;

    fn published(table: &str, row: &[&str], column: &str) -> Published {
        let mut cells = find(SOURCE, table).unwrap().cells.iter();
        cells.find(|cell| cell.row == row && cell.column == column).and_then(|cell| cell.published).unwrap()
    }

    #[test]
    fn the_tables_are_there_with_figure_and_claims() {
        let expected =
            ["table-1", "table-2", "table-3", "table-4", "table-5", "table-6", "times", "figure-18", "claims"];
        assert_eq!(tables(SOURCE).unwrap(), expected);
    }

    #[test]
    fn of_single_runs_the_mean_and_the_number_stand_in_a_cell() {
        let two = published("table-1", &["pl-lgg"], "lane-b");
        assert_eq!((two.value, two.runs), (4.5, Some(2)));
        let five = published("table-4", &["pl-ekf-gains-0.7-1.5"], "lane-h");
        assert_eq!((five.value, five.runs), (3.0, Some(5)));
        let one = published("table-2", &["pl-lgg", "5"], "lane-b");
        assert_eq!((one.value, one.runs), (8.0, Some(1)));
    }

    #[test]
    fn the_shares_of_the_causes_are_of_all_interventions() {
        let gap = published("table-6", &["es-1"], "gap");
        assert_eq!((gap.value, gap.sums), (93.0 / 138.0, Some([93.0, 138.0])));
        for field in ["es-1", "es-2"] {
            let sum: f64 = CAUSES.iter().map(|(cause, ..)| published("table-6", &[field], cause).value).sum();
            assert!((sum - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn what_a_column_measures_has_a_place_in_tables() {
        for table in super::tables() {
            for column in &table.columns {
                let unlisted = column.measured.replace('_', " ");
                let listed = column.metric().title != unlisted || column.measured == "interventions";
                assert!(listed, "{} {}", table.name, column.label);
            }
        }
        let figure = find(SOURCE, "figure-18").unwrap();
        let without: Vec<bool> = figure.columns.iter().map(|column| column.measured.contains("without")).collect();
        assert_eq!(without, [false, false, false, true]);
    }
}
