//! The way to a server: requests over HTTP, and what its refusals mean for a command.
//!
//! A database is asked in the same way without a server: this process then serves it to itself, on a free port of this
//! machine, for as long as the command takes. To read it a server may be using it, to change it none.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use furrow_coordinator::token::Secret;
use furrow_coordinator::{Config, Coordinator, Store};
use reqwest::{Method, RequestBuilder, Response, Url};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::net::TcpListener;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::error::CliError;
use crate::http::problem::{MEDIA_TYPE, Problem};
use crate::http::{self, App, tls};

const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// A little more than the server takes to give up by itself.
const ANSWER_WITHIN: Duration = Duration::from_secs(75);

/// A long answer that goes on is waited for.
const DOWNLOAD_WITHIN: Duration = Duration::from_secs(7 * 24 * 3_600);

/// Where the server is.
#[derive(Debug, clap::Args)]
pub(super) struct Server {
    /// The server's address; https:// for one on another machine
    #[arg(long, env = "FURROW_URL", value_name = "URL", default_value = "http://127.0.0.1:8080")]
    url: String,
    /// Trust servers by this certificate, or by those that this authority signed (PEM), instead of the system's
    #[arg(long, env = "FURROW_CA", value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Send the token in this file, which not everybody on this machine may read. Without it FURROW_TOKEN is sent, if set
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl Server {
    fn at(url: String) -> Self {
        Self { url, ca: None, token_file: None }
    }

    fn token(&self) -> Result<Option<Secret>, CliError> {
        let (source, text) = match &self.token_file {
            Some(file) => {
                let source = format!("--token-file {}", file.display());
                tls::check_private(file).map_err(CliError::bad_input(&source))?;
                (source.clone(), std::fs::read_to_string(file).map_err(CliError::bad_input(source))?)
            }
            None => match std::env::var("FURROW_TOKEN") {
                Ok(text) => ("FURROW_TOKEN".to_owned(), text),
                Err(_) => return Ok(None),
            },
        };
        let none = || CliError::BadInput(format!("{source}: expected a token as `furrow token create` prints it"));
        Secret::parse(text.trim()).map(Some).ok_or_else(none)
    }

    fn certificates(&self) -> Result<Option<Vec<reqwest::Certificate>>, CliError> {
        let Some(file) = &self.ca else { return Ok(None) };
        let key = format!("--ca {}", file.display());
        let pem = std::fs::read(file).map_err(CliError::bad_input(&key))?;
        let found = reqwest::Certificate::from_pem_bundle(&pem).map_err(CliError::bad_input(&key))?;
        if found.is_empty() { Err(CliError::BadInput(format!("{key}: holds no certificate"))) } else { Ok(Some(found)) }
    }
}

/// Where the sweeps and their results are.
#[derive(Debug, clap::Args)]
pub(super) struct Source {
    #[command(flatten)]
    server: Server,
    /// Use this database instead of asking a server; to change it, no server may be using it
    #[arg(long, value_name = "FILE")]
    db: Option<PathBuf>,
}

/// Asks one server.
pub(super) struct Client {
    http: reqwest::Client,
    base: Url,
    token: Option<Secret>,
    local: Option<Local>,
}

/// A database that this process serves to itself.
struct Local {
    coordinator: Coordinator,
    _stop: DropGuard,
}

impl Client {
    /// # Errors
    /// Bad input: the address is no `http://` or `https://` address, certificate or token cannot be used, or the token
    /// would cross the network in the clear.
    pub(super) fn new(server: &Server) -> Result<Self, CliError> {
        Self::with_token(server, server.token()?)
    }

    fn with_token(server: &Server, token: Option<Secret>) -> Result<Self, CliError> {
        let base = Url::parse(&server.url).map_err(CliError::bad_input(format_args!("--url {}", server.url)))?;
        let refuse = |reason: &str| CliError::BadInput(format!("--url {}: {reason}", server.url));
        if !matches!(base.scheme(), "http" | "https") || base.host().is_none() {
            return Err(refuse("expected http://HOST:PORT or https://HOST:PORT"));
        }
        if token.is_some() && base.scheme() == "http" && !is_this_machine(&base) {
            return Err(refuse("a token must not cross the network in the clear: expected https://HOST:PORT"));
        }
        tls::provide();
        let http = reqwest::Client::builder().no_proxy().redirect(reqwest::redirect::Policy::none());
        let http = http.connect_timeout(CONNECT_WITHIN).timeout(ANSWER_WITHIN);
        // The system's certificates are not needed in the clear, and not every system has any.
        let trusted = server.certificates()?.or_else(|| (base.scheme() == "http").then(Vec::new));
        let http = if let Some(trusted) = trusted { http.tls_certs_only(trusted) } else { http };
        let http = http.build().map_err(CliError::failed("cannot set up HTTP"))?;
        Ok(Self { http, base, token, local: None })
    }

