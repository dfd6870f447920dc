//! Runs that a worker in the same process really simulates, and where they went.

use furrow_coordinator::{Config, Store};
use furrow_schema::id::SweepId;
use serde_json::{Value, json};

use super::super::problem::MEDIA_TYPE;
use super::{Service, plan};
use crate::in_process::Farm;

/// A robot that keeps its heading crashes soon: a run of a fraction of a second.
fn short_run(record: bool) -> Value {
    let mut plan = plan();
    plan["factors"][0]["levels"] = json!([{
        "label": "heading-hold",
        "patch": {"perception": {"kind": "none"}, "mission": {"kind": "heading-hold"}}
    }]);
    json!({"plan": plan, "only": {"field": ["crop-2"]}, "seeds": 1, "record": record})
}

async fn finished(body: &Value) -> (Farm, Service) {
    let farm = Farm::start(Store::in_memory().await.unwrap(), Config::new(crate::engine()), 1);
    let service = Service::of(farm.coordinator().clone());
    let mut changed = farm.coordinator().changed();
    let created = service.post(body, &[]).await;
    assert_eq!(created.status, 201, "{}", created.body);
    while farm.coordinator().sweep(SweepId(1)).await.unwrap().unwrap().done == 0 {
        changed.changed().await.unwrap();
    }
    (farm, service)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_that_was_not_recorded_is_repeated_for_its_path() {
    let (farm, service) = finished(&short_run(false)).await;
    let job = service.get("/v1/jobs/1").await.json();
    assert_eq!((&job["recorded"], &job["metrics"]["success"]), (&json!(false), &json!(0.0)), "{job}");

    let path = service.get("/v1/jobs/1/trajectory").await.json();
    let poses = path["poses"].as_array().unwrap();
    let simulated_s = job["metrics"]["simulated_s"].as_f64().unwrap();
    assert!((poses.len() as f64 * 0.05 - simulated_s).abs() < 0.2, "{} poses, {simulated_s} s", poses.len());
    assert_eq!((&path["stored"], &path["job"]), (&json!(false), &json!(1)));

    let csv = service.get_as("/v1/jobs/1/trajectory", "text/csv").await;
    assert_eq!(csv.body.lines().count(), poses.len() + 1);
    let drawing = service.get("/v1/jobs/1/trajectory.svg").await;
    assert_eq!((drawing.status, drawing.header("content-type")), (200, "image/svg+xml"));
    assert!(drawing.body.starts_with("<svg") && drawing.body.trim_end().ends_with("</svg>"));

    let replay = service.get("/v1/jobs/1/replay").await.json();
    assert_eq!(replay["poses"].as_array().unwrap().len(), poses.len().div_ceil(2));
    assert!((replay["poses"][3][0].as_f64().unwrap() - poses[6][0].as_f64().unwrap()).abs() < 6e-4);
    assert!(replay["field"]["crop"].as_array().unwrap().len() > 100);
    assert_eq!((&replay["outcome"], &replay["step_s"]), (&job["outcome"], &json!(0.1)));
    assert_eq!(replay["scans"], json!([]), "it drives without looking");
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replay_shows_what_the_lidars_saw_among_rows_and_in_a_lane() {
    let rows = json!({"plan": "guyonneau2022/bounds", "only": {"algorithm": ["rgop"], "field": ["crop-1"]},
        "set": {"limits.max_time_s": 5}, "seeds": 1});
    let lane = json!({"plan": "velasquez2022/baselines", "only": {"algorithm": ["pl-ekf-lgg"], "field": ["lane-a"]},
        "set": {"limits.max_time_s": 5}, "seeds": 1});
    for (request, lidars, leaves) in [(rows, 2, false), (lane, 1, true)] {
        let (farm, service) = finished(&request).await;
        let replay = service.get("/v1/jobs/1/replay").await.json();
        let scans = replay["scans"].as_array().unwrap();
        assert!(scans.len().abs_diff(20 * lidars) <= lidars, "{}", scans.len());
        assert!(scans.iter().all(|scan| scan["points_cm"].as_array().unwrap().len() <= 180));
        let seen = |key: &str| scans.iter().any(|scan| !scan[key].as_array().unwrap().is_empty());
        assert!(seen("points_cm") && seen("lines_cm"));
        assert_eq!(!replay["field"]["leaves"].as_array().unwrap().is_empty(), leaves);
        farm.stop().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_replay_as_mcap_names_its_run_and_another_form_is_refused() {
    let (farm, service) = finished(&short_run(false)).await;
    let job = service.get("/v1/jobs/1").await.json();
    let file = service.get("/v1/jobs/1/replay?format=mcap").await;
    assert_eq!((file.status, file.header("content-type")), (200, "application/vnd.mcap"));
    assert_eq!(file.header("content-disposition"), "attachment; filename=\"run-1.mcap\"");
    assert_eq!(service.get_as("/v1/jobs/1/replay", "application/vnd.mcap").await.bytes, file.bytes);
    let summary = mcap::Summary::read(&file.bytes).unwrap().unwrap();
    let about = mcap::read::metadata(&file.bytes, &summary.metadata_indexes[0]).unwrap().metadata;
    for key in ["key", "digest", "outcome"] {
        assert_eq!(about[key], job[key].as_str().unwrap(), "{key}");
    }
    assert_eq!(serde_json::from_str::<Value>(&about["scenario"]).unwrap(), job["scenario"]);
    let refused = service.get("/v1/jobs/1/replay?format=bag").await;
    assert_eq!((refused.status, refused.json()["key"].clone()), (400, json!("format")));
    farm.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recorded_path_is_the_repeated_one_but_for_rounding() {
    let (farm, recorded) = finished(&short_run(true)).await;
    let (other, repeated) = finished(&short_run(false)).await;
    let (a, b) =
        (recorded.get("/v1/jobs/1/trajectory").await.json(), repeated.get("/v1/jobs/1/trajectory").await.json());
    assert_eq!([&a["stored"], &b["stored"]], [&json!(true), &json!(false)]);
    assert_eq!(a["key"], b["key"]);
    let (a, b) = (a["poses"].as_array().unwrap(), b["poses"].as_array().unwrap());
    assert_eq!(a.len(), b.len());
    for (stored, exact) in a.iter().zip(b) {
        for axis in 0..3 {
            let difference = stored[axis].as_f64().unwrap() - exact[axis].as_f64().unwrap();
            assert!(difference.abs() < 1e-4, "{stored} {exact}");
        }
    }
    farm.stop().await;
    other.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_cannot_be_repeated_is_no_path() {
    let service = Service::start().await;
    service.post(&short_run(false), &[]).await;
    service.work().await; // A made-up result: its digest is no run's.
    let answer = service.get("/v1/jobs/1/trajectory.svg").await;
    assert_eq!((answer.status, answer.header("content-type")), (409, MEDIA_TYPE));
    assert!(answer.body.contains("another digest"), "{}", answer.body);
    let answer = service.get("/v1/jobs/1/replay?format=mcap").await;
    assert_eq!((answer.status, answer.header("content-type")), (409, MEDIA_TYPE));
}
