//! A sweep as one document.

use super::Service;

#[tokio::test]
async fn a_report_holds_tables_figures_endings_and_how_to_do_it_again() {
    let service = Service::with_results(3).await;
    let report = service.get("/v1/sweeps/1/report").await;
    assert_eq!((report.status, report.header("content-type")), (200, "text/html; charset=utf-8"), "{}", report.body);
    let page = &report.body;
    for there in [
        "<h1>guyonneau2022/two-by-two</h1>",
        "12 of 12, seeds 1 to 3",
        &crate::engine().to_string(),
        "How to reproduce",
        "&quot;seeds&quot;: 3",
        "success ratio",
        "<svg",
        "How runs ended",
        "<td>lost</td><td>no</td><td class=\"number\">1</td>",
    ] {
        assert!(page.contains(there), "{there}");
    }
    // The results are a test's own: no run gives their digests again, so none is drawn.
    assert!(!page.contains("Single runs"));
    assert_eq!(service.get("/v1/sweeps/1/report").await.body, *page, "the same results give the same bytes");
}

#[tokio::test]
async fn a_report_comes_as_markdown_too_and_of_no_other_sweep() {
    let service = Service::with_results(1).await;
    let markdown = service.get("/v1/sweeps/1/report?format=md").await;
    assert_eq!(markdown.header("content-type"), "text/markdown; charset=utf-8");
    assert!(
        markdown.body.starts_with("# guyonneau2022/two-by-two\n")
            && markdown.body.contains("data:image/svg+xml;base64,")
    );
    assert_eq!(service.get("/v1/sweeps/2/report").await.status, 404);
    let refused = service.get("/v1/sweeps/1/report?format=pdf").await;
    assert!(refused.status == 400 && refused.body.contains("html"), "{}", refused.body);
}

#[tokio::test]
async fn a_sweep_without_results_says_so() {
    let service = Service::start().await;
    service.post(&serde_json::json!({"plan": super::plan(), "seeds": 1}), &[]).await;
    let page = service.get("/v1/sweeps/1/report").await.body;
    assert!(page.contains("not finished: 4 runs are missing") && page.contains("There are no results yet."), "{page}");
}
