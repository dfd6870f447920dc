//! `furrow plans`: what there is to run.

use serde_json::json;

use super::error::CliError;
use super::output;
use crate::http::plans::Plans;
use crate::plan::{self, FactorSummary, PlanSource, PlanSummary};
use crate::table::{Column, Entry, Format, Grid, render};

/// List the plans, or show one with its factors, levels and base scenario
#[derive(Debug, clap::Args)]
pub(super) struct PlansArgs {
    /// A plan's name, or a path ending in .json
    plan: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// There is no such plan.
pub(super) fn run(args: &PlansArgs) -> Result<(), CliError> {
    match &args.plan {
        Some(name) => show(name, args.json),
        None => list(args.json),
    }
}

fn list(json: bool) -> Result<(), CliError> {
    let items = plan::catalogue()?;
    if json {
        return output::json(&Plans { items });
    }
    let row = |plan: PlanSummary| {
        let (cells, seeds) = (Entry::Count(plan.cells()), Entry::Count(plan.seeds));
        vec![Entry::Text(plan.name), cells, seeds, Entry::Text(plan.title)]
    };
    let columns = vec![Column::left("plan"), Column::right("cells"), Column::right("seeds"), Column::left("about")];
    let grid = Grid { columns, rows: items.into_iter().map(row).collect(), ..Grid::default() };
    output::line(&render(&grid, Format::Text))
}

fn show(name: &str, json: bool) -> Result<(), CliError> {
    let plan = PlanSource::from_argument(name).load()?;
    let short = PlanSummary::of(&plan)?;
    if json {
        return output::json(&json!({
            "name": short.name, "title": short.title, "source": short.source, "seeds": short.seeds,
            "factors": short.factors, "base": plan.base,
        }));
    }
    output::line(&format!("{}\n{}\nsource: {}\n", short.name, short.title, short.source))?;
    output::line(&format!("{} cells, seeds 1 to {}\n", short.cells(), short.seeds))?;
    output::line(&factors(&short.factors))?;
    let base = serde_json::to_string_pretty(&plan.base).map_err(CliError::failed("cannot write JSON"))?;
    output::line(&format!("base scenario:\n{base}"))
}

fn factors(factors: &[FactorSummary]) -> String {
    factors.iter().map(|factor| format!("{}: {}\n", factor.name, levels(&factor.labels))).collect()
}

/// All labels, or the first and the last of many.
fn levels(labels: &[String]) -> String {
    match labels {
        [first, second, .., last] if labels.len() > 40 => format!("{first}, {second}, .. {last} ({})", labels.len()),
        _ => labels.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_levels_are_shown_by_their_ends() {
        let labels: Vec<String> = (0..100).map(|i| format!("nursery-{i:03}")).collect();
        assert_eq!(levels(&labels), "nursery-000, nursery-001, .. nursery-099 (100)");
        assert_eq!(levels(&labels[..2]), "nursery-000, nursery-001");
    }
}
