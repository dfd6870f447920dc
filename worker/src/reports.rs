//! Says what became of runs, until the coordinator has it on record.

use furrow_schema::id::EngineId;
use furrow_schema::protocol::{Recorded, Refusal, Report, RunEnd, RunReport};
use tokio_util::sync::CancellationToken;

use crate::board::Board;
use crate::conversation::{AskError, Conversation};
use crate::gathering::Gathering;
use crate::pool::Shared;
use crate::spooling::OpenSpool;
use crate::worker::Summary;

/// Reports ended runs until the board is drained, or until `too_late`. While one report is on its way the next one
/// gathers.
pub(crate) async fn report_runs<S>(
    conversation: &Conversation,
    engine: EngineId,
    shared: &Shared<S>,
    too_late: &CancellationToken,
) -> Result<Summary, AskError> {
    let mut summary = Summary::default();
    let mut gathering = Gathering::default();
    loop {
        gathering.more(shared, &shared.ended, Board::gathers_for_report).await;
        let (runs, drained) = {
            let mut board = shared.board();
            (board.take_ended(), board.is_drained())
        };
        if !runs.is_empty() {
            match report(conversation, engine, &runs, too_late).await {
                Ok(recorded) => summary.count(&runs, &recorded),
                Err(AskError::GivenUp) => return Ok(summary),
                Err(error) => return Err(error),
            }
            shared.board().forget(&runs);
            shared.room.notify_one();
            shared.spool.notify_one();
        } else if drained {
            return Ok(summary);
        } else {
            tokio::select! {
                biased;
                () = too_late.cancelled() => return Ok(summary),
                () = shared.ended.notified() => {}
            }
        }
    }
}

/// Delivers what earlier lives of this worker left in the spool, before it takes on anything new: its jobs may be on
/// their way to others.
pub(crate) async fn deliver_spooled(
    conversation: &Conversation,
    engine: EngineId,
    spool: &OpenSpool,
    give_up: &CancellationToken,
) -> Result<Summary, AskError> {
    let mut summary = Summary::default();
    loop {
        let runs = spool.waiting().await;
        if runs.is_empty() {
            return Ok(summary);
        }
        let recorded = match report(conversation, engine, &runs, give_up).await {
            Err(AskError::GivenUp) => return Ok(summary),
            answer => answer?,
        };
        summary.count(&runs, &recorded);
        let (recorded, ignored) = (recorded.recorded.len(), recorded.ignored.len());
        tracing::info!(recorded, ignored, "delivered runs from the spool");
        spool.forget(runs.iter().map(|run| (run.job, run.attempt)).collect()).await;
    }
}

/// A report that is refused as malformed is sent run by run, so that one bad record does not hold up the others.
async fn report(
    conversation: &Conversation,
    engine: EngineId,
    runs: &[RunReport],
    too_late: &CancellationToken,
) -> Result<Recorded, AskError> {
    match conversation.ask(Report { engine, runs: runs.to_vec() }, too_late).await {
        Err(AskError::Refused(Refusal::Malformed { .. })) => {}
        answer => return answer,
    }
    let mut all = Recorded::default();
    for run in runs {
        let one = report_alone(conversation, engine, run, too_late).await?;
        all.recorded.extend(one.recorded);
        all.ignored.extend(one.ignored);
    }
    Ok(all)
}

/// A run whose record the coordinator cannot read is charged to the job like a panic.
async fn report_alone(
    conversation: &Conversation,
    engine: EngineId,
    run: &RunReport,
    too_late: &CancellationToken,
) -> Result<Recorded, AskError> {
    let refusal = match conversation.ask(Report { engine, runs: vec![run.clone()] }, too_late).await {
        Err(AskError::Refused(refusal @ Refusal::Malformed { .. })) => refusal,
        answer => return answer,
    };
    tracing::error!(job = %run.job, %refusal, "the coordinator cannot read this run's record");
    let ended = RunEnd::Panicked { message: format!("the record was refused: {refusal}") };
    let charge = Report { engine, runs: vec![RunReport { ended, ..run.clone() }] };
    match conversation.ask(charge, too_late).await {
        Err(AskError::Refused(Refusal::Malformed { .. })) => {
            Ok(Recorded { ignored: vec![run.job], ..Recorded::default() })
        }
        answer => answer,
    }
}
