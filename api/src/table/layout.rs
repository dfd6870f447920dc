//! Cells in rows and columns: exact and wide for programs, rounded and with the failures beside for people.

use std::collections::BTreeMap;

use furrow_schema::table::{Cell, Statistics};

use super::grid::{Column, Entry, Grid};
use super::metric::{Metric, SUCCESS, metric};
use super::number::short;
use super::query::Statistic;
use super::tabulate::Table;

/// One column per statistic in full precision; with a factor as columns, one set of them per level.
pub(super) fn for_programs(table: &Table) -> Grid {
    let heading = |level: &str, name: &str| if level.is_empty() { name.to_owned() } else { format!("{level}.{name}") };
    let pivot = Pivot::of(table);
    let mut grid = Grid::default();
    grid.columns.extend(pivot.row_factors.iter().map(|factor| Column::left(factor.as_str())));
    for level in &pivot.levels {
        grid.columns.extend(program_columns(table).iter().map(|name| Column::right(heading(level, name))));
    }
    let width = program_columns(table).len();
    for (labels, cells) in &pivot.rows {
        let mut row: Vec<Entry> = labels.iter().map(|label| Entry::text(label.as_str())).collect();
        for cell in cells {
            row.extend(cell.map_or_else(|| vec![Entry::Empty; width], |index| program_entries(table, index)));
        }
        grid.rows.push(row);
    }
    grid
}

/// Headings of the numbers of one cell.
fn program_columns(table: &Table) -> Vec<String> {
    let mut names = vec!["n".to_owned(), "missing".to_owned()];
    if shows_success(table) {
        names.push(metric(SUCCESS).column(Statistic::Mean));
    }
    for metric in &table.metrics {
        for statistic in program_statistics(table) {
            let name = metric.column(*statistic);
            match statistic {
                Statistic::Ci95 => names.extend([format!("{name}_low"), format!("{name}_high")]),
                _ => names.push(name),
            }
        }
    }
    names
}

fn program_statistics(table: &Table) -> &[Statistic] {
    table.statistics.as_deref().unwrap_or(&Statistic::USUAL)
}

fn program_entries(table: &Table, index: usize) -> Vec<Entry> {
    let cell = &table.cells[index];
    let mut entries = vec![Entry::Count(cell.n), Entry::Count(cell.missing)];
    if shows_success(table) {
        entries.push(Entry::number(table.success[index].and_then(|success| success.mean)));
    }
    for metric in &table.metrics {
        let statistics = cell.metrics.get(metric.name.as_ref()).copied().unwrap_or_default();
        entries.extend(program_statistics(table).iter().flat_map(|statistic| numbers(&statistics, *statistic)));
    }
    entries
}

fn numbers(statistics: &Statistics, statistic: Statistic) -> Vec<Entry> {
    match statistic {
        Statistic::N => vec![Entry::Count(statistics.n)],
        Statistic::Ci95 => [0, 1].map(|end| Entry::number(statistics.ci95.map(|ends| ends[end]))).into(),
        _ => vec![Entry::number(value(statistics, statistic))],
    }
}

fn value(statistics: &Statistics, statistic: Statistic) -> Option<f64> {
    match statistic {
        Statistic::Mean => statistics.mean,
        Statistic::Std => statistics.std,
        Statistic::Median => statistics.median,
        Statistic::Min => statistics.min,
        Statistic::Max => statistics.max,
        Statistic::Ci95 => None,
        Statistic::N => Some(statistics.n as f64),
        Statistic::Sum => statistics.sum,
        Statistic::P5 => statistics.p5,
        Statistic::P25 => statistics.p25,
        Statistic::P75 => statistics.p75,
        Statistic::P95 => statistics.p95,
    }
}

/// Whether success must be added: it is known, and the question is about other metrics only.
fn shows_success(table: &Table) -> bool {
    table.metrics.iter().all(|metric| metric.name != SUCCESS) && table.success.iter().any(Option::is_some)
}

/// A column per metric, or per level of the factor that was chosen for columns.
pub(super) fn for_people(table: &Table) -> Grid {
    let mut grid = if table.columns.is_some() { people_pivot(table) } else { people_list(table) };
    if table.statistics.as_ref().is_none_or(|statistics| statistics.contains(&Statistic::Ci95)) {
        grid.notes.push("In brackets the 95 % interval of the mean.".to_owned());
    }
    let missing: u64 = table.cells.iter().map(|cell| cell.missing).sum();
    if missing > 0 {
        grid.notes.push(format!("{missing} runs have no result (yet)."));
    }
    grid
}

fn people_list(table: &Table) -> Grid {
    let missing = table.cells.iter().any(|cell| cell.missing > 0);
    let mut grid = Grid::default();
    grid.columns.extend(table.factors.iter().map(|factor| Column::left(factor.as_str())));
    grid.columns.push(Column::right("runs"));
    grid.columns.extend(missing.then(|| Column::right("missing")));
    grid.columns.extend(shows_success(table).then(|| Column::right(metric(SUCCESS).heading())));
    grid.columns.extend(table.metrics.iter().map(|metric| Column::right(people_heading(table, metric))));
    for (index, cell) in table.cells.iter().enumerate() {
        let mut row: Vec<Entry> = table.factors.iter().map(|factor| Entry::text(label(cell, factor))).collect();
        row.push(Entry::Count(cell.n));
        row.extend(missing.then_some(Entry::Count(cell.missing)));
        row.extend(shows_success(table).then(|| Entry::text(ratio(table.success[index]))));
        row.extend(table.metrics.iter().map(|metric| Entry::text(people_text(table, cell, metric))));
        grid.rows.push(row);
    }
    grid
}

