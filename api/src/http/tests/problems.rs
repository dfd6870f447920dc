//! What the routes answer when something is wrong: always a problem that names the key.

use axum::body::Body;
use axum::http::Request;
use axum::http::header::CONTENT_TYPE;
use furrow_coordinator::StoreError;
use serde_json::{Value, json};

use super::super::problem::{MEDIA_TYPE, Problem};
use super::{Answer, Service, plan};

/// Checks that `answer` is a problem with `status` and the key at fault, if one is expected.
fn check(answer: &Answer, status: u16, key: Option<&str>) -> Value {
    assert_eq!((answer.status, answer.header("content-type")), (status, MEDIA_TYPE), "{}", answer.body);
    let problem = answer.json();
    assert_eq!(problem["status"], status);
    assert!(problem["title"].is_string() && problem["detail"].is_string(), "{problem}");
    assert_eq!(problem["key"].as_str(), key, "{problem}");
    problem
}

#[tokio::test]
async fn a_malformed_body_is_refused() {
    let service = Service::start().await;
    let raw = async |content_type: &str, body: &str| {
        let request = Request::post("/v1/sweeps").header(CONTENT_TYPE, content_type);
        service.send(request.body(Body::from(body.to_owned())).unwrap()).await
    };
    check(&raw("application/json", "{\"plan\": ").await, 400, None);
    check(&raw("application/json", "").await, 400, None);
    check(&raw("application/json", "[]").await, 400, None);
    check(&raw("application/json", "{} {}").await, 400, None);
    check(&raw("application/json", "\u{0}").await, 400, None);
    check(&raw("application/json", "[\"guyonneau2022/bounds\"]").await, 400, None);
    check(&raw("text/plain", "{}").await, 415, None);
    check(&raw("application/json", &format!("{{\"plan\": {}", "[".repeat(100_000))).await, 400, None);
    let large = format!("{{\"plan\": \"{}\"}}", "x".repeat(11 << 20));
    check(&raw("application/json", &large).await, 413, None);
}

#[tokio::test]
async fn an_unknown_key_is_refused_by_its_name() {
    let service = Service::start().await;
    let problem = check(&service.post(&json!({"plan": plan(), "sedes": 3}), &[]).await, 400, Some("sedes"));
    assert!(problem["detail"].as_str().unwrap().contains("`sedes`"), "{problem}");
    check(&service.post(&json!({"plan": plan(), "seeds": "3"}), &[]).await, 400, Some("seeds"));
    check(&service.post(&json!({"plan": plan(), "only": {"field": "crop-1"}}), &[]).await, 400, Some("only.field"));
    assert_eq!(service.get("/v1/sweeps").await.json()["items"], json!([]));
}

#[tokio::test]
async fn what_the_plan_does_not_have_is_refused_with_what_it_has() {
    let service = Service::start().await;
    let refused = async |body: Value| service.post(&body, &[]).await;
    let level = refused(json!({"plan": plan(), "only": {"field": ["crop-9"]}})).await;
    let problem = check(&level, 422, Some("field"));
    assert_eq!(problem["allowed"], json!(["crop-1", "crop-2"]));
    let factor = refused(json!({"plan": plan(), "only": {"weather": ["rain"]}})).await;
    assert_eq!(check(&factor, 422, Some("weather"))["allowed"], json!(["algorithm", "field"]));
    check(&refused(json!({"plan": "no/such-plan"})).await, 422, Some("plan"));
    check(&refused(json!({"plan": 3})).await, 422, Some("plan"));
    check(&refused(json!({"plan": plan(), "seeds": 0})).await, 422, Some("seeds"));
    check(&refused(json!({"plan": plan(), "set": {"perception.wings": 2}})).await, 422, Some("perception.wings"));
    check(&refused(json!({"plan": plan(), "name": " "})).await, 422, Some("name"));
    assert_eq!(service.get("/v1/sweeps").await.json()["items"], json!([]));
}

