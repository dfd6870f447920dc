//! `furrow status`: where sweeps stand.

use furrow_schema::id::SweepId;
use furrow_schema::sweep::{Sweep, SweepState};

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use super::progress::span;
use crate::http::incidents::{IncidentLine, Incidents};
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
        return if args.json { output::json(&sweeps) } else { print(client, &sweeps.items).await };
    };
    let sweep: Sweep = client.get(&["v1", "sweeps", &id.to_string()], &[]).await?;
    if args.json { output::json(&sweep) } else { print(client, &[sweep]).await }
}

async fn print(client: &Client, sweeps: &[Sweep]) -> Result<(), CliError> {
    let incidents: Incidents = client.get(&["v1", "incidents"], &[("limit", "5")]).await?;
    output::line(&table(sweeps))?;
    doubts(sweeps, &incidents.items).iter().try_for_each(|line| output::line(line))
}

/// What a user should know about results that differ.
fn doubts(sweeps: &[Sweep], incidents: &[IncidentLine]) -> Vec<String> {
    let disputed = sweeps.iter().filter(|sweep| sweep.disputed > 0);
    let disputed = disputed.map(|sweep| format!("sweep {}: {} results are disputed", sweep.id, sweep.disputed));
    let incidents = incidents.iter().map(|incident| {
        let IncidentLine { job, recorded_worker, other_worker, .. } = incident;
        let verdict = incident.verification.as_deref().unwrap_or("not verified");
        format!("job {job}: worker {other_worker} has another result than {recorded_worker}, on record: {verdict}")
    });
    disputed.chain(incidents).collect()
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

    #[test]
    fn disputed_results_and_incidents_are_told() {
        use furrow_schema::id::{Digest, EngineId, JobId, WorkerId};
        let (honest, liar) = (WorkerId::random(), WorkerId::random());
        let incident = IncidentLine {
            job: JobId(7),
            recorded_worker: liar.clone(),
            recorded_engine: EngineId([1; 32]),
            recorded_digest: Digest([1; 32]),
            other_worker: honest.clone(),
            other_engine: EngineId([1; 32]),
            other_digest: Digest([2; 32]),
            other_outcome: "success".to_owned(),
            verification: Some("overruled".to_owned()),
            noted_ms: 0,
        };
        let told = doubts(&[sweep(3, 12), Sweep { disputed: 1, ..sweep(3, 12) }], &[incident]);
        let about_job = format!("job 7: worker {honest} has another result than {liar}, on record: overruled");
        assert_eq!(told, ["sweep 1: 1 results are disputed".to_owned(), about_job]);
    }
}
