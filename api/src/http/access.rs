//! Who may use the service, and for what.
//!
//! On the loopback interface everybody on this machine may, but no page in a browser that came from elsewhere.
//! Anywhere else each request needs a token with the scope that its route demands.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Instant;

use axum::extract::{Request, State};
use axum::http::header::{AUTHORIZATION, HOST, ORIGIN};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::token::{Scope, Secret, TokenInfo};

use super::App;
use super::limiter::{Client, Rate};
use super::problem::Problem;

/// Requests per second of one address or token, where nothing else is asked.
pub const DEFAULT_RATE: u32 = 200;

/// A client may be ahead of its rate by so many seconds.
const BURST_S: f64 = 5.0;

/// Wrong tokens from one address: ten at once, then one a second.
const STRANGERS: Rate = Rate { per_s: 1.0, burst: 10.0 };

/// How the service meets its clients.
#[derive(Debug, Clone)]
pub struct Access {
    /// Whether every request needs a token.
    pub tokens: bool,
    /// Whether a reverse proxy stands in front, which says in `X-Forwarded-For` who asks.
    pub proxied: bool,
    /// Requests per second of one address or token.
    pub rate_per_s: u32,
    /// The certificate and key by which connections are encrypted; in the clear without.
    pub tls: Option<Arc<rustls::ServerConfig>>,
}

impl Default for Access {
    /// For this machine only.
    fn default() -> Self {
        Self { tokens: false, proxied: false, rate_per_s: DEFAULT_RATE, tls: None }
    }
}

impl Access {
    fn rate(&self) -> Rate {
        let per_s = f64::from(self.rate_per_s);
        Rate { per_s, burst: per_s * BURST_S }
    }
}

/// From where a connection came.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peer(pub(super) IpAddr);

/// The request comes from who may know what runs here.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trusted;

/// Lets a request through to `next`, or says why not.
pub(super) async fn admit(State(app): State<App>, request: Request, next: Next) -> Response {
    let (mut parts, body) = request.into_parts();
    match check(&app, &parts).await {
        Ok(trusted) => {
            if trusted {
                parts.extensions.insert(Trusted);
            }
            next.run(Request::from_parts(parts, body)).await
        }
        Err(problem) => problem.into_response(),
    }
}

/// Whether the request comes from who may know what runs here.
async fn check(app: &App, request: &Parts) -> Result<bool, Problem> {
    let (access, now) = (app.access(), Instant::now());
    let address = address(access, request);
    let within = |client: Client| app.limiter().take(client, access.rate(), now).then_some(()).ok_or_else(too_many);
    within(Client::at(address))?;
    if !access.tokens {
        not_of_a_strange_page(request)?;
    }
    let demanded = demanded(&request.method, &request.uri);
    match request.headers.get(AUTHORIZATION) {
        None if !access.tokens => Ok(true),
        None if demanded.is_none() => Ok(false),
        sent => {
            let token = authenticate(app, address, sent, now).await?;
            within(Client::Token(token.id))?;
            allow(&token, demanded)?;
            Ok(true)
        }
    }
}

/// Who asks: the other end of the connection, or whom the proxy there saw.
fn address(access: &Access, request: &Parts) -> IpAddr {
    let peer = request.extensions.get::<Peer>().map_or(Ipv4Addr::LOCALHOST.into(), |peer| peer.0);
    let seen = || {
        let last = request.headers.get_all("x-forwarded-for").iter().next_back()?.to_str().ok()?;
        last.rsplit(',').next()?.trim().parse().ok()
    };
    if access.proxied { seen().unwrap_or(peer) } else { peer }
}

