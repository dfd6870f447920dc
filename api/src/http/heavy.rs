//! Requests that take memory or processor time for long have to wait for one another.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::{Semaphore, SemaphorePermit};

use super::problem::Problem;

/// Tables at a time: one less than the database has readers, so that the others are answered meanwhile.
const TABLES: usize = 3;

/// Bodies that are read at a time, each up to the limit of a body.
const BODIES: usize = 16;

/// A request waits so long for its turn.
const PATIENCE: Duration = Duration::from_secs(20);

/// Whose turn it is.
#[derive(Debug, Clone)]
pub(super) struct Turns {
    tables: Arc<Semaphore>,
    bodies: Arc<Semaphore>,
    patience: Duration,
}

impl Default for Turns {
    fn default() -> Self {
        let turns = |n| Arc::new(Semaphore::new(n));
        Self { tables: turns(TABLES), bodies: turns(BODIES), patience: PATIENCE }
    }
}

impl Turns {
    /// Whose turn this request has to wait for, if any.
    fn of(&self, request: &Request) -> Option<&Semaphore> {
        let path = request.uri().path();
        let heavy = ["/table", "/values", "/compare", "/results", "/report"].iter().any(|end| path.ends_with(end));
        if !request.method().is_safe() {
            Some(&self.bodies)
        } else if heavy || path.starts_with("/v1/publications/") {
            Some(&self.tables)
        } else {
            None
        }
    }

    async fn wait<'a>(&self, turns: &'a Semaphore) -> Result<SemaphorePermit<'a>, Problem> {
        match tokio::time::timeout(self.patience, turns.acquire()).await {
            Ok(Ok(turn)) => Ok(turn),
            _ => Err(Problem::unavailable("too many such requests are under way")),
        }
    }
}

/// Lets a request through to `next` when it is its turn.
pub(super) async fn in_turn(State(turns): State<Turns>, request: Request, next: Next) -> Response {
    let Some(semaphore) = turns.of(&request) else { return next.run(request).await };
    match turns.wait(semaphore).await {
        Ok(_turn) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::body::Body;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use tokio::sync::Notify;
    use tower::ServiceExt;

    use super::*;

    #[tokio::test]
    async fn tables_beyond_those_at_a_time_wait_and_are_refused_in_the_end() {
        let (begun, end) = (Arc::new(Semaphore::new(0)), Arc::new(Notify::new()));
        let (signal, gate) = (begun.clone(), end.clone());
        let table = move || async move {
            signal.add_permits(1);
            gate.notified().await;
        };
        let turns = Turns { patience: Duration::from_millis(20), ..Turns::default() };
        let router = Router::new().route("/table", get(table)).route("/light", get(async || ()));
        let router = router.layer(from_fn_with_state(turns, in_turn));
        let ask = |path: &str| {
            let request = Request::get(path.to_owned()).body(Body::empty()).unwrap();
            let answer = router.clone().oneshot(request);
            async move { answer.await.unwrap().status().as_u16() }
        };
        let asked: Vec<_> = (0..TABLES).map(|_| tokio::spawn(ask("/table"))).collect();
        let _all = begun.acquire_many(u32::try_from(TABLES).unwrap()).await.unwrap();
        assert_eq!(ask("/table").await, 503);
        assert_eq!(ask("/light").await, 200);
        end.notify_waiters();
        for answer in asked {
            assert_eq!(answer.await.unwrap(), 200);
        }
    }
}
