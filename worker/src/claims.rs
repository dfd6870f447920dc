//! Keeps the board filled, one batch ahead of the threads.

use std::time::Duration;

use furrow_schema::id::EngineId;
use furrow_schema::protocol::{Claim, Leases};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::conversation::{AskError, Conversation};
use crate::pool::{Pool, Shared};
use crate::runner::Runner;
use crate::scenarios::Scenarios;

/// A claim that is on its way when the worker is told to stop has this long to come back: what it brings can then
/// be handed back at once.
const CLAIM_GRACE: Duration = Duration::from_secs(1);
/// Bounds of the pause when the coordinator has no jobs.
const SHORTEST_RETRY: Duration = Duration::from_millis(5);
const LONGEST_RETRY: Duration = Duration::from_secs(10);

/// Claims jobs until `stop`, or until the coordinator refuses for good.
pub(crate) async fn claim_jobs<R: Runner>(
    conversation: &Conversation,
    engine: EngineId,
    shared: &Shared<R::Scenario>,
    pool: &Pool<R>,
    stop: &CancellationToken,
) -> Result<(), AskError> {
    let too_late = CancellationToken::new();
    let work = claim_until_stopped(conversation, engine, shared, pool, stop, &too_late);
    let grace = async {
        stop.cancelled().await;
        tokio::time::sleep(CLAIM_GRACE).await;
        too_late.cancel();
        std::future::pending::<()>().await;
    };
    tokio::select! {
        biased;
        ended = work => ended,
        () = grace => Ok(()),
    }
}

async fn claim_until_stopped<R: Runner>(
    conversation: &Conversation,
    engine: EngineId,
    shared: &Shared<R::Scenario>,
    pool: &Pool<R>,
    stop: &CancellationToken,
    too_late: &CancellationToken,
) -> Result<(), AskError> {
    let mut scenarios = Scenarios::new();
    let mut changes = conversation.changes();
    let mut first = true;
    while !stop.is_cancelled() {
        let want = shared.board().want();
        if want == 0 {
            pause(shared.room.notified(), stop).await;
            continue;
        }
        scenarios.forget_surplus();
        if let Some(changes) = &mut changes {
            changes.mark_unchanged();
        }
        let claim = Claim { engine, want, known_scenarios: scenarios.known(), first };
        let leases = match conversation.ask(claim, too_late).await {
            Ok(leases) => leases,
            Err(AskError::GivenUp) => return Ok(()),
            Err(error) => return Err(error),
        };
        first = false;
        shared.board().note_grant(want, leases.jobs.len());
        if leases.jobs.is_empty() {
            let retry = Duration::from_millis(leases.retry_after_ms).clamp(SHORTEST_RETRY, LONGEST_RETRY);
            pause(new_work(retry, changes.as_mut()), stop).await;
        } else {
            take_in(leases, &mut scenarios, shared);
            pool.kick();
        }
    }
    Ok(())
}

/// Waits until it is worth asking again: after `retry`, or soon after a change since the last question.
async fn new_work(retry: Duration, changes: Option<&mut watch::Receiver<u64>>) {
    let change = async {
        tokio::time::sleep(SHORTEST_RETRY).await;
        let Some(changes) = changes else { return std::future::pending().await };
        if changes.changed().await.is_err() {
            std::future::pending().await
        }
    };
    tokio::select! {
        biased;
        () = change => {}
        () = tokio::time::sleep(retry) => {}
    }
}

async fn pause(what: impl Future<Output = ()>, stop: &CancellationToken) {
    tokio::select! {
        biased;
        () = what => {}
        () = stop.cancelled() => {}
    }
}

fn take_in<S>(leases: Leases, scenarios: &mut Scenarios<S>, shared: &Shared<S>) {
    scenarios.learn(leases.scenarios);
    let mut board = shared.board();
    for lease in leases.jobs {
        let scenario = scenarios.get(lease.scenario);
        board.add(lease, scenario);
    }
    drop(board);
    shared.ring_ended();
}
