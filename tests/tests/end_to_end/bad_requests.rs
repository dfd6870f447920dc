//! Bad requests over HTTP: a 4xx problem document that names the key, and nothing stored.

use reqwest::Response;
use serde_json::{Value, json};

use crate::plan::{directory, path, plan};
use crate::server::Server;

/// The answer must be a problem document with a status of the caller's fault that says `word`.
async fn is_problem(response: Response, word: &str, asked: &str) {
    let (status, media_type) = (response.status().as_u16(), response.headers()["content-type"].clone());
    let text = response.text().await.unwrap();
    assert!((400..500).contains(&status), "{asked}: {status} {text}");
    assert_eq!(media_type, "application/problem+json", "{asked}");
    let problem: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(problem["status"], status, "{asked}");
    assert!(text.contains(word), "{asked} does not say `{word}`: {text}");
}

fn with(key: &str, value: Value) -> Value {
    let mut request = json!({"plan": plan(1.0, 1)});
    request[key] = value;
    request
}

#[tokio::test]
async fn a_bad_submission_is_refused_by_its_key_and_stores_nothing() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    for (request, word) in [
        (json!({"plan": "guyonneau2022/none"}), "guyonneau2022/none"),
        (json!({"plan": 3}), "plan"),
        (json!({}), "plan"),
        (json!([]), "object"),
        (with("sedes", json!(3)), "sedes"),
        (with("seeds", json!(0)), "seeds"),
        (with("seeds", json!("many")), "seeds"),
        (with("only", json!({"robot": ["rgop"]})), "robot"),
        (with("only", json!({"algorithm": ["rgop2"]})), "rgop2"),
        (with("set", json!({"limits.max_tim_s": 3})), "limits.max_tim_s"),
        (with("set", json!({"limits.max_time_s": -1})), "limits.max_time_s"),
        (with("field", json!({"name": "mine", "rows": 3})), "field"),
        (with("priority", json!(1.5)), "priority"),
    ] {
        let response = server.post("/v1/sweeps", "application/json", request.to_string()).await;
        is_problem(response, word, &request.to_string()).await;
    }
    for torn in ["", "{", "nonsense", "{\"plan\": \u{1}}"] {
        is_problem(server.post("/v1/sweeps", "application/json", torn).await, "", torn).await;
    }
    is_problem(server.post("/v1/sweeps", "text/plain", "{}").await, "application/json", "text/plain").await;
    assert_eq!(server.json("/v1/sweeps").await["items"], json!([]));
}

#[tokio::test]
async fn what_is_not_there_or_not_allowed_is_a_problem_by_its_name() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    let sweep = server.submit(&json!({"plan": plan(1.0, 1)})).await;
    for (asked, word) in [
        ("/v1/sweeps/999".to_owned(), "999"),
        ("/v1/sweeps/x".to_owned(), "x"),
        ("/v1/jobs/999".to_owned(), "999"),
        ("/v1/jobs/999/trajectory.svg".to_owned(), "999"),
        ("/v1/nothing".to_owned(), "/v1/nothing"),
        ("/v1/jobs?state=asleep".to_owned(), "state"),
        ("/v1/jobs?limit=-1".to_owned(), "limit"),
        ("/v1/jobs?colour=red".to_owned(), "colour"),
        (format!("/v1/sweeps/{sweep}/table?group_by=robot"), "group_by"),
        (format!("/v1/sweeps/{sweep}/table?metric=beauty"), "metric"),
        (format!("/v1/sweeps/{sweep}/table?format=papyrus"), "format"),
        ("/v1/publications/guyonneau2022/table-99".to_owned(), "table-99"),
    ] {
        is_problem(server.get(&asked).await, word, &asked).await;
    }
    assert_eq!(server.get("/healthz").await.status(), 200, "it still serves");
}
