//! A machine on a local network whose questions are put by hand, so that they may be those of a stranger.

use std::path::Path;
use std::sync::Mutex;
use std::time::Duration;

use furrow_schema::id::RequestId;
use furrow_schema::join::JoinSecret;
use furrow_schema::protocol::{Call, Claim, Hello, Method, Refusal, Reply, key};
use furrow_worker::Spool;
use furrow_worker::lan::{self, EnrolError, Enrolment};
use furrow_worker::spool::Identity;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use zenoh::Session;

use crate::process;
use crate::server::Server;

/// A question is answered within this time, or by nobody.
const PATIENCE: Duration = Duration::from_secs(10);

/// Serves the local network of this machine alone; the file that holds the first join secret.
pub(crate) async fn serve_lan(db: &str) -> (Server, String) {
    serve_lan_at(db, "quic/127.0.0.1:0").await
}

/// The same, where workers know it.
pub(crate) async fn serve_lan_at(db: &str, endpoint: &str) -> (Server, String) {
    let secret = format!("{db}.join");
    let args = ["--lan", "--zenoh", endpoint, "--join-out", &secret];
    (Server::start_with(db, &args, &[]).await, secret)
}

/// Reads a join secret.
pub(crate) fn secret_in(file: &str) -> JoinSecret {
    std::fs::read_to_string(file).unwrap().parse().unwrap()
}

/// Makes a further join secret, as a user does.
pub(crate) async fn new_secret(server: &Server, terms: &[&str]) -> JoinSecret {
    let args = [&["join", "--url", &server.url], terms].concat();
    let finished = process::finished(&args).await;
    assert_eq!(finished.code, Some(0), "{finished:?}");
    finished.stdout.parse().unwrap()
}

/// Certificate and key, as PEM.
pub(crate) type Pair<'a> = (&'a str, &'a str);

/// Tries once to open a session at `endpoint` over QUIC, trusting `authority_pem`, with a certificate or without.
pub(crate) async fn connect(endpoint: &str, authority_pem: &str, own: Option<Pair<'_>>) -> Result<Session, String> {
    connect_with(endpoint, authority_pem, own, Vec::new()).await
}

/// The same with further settings.
pub(crate) async fn connect_with(
    endpoint: &str,
    authority_pem: &str,
    own: Option<Pair<'_>>,
    mut settings: Vec<(&str, Value)>,
) -> Result<Session, String> {
    settings.push(("transport/link/tls/root_ca_certificate_base64", json!(base64(authority_pem))));
    settings.push(("transport/link/tls/enable_mtls", json!(own.is_some())));
    if let Some((certificate, key)) = own {
        settings.push(("transport/link/tls/connect_certificate_base64", json!(base64(certificate))));
        settings.push(("transport/link/tls/connect_private_key_base64", json!(base64(key))));
    }
    open(endpoint, settings).await
}

/// Tries once to open a session at `endpoint` with these settings.
pub(crate) async fn open(endpoint: &str, more: Vec<(&str, Value)>) -> Result<Session, String> {
    let settings = [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("connect/timeout_ms", json!(10_000)),
        ("connect/exit_on_failure", json!(true)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
    ];
    let mut config = zenoh::Config::default();
    for (key, value) in settings.into_iter().chain(more) {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.map_err(|error| error.to_string())
}

pub(crate) fn base64(pem: &str) -> String {
    use base64::Engine;
    base64::engine::general_purpose::STANDARD.encode(pem)
}

/// An enrolled machine.
pub(crate) struct Machine {
    pub(crate) identity: Identity,
    pub(crate) enrolment: Enrolment,
    pub(crate) key_pem: String,
    pub(crate) session: Session,
    pub(crate) spool: Mutex<Spool>,
}

pub(crate) fn hello() -> Hello {
    Hello { name: "by hand".to_owned(), engine: furrow_api::engine(), threads: 1 }
}

/// Enrols a worker that keeps what it has in `place`; what came of it.
pub(crate) async fn enrol(secret: &JoinSecret, place: &Path) -> Result<Mutex<Spool>, EnrolError> {
    let spool = Spool::open(place, furrow_api::engine(), Spool::DEFAULT_LIMIT_BYTES).unwrap();
    let spool = Mutex::new(spool);
    lan::enrol(secret, hello(), &spool).await.map(|()| spool)
}

/// Why the coordinator did not enrol a worker.
pub(crate) async fn refused(secret: &JoinSecret, place: &Path) -> Refusal {
    match enrol(secret, place).await {
        Err(EnrolError::Refused(refusal)) => refusal,
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("it was enrolled"),
    }
}

impl Machine {
    /// Enrols with `secret`, and connects as itself.
    pub(crate) async fn enrol(secret: &JoinSecret, place: &Path) -> Self {
        let spool = enrol(secret, place).await.unwrap();
        let (identity, enrolment, key_pem) = {
            let spool = spool.lock().unwrap();
            let enrolment = spool.enrolment().unwrap().clone();
            (spool.identity_at(&enrolment.coordinator), enrolment, spool.key_pem().unwrap())
        };
        let own = (enrolment.certificate_pem.as_str(), key_pem.as_str());
        let session = connect(&enrolment.endpoints[0], &enrolment.authority_pem, Some(own)).await.unwrap();
        Self { identity, enrolment, key_pem, session, spool }
    }

    pub(crate) fn call<T>(&self, body: T) -> Call<T> {
        let Identity { worker, credential } = self.identity.clone();
        Call { request: RequestId::random(), worker, credential, body }
    }

    pub(crate) fn claim(&self, want: u32) -> Call<Claim> {
        self.call(Claim { engine: furrow_api::engine(), want, known_scenarios: Vec::new(), first: false })
    }

    /// The key of a question.
    pub(crate) fn key(&self, method: Method) -> String {
        key(&self.enrolment.namespace, &self.enrolment.coordinator, method)
    }

    /// Puts one question over this machine's own connection; none if nobody answers.
    pub(crate) async fn ask<A: DeserializeOwned>(&self, method: Method, call: &impl Serialize) -> Option<Reply<A>> {
        ask(&self.session, &self.key(method), call).await
    }
}

/// Puts one question; none if nobody answers.
pub(crate) async fn ask<A: DeserializeOwned>(session: &Session, key: &str, call: &impl Serialize) -> Option<Reply<A>> {
    let replies = session.get(key).payload(serde_json::to_vec(call).unwrap()).timeout(PATIENCE).await.unwrap();
    let reply = replies.recv_async().await.ok()?;
    let sample = reply.into_result().ok()?;
    Some(serde_json::from_slice(&sample.payload().to_bytes()).unwrap())
}
