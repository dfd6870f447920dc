//! What was published: the JSON files of the folder `reference`, compiled in.

use std::sync::LazyLock;

use serde::Deserialize;

use super::Ours;
use super::error::PublicationError;
use super::verdict::interval_of_means;
use crate::table::{Metric, metric, wilson_interval};

/// The finders of the plan, in the order of the paper's method; `pearl` is announced there but not in its tables.
pub(super) const ALGORITHMS: [&str; 6] = ["pearl", "ruby", "rg", "rgop", "rgoppn", "rgoppni"];
/// The crops.
pub(super) const FIELDS: [&str; 4] = ["crop-1", "crop-2", "crop-3", "crop-4"];
/// The column that holds the mean over the crops.
pub(super) const MEAN: &str = "mean";

const SOURCE: &str = "guyonneau2022";
const SOURCES: [&str; 1] = [SOURCE];

static TABLES: LazyLock<Vec<Reference>> = LazyLock::new(|| {
    [
        ("table-2", include_str!("../../reference/guyonneau2022-table-2.json")),
        ("table-3", include_str!("../../reference/guyonneau2022-table-3.json")),
        ("table-4", include_str!("../../reference/guyonneau2022-table-4.json")),
        ("table-5", include_str!("../../reference/guyonneau2022-table-5.json")),
        ("table-6", include_str!("../../reference/guyonneau2022-table-6.json")),
    ]
    .map(|(name, text)| Reference { name, published: serde_json::from_str(text).expect(COMPILED_IN) })
    .into()
});

static PROGRAM: LazyLock<Program> = LazyLock::new(|| {
    serde_json::from_str(include_str!("../../reference/guyonneau2022-program.json")).expect(COMPILED_IN)
});

const COMPILED_IN: &str = "the file is compiled in, and a test reads it";

/// A published table.
pub(super) struct Reference {
    /// Its name in a URL.
    pub(super) name: &'static str,
    published: Published,
}

#[derive(Deserialize)]
struct Published {
    source: String,
    metric: String,
    unit: String,
    note: Option<String>,
    cells: Vec<PublishedValue>,
}

#[derive(Deserialize)]
struct PublishedValue {
    algorithm: String,
    field: String,
    value: f64,
}

/// What the authors' program gave.
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

/// What the authors' program gave for one cell of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ProgramValue {
    pub(super) value: f64,
    pub(super) median: Option<f64>,
    pub(super) runs: u64,
    /// 95 % interval; of ratios only, since the spread of the other values is not on record.
    pub(super) ci95: Option<[f64; 2]>,
}

impl ProgramValue {
    /// For the column `mean`: the mean over the crops.
    fn mean_of(crops: &[Self]) -> Self {
        let mean = crops.iter().map(|crop| crop.value).sum::<f64>() / crops.len() as f64;
        let ours = |crop: &Self| Ours { mean: crop.value, median: None, ci95: crop.ci95, n: crop.runs };
        Self {
            // The crops' values are given with two digits behind the point; the quarter of a sum has two more.
            value: (mean * 1e4).round() / 1e4,
            median: None,
            runs: crops.iter().map(|crop| crop.runs).sum(),
            ci95: interval_of_means(&crops.iter().map(ours).collect::<Vec<_>>()),
        }
    }
}

/// Names of the publications whose tables are known.
#[must_use]
pub fn sources() -> &'static [&'static str] {
    &SOURCES
}

/// Names of a publication's tables.
///
/// # Errors
/// Lists the publications there are.
pub fn tables(source: &str) -> Result<Vec<&'static str>, PublicationError> {
    let known = known_source(source)?;
    Ok(of(known).map(|table| table.name).collect())
}

fn known_source(source: &str) -> Result<&'static str, PublicationError> {
    let found = SOURCES.into_iter().find(|known| *known == source);
    let given = || source.chars().take(80).collect();
    found.ok_or_else(|| PublicationError::UnknownSource { source_name: given(), known: SOURCES.into() })
}

/// The tables of a publication.
pub(super) fn of(source: &str) -> impl Iterator<Item = &'static Reference> {
    let known = source == SOURCE;
    TABLES.iter().filter(move |_| known)
}

/// One table of a publication.
pub(super) fn find(source: &str, table: &str) -> Result<(&'static str, &'static Reference), PublicationError> {
    let source = known_source(source)?;
    let found = of(source).find(|known| known.name == table);
    let reference = found.ok_or_else(|| PublicationError::UnknownTable {
        source_name: source,
        table: table.chars().take(80).collect(),
        known: of(source).map(|known| known.name).collect(),
    })?;
    Ok((source, reference))
}

