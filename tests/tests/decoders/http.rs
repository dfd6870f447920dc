//! What users send: any method, path, query, headers and body, through the whole service.

use std::sync::LazyLock;
use std::time::Duration;

use axum::Router;
use axum::body::{Body, to_bytes};
use axum::http::{HeaderName, HeaderValue, Request};
use furrow_api::http::{Access, App, router};
use furrow_api::in_process::Farm;
use furrow_coordinator::token::{NewToken, Scope, TokenBook};
use furrow_coordinator::{Config, Coordinator, Store};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;
use serde_json::{Value, json};
use tokio::runtime::Runtime;
use tokio::time::timeout;
use tower::ServiceExt;

use crate::mutation::{config, spoiled};

const ANSWERS_WITHIN: Duration = Duration::from_secs(30);

static RUNTIME: LazyLock<Runtime> = LazyLock::new(|| Runtime::new().unwrap());

/// The service on a finished sweep, for this machine and for those with tokens; and a token with all scopes.
static SERVICES: LazyLock<Services> = LazyLock::new(|| RUNTIME.block_on(Services::start()));

struct Services {
    open: Router,
    guarded: Router,
    token: String,
    _folder: tempfile::TempDir,
}

impl Services {
    async fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let settings = || Config::new(furrow_api::engine());
        finish_a_sweep(Farm::start(Store::open(&path).await.unwrap(), settings(), 2)).await;
        let mut book = TokenBook::open(&path).await.unwrap();
        let new = NewToken { name: "all".to_owned(), scopes: Scope::ALL.to_vec(), expires_ms: None };
        let token = book.create(&new, 1).await.unwrap().reveal().to_owned();
        book.close().await.unwrap();
        let coordinator = Coordinator::start(Store::open(&path).await.unwrap(), settings());
        let usual = Access { rate_per_s: 1_000_000, ..Access::default() };
        let open = router(App::with_access(coordinator.clone(), usual.clone()));
        let guarded = router(App::with_access(coordinator, Access { tokens: true, proxied: true, ..usual }));
        Self { open, guarded, token, _folder: folder }
    }
}

/// Submits a short sweep, lets the farm run it, and stops the farm.
async fn finish_a_sweep(farm: Farm) {
    let mut changed = farm.coordinator().changed();
    let service = router(App::new(farm.coordinator().clone()));
    let request = Request::post("/v1/sweeps").header("content-type", "application/json");
    let request = request.body(Body::from(submission().to_string())).unwrap();
    assert_eq!(service.oneshot(request).await.unwrap().status(), 201);
    let sweep = "1".parse().unwrap();
    while farm.coordinator().sweep(sweep).await.unwrap().unwrap().done < 4 {
        changed.changed().await.unwrap();
    }
    farm.stop().await;
}

/// A valid submission with all there can be in one.
fn submission() -> Value {
    json!({
        "plan": {
            "name": "tests/short", "title": "Short runs", "source": "a test", "seeds": 2,
            "base": {
                "field": {"kind": "guyonneau2022", "crop": 1, "seed": "job"}, "robot": {"kind": "two-wheeled"},
                "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "oracle"},
                "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
                "mission": {"kind": "row-by-row"}, "observer": {"kind": "inter-rows"},
                "limits": {"kind": "simulated-time", "max_time_s": 1.0}
            },
            "factors": [
                {"name": "algorithm", "levels": [
                    {"label": "oracle", "patch": {}}, {"label": "rgop", "patch": {"perception": {"kind": "rgop"}}}
                ]},
                {"name": "field", "levels": [{"label": "crop-#", "range": [1, 2], "path": "field.crop"}]}
            ]
        },
        "only": {"field": ["crop-1"]}, "set": {"limits.max_time_s": 1.5}, "seeds": 2, "priority": 3, "name": "short"
    })
}

