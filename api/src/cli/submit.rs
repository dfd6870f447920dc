//! `furrow submit`: hand a sweep to a server, or put it into a database.

use furrow_schema::id::RequestId;
use serde_json::json;

use super::client::{Client, Source};
use super::error::CliError;
use super::output;
use super::selection::Selection;
use crate::http::sweeps::{SweepCreated, SweepRequest};
use crate::plan::{NotApplied, PlanSource, Request};

/// Hand a sweep to a server
#[derive(Debug, clap::Args)]
pub(super) struct SubmitArgs {
    #[command(flatten)]
    selection: Selection,
    #[command(flatten)]
    source: Source,
    /// A name for the sweep instead of the plan's
    #[arg(long)]
    name: Option<String>,
    /// Higher goes first
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    priority: i64,
    /// Run everything anew, one run at a time on each worker, to measure times
    #[arg(long)]
    timing: bool,
    /// Store the trajectories
    #[arg(long)]
    record: bool,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// Bad input, or the server is away or refuses.
pub(super) async fn run(args: SubmitArgs) -> Result<(), CliError> {
    let client = Client::open_to_change(&args.source).await?;
    let ended = submit(&client, args).await;
    client.close().await;
    ended
}

async fn submit(client: &Client, args: SubmitArgs) -> Result<(), CliError> {
    let body = SweepRequest {
        priority: args.priority,
        name: args.name,
        record: args.record,
        timing: args.timing,
        ..body(args.selection.request()?)?
    };
    let key = RequestId::random();
    let created: SweepCreated = client.post(&["v1", "sweeps"], key.as_str(), &body).await?;
    warn(&created.not_applied);
    if args.json {
        return output::json(&created);
    }
    let SweepCreated { id, total, new, cached, .. } = created;
    output::line(&format!("sweep {id}: {total} runs, {new} of them new, {cached} with a result already"))
}

/// The request as a server reads it: a plan from a file travels whole.
fn body(request: Request) -> Result<SweepRequest, CliError> {
    let plan = match &request.plan {
        PlanSource::Named(name) => json!(name),
        file => json!(file.load()?),
    };
    Ok(SweepRequest {
        plan,
        only: request.only,
        set: request.set,
        vary: request.vary,
        field: request.field.map(|field| field.request_part()),
        seeds: request.seeds,
        priority: 0,
        name: None,
        record: false,
        timing: false,
    })
}

/// Says which paths changed nothing somewhere.
pub(super) fn warn(not_applied: &[NotApplied]) {
    for NotApplied { path, levels } in not_applied {
        output::note(&format!("furrow: `{path}` does not apply to {}", levels.join(", ")));
    }
}
