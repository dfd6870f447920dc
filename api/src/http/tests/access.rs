//! Who is let in, on this machine and beyond it.

use axum::body::Body;
use axum::http::Request;
use furrow_coordinator::token::{NewToken, Scope, Secret, TokenBook};
use furrow_coordinator::{Config, Coordinator, Store};
use serde_json::json;

use super::super::problem::MEDIA_TYPE;
use super::{Access, Answer, Service, plan};

/// A service beyond this machine, and its tokens.
struct Guarded {
    _folder: tempfile::TempDir,
    service: Service,
    book: TokenBook,
}

impl Guarded {
    async fn start(rate_per_s: u32) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("furrow.db");
        let coordinator = Coordinator::start(Store::open(&path).await.unwrap(), Config::new(crate::engine()));
        let access = Access { tokens: true, proxied: true, rate_per_s, ..Access::default() };
        let service = Service::with_access(coordinator, access);
        Self { _folder: folder, service, book: TokenBook::open(&path).await.unwrap() }
    }

    async fn token(&mut self, name: &str, scopes: &[Scope]) -> Secret {
        let new = NewToken { name: name.to_owned(), scopes: scopes.to_vec(), expires_ms: None };
        self.book.create(&new, 1).await.unwrap()
    }

    async fn ask(&self, method: &str, path: &str, token: Option<&str>) -> Answer {
        self.ask_from("192.0.2.1", method, path, token).await
    }

    async fn ask_from(&self, address: &str, method: &str, path: &str, token: Option<&str>) -> Answer {
        let request = Request::builder().method(method).uri(path).header("x-forwarded-for", address);
        let request = request.header("content-type", "application/json").header("host", "furrow.example");
        let request = match token {
            Some(token) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        };
        let body = json!({"plan": plan(), "seeds": 1}).to_string();
        let body = if method == "POST" && path == "/v1/sweeps" { Body::from(body) } else { Body::empty() };
        self.service.send(request.body(body).unwrap()).await
    }

    async fn stop(self) {
        self.book.close().await.unwrap();
        self.service.coordinator.shutdown().await;
    }
}

#[tokio::test]
async fn beyond_this_machine_every_route_needs_a_token_but_the_probes_and_the_page() {
    let guarded = Guarded::start(1_000).await;
    for path in ["/v1/sweeps", "/v1/plans", "/metrics", "/openapi.json", "/nowhere", "/page/a/b", "/v1/events"] {
        let answer = guarded.ask("GET", path, None).await;
        assert_eq!((answer.status, answer.header("content-type")), (401, MEDIA_TYPE), "{path}");
        assert!(answer.header("www-authenticate").starts_with("Bearer"), "{path}");
    }
    assert_eq!(guarded.ask("POST", "/v1/sweeps", None).await.status, 401);
    for path in ["/healthz", "/readyz"] {
        let answer = guarded.ask("GET", path, None).await;
        assert_eq!((answer.status, answer.json()), (200, json!({"status": "ok"})), "strangers learn no more");
    }
    for path in ["/", "/docs", "/page/main.js"] {
        assert_eq!(guarded.ask("GET", path, None).await.status, 200, "the page can ask for a token");
    }
    guarded.stop().await;
}

#[tokio::test]
async fn a_token_opens_what_its_scopes_say() {
    let mut guarded = Guarded::start(1_000).await;
    let reader = guarded.token("reader", &[Scope::Read]).await;
    let writer = guarded.token("writer", &[Scope::Read, Scope::Submit]).await;
    let admin = guarded.token("admin", &[Scope::Admin]).await;
    for (token, method, path, status) in [
        (&reader, "GET", "/v1/sweeps", 200),
        (&reader, "POST", "/v1/sweeps", 403),
        (&writer, "POST", "/v1/sweeps", 201),
        (&reader, "DELETE", "/v1/sweeps/1", 403),
        (&writer, "DELETE", "/v1/sweeps/1", 200),
        (&reader, "POST", "/v1/sweeps/1/retry", 403),
        (&writer, "POST", "/v1/sweeps/1/retry", 200),
        (&writer, "DELETE", "/v1/sweeps/1?purge=true", 403),
        (&writer, "DELETE", "/v1/sweeps/1?%70urge=true", 403),
        (&admin, "GET", "/v1/sweeps", 403),
        (&admin, "DELETE", "/v1/sweeps/1?purge=true", 204),
    ] {
        let answer = guarded.ask(method, path, Some(token.reveal())).await;
        assert_eq!(answer.status, status, "{method} {path}: {}", answer.body);
        assert!(!answer.body.contains(token.reveal()));
    }
    let refusal = guarded.ask("POST", "/v1/sweeps", Some(reader.reveal())).await.json();
    assert_eq!(refusal["key"], "scope");
    assert!(refusal["detail"].as_str().unwrap().contains("`submit`"), "{refusal}");
    let health = guarded.ask("GET", "/healthz", Some(reader.reveal())).await.json();
    assert_eq!(health["engine"], json!(crate::engine()));
    guarded.stop().await;
}