/// A field of a user's own, beside a plan.
fn own_field() -> Value {
    json!({
        "plan": "guyonneau2022/algorithm-5", "seeds": 1, "only": {"algorithm": ["rgop"]},
        "vary": {"perception.iterations": [2, 3]},
        "field": {
            "name": "Curved rows", "row_spacing_m": 1.5,
            "rows": [{"points_m": [[0, -0.75], [6, -0.15]]}, {"points_m": [[0, 0.75], [6, 1.35]]}],
            "plants": [{"x_m": 0.15, "y_m": -0.72, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": 0}],
            "start": {"x_m": 0, "y_m": 0, "heading_rad": 0.1}, "inter_rows": 1, "error_range_x_m": [1.0, 5.0]
        }
    })
}

/// A segment of a path: a name of ours, a number, or whatever a client writes.
fn segment() -> impl Strategy<Value = String> {
    let ours = [
        "v1",
        "sweeps",
        "jobs",
        "plans",
        "publications",
        "guyonneau2022",
        "table-2",
        "table-5",
        "table",
        "retry",
        "trajectory",
        "trajectory.svg",
        "healthz",
        "metrics",
        "openapi.json",
        "1",
        "2",
        "0",
        "-1",
        "99999999999999999999",
        "00000000",
        "%00",
        "%ff",
        "..",
        "%2e%2e",
        "a%2Fb",
    ];
    prop_oneof![5 => select(ours.to_vec()).prop_map(str::to_owned), 1 => "[0-9a-f]{7,65}", 1 => "[!-~&&[^?#]]{0,12}"]
}

fn path() -> impl Strategy<Value = String> {
    let routes = [
        "/v1/sweeps",
        "/v1/sweeps/1",
        "/v1/sweeps/1/table",
        "/v1/jobs",
        "/v1/jobs/1",
        "/v1/jobs/1/trajectory",
        "/v1/jobs/1/trajectory.svg",
        "/v1/jobs/1/replay",
        "/v1/sweeps/1/values",
        "/v1/sweeps/1/events",
        "/v1/publications",
        "/v1/publications/guyonneau2022/table-2",
        "/v1/plans",
        "/readyz",
        "/metrics",
    ];
    let built = vec(segment(), 0..6).prop_map(|segments| format!("/{}", segments.join("/")));
    prop_oneof![3 => select(routes.to_vec()).prop_map(str::to_owned), 2 => built]
}

fn query() -> impl Strategy<Value = String> {
    let keys = [
        "sweep",
        "state",
        "limit",
        "after",
        "group_by",
        "metric",
        "columns",
        "statistic",
        "format",
        "factor.algorithm",
        "factor.",
        "purge",
        "%66ormat",
        "",
    ];
    let values = [
        "1",
        "0",
        "-1",
        "4294967296",
        "1.1",
        "9223372036854775807.1",
        "done",
        "algorithm",
        "algorithm,field",
        "success",
        "success,mean_squared_error_mm2",
        "mean",
        "mean,ci95,median",
        "csv",
        "json",
        "md",
        "latex",
        "text",
        "true",
        ",,",
        "%00",
        "%",
        "%zz",
        "a+b",
        "",
    ];
    let key = prop_oneof![6 => select(keys.to_vec()).prop_map(str::to_owned), 1 => "[a-z%.=]{0,8}"];
    let value = prop_oneof![6 => select(values.to_vec()).prop_map(str::to_owned), 1 => "[!-~&&[^#&]]{0,20}"];
    vec((key, value), 0..5).prop_map(|pairs| {
        let pairs: Vec<_> = pairs.into_iter().map(|(key, value)| format!("{key}={value}")).collect();
        pairs.join("&")
    })
}

fn headers() -> impl Strategy<Value = Vec<(HeaderName, HeaderValue)>> {
    let names = [
        "accept",
        "content-type",
        "idempotency-key",
        "authorization",
        "host",
        "origin",
        "sec-fetch-site",
        "range",
        "x-forwarded-for",
        "content-length",
        "if-none-match",
        "x-anything",
    ];
    let values = [
        "*/*",
        "text/csv;q=0.5, application/json",
        "application/json",
        "text/plain",
        "Bearer x",
        "Bearer furrow_",
        "null",
        "localhost",
        "[::1]:80",
        "a:b:c",
        "http://localhost",
        "same-origin",
        "bytes=0-",
        "::1, ::2",
        "18446744073709551616",
        "",
    ];
    // All bytes that a header may hold.
    let byte = prop_oneof![Just(b'\t'), b' '..=b'~', 128..=u8::MAX];
    let value = prop_oneof![
        3 => select(values.to_vec()).prop_map(HeaderValue::from_static),
        1 => vec(byte, 0..300).prop_map(|bytes| HeaderValue::from_bytes(&bytes).expect("it may hold them")),
    ];
    vec((select(names.to_vec()).prop_map(HeaderName::from_static), value), 0..4)
}

fn method() -> impl Strategy<Value = &'static str> {
    select(&["GET", "GET", "GET", "GET", "HEAD", "POST", "PATCH", "PUT", "DELETE", "OPTIONS", "TRACE", "BREW"][..])
}

fn body() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        Just(Vec::new()),
        spoiled(submission()),
        spoiled(own_field()),
        spoiled(json!({"priority": 5, "paused": true})),
        vec(any::<u8>(), 0..200),
    ]
}

