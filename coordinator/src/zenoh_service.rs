//! The coordinator on the network: a queryable a question, a token that says it is there, and an eye on the workers' tokens.
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
use crate::gate::Gate;
use crate::zenoh_config::session;
pub use crate::zenoh_config::{LocalNetwork, Scouting, ZenohConfig, ZenohError};

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
    gate: Option<Gate>,
    beside: [AbortHandle; 2],
}

/// Brings `coordinator` onto the network. Needs a tokio runtime with several threads.
///
/// # Errors
/// [`ZenohError`] names the setting or the endpoint that is at fault; nothing is left running.
pub async fn serve(coordinator: Coordinator, config: ZenohConfig) -> Result<ZenohService, ZenohError> {
    config.check_namespace()?;
    let (session, endpoints) = open(&coordinator, &config).await?;
    let gate = config.local_network.as_ref().map(|network| {
        let reached_at = network.reached_at(&endpoints);
        Gate::new(coordinator.clone(), network.authority.clone(), config.namespace.clone(), reached_at)
    });
    let (queue, queries) = mpsc::channel(QUEUE_LENGTH);
    let mut queryables = Vec::new();
    for method in if gate.is_some() { &Method::ALL[..] } else { &Method::OF_WORK[..] } {
        let method = *method;
        let key = key(&config.namespace, coordinator.id(), method);
        queryables.push(declare(&session, &key, method, queue.clone()).await?);
    }
    let token = coordinator_key(&config.namespace, coordinator.id());
    let watching = presence::watch(&session, &config.namespace, coordinator.clone()).await?;
    let hinting = tokio::spawn(hints::give(session.clone(), config.namespace.clone(), coordinator.clone()));
    let who = gate.clone().map_or_else(|| Answerer::Coordinator(coordinator), Answerer::Gate);
    let answering = tokio::spawn(answer_all(who, queries));
    let token = session.liveliness().declare_token(token).await?;
    tracing::info!(?endpoints, namespace = config.namespace, "listening for workers");
    let beside = [watching.abort_handle(), hinting.abort_handle()];
    Ok(ZenohService { session, endpoints, token, queryables, answering, gate, beside })
}

/// Who answers the network.
#[derive(Debug)]
enum Answerer {
    /// Everybody is on this machine.
    Coordinator(Coordinator),
    /// Nobody is let in without having enrolled.
    Gate(Gate),
}

impl Answerer {
    async fn handle(&self, method: Method, payload: &[u8]) -> Vec<u8> {
        match self {
            Self::Coordinator(coordinator) => coordinator.handle(method, payload).await,
            Self::Gate(gate) => gate.handle(method, payload).await,
        }
    }
}

impl ZenohService {
    /// Where the service listens, with the ports it got.
    #[must_use]
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Who lets workers in, on a local network.
    #[must_use]
    pub fn gate(&self) -> Option<&Gate> {
        self.gate.as_ref()
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
async fn open(coordinator: &Coordinator, config: &ZenohConfig) -> Result<(Session, Vec<String>), ZenohError> {
    let network = config.local_network.as_ref();
    let mut scouting = if network.is_some() { Scouting::Off } else { config.scouting };
    let mut tries = TRIES;
    loop {
        let endpoints = config.endpoints()?;
        tries -= 1;
        let settings = |network: &LocalNetwork| {
            network.settings(&endpoints, &config.namespace, coordinator.id(), coordinator.now_ms())
        };
        let security = network.map(settings).transpose()?.unwrap_or_default();
        match zenoh::open(session(&endpoints, scouting, security)?).await {
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

async fn answer_all(who: Answerer, queries: mpsc::Receiver<(Method, Query)>) {
    let who = Arc::new(who);
    stream::unfold(queries, async |mut queries| queries.recv().await.map(|query| (query, queries)))
        .for_each_concurrent(AT_A_TIME, |(method, query)| answer(who.clone(), method, query))
        .await;
}

async fn answer(who: Arc<Answerer>, method: Method, query: Query) {
    let payload = query.payload().map(|payload| payload.to_bytes()).unwrap_or_default();
    let reply = who.handle(method, &payload).await;
    let sent = query.reply(query.key_expr(), reply).encoding(Encoding::APPLICATION_JSON).await;
    if let Err(error) = sent {
        // The worker is gone, or asked with a pattern; either way it asks again.
        tracing::debug!(%error, method = method.as_str(), "an answer could not be sent");
    }
}

#[cfg(test)]
mod tests;
