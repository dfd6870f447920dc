//! The pages, and what is there for them alone.

use serde_json::json;

use super::{Service, plan};

#[tokio::test]
async fn the_pages_come_from_the_program_and_let_nothing_in_from_elsewhere() {
    let service = Service::start().await;
    for (path, media_type) in [
        ("/", "text/html; charset=utf-8"),
        ("/docs", "text/html; charset=utf-8"),
        ("/page/main.js", "text/javascript; charset=utf-8"),
        ("/page/app.css", "text/css; charset=utf-8"),
        ("/page/icon.svg", "image/svg+xml"),
    ] {
        let answer = service.get(path).await;
        assert_eq!((answer.status, answer.header("content-type")), (200, media_type), "{path}");
        let policy = answer.header("content-security-policy");
        assert!(policy.starts_with("default-src 'none'; script-src 'self'; style-src 'self';"), "{policy}");
        assert!(!policy.contains("unsafe"), "{policy}");
    }
    assert_eq!(service.get("/page/passwords.txt").await.status, 404);
    let table = service.get("/v1/sweeps").await;
    assert!(table.header("content-security-policy").starts_with("default-src 'none'; style-src 'unsafe-inline'"));
}

#[tokio::test]
async fn single_values_come_cell_by_cell_for_the_metrics_asked_for() {
    let service = Service::with_results(3).await;
    let values = service.get("/v1/sweeps/1/values?metric=success&factor.field=crop-2").await.json();
    let cells = values["cells"].as_array().unwrap();
    assert_eq!(cells.len(), 2, "{values}");
    assert!(cells.iter().all(|cell| cell["factors"]["field"] == "crop-2"));
    assert_eq!(cells[0]["seeds"], json!([1, 2, 3]));
    assert_eq!(cells[0]["metrics"], json!({"success": [1.0, 0.0, 1.0]}));
    assert_eq!(cells[0]["outcomes"], json!(["success", "lost", "success"]));
    for (query, key) in [("", "metric"), ("?metric=", "metric"), ("?metric=a,,b", "metric"), ("?metric=a&x=1", "x")] {
        let refused = service.get(&format!("/v1/sweeps/1/values{query}")).await;
        assert_eq!((refused.status, &refused.json()["key"]), (400, &json!(key)), "{query}");
    }
}

#[tokio::test]
async fn a_sweep_knows_the_published_tables_it_belongs_to() {
    let service = Service::start().await;
    service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await;
    let of_sweep = service.get("/v1/publications?sweep=1").await.json();
    let items = of_sweep["items"].as_array().unwrap();
    assert!(!items.is_empty() && items.iter().all(|item| item["source"] == "guyonneau2022"), "{of_sweep}");
    let all = service.get("/v1/publications").await.json();
    assert!(all["items"].as_array().unwrap().iter().any(|item| item["source"] == "velasquez2022"), "{all}");
    for item in items {
        let path = format!("/v1/publications/{}/{}", item["source"].as_str().unwrap(), item["table"].as_str().unwrap());
        assert_eq!(service.get(&path).await.status, 200, "{path}");
    }
    assert_eq!(service.get("/v1/publications?sweep=9").await.status, 404);
}
