//! Local networks: how a worker gets in at a coordinator, and stays in.
//!
//! A join secret is used once: the worker draws a key that never leaves its folder, and is given a certificate for it and
//! a credential ([`enrol`]). Both are kept beside its finished runs ([`Enrolment`]), so that it comes back without the
//! secret. A certificate ends; long before it does the worker asks for the next ([`keep_fresh`]).

mod enrol;
mod fresh;

use std::fmt;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use furrow_schema::id::Credential;
use furrow_schema::join::JoinSecret;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

pub use enrol::{EnrolError, enrol};
pub use fresh::keep_fresh;

/// What a worker has from a coordinator that took it in. Its `Debug` shows no secret.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrolment {
    /// The coordinator's id.
    pub coordinator: String,
    /// The namespace it serves.
    pub namespace: String,
    /// Where it listens.
    pub endpoints: Vec<String>,
    /// Whom its certificates come from (PEM).
    pub authority_pem: String,
    /// The worker's own certificate (PEM).
    pub certificate_pem: String,
    /// When it was issued, and when it ends [ms since 1970].
    pub certificate_ms: [i64; 2],
    /// What the worker proves itself with.
    pub credential: Credential,
}

impl fmt::Debug for Enrolment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Enrolment").field("coordinator", &self.coordinator).finish_non_exhaustive()
    }
}

/// Certificates for a connection. Its `Debug` shows nothing of them.
#[derive(Clone, PartialEq, Eq)]
pub struct Certificates {
    authority_pem: String,
    certificate_pem: String,
    key_pem: String,
}

impl Certificates {
    /// Those of an enrolled worker with this key (PEM).
    #[must_use]
    pub fn of_worker(enrolment: &Enrolment, key_pem: &str) -> Self {
        Self {
            authority_pem: enrolment.authority_pem.clone(),
            certificate_pem: enrolment.certificate_pem.clone(),
            key_pem: key_pem.to_owned(),
        }
    }

    fn of_secret(secret: &JoinSecret) -> Self {
        Self {
            authority_pem: secret.authority_pem.clone(),
            certificate_pem: secret.certificate_pem.clone(),
            key_pem: secret.key_pem.clone(),
        }
    }

    /// What Zenoh is told.
    pub(crate) fn settings(&self) -> [(&'static str, Value); 6] {
        let encoded = |pem: &str| json!(STANDARD.encode(pem));
        [
            ("transport/link/protocols", json!(["quic"])),
            ("transport/link/tls/root_ca_certificate_base64", encoded(&self.authority_pem)),
            ("transport/link/tls/connect_certificate_base64", encoded(&self.certificate_pem)),
            ("transport/link/tls/connect_private_key_base64", encoded(&self.key_pem)),
            ("transport/link/tls/enable_mtls", json!(true)),
            // Zenoh trusts the web's authorities, too: the name is what keeps their certificates out.
            ("transport/link/tls/verify_name_on_connect", json!(true)),
        ]
    }
}

impl fmt::Debug for Certificates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Certificates(..)")
    }
}
