//! The way to a coordinator over Zenoh.
//!
//! Every question is a query with an explicit timeout, one reply and no consolidation. What shapes the rest is how
//! Zenoh 1.10 behaves: a client that was given its endpoint connects again after a break, one that found it by
//! scouting does not, so the search only finds the endpoint and the session is then opened with it; a coordinator
//! that is away, or a link that breaks, shows as no reply at once, which tells nothing of what was done.
//!
//! A link belongs to one coordinator. One that was found by scouting may come back elsewhere, so that it is scouted
//! for again; meanwhile another one is not taken for it before all leases of the old one ran out.

mod discovery;
mod life;
mod session;

use std::time::Duration;

use async_trait::async_trait;
use furrow_schema::id::WorkerId;
use furrow_schema::protocol::{
    Call, Certificate, Claim, DEFAULT_NAMESPACE, Hello, LEASE_MS, Leases, Method, Recorded, Refresh, Renew, Renewed,
    Reply, Report, Welcome, key,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::sync::{Mutex, watch};
use tokio::time::Instant;
use zenoh::Session;
use zenoh::query::ConsolidationMode;

use crate::lan::{Certificates, Enrolment};
use crate::link::{Link, LinkError};
use life::Life;

/// A question is given up after this long. A coordinator that is busy with a large submission needs some of it.
const QUERY_TIMEOUT: Duration = Duration::from_secs(10);
/// How long [`ZenohLink::connect`] looks for a coordinator, unless told otherwise.
const DEFAULT_PATIENCE: Duration = Duration::from_secs(5);
/// The same for one on a local network, which may have several addresses.
const NETWORK_PATIENCE: Duration = Duration::from_secs(20);
/// A coordinator that was found by scouting is waited for so long before another one is taken: by then nothing that it
/// handed out is this worker's any more.
const FAITHFUL_FOR: Duration = Duration::from_millis(LEASE_MS.unsigned_abs());
/// A session that finds nobody for so long at the one place where it may look is opened anew. Zenoh's own may have connected
/// again and still hear of nobody, after a time when the coordinator stood still.
const PATIENT_FOR: Duration = Duration::from_secs(5);

/// Where to look for a coordinator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConnectConfig {
    /// Its endpoint, such as `tcp/127.0.0.1:7447`; none to search for it.
    pub endpoint: Option<String>,
    /// The namespace it serves.
    pub namespace: String,
    /// The certificates with which to connect to a coordinator on a local network; none for one on this machine.
    pub certificates: Option<Certificates>,
    /// Where that coordinator listens, if no endpoint is given: one of these.
    pub known: Vec<String>,
    /// How long to look for it; none to wait for ever.
    pub patience: Option<Duration>,
}

impl Default for ConnectConfig {
    fn default() -> Self {
        let (namespace, patience) = (DEFAULT_NAMESPACE.to_owned(), Some(DEFAULT_PATIENCE));
        Self { endpoint: None, namespace, certificates: None, known: Vec::new(), patience }
    }
}

impl ConnectConfig {
    /// Whether the coordinator can be at one address only.
    fn is_one_place(&self) -> bool {
        self.endpoint.is_some() || (self.certificates.is_some() && self.known.len() < 2)
    }

    /// How an enrolled worker with this key (PEM) reaches its coordinator.
    #[must_use]
    pub fn enrolled(enrolment: &Enrolment, key_pem: &str) -> Self {
        Self {
            namespace: enrolment.namespace.clone(),
            certificates: Some(Certificates::of_worker(enrolment, key_pem)),
            known: enrolment.endpoints.clone(),
            patience: Some(NETWORK_PATIENCE),
            ..Self::default()
        }
    }
}

