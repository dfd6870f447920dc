//! What a worker shows and hears beside its questions: that it lives, and that there may be work.
//!
//! Either may be lost: a dead worker's leases run out, and an idle worker asks again by itself.

use std::sync::Arc;
use std::time::Duration;

use furrow_schema::id::WorkerId;
use furrow_schema::protocol::{work_key, worker_key};
use tokio::sync::{Notify, watch};
use tokio::task::AbortHandle;
use zenoh::Session;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;

/// Workers that hear one hint ask at different moments within this time \[ms\].
const SPREAD_MS: u64 = 50;

/// A worker's token and its ear. The coordinator sees both go when this is dropped or the process dies.
pub(super) struct Life {
    pub(super) worker: WorkerId,
    _token: LivelinessToken,
    _ear: Subscriber<()>,
    relay: AbortHandle,
}

impl Life {
    /// Shows `coordinator` that `worker` lives, and changes `bell` a little after each of its hints.
    pub(super) async fn show(
        session: &Session,
        namespace: &str,
        coordinator: &str,
        worker: &WorkerId,
        bell: watch::Sender<u64>,
    ) -> Result<Self, zenoh::Error> {
        let key = worker_key(namespace, coordinator, worker.as_str());
        let token = session.liveliness().declare_token(key).await?;
        let hint = Arc::new(Notify::new());
        let heard = Arc::clone(&hint);
        let ear = session.declare_subscriber(work_key(namespace, coordinator));
        let ear = ear.callback(move |_| heard.notify_one()).await?;
        let relay = tokio::spawn(relay(hint, spread(worker), bell)).abort_handle();
        Ok(Self { worker: worker.clone(), _token: token, _ear: ear, relay })
    }
}

impl Drop for Life {
    fn drop(&mut self) {
        self.relay.abort();
    }
}

async fn relay(hint: Arc<Notify>, spread: Duration, bell: watch::Sender<u64>) {
    loop {
        hint.notified().await;
        tokio::time::sleep(spread).await;
        bell.send_modify(|hints| *hints += 1);
    }
}

/// How long this worker waits after a hint, so that not all of them ask at one moment.
fn spread(worker: &WorkerId) -> Duration {
    let first_digits = u64::from_str_radix(&worker.as_str()[..8], 16).expect("a worker's name is hexadecimal digits");
    Duration::from_millis(first_digits % SPREAD_MS)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn workers_answer_a_hint_at_different_moments_each_always_at_its_own() {
        let workers: Vec<_> = (0..100).map(|_| WorkerId::random()).collect();
        let moments: BTreeSet<_> = workers.iter().map(spread).collect();
        assert!(moments.len() > 20 && moments.iter().all(|moment| moment.as_millis() < u128::from(SPREAD_MS)));
        assert_eq!(spread(&workers[0]), spread(&workers[0].clone()));
    }
}
