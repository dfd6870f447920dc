//! Guyonneau et al. (2022): tables 2 to 6, algorithms by crops, and what the authors' own program gave.

use std::sync::LazyLock;

use serde::Deserialize;

use super::{COMPILED_IN, Cell, Column, Kind, MEAN, ProgramValue, Published, Reference};
use crate::table::{metric, wilson_interval};

pub(super) const SOURCE: &str = "guyonneau2022";

/// The finders of the plan, in the order of the paper's method; `pearl` is announced there but not in its tables.
const ALGORITHMS: [&str; 6] = ["pearl", "ruby", "rg", "rgop", "rgoppn", "rgoppni"];
const FIELDS: [&str; 4] = ["crop-1", "crop-2", "crop-3", "crop-4"];

static PROGRAM: LazyLock<Program> = LazyLock::new(|| {
    serde_json::from_str(include_str!("../../../reference/guyonneau2022-program.json")).expect(COMPILED_IN)
});

#[derive(Deserialize)]
struct File {
    source: String,
    metric: String,
    unit: String,
    note: Option<String>,
    cells: Vec<Value>,
}

#[derive(Deserialize)]
struct Value {
    algorithm: String,
    field: String,
    value: f64,
}

#[derive(Deserialize)]
struct Program {
    source: String,
    cells: Vec<ProgramCell>,
}

#[derive(Deserialize)]
struct ProgramCell {
    algorithm: String,
    field: String,
    runs: u64,
    success_ratio_body: f64,
    mean_squared_error_mm2_mean: f64,
    mean_squared_error_mm2_median: f64,
    points_processed: f64,
}

pub(super) fn tables() -> Vec<Reference> {
    [
        ("table-2", include_str!("../../../reference/guyonneau2022-table-2.json")),
        ("table-3", include_str!("../../../reference/guyonneau2022-table-3.json")),
        ("table-4", include_str!("../../../reference/guyonneau2022-table-4.json")),
        ("table-5", include_str!("../../../reference/guyonneau2022-table-5.json")),
        ("table-6", include_str!("../../../reference/guyonneau2022-table-6.json")),
    ]
    .map(|(name, text)| table(name, serde_json::from_str(text).expect(COMPILED_IN)))
    .into()
}

fn table(name: &'static str, file: File) -> Reference {
    let measured = if file.metric == "success_ratio" { "success" } else { &file.metric };
    let column = |label: &str, kind| Column { label: label.to_owned(), measured: measured.to_owned(), kind };
    let columns = FIELDS.map(|field| column(field, Kind::Level)).into_iter().chain([column(MEAN, Kind::Mean)]);
    let columns: Vec<Column> = columns.collect();
    let at = |algorithm: &str, field: &str| Cell {
        row: vec![algorithm.to_owned()],
        column: field.to_owned(),
        published: published(&file, algorithm, field),
        program: program(measured, algorithm, field),
    };
    let row = |algorithm| FIELDS.into_iter().chain([MEAN]).map(move |field| (algorithm, field));
    let cells: Vec<Cell> = ALGORITHMS.into_iter().flat_map(row).map(|(a, f)| at(a, f)).collect();
    Reference {
        source: SOURCE,
        name,
        program_source: cells[0].program.map(|_| PROGRAM.source.clone()),
        row_factors: &["algorithm"],
        rows: ALGORITHMS.map(|algorithm| vec![algorithm.to_owned()]).into(),
        column_factor: "field",
        columns,
        pooled: &[],
        only: &[],
        unpublished: "announced in the paper's method, but not in its tables",
        counts_successes: true,
        cells,
        citation: file.source,
        metric: file.metric,
        unit: file.unit,
        note: file.note,
    }
}

fn published(file: &File, algorithm: &str, field: &str) -> Option<Published> {
    let found = file.cells.iter().find(|cell| cell.algorithm == algorithm && cell.field == field)?;
    Some(Published { value: found.value, runs: None, sums: None })
}

/// What the authors' program gave for a cell; for the column `mean` the mean over its crops.
fn program(measured: &str, algorithm: &str, field: &str) -> Option<ProgramValue> {
    if field == MEAN {
        let crops: Option<Vec<ProgramValue>> = FIELDS.iter().map(|crop| program(measured, algorithm, crop)).collect();
        return crops.map(|crops| ProgramValue::mean_of(&crops));
    }
    let cell = PROGRAM.cells.iter().find(|cell| cell.algorithm == algorithm && cell.field == field)?;
    let (value, median) = match measured {
        "success" => (cell.success_ratio_body, None),
        "mean_squared_error_mm2" => (cell.mean_squared_error_mm2_mean, Some(cell.mean_squared_error_mm2_median)),
        "points_processed" => (cell.points_processed, None),
        _ => return None,
    };
    let ci95 = metric(measured).ratio.then(|| wilson_interval(value, cell.runs)).flatten();
    Some(ProgramValue { value, median, runs: cell.runs, ci95 })
}

#[cfg(test)]
mod tests {
    use super::super::{find, of, tables};
    use super::*;

    #[test]
    fn each_published_table_has_every_cell_but_those_of_pearl() {
        assert_eq!(tables(SOURCE).unwrap(), ["table-2", "table-3", "table-4", "table-5", "table-6"]);
        for table in of(SOURCE) {
            assert_eq!(table.cells.len(), 30);
            for cell in &table.cells {
                assert_eq!(cell.published.is_some(), cell.row != ["pearl"], "{} {:?}", table.name, cell.row);
            }
        }
    }

    #[test]
    fn the_program_has_every_cell_of_the_tables_it_can_fill() {
        for table in of(SOURCE) {
            assert!(table.cells.iter().all(|cell| cell.program.is_some() != table.is_timing()), "{}", table.name);
        }
        let program = |table: &str, algorithm: &str, field: &str| {
            let mut cells = find(SOURCE, table).unwrap().cells.iter();
            cells.find(|cell| cell.row == [algorithm] && cell.column == field).and_then(|cell| cell.program).unwrap()
        };
        let expected = ProgramValue { value: 67.0, median: Some(66.3), runs: 7, ci95: None };
        assert_eq!(program("table-3", "rgop", "crop-1"), expected);
        assert_eq!(program("table-3", "rgop", MEAN).value, 368.675);
        let [low, high] = program("table-2", "rgop", MEAN).ci95.unwrap();
        assert!(0.8 < low && low < 0.85 && high == 1.0, "[{low}, {high}]");
    }
}