fn people_pivot(table: &Table) -> Grid {
    let pivot = Pivot::of(table);
    let several = table.metrics.len() != 1;
    let mut grid = Grid::default();
    if let [only] = table.metrics.as_slice() {
        grid.title = people_heading(table, only);
    }
    grid.columns.extend(pivot.row_factors.iter().map(|factor| Column::left(factor.as_str())));
    grid.columns.extend(several.then(|| Column::left("metric")));
    grid.columns.extend(pivot.levels.iter().map(|level| Column::right(level.as_str())));
    for (labels, cells) in &pivot.rows {
        for metric in &table.metrics {
            let mut row: Vec<Entry> = labels.iter().map(|label| Entry::text(label.as_str())).collect();
            row.extend(several.then(|| Entry::text(people_heading(table, metric))));
            let text = |index: usize| Entry::text(with_failures(table, index, metric));
            row.extend(cells.iter().map(|cell| cell.map_or(Entry::Empty, text)));
            grid.rows.push(row);
        }
    }
    grid.notes.push("Behind each figure: successful of finished runs.".to_owned());
    grid
}

/// A metric's figures, with successful and finished runs and those without a result.
fn with_failures(table: &Table, index: usize, metric: &Metric) -> String {
    let cell = &table.cells[index];
    let text = people_text(table, cell, metric);
    let runs = match table.success[index] {
        Some(Statistics { n, mean: Some(mean), .. }) => format!("{}/{n}", (mean * n as f64).round()),
        _ => format!("n {}", cell.n),
    };
    let missing = if cell.missing > 0 { format!(", {} missing", cell.missing) } else { String::new() };
    format!("{text} ({runs}{missing})")
}

fn ratio(success: Option<Statistics>) -> String {
    let mean = success.and_then(|success| success.mean);
    mean.map_or_else(|| "-".to_owned(), |mean| short(mean, metric(SUCCESS).decimals))
}

fn people_heading(table: &Table, metric: &Metric) -> String {
    match table.statistics.as_deref() {
        Some([only]) if *only != Statistic::Mean => format!("{} ({})", metric.heading(), only.as_str()),
        _ => metric.heading(),
    }
}

/// The statistics of a metric in a few words: `65.2 [60.1, 70.3]`, `65.2 ± 3.1`, `median 65.0`.
fn people_text(table: &Table, cell: &Cell, metric: &Metric) -> String {
    let asked = table.statistics.as_deref().unwrap_or(&[Statistic::Mean, Statistic::Ci95]);
    let statistics = cell.metrics.get(metric.name.as_ref()).copied().unwrap_or_default();
    let part = |statistic: &Statistic| {
        let text = number_text(&statistics, *statistic, metric.decimals)?;
        Some(match statistic {
            Statistic::Mean | Statistic::Ci95 => text,
            _ if asked.len() == 1 => text,
            Statistic::Std => format!("± {text}"),
            _ => format!("{} {text}", statistic.as_str()),
        })
    };
    let parts: Vec<String> = asked.iter().filter_map(part).collect();
    if parts.is_empty() { "-".to_owned() } else { parts.join(" ") }
}

fn number_text(statistics: &Statistics, statistic: Statistic, decimals: u8) -> Option<String> {
    match statistic {
        Statistic::N => Some(statistics.n.to_string()),
        Statistic::Ci95 => {
            statistics.ci95.map(|[low, high]| format!("[{}, {}]", short(low, decimals), short(high, decimals)))
        }
        _ => value(statistics, statistic).map(|value| short(value, decimals)),
    }
}

/// Cells with one factor's levels beside each other.
struct Pivot<'a> {
    /// The factors that are left for the rows.
    row_factors: Vec<&'a String>,
    /// The levels, in the plan's order; a single empty one when no factor was chosen.
    levels: Vec<String>,
    /// The rows: labels, and per level the cell's index.
    rows: Vec<(Vec<String>, Vec<Option<usize>>)>,
}

impl<'a> Pivot<'a> {
    fn of(table: &'a Table) -> Self {
        let column = |cell: &Cell| table.columns.as_ref().map_or("", |factor| label(cell, factor)).to_owned();
        let row_factors: Vec<&String> =
            table.factors.iter().filter(|factor| table.columns.as_ref() != Some(*factor)).collect();
        let mut levels: Vec<String> = Vec::new();
        let mut level_of: BTreeMap<String, usize> = BTreeMap::new();
        let mut row_of: BTreeMap<Vec<String>, usize> = BTreeMap::new();
        let mut rows: Vec<(Vec<String>, Vec<Option<usize>>)> = Vec::new();
        for (index, cell) in table.cells.iter().enumerate() {
            let labels: Vec<String> = row_factors.iter().map(|factor| label(cell, factor).to_owned()).collect();
            let row = *row_of.entry(labels.clone()).or_insert_with(|| {
                rows.push((labels, Vec::new()));
                rows.len() - 1
            });
            let level = *level_of.entry(column(cell)).or_insert_with(|| {
                levels.push(column(cell));
                levels.len() - 1
            });
            let cells = &mut rows[row].1;
            cells.resize(cells.len().max(level + 1), None);
            cells[level] = Some(index);
        }
        rows.iter_mut().for_each(|(_, cells)| cells.resize(levels.len(), None));
        Self { row_factors, levels, rows }
    }
}

fn label<'a>(cell: &'a Cell, factor: &str) -> &'a str {
    cell.factors.get(factor).map_or("", String::as_str)
}