/// Sends a request; what comes back must be an answer of ours: never a fault, and a problem if it is a refusal.
fn check(service: &Router, request: Request<Body>) -> Result<u16, TestCaseError> {
    let asked = format!("{} {} {:?}", request.method(), request.uri(), request.headers());
    let head = request.method() == "HEAD";
    let (status, headers, body) = RUNTIME.block_on(async {
        let response = timeout(ANSWERS_WITHIN, service.clone().oneshot(request)).await;
        let response = response.unwrap_or_else(|_| panic!("{asked} hangs")).unwrap();
        let (parts, body) = response.into_parts();
        (parts.status.as_u16(), parts.headers, to_bytes(body, usize::MAX).await.unwrap())
    });
    prop_assert!(status < 500, "{asked}: {status} {}", String::from_utf8_lossy(&body));
    prop_assert_eq!(&headers["x-content-type-options"], "nosniff");
    if status >= 400 {
        prop_assert_eq!(&headers["content-type"], "application/problem+json", "{}", asked);
        if !head {
            let problem: Value =
                serde_json::from_slice(&body).map_err(|error| TestCaseError::fail(error.to_string()))?;
            prop_assert_eq!(&problem["status"], status);
        }
    }
    Ok(status)
}

/// A request, unless these pieces make none. The finished sweep stays.
fn request(
    method: &str,
    path: &str,
    query: &str,
    headers: &[(HeaderName, HeaderValue)],
    body: Vec<u8>,
) -> Option<Request<Body>> {
    let method = if method == "DELETE" && path == "/v1/sweeps/1" { "GET" } else { method };
    let uri = if query.is_empty() { path.to_owned() } else { format!("{path}?{query}") };
    let mut request = Request::builder().method(method).uri(uri).body(Body::from(body)).ok()?;
    request.headers_mut().extend(headers.iter().cloned());
    Some(request)
}

#[test]
fn the_valid_submissions_are_valid() {
    for body in [submission(), own_field()] {
        let request = Request::post("/v1/sweeps").header("content-type", "application/json");
        let status = check(&SERVICES.open, request.body(Body::from(body.to_string())).unwrap()).unwrap();
        assert_eq!(status, 201, "{body}");
    }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn any_request_is_answered(
        method in method(), path in path(), query in query(), headers in headers(), body in body()
    ) {
        if let Some(request) = request(method, &path, &query, &headers, body) {
            check(&SERVICES.open, request)?;
        }
    }

    #[test]
    fn nobody_gets_in_without_a_token(
        method in method(), path in path(), query in query(), headers in headers(), body in body()
    ) {
        if let Some(request) = request(method, &path, &query, &headers, body) {
            let asked = request.uri().path();
            let page = asked == "/" || asked == "/docs" || asked.starts_with("/page/");
            let open = request.method().is_safe() && (page || ["/healthz", "/readyz"].contains(&asked));
            let status = check(&SERVICES.guarded, request)?;
            prop_assert!(open || status == 401 || status == 429, "{method} {path}: {status}");
        }
    }

    #[test]
    fn any_request_with_a_token_is_answered(
        method in method(), path in path(), query in query(), headers in headers(), body in body()
    ) {
        if let Some(mut request) = request(method, &path, &query, &headers, body) {
            let bearer = format!("Bearer {}", SERVICES.token);
            request.headers_mut().insert("authorization", HeaderValue::from_str(&bearer).unwrap());
            request.headers_mut().remove("x-forwarded-for");
            check(&SERVICES.guarded, request)?;
        }
    }

    #[test]
    fn any_spoiled_submission_is_taken_or_refused(
        bytes in prop_oneof![spoiled(submission()), spoiled(own_field())],
        key in proptest::option::of(vec(any::<u8>(), 0..300))
    ) {
        let mut request = Request::post("/v1/sweeps").header("content-type", "application/json").body(Body::from(bytes)).unwrap();
        if let Some(key) = key.and_then(|key| HeaderValue::from_bytes(&key).ok()) {
            request.headers_mut().insert("idempotency-key", key);
        }
        check(&SERVICES.open, request)?;
    }

    #[test]
    fn any_spoiled_change_is_taken_or_refused(bytes in spoiled(json!({"priority": 5, "paused": true}))) {
        let request = Request::patch("/v1/sweeps/1").header("content-type", "application/json");
        check(&SERVICES.open, request.body(Body::from(bytes)).unwrap())?;
    }
}