impl Reference {
    /// The publication for people.
    pub(super) fn citation(&self) -> &str {
        &self.published.source
    }

    /// What is published, as the publication's file names it.
    pub(super) fn metric_name(&self) -> &str {
        &self.published.metric
    }

    pub(super) fn unit(&self) -> &str {
        &self.published.unit
    }

    pub(super) fn note(&self) -> Option<&str> {
        self.published.note.as_deref()
    }

    /// The name of the per-run metric whose mean this is.
    pub(super) fn measured(&self) -> &str {
        let name = self.metric_name();
        if name == "success_ratio" { "success" } else { name }
    }

    /// The per-run metric whose mean this is.
    pub(super) fn metric(&self) -> Metric {
        metric(self.measured())
    }

    /// Whether this is a table of times.
    pub(super) fn is_timing(&self) -> bool {
        self.metric().timing
    }

    /// The published value of a cell.
    pub(super) fn value(&self, algorithm: &str, field: &str) -> Option<f64> {
        let cells = &self.published.cells;
        cells.iter().find(|cell| cell.algorithm == algorithm && cell.field == field).map(|cell| cell.value)
    }

    /// How the program's values were made, where it has any of this table.
    pub(super) fn program_source(&self) -> Option<&'static str> {
        self.program(ALGORITHMS[0], FIELDS[0]).map(|_| PROGRAM.source.as_str())
    }

    /// What the authors' program gave for a cell; for the column `mean` the mean over its crops.
    pub(super) fn program(&self, algorithm: &str, field: &str) -> Option<ProgramValue> {
        if field == MEAN {
            let crops: Option<Vec<ProgramValue>> = FIELDS.iter().map(|crop| self.program(algorithm, crop)).collect();
            return crops.map(|crops| ProgramValue::mean_of(&crops));
        }
        let cell = PROGRAM.cells.iter().find(|cell| cell.algorithm == algorithm && cell.field == field)?;
        let (value, median) = match self.measured() {
            "success" => (cell.success_ratio_body, None),
            "mean_squared_error_mm2" => (cell.mean_squared_error_mm2_mean, Some(cell.mean_squared_error_mm2_median)),
            "points_processed" => (cell.points_processed, None),
            _ => return None,
        };
        let ci95 = self.metric().ratio.then(|| wilson_interval(value, cell.runs)).flatten();
        Some(ProgramValue { value, median, runs: cell.runs, ci95 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_published_table_has_every_cell_but_those_of_pearl() {
        assert_eq!(tables("guyonneau2022").unwrap(), ["table-2", "table-3", "table-4", "table-5", "table-6"]);
        for table in of("guyonneau2022") {
            for algorithm in ALGORITHMS {
                for field in FIELDS.into_iter().chain([MEAN]) {
                    let is_there = table.value(algorithm, field).is_some();
                    assert_eq!(is_there, algorithm != "pearl", "{} {algorithm} {field}", table.name);
                }
            }
            assert_eq!(table.published.cells.len(), 25);
        }
    }

    #[test]
    fn the_program_has_every_cell_of_the_tables_it_can_fill() {
        for table in of("guyonneau2022") {
            for algorithm in ALGORITHMS {
                let is_there = FIELDS.iter().all(|field| table.program(algorithm, field).is_some());
                assert_eq!(is_there, !table.is_timing(), "{}", table.name);
            }
        }
        let (_, errors) = find("guyonneau2022", "table-3").unwrap();
        let expected = ProgramValue { value: 67.0, median: Some(66.3), runs: 7, ci95: None };
        assert_eq!(errors.program("rgop", "crop-1"), Some(expected));
        assert_eq!(errors.program("rgop", MEAN).unwrap().value, 368.675);
        let (_, success) = find("guyonneau2022", "table-2").unwrap();
        let [low, high] = success.program("rgop", MEAN).unwrap().ci95.unwrap();
        assert!(0.8 < low && low < 0.85 && high == 1.0, "[{low}, {high}]");
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones() {
        let error = tables("guyonneau2023").unwrap_err().to_string();
        assert_eq!(error, "unknown publication `guyonneau2023`: there are guyonneau2022");
        let error = find("guyonneau2022", "table-1").err().unwrap().to_string();
        assert!(error.ends_with("there are table-2, table-3, table-4, table-5, table-6"), "{error}");
    }
}
