//! Hints at new work, for idle workers. One that is lost costs them some time.

use std::time::Duration;

use furrow_schema::protocol::work_key;
use tokio::time::sleep;
use zenoh::Session;
use zenoh::qos::CongestionControl;

use crate::coordinator::Coordinator;

/// No two hints come closer to each other than this.
const AT_MOST_EVERY: Duration = Duration::from_millis(100);

/// Puts a hint whenever there may be jobs for idle workers, until the coordinator is gone.
pub(super) async fn give(session: Session, namespace: String, coordinator: Coordinator) {
    let key = work_key(&namespace, coordinator.id());
    let mut work = coordinator.work();
    drop(coordinator);
    while work.changed().await.is_ok() {
        let put = session.put(&key, Vec::new()).congestion_control(CongestionControl::Drop).await;
        if let Err(error) = put {
            tracing::debug!(%error, "a hint at new work was not sent");
        }
        sleep(AT_MOST_EVERY).await;
    }
}
