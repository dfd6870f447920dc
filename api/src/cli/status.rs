//! `furrow status`: where sweeps stand.

use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use super::progress::span;
use crate::http::sweeps::Sweeps;
use crate::table::{Column, Entry, Format, Grid, render};

/// Show where a sweep stands, or the latest sweeps
#[derive(Debug, clap::Args)]
pub(super) struct StatusArgs {
    /// The sweep's number
    sweep: Option<SweepId>,
    #[command(flatten)]
    source: Source,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// The server is away, or there is no such sweep.
pub(super) async fn run(args: StatusArgs) -> Result<(), CliError> {
    let client = Client::open(&args.source).await?;
    let ended = show(&client, &args).await;
    client.close().await;
    ended
}

async fn show(client: &Client, args: &StatusArgs) -> Result<(), CliError> {
    let Some(id) = args.sweep else {
        let sweeps: Sweeps = client.get(&["v1", "sweeps"], &[("limit", "20")]).await?;
        return if args.json { output::json(&sweeps) } else { output::line(&table(&sweeps.items)) };
    };
    let sweep: Sweep = client.get(&["v1", "sweeps", &id.to_string()], &[]).await?;
    if args.json { output::json(&sweep) } else { output::line(&table(&[sweep])) }
}

fn table(sweeps: &[Sweep]) -> String {
    let [sweep, name, state] = ["sweep", "name", "state"].map(Column::left);
    let numbers = ["done", "of", "failed", "queued", "running", "runs/s", "left"].map(Column::right);
    let columns = [sweep, name, state].into_iter().chain(numbers).collect();
    render(&Grid { columns, rows: sweeps.iter().map(row).collect(), ..Grid::default() }, Format::Text)
}

fn row(sweep: &Sweep) -> Vec<Entry> {
    let rate = sweep.rate_per_s.map(|rate| format!("{rate:.1}")).unwrap_or_default();
    let left = sweep.eta_s.filter(|_| sweep.state == SweepState::Active).map(span).unwrap_or_default();
    let words = [sweep.id.to_string(), sweep.name.clone(), word(sweep.state).to_owned()].map(Entry::Text);
    let counts = [sweep.done, sweep.total, sweep.failed, sweep.queued, sweep.leased].map(Entry::Count);
    words.into_iter().chain(counts).chain([rate, left].map(Entry::Text)).collect()
}

/// The word for a state.
pub(super) fn word(state: SweepState) -> &'static str {
    match state {
        SweepState::Active => "active",
        SweepState::Paused => "paused",
        SweepState::Done => "done",
        SweepState::Cancelled => "cancelled",
    }
}

#[cfg(test)]
mod tests {
    use super::super::progress::tests::sweep;
    use super::*;

    #[test]
    fn a_line_says_how_much_is_done_and_how_long_it_takes() {
        let shown = table(&[sweep(3, 12)]);
        let line = shown.lines().find(|line| line.contains("night")).unwrap();
        let words: Vec<_> = line.split_whitespace().collect();
        assert_eq!(words, ["1", "night", "active", "3", "12", "0", "9", "0", "2.0", "3", "min", "05", "s"]);
    }
}
