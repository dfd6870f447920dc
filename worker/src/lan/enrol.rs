//! Getting in: once, with a join secret.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use furrow_schema::id::{PublicKey, RequestId};
use furrow_schema::join::JoinSecret;
use furrow_schema::protocol::{Call, Enrol, Enrolled, Hello, Method, Refusal, Reply, enrolment_statement, key};
use rcgen::{KeyPair, PKCS_ED25519, SigningKey};
use tokio::time::{sleep, timeout};
use zenoh::Session;

use super::{Certificates, Enrolment};
use crate::link::LinkError;
use crate::spool::{Identity, Spool, SpoolError};
use crate::zenoh_link::{ConnectError, open_any, query};

/// The coordinator is looked for so long.
const PATIENCE: Duration = Duration::from_secs(20);
/// Pause after a question without an answer.
const ASK_AGAIN: Duration = Duration::from_millis(200);

/// Why a worker was not taken in.
#[derive(Debug, thiserror::Error)]
pub enum EnrolError {
    /// Nobody answers where the join secret says. The user looks whether the coordinator runs, and makes a new secret if
    /// it has moved.
    #[error("--join: no coordinator answers at {}: is it running, and is the join secret its own?{}", endpoints.join(", "), hint(*.expired))]
    NoCoordinator {
        /// Where it was looked for.
        endpoints: Vec<String>,
        /// Whether the secret's time is over by this machine's clock.
        expired: bool,
    },
    /// The coordinator says no. The user gets another join secret, or none.
    #[error("--join: the coordinator refused this worker: {0}")]
    Refused(Refusal),
    /// The join secret was read, but what is in it is of no use. The user copies it again.
    #[error("--join: the join secret holds no usable key")]
    Key,
    /// The folder cannot be written. The user makes room, or names another.
    #[error(transparent)]
    Spool(#[from] SpoolError),
}

fn hint(expired: bool) -> &'static str {
    if expired { " The join secret has expired: `furrow join` makes a new one" } else { "" }
}

/// Takes the worker of `spool` in at the coordinator that `secret` is from, unless it is in already; then only the
/// coordinator's addresses are taken from it.
///
/// # Errors
/// See [`EnrolError`]; the folder is as before then.
pub async fn enrol(secret: &JoinSecret, hello: Hello, spool: &Mutex<Spool>) -> Result<(), EnrolError> {
    let (key_pem, identity, before) = {
        let spool = spool.lock().unwrap_or_else(PoisonError::into_inner);
        (spool.key_pem()?, spool.identity().clone(), spool.enrolment().cloned())
    };
    let is_in =
        |before: &Enrolment| before.coordinator == secret.coordinator && before.authority_pem == secret.authority_pem;
    let enrolment = match before.filter(is_in) {
        Some(before) => Enrolment { endpoints: secret.endpoints.clone(), ..before },
        None => {
            let enrolled = ask(secret, &call(secret, hello, identity, &key_pem)?).await?;
            tracing::info!(coordinator = secret.coordinator, "enrolled");
            enrolment(secret, enrolled)
        }
    };
    Ok(spool.lock().unwrap_or_else(PoisonError::into_inner).keep_enrolment(enrolment)?)
}

fn enrolment(secret: &JoinSecret, enrolled: Enrolled) -> Enrolment {
    Enrolment {
        coordinator: secret.coordinator.clone(),
        namespace: secret.namespace.clone(),
        endpoints: secret.endpoints.clone(),
        authority_pem: secret.authority_pem.clone(),
        certificate_pem: enrolled.certificate.pem,
        certificate_ms: [now_ms(), enrolled.certificate.until_ms],
        credential: enrolled.credential,
    }
}

fn call(secret: &JoinSecret, hello: Hello, identity: Identity, key_pem: &str) -> Result<Call<Enrol>, EnrolError> {
    let Identity { worker, credential } = identity;
    let (own, join) = (read_key(key_pem)?, read_key(&secret.key_pem)?);
    let public_key = public_key(&own);
    let statement = enrolment_statement(&secret.coordinator, &worker, public_key);
    let sign = |key: &KeyPair| key.sign(&statement).map(|signature| hex(&signature)).map_err(|_| EnrolError::Key);
    let body = Enrol { hello, public_key, join: self::public_key(&join), signature: sign(&join)?, proof: sign(&own)? };
    Ok(Call { request: RequestId::random(), worker, credential, body })
}

fn read_key(pem: &str) -> Result<KeyPair, EnrolError> {
    KeyPair::from_pkcs8_pem_and_sign_algo(pem, &PKCS_ED25519).map_err(|_| EnrolError::Key)
}

fn public_key(key: &KeyPair) -> PublicKey {
    PublicKey(key.public_key_raw().try_into().expect("Ed25519 keys have 32 bytes"))
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Asks until there is an answer. Repeated, it is the same question.
async fn ask(secret: &JoinSecret, call: &Call<Enrol>) -> Result<Enrolled, EnrolError> {
    let asking = async {
        let session = open_any(&secret.endpoints, &Certificates::of_secret(secret)).await?;
        let enrolled = ask_over(&session, secret, call).await;
        let _ = session.close().await;
        Ok::<_, ConnectError>(enrolled)
    };
    match timeout(PATIENCE, asking).await {
        Ok(Ok(answer)) => answer.map_err(EnrolError::Refused),
        Ok(Err(_)) | Err(_) => {
            Err(EnrolError::NoCoordinator { endpoints: secret.endpoints.clone(), expired: secret.until_ms <= now_ms() })
        }
    }
}

async fn ask_over(session: &Session, secret: &JoinSecret, call: &Call<Enrol>) -> Result<Enrolled, Refusal> {
    let key = key(&secret.namespace, &secret.coordinator, Method::Enrol);
    loop {
        let trouble = match query(session, &key, call).await {
            Ok(Reply::Ok(enrolled)) => return Ok(enrolled),
            Ok(Reply::Refused(refusal @ Refusal::Unavailable { .. })) => refusal.to_string(),
            Ok(Reply::Refused(refusal)) => return Err(refusal),
            Err(error @ (LinkError::NoAnswer(_) | LinkError::Unreadable(_))) => error.to_string(),
            Err(error) => error.to_string(),
        };
        tracing::debug!(trouble, "asking to be enrolled again");
        sleep(ASK_AGAIN).await;
    }
}

/// This machine's time [ms since 1970].
pub(super) fn now_ms() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_millis()).unwrap_or(i64::MAX)
}
