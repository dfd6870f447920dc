//! `--until`: looks at what there is, and whether more seeds are needed.

use furrow_coordinator::Coordinator;
use furrow_schema::sweep::Sweep;

use super::error::CliError;
use super::output;
use crate::http::comparisons::{outline, runs_of};
use crate::http::tables::sweep_data;
use crate::paired::{PairedError, Question};
use crate::sequential::{CellWidth, ERROR_RATE, Goal, Judgement, Order, error_rate_of, next_seeds, order, widths};
use crate::table::{Column, Entry, Format, Grid, Query, metric, render, short};

/// Seeds of the first look where neither the user nor the plan asks for more.
const FIRST_SEEDS: u64 = 5;

#[derive(Debug, Clone, clap::Args)]
pub(super) struct Until {
    /// Add seeds until every cell's 95 % interval is at most so wide (`success<=0.2`, `mean_squared_error_mm2<=10%` of the
    /// mean), or until the order of every two levels is decided (`algorithm:success`); wrong at most one time in twenty,
    /// however often it looks
    #[arg(long = "until", value_name = "GOAL", conflicts_with = "timing")]
    goal: Option<Goal>,
    /// Give up at this number of seeds
    #[arg(long, value_name = "N", requires = "goal", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    max_seeds: u64,
}

impl Until {
    /// Refuses a factor that the plan does not have, before anything is run.
    ///
    /// # Errors
    /// Names the factor, and those there are.
    pub(super) fn check(&self, factors: &[String]) -> Result<(), CliError> {
        match &self.goal {
            Some(Goal::Order { factor, .. }) if !factors.contains(factor) => Err(CliError::BadInput(format!(
                "--until: there is no factor `{factor}`, allowed is {}",
                factors.join(", ")
            ))),
            _ => Ok(()),
        }
    }

    /// The search, if there is a goal; it starts with `seeds`, and at least with a few.
    pub(super) fn search(&self, seeds: u64) -> Option<Search> {
        let goal = self.goal.clone()?;
        let seeds = seeds.max(FIRST_SEEDS).min(self.max_seeds);
        Some(Search { goal, most: self.max_seeds, seeds, look: 0, orders: Vec::new() })
    }
}

/// A goal, and how far it is.
pub(super) struct Search {
    goal: Goal,
    most: u64,
    seeds: u64,
    look: u32,
    orders: Vec<Order>,
}

impl Search {
    /// Seeds of the next look.
    pub(super) fn seeds(&self) -> u64 {
        self.seeds
    }

    /// Judges a sweep that has ended. Unless that is the end, the next look has more seeds.
    ///
    /// # Errors
    /// The sweep has no such factor or metric.
    pub(super) async fn judge(&mut self, coordinator: &Coordinator, sweep: &Sweep) -> Result<Judgement, CliError> {
        self.look += 1;
        let error = error_rate_of(self.look);
        let mut judgement = Judgement {
            goal: self.goal.to_string(),
            metric: self.goal.metric().to_owned(),
            reached: false,
            looks: self.look,
            seeds: self.seeds,
            error_rate_of_look: error,
            error_rate: ERROR_RATE,
            widths: Vec::new(),
            orders: Vec::new(),
        };
        match &self.goal {
            Goal::Width { metric, at_most } => {
                let data = sweep_data(coordinator, sweep, &Query::default()).await?;
                judgement.widths = widths(&data, metric, *at_most, error);
                judgement.reached = judgement.widths.iter().all(CellWidth::reached);
            }
            Goal::Order { factor, metric } => {
                self.orders = orders(coordinator, sweep, [factor, metric], (self.look, error), &self.orders).await?;
                judgement.orders.clone_from(&self.orders);
                judgement.reached = self.orders.iter().all(|order| order.larger.is_some());
            }
        }
        Ok(judgement)
    }

    /// Whether there is no need, or no room, for another look.
    pub(super) fn ends_with(&mut self, judgement: &Judgement) -> bool {
        if judgement.reached || self.seeds >= self.most {
            return true;
        }
        self.seeds = next_seeds(self.seeds, self.most);
        output::note(&format!("{}: not yet with {} seeds; on to {}", judgement.goal, judgement.seeds, self.seeds));
        false
    }
}

async fn orders(
    coordinator: &Coordinator,
    sweep: &Sweep,
    [factor, metric]: [&str; 2],
    look: (u32, f64),
    before: &[Order],
) -> Result<Vec<Order>, CliError> {
    let bad = |error: PairedError| CliError::BadInput(format!("--until {factor}:{metric}: {error}"));
    let outline = outline(coordinator, sweep).await?;
    let levels = outline.levels(factor).map_err(bad)?;
    let [a, b] = [levels[0], levels[1]].map(|label| Some(label.to_owned()));
    let (of, by) = (Some(factor.to_owned()), Some(metric.to_owned()));
    let question = Question { factor: of, a, b, metric: by, group_by: None }.resolve(&outline, None).map_err(bad)?;
    let runs = runs_of(coordinator, sweep, &question).await?;
    order(&outline, &runs, [factor, metric], look, before).map_err(bad)
}

