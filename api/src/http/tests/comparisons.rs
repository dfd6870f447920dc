//! Comparisons in pairs, over HTTP.

use serde_json::json;

use super::{Service, plan};

const PATH: &str = "/v1/sweeps/1/compare?factor=algorithm&a=rgop&b=oracle&metric=success,mean_squared_error_mm2";

#[tokio::test]
async fn two_levels_are_compared_over_all_pairs_and_by_group() {
    let service = Service::with_results(3).await;
    let answer = service.get(&format!("{PATH}&group_by=field")).await;
    assert_eq!((answer.status, answer.header("content-type")), (200, "application/json"), "{}", answer.body);
    let answer = answer.json();
    assert_eq!([&answer["sweep"], &answer["other"], &answer["tests"]], [&json!(1), &json!(null), &json!(6)]);
    assert_eq!(answer["paired_by"], json!(["field"]));
    let groups = answer["groups"].as_array().unwrap();
    assert_eq!(groups.iter().map(|group| group["pairs"].clone()).collect::<Vec<_>>(), [6, 3, 3]);
    assert_eq!(groups[2]["factors"], json!({"field": "crop-2"}));
    // The results of a test depend on the seed alone.
    let success = &groups[0]["metrics"]["success"];
    assert_eq!(success["two_by_two"], json!({"both": 4, "only_a": 0, "only_b": 0, "neither": 2}));
    assert_eq!([&success["difference"], &success["p"]], [0.0, 1.0]);
    assert_eq!(groups[0]["metrics"]["mean_squared_error_mm2"]["zeros"], 6);
}

#[tokio::test]
async fn a_comparison_comes_in_every_form() {
    let service = Service::with_results(2).await;
    let csv = service.get(&format!("{PATH}&format=csv")).await;
    assert_eq!(csv.header("content-type"), "text/csv; charset=utf-8");
    let lines: Vec<&str> = csv.body.lines().collect();
    assert_eq!(lines.len(), 3, "{}", csv.body);
    assert!(lines.iter().all(|line| line.split(',').count() == lines[0].split(',').count()), "{}", csv.body);
    for format in ["md", "latex", "text"] {
        let text = service.get(&format!("{PATH}&format={format}")).await.body;
        assert!(text.contains("success ratio") && text.contains("rgop"), "{text}");
    }
}

#[tokio::test]
async fn runs_without_a_partner_are_told() {
    let service = Service::with_results(2).await;
    service.post(&json!({"plan": plan(), "seeds": 3}), &[]).await;
    let text = service.get("/v1/sweeps/2/compare?factor=algorithm&a=rgop&b=oracle&format=text").await.body;
    assert!(text.contains("2 pairs are incomplete and in no figure"), "{text}");
}

#[tokio::test]
async fn two_sweeps_are_compared_in_the_cells_they_share() {
    let service = Service::with_results(2).await;
    service.post(&json!({"plan": plan(), "only": {"field": ["crop-1"]}, "seeds": 2}), &[]).await;
    let answer = service.get("/v1/sweeps/1/compare?other=2").await.json();
    assert_eq!(
        [&answer["other"], &answer["factor"], &answer["paired_by"]],
        [&json!(2), &json!(null), &json!(["algorithm", "field"])]
    );
    let all = &answer["groups"][0];
    assert_eq!([&all["pairs"], &all["incomplete"], &all["only_a"]], [4, 4, 4]);
    let levels = service.get("/v1/sweeps/1/compare?other=2&factor=field&a=crop-2&b=crop-1").await.json();
    assert_eq!(levels["groups"][0]["pairs"], 4);
}
