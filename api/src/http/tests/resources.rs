//! What the routes answer when all is well.

use serde_json::{Value, json};

use super::{Service, plan};

#[tokio::test]
async fn a_submission_is_created_once_and_found_again() {
    let service = Service::start().await;
    let body = json!({"plan": plan(), "only": {"field": ["crop-2"]}, "seeds": 2, "name": "night", "priority": 3});
    let first = service.post(&body, &[("Idempotency-Key", "k1")]).await;
    assert_eq!((first.status, first.header("location")), (201, "/v1/sweeps/1"), "{}", first.body);
    assert_eq!(first.json(), json!({"id": 1, "total": 4, "new": 4, "cached": 0, "not_applied": []}));
    assert_eq!(service.post(&body, &[("Idempotency-Key", "k1")]).await.json()["id"], 1);

    let other = json!({"plan": plan(), "seeds": 1});
    let conflict = service.post(&other, &[("Idempotency-Key", "k1")]).await;
    assert_eq!((conflict.status, conflict.json()["key"].clone()), (409, json!("Idempotency-Key")));

    for (key, value) in
        [("priority", json!(4)), ("name", json!("day")), ("record", json!(true)), ("timing", json!(true))]
    {
        let mut other = body.clone();
        other[key] = value;
        assert_eq!(service.post(&other, &[("Idempotency-Key", "k1")]).await.status, 409, "{key}");
    }

    let sweep = service.get("/v1/sweeps/1").await.json();
    assert_eq!([&sweep["name"], &sweep["state"], &sweep["plan"]], ["night", "active", "guyonneau2022/two-by-two"]);
    assert_eq!([&sweep["total"], &sweep["queued"], &sweep["priority"]].map(Value::as_u64), [Some(4), Some(4), Some(3)]);
}

#[tokio::test]
async fn a_sweep_submitted_again_runs_only_what_is_missing() {
    let service = Service::with_results(2).await;
    let grown = service.post(&json!({"plan": plan(), "seeds": 3}), &[]).await.json();
    assert_eq!([&grown["total"], &grown["new"], &grown["cached"]].map(Value::as_u64), [Some(12), Some(4), Some(8)]);
}

#[tokio::test]
async fn a_path_that_applies_only_in_part_is_reported() {
    let service = Service::start().await;
    let body = json!({"plan": plan(), "vary": {"field.crop": [1, 2]}, "seeds": 1});
    let created = service.post(&body, &[]).await;
    assert_eq!(created.status, 201, "{}", created.body);
    assert_eq!(created.json()["total"], 8);
    assert!(created.json()["not_applied"].is_array());
}

#[tokio::test]
async fn sweeps_are_listed_newest_first_page_by_page() {
    let service = Service::start().await;
    for seeds in 1..=3 {
        service.post(&json!({"plan": plan(), "seeds": seeds}), &[]).await;
    }
    let ids = |page: &Value| page["items"].as_array().unwrap().iter().map(|s| s["id"].clone()).collect::<Vec<_>>();
    let first = service.get("/v1/sweeps?limit=2").await.json();
    assert_eq!((ids(&first), &first["next"]), (vec![json!(3), json!(2)], &json!(2)));
    let second = service.get("/v1/sweeps?limit=2&after=2").await.json();
    assert_eq!((ids(&second), &second["next"]), (vec![json!(1)], &Value::Null));
}

#[tokio::test]
async fn a_table_comes_in_every_form() {
    let service = Service::with_results(3).await;
    let path = "/v1/sweeps/1/table?metric=mean_squared_error_mm2&group_by=algorithm&statistic=mean";
    let table = service.get(path).await;
    assert_eq!(table.header("content-type"), "application/json");
    let table = table.json();
    assert_eq!(table["sweep"], 1);
    assert_eq!(table["cells"].as_array().unwrap().len(), 2);
    assert_eq!(table["cells"][0]["factors"], json!({"algorithm": "rgop"}));
    assert_eq!(table["cells"][0]["metrics"]["mean_squared_error_mm2"], json!({"n": 6, "mean": 20.0}));

    let csv = service.get(&format!("{path}&format=csv")).await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8");
    assert!(csv.body.lines().next().unwrap().contains("mean_squared_error_mm2_mean"), "{}", csv.body);
    let by_header = service.get_as(path, "text/csv").await;
    assert_eq!(by_header.body, csv.body);
    let markdown = service.get_as(&format!("{path}&format=md"), "text/csv").await;
    assert!(markdown.body.contains("|") && markdown.body.contains("rgop"), "{}", markdown.body);
    assert_eq!(service.get_as(path, "image/png").await.header("content-type"), "application/json");
}

