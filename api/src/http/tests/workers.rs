use axum::body::Body;
use axum::http::header::CONTENT_TYPE;
use axum::http::{Method, Request};
use serde_json::{Value, json};

use super::{Answer, Service};

async fn send(service: &Service, method: Method, path: &str, body: Value) -> Answer {
    let request = Request::builder().method(method).uri(path).header(CONTENT_TYPE, "application/json");
    service.send(request.body(Body::from(body.to_string())).unwrap()).await
}

#[tokio::test]
async fn a_worker_is_listed_let_in_for_a_time_and_revoked() {
    let service = Service::with_results(3).await;
    let listed = service.get("/v1/workers").await.json();
    let worker = &listed["items"][0];
    assert_eq!((&worker["name"], &worker["state"], &worker["results"]), (&json!("test"), &json!("live"), &json!(12)));
    assert_eq!((&worker["enrolled_by"], &worker["engine"]), (&json!("hello"), &json!(crate::engine())));
    let path = format!("/v1/workers/{}", worker["id"].as_str().unwrap());
    assert_eq!(service.get(&path).await.json()["id"], worker["id"]);

    let expired = send(&service, Method::PATCH, &path, json!({"until_ms": 1})).await.json();
    assert_eq!((&expired["state"], &expired["until_ms"]), (&json!("expired"), &json!(1)));
    let back = send(&service, Method::PATCH, &path, json!({"until_ms": null})).await.json();
    assert_eq!((&back["state"], &back["until_ms"]), (&json!("live"), &json!(null)));
    let revoked = send(&service, Method::DELETE, &path, json!({})).await.json();
    assert_eq!(revoked["state"], "revoked");
    let again = send(&service, Method::DELETE, &path, json!({})).await.json();
    assert_eq!(again["revoked_ms"], revoked["revoked_ms"], "the first time counts");
}

#[tokio::test]
async fn what_is_asked_wrongly_of_workers_is_a_problem_that_names_the_key() {
    let service = Service::start().await;
    let nobody = format!("/v1/workers/{}", "0".repeat(32));
    for (method, path, body, status, word) in [
        (Method::GET, "/v1/workers/barn", json!({}), 400, "worker"),
        (Method::GET, nobody.as_str(), json!({}), 404, "worker"),
        (Method::DELETE, &nobody, json!({}), 404, "worker"),
        (Method::PATCH, &nobody, json!({}), 400, "until_ms"),
        (Method::PATCH, &nobody, json!({"until_ms": "soon"}), 400, "until_ms"),
        (Method::POST, "/v1/join-secrets", json!({"uses": 0}), 422, "uses"),
        (Method::POST, "/v1/join-secrets", json!({"valid_s": 0}), 422, "valid_s"),
        (Method::POST, "/v1/join-secrets", json!({"workers_s": u64::MAX}), 422, "workers_s"),
        (Method::POST, "/v1/join-secrets", json!({"wanted": 1}), 400, "wanted"),
        (Method::POST, "/v1/join-secrets", json!({}), 409, "--lan"),
    ] {
        let answer = send(&service, method, path, body.clone()).await;
        assert_eq!(answer.status, status, "{path} {body}: {}", answer.body);
        assert!(answer.body.contains(word), "{path} {body}: {}", answer.body);
    }
}
