//! What stands in a report, in which order.

use std::collections::BTreeSet;

use furrow_schema::sweep::{Sweep, SweepState};
use furrow_schema::table::Cell;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::plot::{Line, intervals};
use super::{Block, Ending, GivenUp, Material, Report, command};
use crate::table::{Column, Entry, Grid, Metric, Query, SweepData, Table, short, tabulate};

/// Metrics in tables and figures: the first few.
const SHOWN: usize = 4;
/// More cells than this do not fit a figure.
const MOST_LINES: usize = 80;

/// Puts a report together.
#[must_use]
pub fn compose(material: &Material) -> Report {
    let mut blocks = vec![facts(material)];
    blocks.extend(again(material));
    blocks.extend(results(material));
    blocks.extend(published(material));
    blocks.extend(endings(material));
    blocks.extend(given_up(material));
    blocks.extend(drawings(material));
    Report { title: title(&material.sweep), blocks }
}

fn title(sweep: &Sweep) -> String {
    if sweep.name == sweep.plan { sweep.plan.clone() } else { format!("{}: {}", sweep.name, sweep.plan) }
}

fn facts(Material { sweep, digest, .. }: &Material) -> Block {
    let unfinished = sweep.queued + sweep.leased;
    let state = match sweep.state {
        SweepState::Done => "all runs have ended".to_owned(),
        SweepState::Cancelled => format!("cancelled: {} runs were not made", sweep.cancelled),
        SweepState::Active | SweepState::Paused => format!("not finished: {unfinished} runs are missing"),
    };
    let mut facts = vec![
        ("Sweep", format!("{}, submitted {}", sweep.id, date(sweep.created_ms))),
        ("State", state),
        ("Runs", format!("{} of {}, seeds 1 to {}", sweep.done, sweep.total, sweep.seeds)),
        ("Given up on", sweep.failed.to_string()),
        ("Engine", sweep.engine.to_string()),
    ];
    if let Some(digest) = digest {
        facts.push(("Digest of all results", digest.to_string()));
    }
    if sweep.disputed > 0 {
        facts.push(("Disputed", format!("{} results differed when they were computed again", sweep.disputed)));
    }
    Block::Facts(facts)
}

fn date(unix_ms: i64) -> String {
    let moment = OffsetDateTime::from_unix_timestamp(unix_ms.div_euclid(1_000)).ok();
    moment.and_then(|moment| moment.format(&Rfc3339).ok()).unwrap_or_else(|| format!("{unix_ms} ms after 1970"))
}

fn again(Material { request, .. }: &Material) -> Vec<Block> {
    let text = "A run is a function of its scenario and seed: the same engine (furrow --version names it) gives the same \
        bits on every machine, and with them the digest above.";
    vec![Block::Heading("How to reproduce".into()), Block::Text(text.into()), Block::Code(command::again(request))]
}

fn results(Material { data, .. }: &Material) -> Vec<Block> {
    let mut blocks = vec![Block::Heading("Results".into())];
    let Some(table) = table(data) else {
        blocks.push(Block::Text("There are no results yet.".into()));
        return blocks;
    };
    blocks.push(Block::Table(table.grid()));
    for metric in &table.metrics {
        blocks.extend(figure(&table, metric));
    }
    blocks
}

/// The first few metrics of all cells.
fn table(data: &SweepData) -> Option<Table> {
    let everything = tabulate(data, &Query::default()).ok()?;
    let table = tabulate(data, &Query { metrics: Some(everything.first_metrics(SHOWN)), ..Query::default() }).ok()?;
    (!table.metrics.is_empty()).then_some(table)
}

fn figure(table: &Table, metric: &Metric) -> Option<Block> {
    if table.cells.len() > MOST_LINES {
        return None;
    }
    let lines: Vec<Line> = table.cells.iter().map(|cell| line(table, cell, metric)).collect();
    let svg = intervals(&lines, &metric.heading())?;
    let caption = format!("{}: mean of each cell and its 95 % interval.", metric.title);
    Some(Block::Figure { svg, caption })
}

