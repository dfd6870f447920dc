//! What a user does to a sweep, and what is answered.

use axum::body::Body;
use axum::http::Request;
use axum::http::header::CONTENT_TYPE;
use serde_json::{Value, json};

use super::super::problem::MEDIA_TYPE;
use super::{Answer, Service, plan};

impl Service {
    async fn with_a_sweep() -> Self {
        let service = Self::start().await;
        assert_eq!(service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await.status, 201);
        service
    }

    async fn patch(&self, path: &str, body: &Value) -> Answer {
        let request = Request::patch(path).header(CONTENT_TYPE, "application/json");
        self.send(request.body(Body::from(body.to_string())).unwrap()).await
    }

    async fn delete(&self, path: &str) -> Answer {
        self.send(Request::delete(path).body(Body::empty()).unwrap()).await
    }

    async fn retry(&self, path: &str) -> Answer {
        self.send(Request::post(path).body(Body::empty()).unwrap()).await
    }
}

fn stands(answer: &Answer) -> (u16, Value, Option<u64>, Option<u64>) {
    let sweep = answer.json();
    (answer.status, sweep["state"].clone(), sweep["queued"].as_u64(), sweep["cancelled"].as_u64())
}

#[tokio::test]
async fn a_sweep_is_paused_resumed_cancelled_and_retried_again_and_again() {
    let service = Service::with_a_sweep().await;
    let path = "/v1/sweeps/1";
    for _ in 0..2 {
        let paused = service.patch(path, &json!({"paused": true, "priority": 7})).await;
        assert_eq!(stands(&paused), (200, json!("paused"), Some(4), Some(0)));
        assert_eq!(paused.json()["priority"], 7);
    }
    for _ in 0..2 {
        assert_eq!(stands(&service.patch(path, &json!({"paused": false})).await).1, "active");
    }
    for _ in 0..2 {
        assert_eq!(stands(&service.delete(path).await), (200, json!("cancelled"), Some(0), Some(4)));
    }
    let resumed = service.patch(path, &json!({"paused": false})).await;
    assert_eq!((resumed.status, resumed.header("content-type")), (409, MEDIA_TYPE), "{}", resumed.body);
    for _ in 0..2 {
        let retried = service.retry("/v1/sweeps/1/retry").await;
        assert_eq!(stands(&retried), (200, json!("active"), Some(4), Some(0)));
    }
    service.work().await;
    for answer in [service.delete(path).await, service.retry("/v1/sweeps/1/retry").await, service.get(path).await] {
        assert_eq!(stands(&answer), (200, json!("done"), Some(0), Some(0)));
    }
}

#[tokio::test]
async fn a_removed_sweep_is_not_found_any_more() {
    let service = Service::with_results(1).await;
    let removed = service.delete("/v1/sweeps/1?purge=true").await;
    assert_eq!((removed.status, removed.body.as_str()), (204, ""));
    for answer in [
        service.get("/v1/sweeps/1").await,
        service.get("/v1/sweeps/1/table").await,
        service.get("/v1/jobs/1").await,
        service.delete("/v1/sweeps/1?purge=true").await,
        service.delete("/v1/sweeps/1").await,
        service.retry("/v1/sweeps/1/retry").await,
        service.patch("/v1/sweeps/1", &json!({"paused": true})).await,
    ] {
        assert_eq!(answer.status, 404, "{}", answer.body);
    }
    assert_eq!(service.get("/v1/jobs").await.json()["items"], json!([]));
    let again = service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await.json();
    assert_eq!((&again["new"], &again["cached"]), (&json!(4), &json!(0)));
}

#[tokio::test]
async fn a_wrong_change_is_refused_by_its_key_and_changes_nothing() {
    let service = Service::with_a_sweep().await;
    let before = service.get("/v1/sweeps/1").await.body;
    for (body, key) in [
        (json!({"pause": true}), json!("pause")),
        (json!({"paused": "yes"}), json!("paused")),
        (json!({"priority": 1.5}), json!("priority")),
        (json!({"paused": true, "state": "done"}), json!("state")),
    ] {
        let refused = service.patch("/v1/sweeps/1", &body).await;
        let named = refused.json()["key"].clone();
        assert_eq!((refused.status, refused.header("content-type"), &named), (400, MEDIA_TYPE, &key), "{body}");
    }
    assert_eq!(service.patch("/v1/sweeps/1", &json!({})).await.status, 422, "nothing to change");
    for (path, key) in [("/v1/sweeps/1?purge=maybe", "purge"), ("/v1/sweeps/1?force=true", "force")] {
        let refused = service.delete(path).await;
        assert_eq!((refused.status, refused.json()["key"].clone()), (400, json!(key)), "{path}");
    }
    assert_eq!(service.delete("/v1/sweeps/x").await.status, 404);
    assert_eq!(service.get("/v1/sweeps/1").await.body, before);
}
