//! Keeps the leases alive, and hears which jobs are lost.

use std::time::Duration;

use furrow_schema::protocol::{HeldJob, MAX_CLAIM, Refusal, Renew};
use tokio::time::{MissedTickBehavior, interval};

use crate::conversation::Conversation;
use crate::pool::Shared;

/// Bounds of the coordinator's wish.
const MOST_OFTEN: Duration = Duration::from_millis(100);
const LEAST_OFTEN: Duration = Duration::from_secs(10);

/// Renews all held leases every `every_ms`, and when the coordinator is back, until it turns the worker away. A renewal
/// without an answer is not repeated: the next one comes soon enough.
pub(crate) async fn renew_leases<S>(conversation: &Conversation, every_ms: u64, shared: &Shared<S>) -> Refusal {
    let mut ticks = interval(Duration::from_millis(every_ms).clamp(MOST_OFTEN, LEAST_OFTEN));
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks.tick().await;
    loop {
        tokio::select! {
            biased;
            _ = ticks.tick() => {}
            () = conversation.back() => {}
        }
        let held = shared.board().held();
        for some in held.chunks(MAX_CLAIM as usize) {
            if let Err(refusal) = renew(conversation, some, shared).await {
                return refusal;
            }
        }
    }
}

async fn renew<S>(conversation: &Conversation, held: &[HeldJob], shared: &Shared<S>) -> Result<(), Refusal> {
    let Some(renewed) = conversation.ask_once(Renew { held: held.to_vec() }).await? else { return Ok(()) };
    let jobs = shared.board().lose(&renewed.lost);
    if jobs > 0 {
        tracing::info!(jobs, "jobs are no longer this worker's");
        shared.ring_ended();
        shared.room.notify_one();
    }
    Ok(())
}