fn line(table: &Table, cell: &Cell, metric: &Metric) -> Line {
    let label: Vec<&str> =
        table.factors.iter().filter_map(|factor| cell.factors.get(factor)).map(String::as_str).collect();
    let statistics = cell.metrics.get(metric.name.as_ref());
    let mean = statistics.and_then(|statistics| statistics.mean);
    let runs = format!("{} of {} runs", cell.n, cell.n + cell.missing);
    let shown = mean.map_or_else(|| runs.clone(), |mean| format!("{} ({runs})", short(mean, metric.decimals)));
    Line { label: label.join(" "), mean, ci95: statistics.and_then(|statistics| statistics.ci95), shown }
}

fn published(Material { comparisons, .. }: &Material) -> Vec<Block> {
    if comparisons.is_empty() {
        return Vec::new();
    }
    let tables = comparisons.iter().map(|comparison| Block::Table(comparison.grid()));
    std::iter::once(Block::Heading("Beside the publication".into())).chain(tables).collect()
}

fn endings(Material { data, endings, .. }: &Material) -> Vec<Block> {
    if endings.is_empty() {
        return Vec::new();
    }
    let mut columns: Vec<Column> = data.factors.iter().map(|factor| Column::left(factor.as_str())).collect();
    columns.extend(["outcome", "success"].map(Column::left));
    columns.extend(["runs", "first job", "its seed"].map(Column::right));
    let row = |ending: &Ending| {
        let mut row: Vec<Entry> = ending.labels.iter().map(Entry::text).collect();
        row.push(Entry::text(ending.outcome.as_str()));
        row.push(Entry::text(ending.success.map_or("", |success| if success { "yes" } else { "no" })));
        row.extend([ending.runs, ending.example.0.0.cast_unsigned(), ending.example.1].map(Entry::Count));
        row
    };
    let outcomes: BTreeSet<&str> = endings.iter().map(|ending| ending.outcome.as_str()).collect();
    let said = format!("Outcomes: {}.", outcomes.into_iter().collect::<Vec<_>>().join(", "));
    let grid = Grid { columns, rows: endings.iter().map(row).collect(), ..Grid::default() };
    vec![Block::Heading("How runs ended".into()), Block::Text(said), Block::Table(grid)]
}

fn given_up(Material { data, sweep, given_up, .. }: &Material) -> Vec<Block> {
    if given_up.is_empty() {
        return Vec::new();
    }
    let mut columns: Vec<Column> = data.factors.iter().map(|factor| Column::left(factor.as_str())).collect();
    columns.push(Column::right("seed"));
    columns.extend(["key", "reason of the last attempt"].map(Column::left));
    let row = |job: &GivenUp| {
        let mut row: Vec<Entry> = job.labels.iter().map(Entry::text).collect();
        row.push(Entry::Count(job.seed));
        row.extend([Entry::text(job.key.to_string()), Entry::text(job.reason.as_str())]);
        row
    };
    let rest = sweep.failed.saturating_sub(given_up.len() as u64);
    let notes = if rest > 0 { vec![format!("And {rest} more.")] } else { Vec::new() };
    let grid = Grid { columns, rows: given_up.iter().map(row).collect(), notes, ..Grid::default() };
    vec![Block::Heading("Jobs that were given up on".into()), Block::Table(grid)]
}

fn drawings(Material { drawings, .. }: &Material) -> Vec<Block> {
    if drawings.is_empty() {
        return Vec::new();
    }
    let figures = drawings.iter().map(|(svg, caption)| Block::Figure { svg: svg.clone(), caption: caption.clone() });
    std::iter::once(Block::Heading("Single runs".into())).chain(figures).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_written_as_a_date() {
        assert_eq!(date(1_700_000_000_123), "2023-11-14T22:13:20Z");
        assert_eq!(date(i64::MAX), "9223372036854775807 ms after 1970");
    }
}
