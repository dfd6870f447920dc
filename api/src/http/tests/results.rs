//! All runs of a sweep, over HTTP.

use serde_json::{Value, json};

use super::{Service, plan};

#[tokio::test]
async fn every_run_is_a_row_with_or_without_a_result() {
    let service = Service::with_results(2).await;
    service.post(&json!({"plan": plan(), "seeds": 3}), &[]).await;
    let answer = service.get("/v1/sweeps/2/results").await;
    assert_eq!((answer.status, answer.header("content-type")), (200, "application/x-ndjson"));
    assert_eq!(answer.header("content-disposition"), "attachment; filename=\"sweep-2.json\"");
    let rows: Vec<Value> = answer.body.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let states = rows.iter().map(|row| row["state"].as_str().unwrap()).collect::<Vec<_>>();
    assert_eq!(states, ["done", "done", "queued"].repeat(4));
    assert_eq!(rows[11]["factors"], json!({"algorithm": "oracle", "field": "crop-2"}));
    assert_eq!(rows[1]["metrics"], json!({"success": 0.0, "mean_squared_error_mm2": 20.0}));
    assert_eq!(rows[2]["metrics"], json!({"success": null, "mean_squared_error_mm2": null}));

    let csv = service.get("/v1/sweeps/2/results?format=csv").await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8");
    let mut lines = csv.body.split("\r\n");
    let heading = "job,key,algorithm,field,seed,state,attempts,outcome,digest,success,mean_squared_error_mm2";
    assert_eq!((lines.next(), csv.body.split("\r\n").count()), (Some(heading), 14));
    let by_header = service.get_as("/v1/sweeps/2/results", "text/csv").await;
    assert_eq!(by_header.body, csv.body);
}
