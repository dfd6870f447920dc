//! Published tables with results beside them.

use furrow_schema::sweep::NewSweep;
use serde_json::{Value, json};

use super::super::sweeps::new_sweep;
use super::{Service, plan};
use crate::plan::{PlanSource, Request, expand};

fn cell<'a>(table: &'a Value, algorithm: &str, field: &str) -> &'a Value {
    let wanted = json!({"algorithm": algorithm, "field": field});
    table["cells"].as_array().unwrap().iter().find(|cell| cell["factors"] == wanted).unwrap()
}

#[tokio::test]
async fn a_publication_takes_the_newest_sweep_of_its_plans() {
    let service = Service::start().await;
    let before = service.get("/v1/publications/guyonneau2022/table-2").await;
    assert_eq!((before.status, &before.json()["sweep"]), (200, &Value::Null));
    assert!(before.json()["cells"].as_array().unwrap().iter().all(|cell| cell["verdict"] == "not-run"));

    service.post(&json!({"plan": plan(), "seeds": 2}), &[]).await;
    service.work().await;
    let after = service.get("/v1/publications/guyonneau2022/table-2").await.json();
    assert_eq!(after["sweep"], 1);
    let is_ours = |cell: &&Value| cell["factors"]["algorithm"] == "rgop" && cell["factors"]["field"] == "crop-1";
    let ours = after["cells"].as_array().unwrap().iter().find(is_ours).unwrap();
    assert_eq!(ours["ours"]["n"], 2, "{ours}");
    assert_eq!(service.get("/v1/publications/guyonneau2022/table-2?sweep=1").await.json(), after);
    let text = service.get("/v1/publications/guyonneau2022/table-2?format=md").await;
    assert_eq!(text.header("content-type"), "text/markdown; charset=utf-8");
}

#[tokio::test]
async fn a_published_table_comes_in_every_form() {
    let service = Service::with_results(3).await;
    let path = "/v1/publications/guyonneau2022/table-3";
    for (format, media_type, piece) in [
        ("json", "application/json", "\"program\":67.0"),
        ("csv", "text/csv; charset=utf-8", "rgop,crop-1,65,67,66.3,20,20,"),
        ("md", "text/markdown; charset=utf-8", "65 different¹<br>67.0<br>20.0 / 66.3"),
        ("latex", "application/x-latex", " & program & 67.0 & "),
        ("text", "text/plain; charset=utf-8", "65 different¹"),
    ] {
        let asked = service.get(&format!("{path}?format={format}")).await;
        assert_eq!((asked.status, asked.header("content-type")), (200, media_type));
        assert!(asked.body.contains(piece), "{}", asked.body);
        let accepted = service.get_as(path, media_type.split(';').next().unwrap()).await;
        assert_eq!(accepted.body, asked.body);
    }
}

#[tokio::test]
async fn a_verdict_different_cites_runs_whose_keys_find_their_jobs() {
    let service = Service::with_results(5).await;
    let table = service.get("/v1/publications/guyonneau2022/table-3").await.json();
    let cell = cell(&table, "rgop", "crop-1");
    assert_eq!(cell["verdict"], "different");
    let note = cell["note"].as_str().unwrap();
    assert!(note.contains("; 2 of 5 runs failed (2 lost); runs: "), "{note}");
    for (words, seed, value) in [("nearest our median ", 3, "(30.0)"), ("farthest from it ", 5, "(50.0)")] {
        let (_, rest) = note.split_once(words).unwrap();
        let job = service.get(&format!("/v1/jobs/{}", &rest[..12])).await.json();
        assert_eq!((&job["seed"], job["cells"][0]["factors"]["field"].as_str()), (&json!(seed), Some("crop-1")));
        assert!(rest[13..].starts_with(value), "{note}");
    }
    assert_eq!(note.matches(", lost)").count(), 2, "{note}");
}

#[tokio::test]
async fn a_table_of_times_is_of_the_newest_sweep_that_measured_them() {
    let service = Service::start().await;
    let expansion = expand(&Request::all_of(PlanSource::Inline(plan()))).unwrap();
    let timing = NewSweep { timing: true, ..new_sweep(expansion, None) };
    service.coordinator.submit(timing).await.unwrap();
    service.post(&json!({"plan": plan()}), &[]).await;
    let sweep_of = async |table: &str| {
        let path = format!("/v1/publications/guyonneau2022/{table}");
        service.get(&path).await.json()["sweep"].clone()
    };
    assert_eq!(sweep_of("table-4").await, 1);
    assert_eq!(sweep_of("table-6").await, 1);
    assert_eq!(sweep_of("table-2").await, 2);
}