/// What came of it, for a terminal.
pub(super) fn shown(judgement: &Judgement) -> String {
    let Judgement { goal, reached, looks, seeds, error_rate_of_look, error_rate, .. } = judgement;
    let end = if *reached { "reached" } else { "not reached" };
    let times = if *looks == 1 { "time" } else { "times" };
    let head = format!("{goal}: {end} with {seeds} seeds, looked at {looks} {times}");
    let rates = format!(
        "Each look has its share of the error rate of {} %, the last one {:.2} %.",
        error_rate * 100.0,
        error_rate_of_look * 100.0
    );
    let table = if judgement.widths.is_empty() { orders_shown(judgement) } else { widths_shown(judgement) };
    format!("{head}\n{table}{rates}")
}

fn written(value: Option<f64>, decimals: u8) -> String {
    value.map_or_else(|| "-".to_owned(), |value| short(value, decimals))
}

/// The widest intervals, at most so many.
const WIDEST: usize = 5;

fn widths_shown(judgement: &Judgement) -> String {
    let number = |value| written(value, metric(&judgement.metric).decimals + 1);
    let mut widest: Vec<&CellWidth> = judgement.widths.iter().collect();
    widest.sort_by(|a, b| b.excess().total_cmp(&a.excess()));
    let row = |cell: &&CellWidth| {
        let labels: Vec<&str> = cell.factors.values().map(String::as_str).collect();
        let interval = cell.interval.map(|ends| ends.map(|end| number(Some(end))).join(", "));
        let interval = interval.map_or_else(|| "-".to_owned(), |ends| format!("[{ends}]"));
        let width = cell.interval.map(|[low, high]| high - low);
        [labels.join(" "), number(cell.mean), interval, number(width), number(cell.at_most)].map(Entry::Text).into()
    };
    let columns = vec![
        Column::left("widest intervals"),
        Column::right("mean"),
        Column::right("at this look"),
        Column::right("wide"),
        Column::right("asked"),
    ];
    render(&Grid { columns, rows: widest.iter().take(WIDEST).map(row).collect(), ..Grid::default() }, Format::Text)
}

fn orders_shown(judgement: &Judgement) -> String {
    let number = |value| written(value, metric(&judgement.metric).decimals + 1);
    let row = |order: &Order| {
        let decided = match (&order.larger, order.decided_at) {
            (Some(larger), Some(look)) => format!("{larger} is larger (look {look})"),
            _ => "not decided".to_owned(),
        };
        let levels = format!("{} - {}", order.a, order.b);
        vec![
            Entry::Text(levels),
            Entry::Count(order.pairs),
            Entry::Text(number(order.difference)),
            Entry::Text(written(order.p_holm, 4)),
            Entry::Text(decided),
        ]
    };
    let columns = vec![
        Column::left("a - b"),
        Column::right("pairs"),
        Column::right("difference"),
        Column::right("p (Holm)"),
        Column::left("order"),
    ];
    render(&Grid { columns, rows: judgement.orders.iter().map(row).collect(), ..Grid::default() }, Format::Text)
}

/// How it ends where a goal was not reached.
pub(super) fn conclude(judgement: Option<&Judgement>) -> Result<(), CliError> {
    match judgement {
        Some(judgement) if !judgement.reached => Err(CliError::Failed(format!(
            "--until {}: not reached with {} seeds; --max-seeds allows more",
            judgement.goal, judgement.seeds
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(goal: &str, most: u64, seeds: u64) -> Search {
        Until { goal: Some(goal.parse().unwrap()), max_seeds: most }.search(seeds).unwrap()
    }

    #[test]
    fn a_search_starts_with_a_few_seeds_and_never_passes_the_most() {
        assert_eq!((search("success<=0.2", 200, 1).seeds(), search("success<=0.2", 200, 20).seeds()), (5, 20));
        assert_eq!(search("success<=0.2", 3, 20).seeds(), 3);
    }

    #[test]
    fn a_factor_that_the_plan_does_not_have_is_refused() {
        let until = Until { goal: Some("robot:success".parse().unwrap()), max_seeds: 9 };
        let error = until.check(&["algorithm".to_owned(), "field".to_owned()]).unwrap_err();
        assert_eq!(error.to_string(), "--until: there is no factor `robot`, allowed is algorithm, field");
        assert_eq!(error.exit_code(), 2);
    }
}