#[tokio::test]
async fn a_table_that_is_known_is_not_sent_again_until_a_result_comes() {
    let service = Service::with_results(2).await;
    service.post(&json!({"plan": plan(), "seeds": 3}), &[]).await;
    let path = "/v1/sweeps/2/table?metric=success";
    let table = service.get(path).await;
    let tag = table.header("etag").to_owned();
    assert!(tag.len() > 10 && table.header("cache-control") == "private, no-cache", "{tag}");
    let again = service.get_if_changed(path, &tag).await;
    assert_eq!((again.status, again.body.as_str(), again.header("etag")), (304, "", tag.as_str()));
    assert_eq!(service.get_if_changed(&format!("{path}&format=csv"), &tag).await.status, 200, "another form");
    assert_eq!(service.get("/v1/sweeps/2/results").await.header("etag"), "", "it may change at any moment");
    service.work().await;
    let changed = service.get_if_changed(path, &tag).await;
    assert_eq!((changed.status, changed.header("etag") == tag), (200, false));

    let rows = service.get("/v1/sweeps/2/results?format=csv").await;
    let known = service.get_if_changed("/v1/sweeps/2/results?format=csv", rows.header("etag")).await;
    assert_eq!((known.status, known.body.as_str()), (304, ""));
}

#[tokio::test]
async fn a_table_of_everything_has_medians() {
    let service = Service::with_results(3).await;
    let cells = service.get("/v1/sweeps/1/table").await.json()["cells"].clone();
    assert_eq!(cells.as_array().unwrap().len(), 4);
    assert_eq!(cells[3]["factors"], json!({"algorithm": "oracle", "field": "crop-2"}));
    assert_eq!(cells[3]["metrics"]["mean_squared_error_mm2"]["median"], 20.0);
    assert_eq!(cells[3]["metrics"]["success"]["n"], 3);
}

#[tokio::test]
async fn jobs_are_found_by_sweep_state_and_label_page_by_page() {
    let service = Service::with_results(3).await;
    let path = "/v1/jobs?sweep=1&state=done&factor.algorithm=oracle&factor.field=crop-1";
    let all = service.get(path).await.json();
    assert_eq!(all["items"].as_array().unwrap().len(), 3, "{all}");
    assert_eq!(all["items"][0]["factors"], json!({"algorithm": "oracle", "field": "crop-1"}));
    assert_eq!(all["next"], Value::Null);

    let first = service.get(&format!("{path}&limit=2")).await.json();
    let after = first["next"].as_str().unwrap();
    let second = service.get(&format!("{path}&limit=2&after={after}")).await.json();
    assert_eq!(second["items"], json!([all["items"][2]]));
    assert_eq!(service.get("/v1/jobs?state=queued").await.json()["items"], json!([]));
}

#[tokio::test]
async fn a_job_goes_by_number_key_or_beginning_of_a_key() {
    let service = Service::with_results(1).await;
    let line = service.get("/v1/jobs?limit=1").await.json()["items"][0].clone();
    let job = service.get(&format!("/v1/jobs/{}", line["id"])).await.json();
    let key = line["key"].as_str().unwrap();
    for name in [key, &key[..12], &key[..8].to_uppercase()] {
        assert_eq!(service.get(&format!("/v1/jobs/{name}")).await.json(), job);
    }
    assert_eq!(service.get(&format!("/v1/jobs/{}", &key[..7])).await.status, 404);
    assert_eq!([&job["key"], &job["digest"], &job["state"]], [&line["key"], &line["digest"], &json!("done")]);
    assert_eq!(job["metrics"], json!({"mean_squared_error_mm2": 10.0, "success": 1.0}));
    assert_eq!(job["scenario"]["field"]["kind"], "guyonneau2022");
    assert_eq!((&job["attempts"][0]["end"], &job["timings"]["wall_ms"]), (&json!("done"), &json!(5.0)));
}

