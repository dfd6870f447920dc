//! Finds a coordinator: at a given endpoint, or by scouting.

use std::collections::BTreeMap;
use std::time::Duration;

use serde_json::json;
use tokio::time::{Instant, timeout, timeout_at};
use zenoh::Session;
use zenoh::config::{EndPoint, WhatAmI};

use super::session::{configure, coordinators, open};
use super::{ConnectConfig, ConnectError};
use crate::lan::Certificates;

/// Once somebody answered a scout, others have this long to answer, too.
const STRAGGLERS: Duration = Duration::from_millis(300);
/// Pause between two looks at an endpoint where no coordinator serves yet.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// A coordinator that is there answers a scout within this time.
const ROUND: Duration = Duration::from_millis(1_500);
/// A session that ends at a coordinator.
pub(super) struct Found {
    pub(super) session: Session,
    pub(super) endpoint: String,
    pub(super) coordinator: String,
}

/// Looks for one coordinator as `config` says, as long as its patience lasts.
pub(super) async fn find(config: &ConnectConfig) -> Result<Found, ConnectError> {
    check_namespace(&config.namespace)?;
    let search = async {
        match places(config) {
            Some(endpoints) => at(endpoints, config).await,
            None => by_scouting(config).await,
        }
    };
    let Some(patience) = config.patience else { return search.await };
    timeout(patience, search).await.unwrap_or_else(|_| Err(nobody(config, patience)))
}

/// Where the coordinator may be; none if it has to be scouted for.
fn places(config: &ConnectConfig) -> Option<&[String]> {
    match &config.endpoint {
        Some(endpoint) => Some(std::slice::from_ref(endpoint)),
        None => config.certificates.is_some().then_some(&config.known),
    }
}

fn check_namespace(namespace: &str) -> Result<(), ConnectError> {
    let good = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_');
    let fits = !namespace.is_empty() && namespace.chars().all(good);
    if fits { Ok(()) } else { Err(ConnectError::BadNamespace(namespace.to_owned())) }
}

fn nobody(config: &ConnectConfig, patience: Duration) -> ConnectError {
    let place = match &config.endpoint {
        Some(endpoint) => format!("at {endpoint}"),
        None if config.certificates.is_some() => format!("at {}", config.known.join(", ")),
        None => "on this machine".to_owned(),
    };
    let place = format!("{place} within {} s", patience.as_secs_f64());
    ConnectError::NoCoordinator { place, namespace: config.namespace.clone() }
}

/// Waits at these endpoints until a coordinator serves at one of them.
async fn at(endpoints: &[String], config: &ConnectConfig) -> Result<Found, ConnectError> {
    let certificates = config.certificates.as_ref();
    let (session, endpoint) = open_first(endpoints, certificates).await?;
    loop {
        let found = coordinators(&session, &config.namespace).await;
        match found.as_slice() {
            [] => tokio::time::sleep(LOOK_AGAIN).await,
            [coordinator] => {
                return Ok(Found { session, endpoint, coordinator: coordinator.clone() });
            }
            _ => return Err(ConnectError::Ambiguous { endpoints: found }),
        }
    }
}

/// Tries one endpoint after the other, again and again, until somebody is there; says where.
pub(super) async fn open_first(
    endpoints: &[String],
    certificates: Option<&Certificates>,
) -> Result<(Session, String), ConnectError> {
    for endpoint in endpoints {
        check_endpoint(endpoint, certificates.is_some())?;
    }
    loop {
        for endpoint in endpoints {
            match open(std::slice::from_ref(endpoint), certificates).await {
                Ok(session) => return Ok((session, endpoint.clone())),
                Err(error) => tracing::debug!(%error, endpoint, "trying again"),
            }
        }
        tokio::time::sleep(LOOK_AGAIN).await;
    }
}

