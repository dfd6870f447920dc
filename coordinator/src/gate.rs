//! The way in on a local network: who is let in, and with what.
//!
//! A new worker connects with the certificate of a join secret, which opens one question to it: `enrol`. It shows that
//! it has the join secret, by a signature over its name and its own key, and that it has that key. It gets a
//! certificate for the key, and a credential, without which no other question is answered.

use std::sync::Arc;

use furrow_schema::id::{PublicKey, WorkerId};
use furrow_schema::join::JoinSecret;
use furrow_schema::protocol::{
    Call, Certificate, Enrol, Enrolled, Method, Refresh, Refusal, Reply, enrolment_statement,
};
use ring::signature::{ED25519, UnparsedPublicKey};

use crate::authority::Authority;
use crate::coordinator::Coordinator;
use crate::error::StoreError;
use crate::store::admission::{self, Admitted, Request, SecretTerms};
use crate::store::worker::Newcomers;
use crate::wire;

/// A coordinator that serves a local network. Clones are handles on the same one.
#[derive(Debug, Clone)]
pub struct Gate {
    coordinator: Coordinator,
    authority: Arc<Authority>,
    namespace: String,
    endpoints: Vec<String>,
}

impl Gate {
    /// The gate of `coordinator`, which workers reach in `namespace` at one of `endpoints`.
    pub(crate) fn new(
        coordinator: Coordinator,
        authority: Arc<Authority>,
        namespace: String,
        endpoints: Vec<String>,
    ) -> Self {
        Self { coordinator, authority, namespace, endpoints }
    }

    /// A new join secret. Nothing of it but its public key is kept: it is shown now, or never.
    ///
    /// # Errors
    /// [`StoreError::NotWritten`] and [`StoreError::Closed`]: it may be asked again.
    pub async fn new_secret(&self, terms: SecretTerms) -> Result<JoinSecret, StoreError> {
        let now_ms = self.coordinator.now_ms();
        let until_ms = now_ms + terms.valid_ms;
        let signed = self.authority.join(now_ms, until_ms);
        // There is nothing to refuse about it.
        let _ = self.coordinator.admission(Request::AddSecret(signed.public_key, terms)).await?;
        Ok(JoinSecret {
            coordinator: self.coordinator.id().to_owned(),
            namespace: self.namespace.clone(),
            endpoints: self.endpoints.clone(),
            authority_pem: self.authority.certificate_pem().to_owned(),
            certificate_pem: signed.certificate_pem,
            key_pem: signed.key_pem,
            until_ms,
        })
    }

    /// Whether there ever was a join secret.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn had_secret(&self) -> Result<bool, StoreError> {
        admission::any_secret(self.coordinator.store()).await
    }

    /// A worker asks to be taken in.
    pub async fn enrol(&self, call: Call<Enrol>) -> Reply<Enrolled> {
        if let Err(refusal) = self.coordinator.presentable(&call.body.hello).and_then(|()| self.is_signed(&call)) {
            return Reply::Refused(refusal);
        }
        let worker = call.worker.clone();
        let credential = self.authority.credential(&worker, call.body.public_key);
        let admitted = self.admit(Request::Enrol(Box::new(call), credential.clone())).await;
        match admitted {
            Ok((key, until_ms)) => {
                Reply::Ok(Enrolled { certificate: self.certificate(&worker, key, until_ms), credential })
            }
            Err(refusal) => Reply::Refused(refusal),
        }
    }

    /// A worker asks for another certificate.
    pub async fn refresh(&self, call: Call<Refresh>) -> Reply<Certificate> {
        let worker = call.worker.clone();
        match self.admit(Request::Refresh(call)).await {
            Ok((key, until_ms)) => Reply::Ok(self.certificate(&worker, key, until_ms)),
            Err(refusal) => Reply::Refused(refusal),
        }
    }

    /// Answers one question from the network.
    pub async fn handle(&self, method: Method, payload: &[u8]) -> Vec<u8> {
        match method {
            Method::Enrol => wire::answer(payload, |call| self.enrol(call)).await,
            Method::Refresh => wire::answer(payload, |call| self.refresh(call)).await,
            Method::Hello => wire::answer(payload, |call| self.coordinator.hello_among(call, Newcomers::Refused)).await,
            _ => self.coordinator.handle(method, payload).await,
        }
    }

    async fn admit(&self, request: Request) -> Result<(PublicKey, i64), Refusal> {
        match self.coordinator.admission(request).await {
            Ok(Ok(Admitted::In(key, until_ms))) => Ok((key, until_ms)),
            Ok(Ok(_)) => Err(Refusal::NotEnrolled),
            Ok(Err(refusal)) => Err(refusal),
            Err(error) => Err(Refusal::Unavailable { detail: error.to_string() }),
        }
    }

    fn certificate(&self, worker: &WorkerId, key: PublicKey, until_ms: i64) -> Certificate {
        let pem = self.authority.worker(worker, key, self.coordinator.now_ms(), until_ms);
        Certificate { pem, until_ms }
    }

    /// Whether both keys vouch for the worker.
    fn is_signed(&self, call: &Call<Enrol>) -> Result<(), Refusal> {
        let Enrol { public_key, join, signature, proof, .. } = &call.body;
        let statement = enrolment_statement(self.coordinator.id(), &call.worker, *public_key);
        let good = |key: &PublicKey, signature: &str| {
            let signature = unhex(signature).ok_or(())?;
            UnparsedPublicKey::new(&ED25519, key.0).verify(&statement, &signature).map_err(|_| ())
        };
        let wrong = |detail: &str| Refusal::Enrolment { detail: detail.to_owned() };
        good(join, signature).map_err(|()| wrong("the signature is not the join secret's"))?;
        good(public_key, proof).map_err(|()| wrong("the proof is not the worker's key's"))
    }
}

/// Reads an even number of hexadecimal digits, as many as a signature has.
fn unhex(digits: &str) -> Option<Vec<u8>> {
    if digits.len() != 128 || !digits.is_ascii() {
        return None;
    }
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).ok()).collect()
}

#[cfg(test)]
mod tests;