    /// The way to what is only read.
    ///
    /// # Errors
    /// Bad input: the address is none, or there is no such database.
    pub(super) async fn open(source: &Source) -> Result<Self, CliError> {
        let Some(file) = &source.db else { return Self::new(&source.server) };
        let store = Store::open_to_read(existing(file)?).await?;
        Self::local(Coordinator::reading(store, Config::new(crate::engine()))).await
    }

    /// The way to what is changed.
    ///
    /// # Errors
    /// Bad input: the address is none, there is no such database, or a server is using it.
    pub(super) async fn open_to_change(source: &Source) -> Result<Self, CliError> {
        let Some(file) = &source.db else { return Self::new(&source.server) };
        let store = Store::open(existing(file)?).await?;
        Self::local(Coordinator::start(store, Config::new(crate::engine()))).await
    }

    async fn local(coordinator: Coordinator) -> Result<Self, CliError> {
        let cannot = "cannot open a port of this machine";
        let listener = TcpListener::bind("127.0.0.1:0").await.map_err(CliError::failed(cannot))?;
        let url = format!("http://{}", listener.local_addr().map_err(CliError::failed(cannot))?);
        let stop = CancellationToken::new();
        tokio::spawn(http::serve(listener, App::new(coordinator.clone()), stop.clone()));
        let local = Some(Local { coordinator, _stop: stop.drop_guard() });
        Ok(Self { local, ..Self::with_token(&Server::at(url), None)? })
    }

    /// Closes the database, if there is one.
    pub(super) async fn close(self) {
        if let Some(local) = self.local {
            local.coordinator.shutdown().await;
        }
    }

    /// GETs JSON at `path` (its segments) with `query`.
    ///
    /// # Errors
    /// The server is away, refuses, or answers something else.
    pub(super) async fn get<T: DeserializeOwned>(&self, path: &[&str], query: &[(&str, &str)]) -> Result<T, CliError> {
        read(self.send(self.request(Method::GET, path, query)).await?).await
    }

    /// GETs text at `path` (its segments) with `query`.
    ///
    /// # Errors
    /// The server is away or refuses.
    pub(super) async fn text(&self, path: &[&str], query: &[(&str, &str)]) -> Result<String, CliError> {
        let response = self.send(self.request(Method::GET, path, query)).await?;
        response.text().await.map_err(CliError::failed("the answer broke off"))
    }

    /// GETs what is at `path` (its segments) with `query` and writes it to `out` as it comes, however long that takes.
    ///
    /// # Errors
    /// The server is away or refuses, the answer breaks off or stands still, or it cannot be written.
    pub(super) async fn download(
        &self,
        path: &[&str],
        query: &[(&str, &str)],
        out: &mut impl Write,
    ) -> Result<(), CliError> {
        let mut response = self.send(self.request(Method::GET, path, query).timeout(DOWNLOAD_WITHIN)).await?;
        loop {
            let chunk = tokio::time::timeout(ANSWER_WITHIN, response.chunk()).await;
            let chunk = chunk.map_err(CliError::failed("the answer stands still"))?;
            let Some(bytes) = chunk.map_err(CliError::failed("the answer broke off"))? else { break };
            out.write_all(&bytes)?;
        }
        Ok(out.flush()?)
    }

    /// POSTs `body` as JSON, with a key under which the server takes it only once.
    ///
    /// # Errors
    /// The server is away, refuses, or answers something else.
    pub(super) async fn post<T: DeserializeOwned>(
        &self,
        path: &[&str],
        idempotency_key: &str,
        body: &impl Serialize,
    ) -> Result<T, CliError> {
        let request = self.request(Method::POST, path, &[]).header("Idempotency-Key", idempotency_key).json(body);
        read(self.send(request).await?).await
    }

    /// Sends a change to `path` (its segments), perhaps with a JSON body; it may be sent again without harm.
    ///
    /// # Errors
    /// The server is away, refuses, or answers something else.
    pub(super) async fn change<T: DeserializeOwned>(
        &self,
        method: Method,
        path: &[&str],
        body: Option<&impl Serialize>,
    ) -> Result<T, CliError> {
        let request = self.request(method, path, &[]);
        let request = if let Some(body) = body { request.json(body) } else { request };
        read(self.send(request).await?).await
    }

    /// DELETEs what is at `path` (its segments) with `query`.
    ///
    /// # Errors
    /// The server is away or refuses.
    pub(super) async fn remove(&self, path: &[&str], query: &[(&str, &str)]) -> Result<(), CliError> {
        self.send(self.request(Method::DELETE, path, query)).await.map(drop)
    }