/// The scope that a request needs: none for the probes and the page, and [`Scope::Admin`] for every change that is not known here.
fn demanded(method: &Method, uri: &Uri) -> Option<Scope> {
    let segments: Vec<_> = uri.path().split('/').skip(1).collect();
    // A purge hides in many spellings, so that any query counts as one.
    let purge = || uri.query().is_some_and(|query| !query.is_empty());
    match (method.as_str(), segments.as_slice()) {
        ("GET" | "HEAD", ["healthz" | "readyz"]) => None,
        // The page itself holds nothing; what it shows it asks for with a token.
        ("GET" | "HEAD", ["" | "docs"] | ["page", _]) => None,
        ("GET" | "HEAD", ["v1", "join" | "tokens", ..]) => Some(Scope::Admin),
        ("GET" | "HEAD" | "OPTIONS", _) => Some(Scope::Read),
        ("POST", ["v1", "sweeps"] | ["v1", "sweeps", _, "retry"]) => Some(Scope::Submit),
        ("PATCH", ["v1", "sweeps", _]) => Some(Scope::Submit),
        ("DELETE", ["v1", "sweeps", _]) if !purge() => Some(Scope::Submit),
        _ => Some(Scope::Admin),
    }
}

async fn authenticate(
    app: &App,
    address: IpAddr,
    sent: Option<&HeaderValue>,
    now: Instant,
) -> Result<TokenInfo, Problem> {
    let stranger = Client::stranger(address);
    if !app.limiter().has(stranger, now) {
        return Err(too_many());
    }
    let Some(sent) = sent else { return Err(unauthorized("this needs a token: `Authorization: Bearer TOKEN`")) };
    let secret = sent.to_str().ok().and_then(bearer);
    let found = match &secret {
        Some(secret) => app.coordinator().token(secret).await?,
        None => None,
    };
    let Some(token) = found else {
        app.limiter().take(stranger, STRANGERS, now);
        tracing::warn!(%address, "a wrong token was refused");
        return Err(unauthorized("the token is unknown, expired or revoked"));
    };
    note_use(app, &token);
    Ok(token)
}

/// The token in `Bearer TOKEN`.
fn bearer(value: &str) -> Option<Secret> {
    let (scheme, token) = value.split_once(' ')?;
    if scheme.eq_ignore_ascii_case("bearer") { Secret::parse(token.trim()) } else { None }
}

/// Notes the use beside the request: nobody waits for the writer because of it.
fn note_use(app: &App, token: &TokenInfo) {
    let (coordinator, token) = (app.coordinator().clone(), token.clone());
    tokio::spawn(async move {
        if let Err(error) = coordinator.note_use(&token).await {
            tracing::debug!(%error, "the use of a token was not noted");
        }
    });
}

fn allow(token: &TokenInfo, demanded: Option<Scope>) -> Result<(), Problem> {
    match demanded.filter(|scope| !token.allows(*scope)) {
        None => Ok(()),
        Some(scope) => {
            let detail = format!("the token `{}` does not have the scope `{scope}` that this needs", token.name);
            Err(Problem::new(StatusCode::FORBIDDEN, detail).at("scope"))
        }
    }
}

/// Refuses what a page from elsewhere has a browser on this machine do.
///
/// A name that was made to point at this machine stands in `Host`; a change asked for by another page has an `Origin`.
/// Programs that are no browser send neither.
fn not_of_a_strange_page(request: &Parts) -> Result<(), Problem> {
    let headers = &request.headers;
    let named = headers.get(HOST).map(|host| host.to_str().unwrap_or("?"));
    let host = named.or(request.uri.authority().map(|authority| authority.as_str()));
    if let Some(host) = host.filter(|host| !is_loopback(host)) {
        let detail = format!("this serves its own machine only, by the name localhost, not `{host}`");
        return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, detail).at("Host"));
    }
    if request.method.is_safe() || is_same_origin(headers, host) {
        return Ok(());
    }
    let detail = "a page from elsewhere must not change anything here";
    Err(Problem::new(StatusCode::FORBIDDEN, detail).at("Origin"))
}

