//! What was published: the JSON files of the folder `reference`, compiled in, each as rows and columns.

mod guyonneau2022;
mod velasquez2022;
mod vintu2018;

use std::sync::LazyLock;

use super::Ours;
use super::claims;
use super::error::PublicationError;
use super::verdict::interval_of_means;
use crate::table::{Metric, metric};

const SOURCES: [&str; 3] = [guyonneau2022::SOURCE, velasquez2022::SOURCE, vintu2018::SOURCE];

static TABLES: LazyLock<Vec<Reference>> = LazyLock::new(|| {
    [guyonneau2022::tables(), velasquez2022::tables(), vintu2018::tables()].into_iter().flatten().collect()
});

/// Why a file of this folder can be read.
pub(super) const COMPILED_IN: &str = "the file is compiled in, and a test reads it";

/// The column that holds a mean over the others.
pub(super) const MEAN: &str = "mean";

/// A published table: rows by labels of one or more factors, columns by those of a last one.
pub(super) struct Reference {
    /// The publication, as in a URL.
    pub(super) source: &'static str,
    /// Its name in a URL.
    pub(super) name: &'static str,
    /// The publication for people.
    pub(super) citation: String,
    /// What is published, as the publication's file names it.
    pub(super) metric: String,
    pub(super) unit: String,
    pub(super) note: Option<String>,
    /// How the program's values were made, where there are any.
    pub(super) program_source: Option<String>,
    pub(super) row_factors: &'static [&'static str],
    /// A label for each of the row factors.
    pub(super) rows: Vec<Vec<String>>,
    pub(super) column_factor: &'static str,
    pub(super) columns: Vec<Column>,
    /// Further factors over whose labels the published values are means.
    pub(super) pooled: &'static [&'static str],
    /// Labels in further factors that runs must have where the sweep has such a factor.
    pub(super) only: &'static [(&'static str, &'static str)],
    /// Why a cell of ours may have no published one.
    pub(super) unpublished: &'static str,
    /// Whether to say beside an average how many runs were successful.
    pub(super) counts_successes: bool,
    pub(super) cells: Vec<Cell>,
}

/// A column of a published table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Column {
    pub(super) label: String,
    /// The metric whose mean it holds.
    pub(super) measured: String,
    pub(super) kind: Kind,
}

/// What makes up a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    /// The runs with its label.
    Level,
    /// The mean over the columns of levels.
    Mean,
    /// All runs of the row: the columns differ in what is measured.
    Measure,
}

/// Where a row meets a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cell {
    pub(super) row: Vec<String>,
    pub(super) column: String,
    pub(super) published: Option<Published>,
    pub(super) program: Option<ProgramValue>,
}

/// A published value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Published {
    pub(super) value: f64,
    /// Runs behind it, where each run is published.
    pub(super) runs: Option<u64>,
    /// The sums whose ratio it is, where they are published.
    pub(super) sums: Option<[f64; 2]>,
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
    /// For the column `mean`: the mean over the others.
    fn mean_of(levels: &[Self]) -> Self {
        let mean = levels.iter().map(|level| level.value).sum::<f64>() / levels.len() as f64;
        let ours = |level: &Self| Ours { mean: level.value, median: None, ci95: level.ci95, n: level.runs };
        Self {
            // The levels' values are given with two digits behind the point; the quarter of a sum has two more.
            value: (mean * 1e4).round() / 1e4,
            median: None,
            runs: levels.iter().map(|level| level.runs).sum(),
            ci95: interval_of_means(&levels.iter().map(ours).collect::<Vec<_>>()),
        }
    }
}

/// Names of the publications whose tables are known.
#[must_use]
pub fn sources() -> &'static [&'static str] {
    &SOURCES
}

/// Names of a publication's tables; `claims` is what it says in words.
///
/// # Errors
/// Lists the publications there are.
pub fn tables(source: &str) -> Result<Vec<&'static str>, PublicationError> {
    let known = known_source(source)?;
    Ok(of(known).map(|table| table.name).chain(claims::exist(known).then_some(claims::TABLE)).collect())
}

fn known_source(source: &str) -> Result<&'static str, PublicationError> {
    let found = SOURCES.into_iter().find(|known| *known == source);
    let given = || source.chars().take(80).collect();
    found.ok_or_else(|| PublicationError::UnknownSource { source_name: given(), known: SOURCES.into() })
}

/// The tables of a publication.
pub(super) fn of(source: &str) -> impl Iterator<Item = &'static Reference> {
    TABLES.iter().filter(move |table| table.source == source)
}

/// One table of a publication.
pub(super) fn find(source: &str, table: &str) -> Result<&'static Reference, PublicationError> {
    let source = known_source(source)?;
    let found = of(source).find(|known| known.name == table);
    found.ok_or_else(|| PublicationError::UnknownTable {
        source_name: source,
        table: table.chars().take(80).collect(),
        known: tables(source).unwrap_or_default(),
    })
}

impl Reference {
    /// Whether this is a table of times.
    pub(super) fn is_timing(&self) -> bool {
        self.columns.iter().all(|column| column.metric().timing)
    }

    /// What was published and what the program gave where a row meets a column.
    pub(super) fn cell(&self, row: &[String], column: &Column) -> Option<&Cell> {
        self.cells.iter().find(|cell| cell.row == row && cell.column == column.label)
    }
}

impl Column {
    /// The metric whose mean it holds.
    pub(super) fn metric(&self) -> Metric {
        metric(&self.measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sources_are_as_plans_name_them() {
        assert_eq!(sources(), ["guyonneau2022", "velasquez2022", "vintu2018"]);
    }

    #[test]
    fn an_unknown_publication_or_table_lists_the_known_ones() {
        let error = tables("nobody2000").unwrap_err().to_string();
        assert_eq!(error, "unknown publication `nobody2000`: there are guyonneau2022, velasquez2022, vintu2018");
        let error = find("guyonneau2022", "table-9").map(|table| table.name).unwrap_err().to_string();
        assert!(error.starts_with("guyonneau2022 has no `table-9` here: there are table-2, table-3"), "{error}");
    }

    #[test]
    fn each_cell_stands_once_and_in_a_row_and_a_column() {
        for table in TABLES.iter() {
            for (i, cell) in table.cells.iter().enumerate() {
                let at = format!("{} {} {:?} {}", table.source, table.name, cell.row, cell.column);
                assert!(table.rows.contains(&cell.row) && cell.row.len() == table.row_factors.len(), "{at}");
                assert!(table.columns.iter().any(|column| column.label == cell.column), "{at}");
                let same = |other: &Cell| other.row == cell.row && other.column == cell.column;
                assert!(!table.cells[..i].iter().any(same), "{at}");
            }
        }
    }
}
