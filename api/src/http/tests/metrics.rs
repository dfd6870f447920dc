//! What Prometheus is told.

use std::collections::BTreeMap;

use super::Service;

/// Samples by name with labels, of a page in the text format; everything in it must be well-formed and announced.
fn parsed(page: &str) -> BTreeMap<String, f64> {
    let mut kinds = BTreeMap::new();
    let mut samples = BTreeMap::new();
    for line in page.lines() {
        if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').unwrap();
            assert!(kinds.insert(name, kind).is_none(), "{name} is announced twice");
        } else if !line.starts_with("# HELP ") {
            let (series, value) = line.rsplit_once(' ').unwrap_or_else(|| panic!("no sample: {line}"));
            let name = series.split('{').next().unwrap();
            let ends = ["", "_bucket", "_sum", "_count"];
            let known = ends.iter().filter_map(|end| name.strip_suffix(end)).any(|family| kinds.contains_key(family));
            assert!(known, "{name} is not announced before it is used");
            assert!(series.ends_with('}') == series.contains('{'), "{series}");
            assert!(samples.insert(series.to_owned(), value.parse().unwrap()).is_none(), "{series} is there twice");
        }
    }
    assert!(page.ends_with('\n'));
    samples
}

#[tokio::test]
async fn the_page_tells_what_happened() {
    let service = Service::with_results(1).await;
    service.get("/v1/sweeps/1").await;
    service.get("/v1/sweeps/999").await;
    service.get("/nowhere/at/all").await;
    let answer = service.get("/metrics").await;
    assert_eq!((answer.status, answer.header("content-type")), (200, "text/plain; version=0.0.4; charset=utf-8"));
    let samples = parsed(&answer.body);
    let sample = |series: &str| *samples.get(series).unwrap_or_else(|| panic!("no {series} in {}", answer.body));
    assert_eq!(sample("furrow_sweeps{state=\"done\"}"), 1.0);
    assert_eq!(sample("furrow_sweeps{state=\"active\"}"), 0.0);
    assert_eq!(sample("furrow_jobs{state=\"done\"}"), 4.0);
    assert_eq!(sample("furrow_results_recorded_total"), 4.0);
    assert_eq!((sample("furrow_workers_live"), sample("furrow_incidents")), (1.0, 0.0));
    let requests = |method: &str, route: &str, status: u16| {
        sample(&format!("furrow_http_requests_total{{method=\"{method}\",route=\"{route}\",status=\"{status}\"}}"))
    };
    assert_eq!(requests("POST", "/v1/sweeps", 201), 1.0);
    assert_eq!(requests("GET", "/v1/sweeps/{sweep}", 200), 1.0);
    assert_eq!(requests("GET", "/v1/sweeps/{sweep}", 404), 1.0);
    assert_eq!(requests("GET", "none", 404), 1.0);
    assert_eq!(sample("furrow_http_request_seconds_count"), 4.0);
    assert_eq!(sample("furrow_http_request_seconds_bucket{le=\"+Inf\"}"), 4.0);
    assert!(sample("furrow_commit_seconds_count") >= 3.0);
    assert!(sample("furrow_commit_seconds_bucket{le=\"5\"}") >= 3.0);
    assert!(sample("process_resident_memory_bytes") > 1e6 && sample("process_open_fds") > 0.0);
    assert!(sample("process_cpu_seconds_total") >= 0.0);
}
