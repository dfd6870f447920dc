//! The coordinator on the network: four queryables, a token that says it is there, and an eye on the workers' tokens.
//!
//! The keys are those of [`furrow_schema::protocol::key`]. While the service runs it holds the liveliness token
//! [`furrow_schema::protocol::coordinator_key`]: a worker that knows the namespace asks for the tokens under
//! `furrow/v1/{namespace}/*/coordinator` and reads the coordinator's id from the key, last word but one.
//!
//! Zenoh's own thread only drops a query into a bounded queue. When that is full the query gets no answer,
//! which to the worker is an unknown outcome: it asks again later, under the same request.

mod hints;
mod presence;

use std::sync::Arc;

use furrow_schema::protocol::{Method, coordinator_key, key};
use futures::{StreamExt, stream};
use tokio::sync::mpsc;
use tokio::task::{AbortHandle, JoinHandle};
use zenoh::Session;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};

use crate::coordinator::Coordinator;
use crate::zenoh_config::session;
pub use crate::zenoh_config::{Scouting, ZenohConfig, ZenohError};

/// Queries that wait to be read.
const QUEUE_LENGTH: usize = 1_024;
/// Queries that are answered at a time: as many may share a transaction.
const AT_A_TIME: usize = 256;
/// A free port may be taken by another between finding and using it; then the next one is tried.
const TRIES: usize = 5;

/// A running service.
#[derive(Debug)]
pub struct ZenohService {
    session: Session,
    endpoints: Vec<String>,
    token: LivelinessToken,
    queryables: Vec<Queryable<()>>,
    answering: JoinHandle<()>,
    beside: [AbortHandle; 2],
}

/// Brings `coordinator` onto the network. Needs a tokio runtime with several threads.
///
/// # Errors
/// [`ZenohError`] names the setting or the endpoint that is at fault; nothing is left running.
pub async fn serve(coordinator: Coordinator, config: ZenohConfig) -> Result<ZenohService, ZenohError> {
    config.check_namespace()?;
    let (session, endpoints) = open(&config).await?;
    let (queue, queries) = mpsc::channel(QUEUE_LENGTH);
    let mut queryables = Vec::new();
    for method in Method::ALL {
        let key = key(&config.namespace, coordinator.id(), method);
        queryables.push(declare(&session, &key, method, queue.clone()).await?);
    }
    let token = coordinator_key(&config.namespace, coordinator.id());
    let watching = presence::watch(&session, &config.namespace, coordinator.clone()).await?;
    let hinting = tokio::spawn(hints::give(session.clone(), config.namespace.clone(), coordinator.clone()));
    let answering = tokio::spawn(answer_all(coordinator, queries));
    let token = session.liveliness().declare_token(token).await?;
    tracing::info!(?endpoints, namespace = config.namespace, "listening for workers");
    let beside = [watching.abort_handle(), hinting.abort_handle()];
    Ok(ZenohService { session, endpoints, token, queryables, answering, beside })
}

impl ZenohService {
    /// Where the service listens, with the ports it got.
    #[must_use]
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Withdraws the token, takes no more queries, answers those that came, and closes the session.
    pub async fn close(self) {
        let Self { session, token, queryables, answering, beside, .. } = self;
        beside.iter().for_each(AbortHandle::abort);
        let mut failed = token.undeclare().await.err();
        for queryable in queryables {
            failed = queryable.undeclare().await.err().or(failed);
        }
        // The queue's senders went with the queryables: this ends when the last query is answered.
        if answering.await.is_err() {
            tracing::error!("the task that answers workers failed");
        }
        if let Some(error) = session.close().await.err().or(failed) {
            tracing::warn!(%error, "the Zenoh session did not close cleanly");
        }
    }
}

/// Opens the session, without scouting if this machine cannot do that.
async fn open(config: &ZenohConfig) -> Result<(Session, Vec<String>), ZenohError> {
    let mut scouting = config.scouting;
    let mut tries = TRIES;
    loop {
        let endpoints = config.endpoints()?;
        tries -= 1;
        match zenoh::open(session(&endpoints, scouting)?).await {
            Ok(session) => return Ok((session, endpoints)),
            Err(error) if tries == 0 => return Err(error.into()),
            Err(error) if scouting != Scouting::Off => {
                tracing::warn!(%error, "no scouting: workers have to be told the endpoint");
                scouting = Scouting::Off;
            }
            Err(_) if config.has_free_choice() => {}
            Err(error) => return Err(error.into()),
        }
    }
}

async fn declare(
    session: &Session,
    key: &str,
    method: Method,
    queue: mpsc::Sender<(Method, Query)>,
) -> Result<Queryable<()>, ZenohError> {
    let declared = session.declare_queryable(key.to_owned()).complete(true).callback(move |query| {
        if queue.try_send((method, query)).is_err() {
            tracing::warn!(method = method.as_str(), "too many queries at once: one was dropped");
        }
    });
    Ok(declared.await?)
}

async fn answer_all(coordinator: Coordinator, queries: mpsc::Receiver<(Method, Query)>) {
    let coordinator = Arc::new(coordinator);
    stream::unfold(queries, async |mut queries| queries.recv().await.map(|query| (query, queries)))
        .for_each_concurrent(AT_A_TIME, |(method, query)| answer(coordinator.clone(), method, query))
        .await;
}

async fn answer(coordinator: Arc<Coordinator>, method: Method, query: Query) {
    let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
    let reply = coordinator.handle(method, &payload).await;
    let sent = query.reply(query.key_expr(), reply).encoding(Encoding::APPLICATION_JSON).await;
    if let Err(error) = sent {
        // The worker is gone, or asked with a pattern; either way it asks again.
        tracing::debug!(%error, method = method.as_str(), "an answer could not be sent");
    }
}

#[cfg(test)]
mod tests;