#[tokio::test]
async fn the_document_lists_every_route_with_its_schemas() {
    let document = Service::start().await.get("/openapi.json").await.json();
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"), "{}", document["openapi"]);
    let paths: Vec<&str> = document["paths"].as_object().unwrap().keys().map(String::as_str).collect();
    let expected = [
        "/healthz",
        "/metrics",
        "/readyz",
        "/v1/jobs",
        "/v1/jobs/{job}",
        "/v1/jobs/{job}/trajectory",
        "/v1/jobs/{job}/trajectory.svg",
        "/v1/plans",
        "/v1/publications/{source}/{table}",
        "/v1/sweeps",
        "/v1/sweeps/{sweep}",
        "/v1/sweeps/{sweep}/compare",
        "/v1/sweeps/{sweep}/results",
        "/v1/sweeps/{sweep}/retry",
        "/v1/sweeps/{sweep}/table",
    ];
    assert!(expected.iter().all(|path| paths.contains(path)), "{paths:?}");
    let methods: Vec<&str> =
        document["paths"]["/v1/sweeps/{sweep}"].as_object().unwrap().keys().map(String::as_str).collect();
    assert!(["get", "patch", "delete"].iter().all(|method| methods.contains(method)), "{methods:?}");
    assert_eq!(document["components"]["securitySchemes"]["token"]["scheme"], "bearer");
    assert_eq!(document["security"], json!([{}, {"token": []}]));
    let schemas = document["components"]["schemas"].as_object().unwrap();
    for reference in references(&document) {
        let name = reference.strip_prefix("#/components/schemas/").unwrap();
        assert!(schemas.contains_key(name), "{name} is referred to and not there");
    }
    assert!(schemas.len() > 15, "{:?}", schemas.keys());
}

/// Every `$ref` in a document.
fn references(value: &Value) -> Vec<String> {
    match value {
        Value::Object(object) => {
            let own = object.get("$ref").and_then(Value::as_str).map(str::to_owned);
            own.into_iter().chain(object.values().flat_map(references)).collect()
        }
        Value::Array(items) => items.iter().flat_map(references).collect(),
        _ => Vec::new(),
    }
}

#[tokio::test]
async fn probes_and_catalogue_answer() {
    let service = Service::start().await;
    for path in ["/healthz", "/readyz"] {
        let health = service.get(path).await;
        assert_eq!((health.status, health.json()["engine"].clone()), (200, json!(crate::engine())));
    }
    let plans = service.get("/v1/plans").await.json();
    let names: Vec<_> = plans["items"].as_array().unwrap().iter().map(|plan| plan["name"].clone()).collect();
    let known: Vec<_> = furrow_sim::plan::builtin().iter().map(|(name, _)| json!(name)).collect();
    assert_eq!(names, known);
}

#[tokio::test]
async fn an_answer_is_remembered_until_a_result_comes() {
    let service = Service::with_results(1).await;
    let table = "/v1/sweeps/1/table?metric=success&group_by=algorithm";
    let compare = "/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle";
    for path in [table, compare, "/v1/publications/guyonneau2022/table-2?sweep=1"] {
        let (first, again) = (service.get(path).await, service.get(path).await);
        assert_eq!((first.status, &first.body), (200, &again.body), "{path}");
        assert!(!first.header("etag").is_empty() && first.header("etag") == again.header("etag"), "{path}");
        let known = service.get_if_changed(path, first.header("etag")).await;
        assert_eq!((known.status, known.body.as_str()), (304, ""), "{path}");
    }
    let csv = service.get_as(table, "text/csv").await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8", "another form is another answer");
    assert_eq!(service.get("/v1/sweeps/2/table").await.status, 404);

    let before = service.get(table).await;
    service.post(&json!({"plan": plan(), "seeds": 2}), &[]).await;
    service.work().await;
    let after = service.get("/v1/sweeps/2/table?metric=success&group_by=algorithm").await;
    assert_eq!(after.status, 200, "what was refused is not remembered");
    assert_eq!(service.get(table).await.body, before.body, "results of another sweep change nothing");
    assert_eq!(after.json()["cells"][0]["n"], 4);
}

#[tokio::test]
async fn the_table_of_a_sweep_shows_all_results_as_soon_as_it_has_ended() {
    let service = Service::start().await;
    let table = "/v1/sweeps/1/table?metric=success&group_by=algorithm";
    service.post(&json!({"plan": plan(), "seeds": 2}), &[]).await;
    let n = |reply: &Value| reply["cells"][0]["n"].clone();
    assert_eq!(n(&service.get(table).await.json()), 0);
    service.work().await;
    assert_eq!(n(&service.get(table).await.json()), 4);
}
