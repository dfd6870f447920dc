//! What surrounds every route: limits, panics, headers, and problems where the router has no answer.

use std::any::Any;
use std::time::Duration;

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, REFERRER_POLICY, STRICT_TRANSPORT_SECURITY, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderValue, Method, StatusCode, Uri};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::trace::TraceLayer;

use super::problem::Problem;

/// A request's body is at most this many bytes long.
pub const BODY_LIMIT: usize = 10 << 20;

/// A request is given up after this long.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// Puts limits, problems and headers around `router`, and within them what `guard` does; `encrypted` is how it is served.
pub(super) fn surround(
    router: Router,
    timeout: Duration,
    encrypted: bool,
    guard: impl FnOnce(Router) -> Router,
) -> Router {
    let router = router.fallback(no_route).method_not_allowed_fallback(no_method);
    guard(router.layer(DefaultBodyLimit::max(BODY_LIMIT)))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(middleware::from_fn(move |request, next| give_up(timeout, request, next)))
        .layer(middleware::map_response(move |response| secured(response, encrypted)))
        .layer(TraceLayer::new_for_http())
}

async fn no_route(uri: Uri) -> Problem {
    Problem::not_found("route", uri.path())
}

async fn no_method(method: Method, uri: Uri) -> Problem {
    let detail = format!("`{method}` is not for `{}`; the header Allow says what is", uri.path());
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, detail)
}

fn panicked(panic: Box<dyn Any + Send>) -> Response {
    let text = panic.downcast_ref::<String>().cloned();
    let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
    Problem::internal(&format!("panic: {}", text.unwrap_or_default())).into_response()
}

async fn give_up(timeout: Duration, request: Request, next: Next) -> Response {
    match tokio::time::timeout(timeout, next.run(request)).await {
        Ok(response) => response,
        Err(_) => Problem::unavailable(format!("no answer within {} s", timeout.as_secs_f64())).into_response(),
    }
}

async fn secured(mut response: Response, encrypted: bool) -> Response {
    let headers = response.headers_mut();
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    let policy = "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'";
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(HeaderValue::from_static(policy));
    // What one token opens must not come out of a cache for somebody else.
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    if encrypted {
        headers.insert(STRICT_TRANSPORT_SECURITY, HeaderValue::from_static("max-age=31536000"));
    }
    response
}

#[cfg(test)]
mod tests {
    use axum::body::Body;
    use axum::routing::get;
    use tower::ServiceExt;

    use super::super::problem::MEDIA_TYPE;
    use super::*;

    fn router(timeout: Duration) -> Router {
        let router = Router::new()
            .route("/calm", get(async || "calm"))
            .route("/panic", get(async || -> &'static str { panic!("on purpose") }))
            .route("/slow", get(std::future::pending::<&'static str>));
        surround(router, timeout, true, |router| router)
    }

    async fn status(method: &str, path: &str) -> (u16, String, Option<String>) {
        let timeout = if path == "/slow" { Duration::from_millis(5) } else { TIMEOUT };
        let request = Request::builder().method(method).uri(path).body(Body::empty()).unwrap();
        let response = router(timeout).oneshot(request).await.unwrap();
        assert_eq!(response.headers()[X_CONTENT_TYPE_OPTIONS], "nosniff");
        assert_eq!(response.headers()[CACHE_CONTROL], "no-store");
        assert_eq!(response.headers()[STRICT_TRANSPORT_SECURITY], "max-age=31536000");
        let text = |name: &str| response.headers().get(name).map(|value| value.to_str().unwrap().to_owned());
        (response.status().as_u16(), text("content-type").unwrap(), text("allow"))
    }

    #[tokio::test]
    async fn what_has_no_answer_is_a_problem() {
        let problem = |status: u16, allow: Option<&str>| (status, MEDIA_TYPE.to_owned(), allow.map(str::to_owned));
        assert_eq!(status("GET", "/calm").await.0, 200);
        assert_eq!(status("GET", "/nowhere").await, problem(404, None));
        assert_eq!(status("POST", "/calm").await, problem(405, Some("GET,HEAD")));
        assert_eq!(status("GET", "/panic").await, problem(500, None));
        assert_eq!(status("GET", "/slow").await, problem(503, None));
    }
}
