//! Between worker and coordinator: questions, answers, and what is in them.

use std::sync::LazyLock;
use std::time::Duration;

use furrow_coordinator::{Config, Coordinator, Store};
use furrow_schema::job::Timings;
use furrow_schema::protocol::{
    Call, Claim, Enrol, Enrolled, Hello, Leases, Method, Recorded, Refresh, Refusal, Renew, Renewed, Reply, Report,
    RunReport, Welcome,
};
use furrow_worker::trajectory;
use proptest::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use tokio::runtime::Runtime;
use tokio::time::timeout;

use crate::mutation::{config, spoiled};

const ANSWERS_WITHIN: Duration = Duration::from_secs(20);

static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());
static COORDINATOR: LazyLock<Coordinator> = LazyLock::new(|| {
    RUNTIME.block_on(async {
        let coordinator = Coordinator::start(Store::in_memory().await.unwrap(), Config::new(furrow_api::engine()));
        let hello = question(Method::Hello);
        coordinator.handle(Method::Hello, hello.to_string().as_bytes()).await;
        coordinator
    })
});

/// A valid question.
fn question(method: Method) -> Value {
    let engine = furrow_api::engine();
    let record = json!({
        "digest": "00".repeat(32), "outcome": "success", "metrics": {"success": 1.0, "mean_squared_error_mm2": 3.5},
        "timings": Timings::default(), "trajectory": "00ff"
    });
    let body = match method {
        Method::Hello => json!({"name": "barn", "engine": engine, "threads": 2}),
        Method::Claim => json!({"engine": engine, "want": 4, "known_scenarios": [1, 2]}),
        Method::Result => json!({"engine": engine, "runs": [
            {"job": 1, "attempt": 1, "ended": {"done": record}},
            {"job": 2, "attempt": 1, "ended": {"panicked": {"message": "at the end"}}},
            {"job": 3, "attempt": 2, "ended": "handed-back"}
        ]}),
        Method::Renew => json!({"held": [{"job": 1, "attempt": 1, "running": true}]}),
        Method::Enrol => json!({
            "hello": {"name": "barn", "engine": engine, "threads": 2},
            "public_key": "01".repeat(32), "join": "02".repeat(32), "signature": "03".repeat(64), "proof": "04".repeat(64)
        }),
        Method::Refresh => json!({}),
    };
    let word = |digit: &str| digit.repeat(32);
    json!({"request": word("a"), "worker": word("b"), "credential": word("c"), "body": body})
}

/// A valid answer to each question, and a refusal.
fn answers() -> Vec<Value> {
    let id = |n: i64| serde_json::from_value(json!(n)).unwrap();
    let leases = json!({
        "jobs": [{"job": 1, "attempt": 1, "scenario": 1, "seed": 7, "record": false, "alone": false}],
        "scenarios": [{"id": 1, "json": "{}"}], "retry_after_ms": 0
    });
    let leases: Leases = serde_json::from_value(leases).unwrap();
    vec![
        json!(Reply::Ok(Welcome { lease_ms: 30_000, renew_every_ms: 1_000 })),
        json!(Reply::Ok(leases)),
        json!(Reply::Ok(Recorded { recorded: vec![id(1)], ignored: vec![id(2)] })),
        json!(Reply::Ok(Renewed { lost: vec![id(1)] })),
        json!(Reply::<Welcome>::Refused(Refusal::Malformed { detail: "no".to_owned() })),
    ]
}

fn any_method() -> impl Strategy<Value = Method> {
    proptest::sample::select(&Method::ALL[..])
}

/// Whoever believes bytes can say them again, and believes that.
fn read<T: DeserializeOwned + Serialize>(bytes: &[u8]) -> Result<(), TestCaseError> {
    if let Ok(value) = serde_json::from_slice::<T>(bytes) {
        let again = serde_json::to_vec(&value).unwrap();
        prop_assert!(serde_json::from_slice::<T>(&again).is_ok(), "{}", String::from_utf8_lossy(&again));
    }
    Ok(())
}

#[test]
fn the_valid_question_is_valid() {
    for method in Method::OF_WORK {
        let bytes = RUNTIME.block_on(COORDINATOR.handle(method, question(method).to_string().as_bytes()));
        let reply: Value = serde_json::from_slice(&bytes).unwrap();
        assert!(reply.get("refused").is_none(), "{method:?}: {reply}");
    }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn a_coordinator_answers_any_spoiled_question(
        (method, bytes) in any_method().prop_flat_map(|method| (Just(method), spoiled(question(method))))
    ) {
        let coordinator = &*COORDINATOR;
        let answer = RUNTIME.block_on(async { timeout(ANSWERS_WITHIN, coordinator.handle(method, &bytes)).await });
        let reply: Value = serde_json::from_slice(&answer.expect("it hangs")).unwrap();
        prop_assert!(reply.is_object(), "{reply}");
        prop_assert_ne!(&reply["refused"]["reason"], "unavailable", "a question must not reach the database like this");
    }

    #[test]
    fn a_worker_reads_or_refuses_any_spoiled_answer(
        bytes in proptest::sample::select(answers()).prop_flat_map(spoiled)
    ) {
        read::<Reply<Welcome>>(&bytes)?;
        read::<Reply<Leases>>(&bytes)?;
        read::<Reply<Recorded>>(&bytes)?;
        read::<Reply<Renewed>>(&bytes)?;
        read::<Reply<Enrolled>>(&bytes)?;
    }

    #[test]
    fn questions_are_read_or_refused(
        bytes in any_method().prop_flat_map(|method| spoiled(question(method)))
    ) {
        read::<Call<Hello>>(&bytes)?;
        read::<Call<Claim>>(&bytes)?;
        read::<Call<Report>>(&bytes)?;
        read::<Call<Renew>>(&bytes)?;
        read::<Call<Enrol>>(&bytes)?;
        read::<Call<Refresh>>(&bytes)?;
        read::<RunReport>(&bytes)?;
    }

    #[test]
    fn arbitrary_bytes_are_read_or_refused_on_both_sides(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        read::<Call<Report>>(&bytes)?;
        read::<Reply<Leases>>(&bytes)?;
        let _ = trajectory::decode(&String::from_utf8_lossy(&bytes));
    }

    #[test]
    fn a_scenario_text_from_a_coordinator_is_read_or_refused(
        bytes in spoiled(json!({
            "field": {"kind": "guyonneau2022", "crop": 1, "seed": {"fixed": 1}}, "robot": {"kind": "two-wheeled"},
            "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
            "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"}, "mission": {"kind": "row-by-row"},
            "observer": {"kind": "inter-rows"}, "limits": {"kind": "simulated-time"}
        }))
    ) {
        if let Ok(value) = serde_json::from_slice::<Value>(&bytes)
            && let Ok(scenario) = furrow_sim::Scenario::from_value(value)
        {
            let again: Value = serde_json::from_str(&scenario.canonical_json()).unwrap();
            prop_assert!(furrow_sim::Scenario::from_value(again).is_ok());
        }
    }
}
