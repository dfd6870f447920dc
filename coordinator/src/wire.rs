//! Bytes in, bytes out: the same questions as JSON.

use furrow_schema::protocol::{Call, Method, Refusal, Reply};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::coordinator::Coordinator;

/// A question is at most this long [bytes].
pub const MAX_PAYLOAD_BYTES: usize = 32 << 20;

impl Coordinator {
    /// Answers one question of a worker: parses it, asks, and writes the answer. Any bytes get an answer.
    pub async fn handle(&self, method: Method, payload: &[u8]) -> Vec<u8> {
        match method {
            Method::Hello => answer(payload, |call| self.hello(call)).await,
            Method::Claim => answer(payload, |call| self.claim(call)).await,
            Method::Result => answer(payload, |call| self.result(call)).await,
            Method::Renew => answer(payload, |call| self.renew(call)).await,
        }
    }
}

async fn answer<Q, A, F>(payload: &[u8], ask: impl FnOnce(Call<Q>) -> F) -> Vec<u8>
where
    Q: DeserializeOwned,
    A: Serialize,
    F: Future<Output = Reply<A>>,
{
    let reply = match parse(payload) {
        Ok(call) => ask(call).await,
        Err(detail) => Reply::Refused(Refusal::Malformed { detail }),
    };
    serde_json::to_vec(&reply).expect("answers are structures of numbers and texts")
}

fn parse<Q: DeserializeOwned>(payload: &[u8]) -> Result<Call<Q>, String> {
    if payload.len() > MAX_PAYLOAD_BYTES {
        return Err(format!("longer than {MAX_PAYLOAD_BYTES} bytes"));
    }
    serde_json::from_slice(payload).map_err(|error| error.to_string().chars().take(500).collect())
}
