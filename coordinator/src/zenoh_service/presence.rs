//! Which workers' tokens went, and what follows from it.
//!
//! A token goes within milliseconds when its process dies, but also when a link breaks, and anybody may show or
//! withdraw one. So it is only a reason to look: a worker whose token stays away, and of which nothing is heard for a
//! grace period, loses its leases before they run out.

use std::collections::HashMap;
use std::time::Duration;

use furrow_schema::id::WorkerId;
use furrow_schema::protocol::worker_key;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::{Instant, sleep_until};
use zenoh::Session;
use zenoh::sample::{Sample, SampleKind};

use crate::coordinator::Coordinator;

/// A worker may be silent for so long after its token went.
const GRACE: Duration = Duration::from_secs(2);
/// Tokens that wait to be looked at.
const QUEUE_LENGTH: usize = 1_024;
/// At most this many workers are watched at a time; the leases of others run out in their own time.
const MOST_ABSENT: usize = 10_000;

/// A worker's token came or went.
#[derive(Debug, PartialEq, Eq)]
struct Sign {
    worker: WorkerId,
    lives: bool,
}

/// Watches the tokens of the workers of `coordinator` until it is aborted or the session closed.
pub(super) async fn watch(
    session: &Session,
    namespace: &str,
    coordinator: Coordinator,
) -> Result<JoinHandle<()>, zenoh::Error> {
    let (queue, signs) = mpsc::channel(QUEUE_LENGTH);
    let everyone = worker_key(namespace, coordinator.id(), "*");
    let look = move |token: Sample| {
        let sign = sign(token.key_expr().as_str(), token.kind());
        if sign.is_some_and(|sign| queue.try_send(sign).is_err()) {
            tracing::warn!("too many workers came and went at once: leases will run out in their own time");
        }
    };
    let subscriber = session.liveliness().declare_subscriber(everyone).callback(look).await?;
    Ok(tokio::spawn(async move {
        let _subscriber = subscriber;
        attend(coordinator, signs).await;
    }))
}

/// Reads a token; nothing if it names no worker.
fn sign(key: &str, kind: SampleKind) -> Option<Sign> {
    let worker = WorkerId::try_from(key.rsplit('/').next()?.to_owned()).ok()?;
    Some(Sign { worker, lives: kind == SampleKind::Put })
}

async fn attend(coordinator: Coordinator, mut signs: mpsc::Receiver<Sign>) {
    let mut absent = Absent::default();
    loop {
        let next = absent.next();
        let look = async {
            match next {
                Some(due) => sleep_until(due).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            sign = signs.recv() => match sign {
                Some(sign) => absent.note(sign, coordinator.now_ms(), Instant::now()),
                None => return,
            },
            () = look => {
                for (worker, since_ms) in absent.due(Instant::now()) {
                    look_for(&coordinator, worker, since_ms, &mut absent).await;
                }
            }
        }
    }
}

/// Ends the leases of a worker that is away for long enough; one that was heard of meanwhile has more time.
async fn look_for(coordinator: &Coordinator, worker: WorkerId, since_ms: i64, absent: &mut Absent) {
    match coordinator.worker_gone(worker.clone(), since_ms).await {
        Ok(None) => {}
        Ok(Some(heard_ms)) => absent.watch(worker, heard_ms, coordinator.now_ms(), Instant::now()),
        Err(error) => tracing::warn!(%error, %worker, "its leases will run out in their own time"),
    }
}

/// The workers whose token is away: since when, and when to look for them.
#[derive(Debug, Default)]
struct Absent(HashMap<WorkerId, (i64, Instant)>);

impl Absent {
    fn note(&mut self, Sign { worker, lives }: Sign, now_ms: i64, now: Instant) {
        if lives {
            self.0.remove(&worker);
        } else {
            self.watch(worker, now_ms, now_ms, now);
        }
    }

    /// Looks for a worker when it was silent since `since_ms` for the grace period.
    fn watch(&mut self, worker: WorkerId, since_ms: i64, now_ms: i64, now: Instant) {
        if self.0.len() < MOST_ABSENT {
            let silent_for = Duration::from_millis(u64::try_from(now_ms - since_ms).unwrap_or_default());
            self.0.insert(worker, (since_ms, now + GRACE.saturating_sub(silent_for)));
        }
    }

    fn next(&self) -> Option<Instant> {
        self.0.values().map(|(_, due)| *due).min()
    }

    /// Takes out those to look for now.
    fn due(&mut self, now: Instant) -> Vec<(WorkerId, i64)> {
        let due = self.0.extract_if(|_, (_, due)| *due <= now);
        due.map(|(worker, (since_ms, _))| (worker, since_ms)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_MS: i64 = 1_000_000;

    fn gone(worker: &WorkerId) -> Sign {
        Sign { worker: worker.clone(), lives: false }
    }

    #[test]
    fn a_worker_is_looked_for_when_its_token_was_away_for_the_grace_period() {
        let (mut absent, worker, now) = (Absent::default(), WorkerId::random(), Instant::now());
        absent.note(gone(&worker), START_MS, now);
        assert_eq!(absent.next(), Some(now + GRACE));
        assert!(absent.due(now + GRACE - Duration::from_millis(1)).is_empty());
        assert_eq!(absent.due(now + GRACE), [(worker, START_MS)]);
        assert_eq!(absent.next(), None);
    }

    #[test]
    fn a_token_that_comes_back_in_time_is_no_absence() {
        let (mut absent, worker, now) = (Absent::default(), WorkerId::random(), Instant::now());
        absent.note(gone(&worker), START_MS, now);
        absent.note(Sign { worker, lives: true }, START_MS + 1_999, now + GRACE - Duration::from_millis(1));
        assert!(absent.due(now + 2 * GRACE).is_empty());
    }

    #[test]
    fn a_worker_that_was_heard_of_has_the_rest_of_a_new_grace_period() {
        let (mut absent, worker, now) = (Absent::default(), WorkerId::random(), Instant::now());
        absent.watch(worker.clone(), START_MS - 1_500, START_MS, now);
        assert_eq!(absent.next(), Some(now + Duration::from_millis(500)));
        absent.watch(worker.clone(), START_MS - 9_000, START_MS, now);
        assert_eq!(absent.due(now), [(worker, START_MS - 9_000)]);
    }

    #[test]
    fn many_forged_tokens_take_bounded_room() {
        let (mut absent, now) = (Absent::default(), Instant::now());
        for _ in 0..MOST_ABSENT + 10 {
            absent.note(gone(&WorkerId::random()), START_MS, now);
        }
        assert_eq!(absent.0.len(), MOST_ABSENT);
    }

    #[test]
    fn a_token_of_no_worker_means_nothing() {
        let worker = WorkerId::random();
        let key = worker_key("default", "c0ffee", worker.as_str());
        assert_eq!(sign(&key, SampleKind::Delete), Some(gone(&worker)));
        assert_eq!(sign("furrow/v1/default/c0ffee/worker/nobody", SampleKind::Delete), None);
    }
}
