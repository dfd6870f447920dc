//! Bytes in, bytes out: the same questions as JSON.

use furrow_schema::protocol::{Call, Method, Refusal, Reply};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::coordinator::Coordinator;

/// A question is at most this long \[bytes\].
pub const MAX_PAYLOAD_BYTES: usize = 32 << 20;

impl Coordinator {
    /// Answers one question of a worker: parses it, asks, and writes the answer. Any bytes get an answer.
    pub async fn handle(&self, method: Method, payload: &[u8]) -> Vec<u8> {
        match method {
            Method::Hello => answer(payload, |call| self.hello(call)).await,
            Method::Claim => answer(payload, |call| self.claim(call)).await,
            Method::Result => answer(payload, |call| self.result(call)).await,
            Method::Renew => answer(payload, |call| self.renew(call)).await,
            Method::Enrol | Method::Refresh => {
                let detail = "nobody enrols here: a hello is enough on the coordinator's own machine";
                write(&Reply::<()>::Refused(Refusal::Enrolment { detail: detail.to_owned() }))
            }
        }
    }
}

/// Parses a question, asks, and writes the answer.
pub(crate) async fn answer<Q, A, F>(payload: &[u8], ask: impl FnOnce(Call<Q>) -> F) -> Vec<u8>
where
    Q: DeserializeOwned,
    A: Serialize,
    F: Future<Output = Reply<A>>,
{
    let reply = match parse(payload) {
        Ok(call) => ask(call).await,
        Err(detail) => Reply::Refused(Refusal::Malformed { detail }),
    };
    write(&reply)
}

fn write<A: Serialize>(reply: &Reply<A>) -> Vec<u8> {
    serde_json::to_vec(reply).expect("answers are structures of numbers and texts")
}

fn parse<Q: DeserializeOwned>(payload: &[u8]) -> Result<Call<Q>, String> {
    if payload.len() > MAX_PAYLOAD_BYTES {
        return Err(format!("longer than {MAX_PAYLOAD_BYTES} bytes"));
    }
    serde_json::from_slice(payload).map_err(|error| error.to_string().chars().take(500).collect())
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use furrow_schema::protocol::{Leases, Recorded, Report, RunReport};
    use proptest::prelude::*;
    use serde_json::Value;
    use tokio::runtime::Runtime;

    use super::*;
    use crate::testing::{Bench, ENGINE, done, sweep};

    static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());
    static BENCH: LazyLock<Bench> = LazyLock::new(|| RUNTIME.block_on(Bench::new()));

    fn answer(method: Method, payload: &[u8]) -> Value {
        let bytes = RUNTIME.block_on(BENCH.coordinator.handle(method, payload));
        serde_json::from_slice(&bytes).unwrap()
    }

    fn any_method() -> impl Strategy<Value = Method> {
        proptest::sample::select(&Method::OF_WORK[..])
    }

    /// JSON that is nearly a question: right keys, anything in them.
    fn near_miss() -> impl Strategy<Value = Value> {
        let hex = "[0-9a-f]{32}".prop_map(Value::from);
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<i64>().prop_map(Value::from),
            any::<f64>().prop_map(Value::from),
            ".{0,20}".prop_map(Value::from),
        ];
        let keys = proptest::sample::select(vec![
            "name",
            "engine",
            "threads",
            "want",
            "known_scenarios",
            "runs",
            "job",
            "attempt",
            "ended",
            "held",
            "running",
        ]);
        let body = leaf.prop_recursive(3, 20, 5, move |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..5).prop_map(Value::from),
                proptest::collection::btree_map(keys.clone().prop_map(str::to_owned), inner, 0..5)
                    .prop_map(|map| Value::Object(map.into_iter().collect())),
            ]
        });
        (hex.clone(), hex.clone(), hex, body).prop_map(|(request, worker, credential, body)| {
            serde_json::json!({"request": request, "worker": worker, "credential": credential, "body": body})
        })
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_refused(method in any_method(), bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            prop_assert_eq!(&answer(method, &bytes)["refused"]["reason"], "malformed");
        }

        #[test]
        fn nearly_right_questions_are_answered(method in any_method(), question in near_miss()) {
            let reply = answer(method, question.to_string().as_bytes());
            prop_assert!(reply["refused"]["reason"].is_string(), "{reply}");
        }
    }

    #[tokio::test]
    async fn questions_go_through_as_json() {
        let bench = Bench::new().await;
        bench.submit(sweep(&["rgop"], 1)).await;
        let worker = bench.worker().await;
        let claim = serde_json::to_vec(&worker.claim_call(1)).unwrap();
        let leases = bench.coordinator.handle(Method::Claim, &claim).await;
        let leases: Reply<Leases> = serde_json::from_slice(&leases).unwrap();
        let job = leases.into_result().unwrap().jobs.remove(0);

        let runs = vec![RunReport { job: job.job, attempt: job.attempt, ended: done(0.1) }];
        let report = serde_json::to_vec(&worker.call(Report { engine: ENGINE, runs })).unwrap();
        let recorded = bench.coordinator.handle(Method::Result, &report).await;
        let recorded: Reply<Recorded> = serde_json::from_slice(&recorded).unwrap();
        assert_eq!(recorded.into_result().unwrap().recorded, [job.job]);
        bench.assert_consistent().await;
    }
}