fn is_same_origin(headers: &HeaderMap, host: Option<&str>) -> bool {
    let site = headers.get("sec-fetch-site").map(HeaderValue::as_bytes);
    let same_site = site.is_none_or(|site| site == b"same-origin" || site == b"none");
    let of_host = |origin: &str| origin.split_once("://").is_some_and(|(_, rest)| Some(rest) == host);
    same_site && headers.get(ORIGIN).is_none_or(|origin| origin.to_str().is_ok_and(of_host))
}

/// Whether `host`, with a port or without, is this machine by whatever name service.
fn is_loopback(host: &str) -> bool {
    let Ok(authority) = host.parse::<axum::http::uri::Authority>() else { return false };
    let name = authority.host().trim_start_matches('[').trim_end_matches(']');
    let is_address = name.parse::<IpAddr>().is_ok_and(|address| address.to_canonical().is_loopback());
    is_address || name.eq_ignore_ascii_case("localhost")
}

fn unauthorized(detail: &str) -> Problem {
    Problem::new(StatusCode::UNAUTHORIZED, detail)
}

fn too_many() -> Problem {
    Problem::new(StatusCode::TOO_MANY_REQUESTS, "too many requests: ask again in a second")
}

#[cfg(test)]
mod tests {
    use axum::body::Body;

    use super::*;

    #[test]
    fn every_route_demands_its_scope_and_unknown_changes_the_highest() {
        for (method, path, scope) in [
            ("GET", "/healthz", None),
            ("GET", "/readyz", None),
            ("POST", "/healthz", Some(Scope::Admin)),
            ("GET", "/metrics", Some(Scope::Read)),
            ("GET", "/v1/sweeps", Some(Scope::Read)),
            ("GET", "/nowhere", Some(Scope::Read)),
            ("GET", "/v1/join", Some(Scope::Admin)),
            ("POST", "/v1/sweeps", Some(Scope::Submit)),
            ("POST", "/v1/sweeps/3/retry", Some(Scope::Submit)),
            ("PATCH", "/v1/sweeps/3", Some(Scope::Submit)),
            ("DELETE", "/v1/sweeps/3", Some(Scope::Submit)),
            ("DELETE", "/v1/sweeps/3?purge=false", Some(Scope::Admin)),
            ("DELETE", "/v1/sweeps/3?purge=true", Some(Scope::Admin)),
            ("DELETE", "/v1/sweeps/3?%70urge=true", Some(Scope::Admin)),
            ("DELETE", "/v1/workers/abc", Some(Scope::Admin)),
            ("POST", "/v1/anything", Some(Scope::Admin)),
            ("BREW", "/v1/sweeps", Some(Scope::Admin)),
        ] {
            let method = Method::from_bytes(method.as_bytes()).unwrap();
            assert_eq!(demanded(&method, &path.parse().unwrap()), scope, "{method} {path}");
        }
    }

    #[test]
    fn this_machine_is_known_by_its_loopback_names_only() {
        for good in ["localhost", "LocalHost:8080", "127.0.0.1:8080", "127.8.9.1", "[::1]:8080"] {
            assert!(is_loopback(good), "{good}");
        }
        for bad in ["evil.example", "127.0.0.1.evil.example:80", "192.0.2.1", "", "a b", "localhost.evil.example"] {
            assert!(!is_loopback(bad), "{bad}");
        }
    }

    #[test]
    fn behind_a_proxy_the_last_address_it_saw_counts() {
        let request = |value: &str| {
            Request::get("/").header("x-forwarded-for", value).body(Body::empty()).unwrap().into_parts().0
        };
        let proxied = Access { proxied: true, ..Access::default() };
        let seen = |access: &Access, value: &str| address(access, &request(value)).to_string();
        assert_eq!(seen(&proxied, "198.51.100.1, 192.0.2.7"), "192.0.2.7");
        assert_eq!(seen(&proxied, "nonsense"), "127.0.0.1");
        assert_eq!(seen(&Access::default(), "192.0.2.7"), "127.0.0.1");
    }
}