    fn request(&self, method: Method, path: &[&str], query: &[(&str, &str)]) -> RequestBuilder {
        let mut url = self.base.clone();
        if let Ok(mut segments) = url.path_segments_mut() {
            segments.pop_if_empty().extend(path);
        }
        if !query.is_empty() {
            url.query_pairs_mut().extend_pairs(query);
        }
        let request = self.http.request(method, url);
        if let Some(token) = &self.token { request.bearer_auth(token.reveal()) } else { request }
    }

    async fn send(&self, request: RequestBuilder) -> Result<Response, CliError> {
        let unreachable =
            |error: reqwest::Error| CliError::Unreachable { url: self.base.to_string(), cause: root_cause(&error) };
        let response = request.send().await.map_err(unreachable)?;
        if response.status().is_success() { Ok(response) } else { Err(refused(response).await) }
    }
}

fn existing(file: &Path) -> Result<&Path, CliError> {
    let missing = || CliError::BadInput(format!("--db {}: there is no such file", file.display()));
    if file.exists() { Ok(file) } else { Err(missing()) }
}

fn is_this_machine(url: &Url) -> bool {
    let name = url.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    name == "localhost" || name.parse::<std::net::IpAddr>().is_ok_and(|address| address.to_canonical().is_loopback())
}

async fn read<T: DeserializeOwned>(response: Response) -> Result<T, CliError> {
    let bytes = response.bytes().await.map_err(CliError::failed("the answer broke off"))?;
    serde_json::from_slice(&bytes).map_err(CliError::failed("the answer is not Furrow's"))
}

async fn refused(response: Response) -> CliError {
    let status = response.status();
    let media_type = response.headers().get("content-type").and_then(|value| value.to_str().ok());
    let is_problem = media_type.is_some_and(|text| text.starts_with(MEDIA_TYPE));
    let bytes = response.bytes().await.unwrap_or_default();
    match serde_json::from_slice::<Problem>(&bytes) {
        Ok(problem) if is_problem => CliError::Refused(Box::new(problem)),
        _ => CliError::Failed(format!("the server answered {status}")),
    }
}

/// The innermost cause: "connection refused" rather than "error sending request".
fn root_cause(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(inner) = cause.source() {
        cause = inner;
    }
    cause.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(url: &str) -> Result<Client, CliError> {
        Client::with_token(&Server::at(url.to_owned()), None)
    }

    #[test]
    fn an_address_that_is_none_is_bad_input() {
        for bad in ["nonsense", "ftp://host", "http://", "https://"] {
            assert_eq!(client(bad).err().map(|error| error.exit_code()), Some(2), "{bad}");
        }
    }

    #[test]
    fn a_token_leaves_this_machine_encrypted_only() {
        let with_token = |url: &str| Client::with_token(&Server::at(url.to_owned()), Some(Secret::random()));
        for good in ["https://furrow.example", "http://localhost:8080", "http://127.0.0.1:1", "http://[::1]:1"] {
            assert!(with_token(good).is_ok(), "{good}");
        }
        for bad in ["http://furrow.example", "http://192.0.2.1:8080", "http://localhost.example"] {
            let error = with_token(bad).err().expect(bad);
            assert!(error.to_string().contains("in the clear"), "{error}");
        }
    }

    #[test]
    fn a_token_file_is_private_and_holds_a_token() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("token");
        let server = Server { token_file: Some(file.clone()), ..Server::at("https://host".to_owned()) };
        let refusal = |word: &str| {
            let error = server.token().unwrap_err();
            assert!(error.exit_code() == 2 && error.to_string().contains(word), "{error}");
        };
        refusal("token");
        let write = |text: &str, mode: u32| {
            use std::os::unix::fs::PermissionsExt;
            std::fs::write(&file, text).unwrap();
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).unwrap();
        };
        let secret = Secret::random();
        write(&format!("{}\n", secret.reveal()), 0o644);
        refusal("everybody");
        write("hunter2", 0o600);
        refusal("furrow token create");
        write(&format!("{}\n", secret.reveal()), 0o600);
        assert_eq!(server.token().unwrap().unwrap().reveal(), secret.reveal());
    }

    #[test]
    fn segments_and_parameters_are_escaped() {
        let client = client("http://host:1/base/").unwrap();
        let request = client.request(Method::GET, &["v1", "jobs", "a/b"], &[("group_by", "a,b&c")]).build().unwrap();
        assert_eq!(request.url().as_str(), "http://host:1/base/v1/jobs/a%2Fb?group_by=a%2Cb%26c");
    }

    #[tokio::test]
    async fn a_server_that_is_away_is_named() {
        let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let error = client(&format!("http://{free}")).unwrap().text(&["healthz"], &[]).await.unwrap_err();
        assert_eq!(error.exit_code(), 1);
        assert!(error.to_string().contains(&free.to_string()), "{error}");
    }
}