/// Why there is no link to a coordinator.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ConnectError {
    /// Nobody answers. The caller starts a coordinator, or says where it is.
    #[error(
        "no coordinator found {place} in namespace `{namespace}`: start one with `furrow serve`, or give its endpoint with --connect"
    )]
    NoCoordinator {
        /// Where it was looked for, in words.
        place: String,
        /// For which namespace.
        namespace: String,
    },
    /// More than one answers. The caller chooses.
    #[error("several coordinators answer, choose one with --connect: {}", endpoints.join(", "))]
    Ambiguous {
        /// Their endpoints.
        endpoints: Vec<String>,
    },
    /// The endpoint is not one. The caller corrects it.
    #[error("--connect: `{endpoint}` is not an endpoint, expected tcp/HOST:PORT or quic/HOST:PORT: {reason}")]
    BadEndpoint {
        /// As it was given.
        endpoint: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The namespace is not a word of a key. The caller corrects it.
    #[error("`{0}` is not a namespace: expected letters, digits, `-` and `_`")]
    BadNamespace(String),
    /// Zenoh cannot work here. The caller shows the reason and gives up.
    #[error("cannot open a Zenoh session: {0}")]
    Session(String),
}

/// A link to one coordinator. After a break it connects again by itself, wherever the coordinator is then.
pub struct ZenohLink {
    namespace: String,
    coordinator: String,
    faithful_for: Duration,
    patient_for: Duration,
    /// Changes when the coordinator hints at new work.
    work: watch::Sender<u64>,
    state: Mutex<State>,
}

/// How the coordinator is reached.
struct State {
    config: ConnectConfig,
    session: Session,
    /// Since when questions have no answer: the coordinator may be elsewhere, or another in its place.
    away_since: Option<Instant>,
    /// Tells the coordinator at once when this process dies, and hears its hints.
    life: Option<Life>,
}

impl ZenohLink {
    /// Finds a coordinator and connects to it. Needs a multi-threaded tokio runtime.
    ///
    /// # Errors
    /// See [`ConnectError`].
    pub async fn connect(config: ConnectConfig) -> Result<Self, ConnectError> {
        let found = discovery::find(&config).await?;
        tracing::info!(endpoint = found.endpoint, coordinator = found.coordinator, "connected");
        let namespace = config.namespace.clone();
        let state = Mutex::new(State { config, session: found.session, away_since: None, life: None });
        let work = watch::Sender::new(0);
        let coordinator = found.coordinator;
        Ok(Self { namespace, coordinator, faithful_for: FAITHFUL_FOR, patient_for: PATIENT_FOR, work, state })
    }

    /// The coordinator's id.
    #[must_use]
    pub fn coordinator(&self) -> &str {
        &self.coordinator
    }

    /// Says goodbye: the coordinator sees the worker leave. Without it, dropping the link does the same a little
    /// later.
    pub async fn close(&self) {
        let mut state = self.state.lock().await;
        state.life = None;
        close(&state.session).await;
    }

    /// Asks for the worker's next certificate.
    ///
    /// # Errors
    /// See [`LinkError`].
    pub async fn refresh(&self, call: &Call<Refresh>) -> Result<Reply<Certificate>, LinkError> {
        self.ask(Method::Refresh, call).await
    }

    /// Connects with other certificates from now on. If that fails the old connection stays; the next process uses them.
    pub(crate) async fn go_on_with(&self, certificates: Certificates) {
        let config = {
            let mut state = self.state.lock().await;
            state.config.certificates = Some(certificates);
            state.config.clone()
        };
        match discovery::find(&config).await {
            Ok(found) if found.coordinator == self.coordinator => {
                self.move_to(found, &mut *self.state.lock().await).await;
            }
            Ok(_) | Err(_) => tracing::warn!("cannot connect with the new certificate"),
        }
    }

    async fn ask<Q: Serialize, A: DeserializeOwned>(
        &self,
        method: Method,
        call: &Call<Q>,
    ) -> Result<Reply<A>, LinkError> {
        let session = self.sure_session().await?;
        let answer = query(&session, &key(&self.namespace, &self.coordinator, method), call).await;
        if matches!(answer, Err(LinkError::NoAnswer(_))) {
            self.state.lock().await.away_since.get_or_insert_with(Instant::now);
        }
        answer
    }

    /// The session to ask over: looked at first if the last question had no answer.
    async fn sure_session(&self) -> Result<Session, LinkError> {
        let mut state = self.state.lock().await;
        if state.session.is_closed() {
            return Err(LinkError::Closed);
        }
        if let Some(since) = state.away_since {
            self.look(&mut state, since).await?;
        }
        Ok(state.session.clone())
    }