#[tokio::test]
async fn a_revoked_token_is_refused_at_once() {
    let mut guarded = Guarded::start(1_000).await;
    let token = guarded.token("laptop", &[Scope::Read]).await;
    assert_eq!(guarded.ask("GET", "/v1/sweeps", Some(token.reveal())).await.status, 200);
    guarded.book.revoke("laptop", 2).await.unwrap().unwrap();
    assert_eq!(guarded.ask("GET", "/v1/sweeps", Some(token.reveal())).await.status, 401);
    guarded.stop().await;
}

#[tokio::test]
async fn who_sends_wrong_tokens_is_slowed_down_and_others_are_not() {
    let mut guarded = Guarded::start(1_000).await;
    let token = guarded.token("laptop", &[Scope::Read]).await;
    let mut statuses = Vec::new();
    for n in 0..14 {
        let wrong = if n % 2 == 0 { "nonsense".to_owned() } else { Secret::random().reveal().to_owned() };
        statuses.push(guarded.ask("GET", "/v1/sweeps", Some(&wrong)).await.status);
    }
    assert!(statuses[..10].iter().all(|status| *status == 401), "{statuses:?}");
    assert!(statuses[10..].contains(&429), "{statuses:?}");
    let answer = guarded.ask("GET", "/v1/sweeps", Some(Secret::random().reveal())).await;
    assert_eq!((answer.status, answer.header("retry-after"), answer.header("content-type")), (429, "1", MEDIA_TYPE));
    let other = guarded.ask_from("192.0.2.2", "GET", "/v1/sweeps", Some(token.reveal())).await;
    assert_eq!(other.status, 200);
    guarded.stop().await;
}

#[tokio::test]
async fn an_address_and_a_token_have_a_rate() {
    let mut guarded = Guarded::start(1).await;
    let token = guarded.token("laptop", &[Scope::Read]).await;
    let mut allowed = 0;
    for n in 0..40 {
        let address = format!("192.0.2.{n}");
        allowed += u32::from(guarded.ask_from(&address, "GET", "/v1/sweeps", Some(token.reveal())).await.status == 200);
    }
    assert!((5..20).contains(&allowed), "one token from many addresses: {allowed}");
    let mut probes = 0;
    for _ in 0..40 {
        probes += u32::from(guarded.ask("GET", "/healthz", None).await.status == 200);
    }
    assert!((4..20).contains(&probes), "one address without a token: {probes}");
    guarded.stop().await;
}

#[tokio::test]
async fn on_this_machine_no_token_is_needed_but_a_wrong_one_is_refused() {
    let service = Service::start().await;
    assert_eq!(service.get("/v1/sweeps").await.status, 200);
    for sent in ["Bearer nonsense", "Basic dXNlcjpwYXNz", "Bearer", &format!("Bearer {}", Secret::random().reveal())] {
        let request = Request::get("/v1/sweeps").header("authorization", sent).body(Body::empty()).unwrap();
        assert_eq!(service.send(request).await.status, 401, "{sent}");
    }
}

#[tokio::test]
async fn on_this_machine_a_strange_page_can_change_nothing() {
    let service = Service::start().await;
    let ask = async |method: &str, headers: &[(&str, &str)]| {
        let request = Request::builder().method(method).uri("/v1/sweeps").header("content-type", "application/json");
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        let body = if method == "POST" { json!({"plan": plan(), "seeds": 1}).to_string() } else { String::new() };
        service.send(request.body(Body::from(body)).unwrap()).await.status
    };
    let here = ("host", "127.0.0.1:8080");
    // A name of the page's own that was made to point here.
    assert_eq!(ask("GET", &[("host", "rebound.example:8080")]).await, 421);
    assert_eq!(ask("POST", &[("host", "rebound.example:8080"), ("origin", "http://rebound.example:8080")]).await, 421);
    // A page of another site, or of another port of this machine.
    for origin in ["http://evil.example", "null", "http://127.0.0.1:9999", "http://localhost:8080"] {
        assert_eq!(ask("POST", &[here, ("origin", origin)]).await, 403, "{origin}");
    }
    for site in ["cross-site", "same-site", "nonsense"] {
        assert_eq!(ask("POST", &[here, ("sec-fetch-site", site)]).await, 403, "{site}");
    }
    assert_eq!(service.get("/v1/sweeps").await.json()["items"], json!([]), "nothing was submitted");
    // Our own page, and programs that are no browser.
    let own = [here, ("origin", "http://127.0.0.1:8080"), ("sec-fetch-site", "same-origin")];
    assert_eq!(ask("POST", &own).await, 201);
    assert_eq!(ask("POST", &[here]).await, 201);
    assert_eq!(ask("GET", &[("host", "localhost:8080"), ("sec-fetch-site", "cross-site")]).await, 200);
    assert_eq!(ask("OPTIONS", &[here, ("origin", "http://evil.example")]).await, 405, "no page is let in by CORS");
}