#[tokio::test]
async fn a_bad_parameter_is_refused_by_its_name() {
    let service = Service::with_results(1).await;
    for (path, key) in [
        ("/v1/sweeps?limit=0", "limit"),
        ("/v1/sweeps?limit=many", "limit"),
        ("/v1/sweeps?after=x", "after"),
        ("/v1/sweeps?colour=red", "colour"),
        ("/v1/sweeps/1?format=csv", "format"),
        ("/v1/jobs?state=lost", "state"),
        ("/v1/jobs?sweep=x", "sweep"),
        ("/v1/jobs?after=1", "after"),
        ("/v1/jobs?limit=10001", "limit"),
        ("/v1/sweeps/1/table?format=pdf", "format"),
        ("/v1/sweeps/1/results?format=xlsx", "format"),
        ("/v1/sweeps/1/results?limit=3", "limit"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle&format=pdf", "format"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle&colour=red", "colour"),
        ("/v1/sweeps/1/compare?other=x", "other"),
        ("/v1/jobs/1/trajectory?format=gpx", "format"),
        ("/v1/publications/guyonneau2022/table-2?sweep=x", "sweep"),
    ] {
        check(&service.get(path).await, 400, Some(key));
    }
}

#[tokio::test]
async fn what_a_sweep_does_not_have_is_refused_by_its_name() {
    let service = Service::with_results(1).await;
    for (path, key) in [
        ("/v1/jobs?sweep=1&factor.weather=rain", "factor.weather"),
        ("/v1/sweeps/1/table?metric=beauty", "metric"),
        ("/v1/sweeps/1/table?group_by=weather", "group_by"),
        ("/v1/sweeps/1/table?columns=weather", "columns"),
        ("/v1/sweeps/1/table?statistic=mode", "statistic"),
        ("/v1/sweeps/1/compare", "factor"),
        ("/v1/sweeps/1/compare?factor=weather&a=rgop&b=oracle", "factor"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop", "b"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=ruby&b=rgop", "a"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=rgop", "b"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle&metric=beauty", "metric"),
        ("/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle&group_by=algorithm", "group_by"),
    ] {
        check(&service.get(path).await, 422, Some(key));
    }
}

#[tokio::test]
async fn what_is_not_there_is_not_found() {
    let service = Service::start().await;
    for path in [
        "/v1/sweeps/9",
        "/v1/sweeps/x",
        "/v1/sweeps/-1",
        "/v1/sweeps/99999999999999999999",
        "/v1/sweeps/9/table",
        "/v1/sweeps/9/compare",
        "/v1/sweeps/9/results",
        "/v1/jobs/9",
        "/v1/jobs/x",
        "/v1/jobs/9/trajectory",
        "/v1/jobs/9/trajectory.svg",
        "/v1/jobs?sweep=9",
        "/v1/publications/guyonneau2022/table-2?sweep=9",
        "/v2/sweeps",
        "/v1/sweeps/1/%ff",
        "/v1/sweeps/9/values?metric=success",
        "/v1/sweeps/9/events",
        "/v1/jobs/9/replay",
    ] {
        check(&service.get(path).await, 404, None);
    }
    check(&service.get("/v1/publications/nobody/table-1").await, 404, Some("source"));
    service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await;
    check(&service.get("/v1/sweeps/1/compare?other=9").await, 404, Some("other"));
    check(&service.get("/v1/publications/guyonneau2022/table-99").await, 404, Some("table"));
}

#[test]
fn too_few_digits_of_a_key_are_a_bad_request() {
    let problem = Problem::from(StoreError::Ambiguous("ab123456".to_owned()));
    assert_eq!((problem.status, problem.key.as_deref()), (400, Some("job")));
    assert!(problem.detail.contains("`ab123456`: give more digits"), "{}", problem.detail);
}

#[tokio::test]
async fn a_wrong_method_is_told_the_right_ones() {
    let service = Service::start().await;
    let answer = service.send(Request::delete("/v1/plans").body(Body::empty()).unwrap()).await;
    check(&answer, 405, None);
    assert_eq!(answer.header("allow"), "GET,HEAD");
}

#[tokio::test]
async fn a_job_without_a_result_has_no_path() {
    let service = Service::start().await;
    service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await;
    check(&service.get("/v1/jobs/1/trajectory").await, 409, None);
    check(&service.get("/v1/jobs/1/trajectory.svg").await, 409, None);
}