fn check_endpoint(endpoint: &str, secure: bool) -> Result<(), ConnectError> {
    let bad = |reason: String| ConnectError::BadEndpoint { endpoint: endpoint.to_owned(), reason };
    let parsed: EndPoint = endpoint.parse().map_err(|error: zenoh::Error| bad(error.to_string()))?;
    match (parsed.protocol().as_str(), secure) {
        ("tcp", false) | ("quic", true) => {}
        ("quic", false) => return Err(bad("to use QUIC the worker has to join first (--join)".to_owned())),
        (protocol, _) => return Err(bad(format!("the protocol `{protocol}` is not supported"))),
    }
    let address = parsed.address();
    let port = address.as_str().rsplit_once(':').and_then(|(host, port)| (!host.is_empty()).then_some(port));
    match port.map(str::parse::<u16>) {
        Some(Ok(1..)) if !secure || parsed.config().is_empty() => Ok(()),
        Some(Ok(1..)) => Err(bad("nothing may follow the port".to_owned())),
        _ => Err(bad("it needs a host and a port from 1 to 65535".to_owned())),
    }
}

/// Scouts again and again, and asks whoever answers whether it is a coordinator of the namespace.
async fn by_scouting(config: &ConnectConfig) -> Result<Found, ConnectError> {
    loop {
        let mut found = coordinators_among(scout().await?, &config.namespace).await;
        match found.len() {
            0 => tokio::time::sleep(LOOK_AGAIN).await,
            1 => return Ok(found.remove(0)),
            _ => {
                let endpoints = found.into_iter().map(|found| found.endpoint).collect();
                return Err(ConnectError::Ambiguous { endpoints });
            }
        }
    }
}

/// Looks once, for a short time and with a new session, where coordinators of the namespace may be now.
pub(super) async fn elsewhere(config: &ConnectConfig) -> Vec<Found> {
    if let Some(endpoints) = places(config) {
        return timeout(ROUND, at(endpoints, config)).await.ok().and_then(Result::ok).into_iter().collect();
    }
    match timeout(ROUND, scout()).await {
        Ok(Ok(answers)) => coordinators_among(answers, &config.namespace).await,
        Ok(Err(error)) => {
            tracing::debug!(%error, "cannot scout");
            Vec::new()
        }
        Err(_) => Vec::new(),
    }
}

/// Asks everybody who answered a scout.
async fn coordinators_among(answers: BTreeMap<String, Vec<String>>, namespace: &str) -> Vec<Found> {
    let mut found = Vec::new();
    for locators in answers.into_values() {
        found.extend(coordinator_at(&locators, namespace).await);
    }
    found
}

/// The locators of everybody who answers, by Zenoh id. Waits for the first, and a little for the others.
async fn scout() -> Result<BTreeMap<String, Vec<String>>, ConnectError> {
    let config = configure(&[("scouting/multicast/interface", json!("127.0.0.1"))]).map_err(session_error)?;
    let scout = zenoh::scout(WhatAmI::Peer | WhatAmI::Router, config).await.map_err(session_error)?;
    let mut answers = BTreeMap::new();
    let mut until = None;
    loop {
        let hello = match until {
            None => scout.recv_async().await.ok(),
            Some(until) => timeout_at(until, scout.recv_async()).await.ok().and_then(Result::ok),
        };
        let Some(hello) = hello else { return Ok(answers) };
        until.get_or_insert_with(|| Instant::now() + STRAGGLERS);
        answers.insert(hello.zid().to_string(), hello.locators_iter().map(ToString::to_string).collect());
    }
}

/// A session with the party behind these locators, if it is a coordinator of the namespace.
async fn coordinator_at(locators: &[String], namespace: &str) -> Option<Found> {
    let locators: Vec<String> =
        locators.iter().filter(|locator| check_endpoint(locator, false).is_ok()).cloned().collect();
    let endpoint = locators.first()?.clone();
    let session = open(&locators, None).await.ok()?;
    let coordinator = coordinators(&session, namespace).await.into_iter().next()?;
    Some(Found { session, endpoint, coordinator })
}

fn session_error(error: zenoh::Error) -> ConnectError {
    ConnectError::Session(error.to_string())
}