    /// Looks for the coordinator where it was, and elsewhere; if it can be in one place only, there anew after a while.
    async fn look(&self, state: &mut State, since: Instant) -> Result<(), LinkError> {
        let here = session::coordinators(&state.session, &self.namespace).await;
        if here.contains(&self.coordinator) {
            state.away_since = None;
        } else if let Some(other) = here.into_iter().next() {
            return Err(LinkError::OtherCoordinator(other));
        } else if !state.config.is_one_place() || since.elapsed() >= self.patient_for {
            let mut others = discovery::elsewhere(&state.config).await;
            if let Some(own) = others.iter().position(|found| found.coordinator == self.coordinator) {
                self.move_to(others.swap_remove(own), state).await;
            } else if let ([other], true) = (others.as_slice(), since.elapsed() >= self.faithful_for) {
                return Err(LinkError::OtherCoordinator(other.coordinator.clone()));
            }
        }
        Ok(())
    }

    /// Goes on where the coordinator is now.
    async fn move_to(&self, found: discovery::Found, state: &mut State) {
        tracing::info!(endpoint = found.endpoint, coordinator = self.coordinator, "going on over another connection");
        let old = std::mem::replace(&mut state.session, found.session);
        state.away_since = None;
        if let Some(life) = state.life.take() {
            self.show_life(&life.worker, state).await;
        }
        tokio::spawn(async move { close(&old).await });
    }

    /// Shows the coordinator that the worker lives, for as long as this link does.
    async fn show_life(&self, worker: &WorkerId, state: &mut State) {
        if state.life.as_ref().is_some_and(|life| &life.worker == worker) {
            return;
        }
        let bell = self.work.clone();
        match Life::show(&state.session, &self.namespace, &self.coordinator, worker, bell).await {
            Ok(life) => state.life = Some(life),
            Err(error) => tracing::warn!(%error, "the coordinator will notice this worker's end only by its leases"),
        }
    }
}

async fn close(session: &Session) {
    if let Err(error) = session.close().await {
        tracing::debug!(%error, "closing the session");
    }
}

/// Opens a session with the first of these endpoints where somebody is, over QUIC.
pub(crate) async fn open_any(endpoints: &[String], certificates: &Certificates) -> Result<Session, ConnectError> {
    discovery::open_first(endpoints, Some(certificates)).await.map(|(session, _)| session)
}

/// Puts one question, and reads its one answer.
pub(crate) async fn query<Q: Serialize, A: DeserializeOwned>(
    session: &Session,
    key: &str,
    call: &Call<Q>,
) -> Result<Reply<A>, LinkError> {
    let question = serde_json::to_vec(call).map_err(|error| LinkError::Unreadable(error.to_string()))?;
    let replies = session
        .get(key)
        .payload(question)
        .consolidation(ConsolidationMode::None)
        .timeout(QUERY_TIMEOUT)
        .await
        .map_err(|error| LinkError::NoAnswer(error.to_string()))?;
    let nobody = |_| LinkError::NoAnswer("nobody is there, or the link broke".to_owned());
    let reply = replies.recv_async().await.map_err(nobody)?;
    match reply.result() {
        Ok(sample) => serde_json::from_slice(&sample.payload().to_bytes())
            .map_err(|error| LinkError::Unreadable(error.to_string())),
        Err(error) => Err(LinkError::NoAnswer(String::from_utf8_lossy(&error.payload().to_bytes()).into_owned())),
    }
}

#[async_trait]
impl Link for ZenohLink {
    async fn hello(&self, call: Call<Hello>) -> Result<Reply<Welcome>, LinkError> {
        let answer = self.ask(Method::Hello, &call).await;
        if matches!(answer, Ok(Reply::Ok(_))) {
            let mut state = self.state.lock().await;
            self.show_life(&call.worker, &mut state).await;
        }
        answer
    }

    async fn claim(&self, call: Call<Claim>) -> Result<Reply<Leases>, LinkError> {
        self.ask(Method::Claim, &call).await
    }

    async fn result(&self, call: Call<Report>) -> Result<Reply<Recorded>, LinkError> {
        self.ask(Method::Result, &call).await
    }

    async fn renew(&self, call: Call<Renew>) -> Result<Reply<Renewed>, LinkError> {
        self.ask(Method::Renew, &call).await
    }

    fn changes(&self) -> Option<watch::Receiver<u64>> {
        Some(self.work.subscribe())
    }
}

#[cfg(test)]
mod tests;
