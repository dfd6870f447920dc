//! The way to a server: requests over HTTP, and what its refusals mean for a command.
//!
//! A database is asked in the same way without a server: this process then serves it to itself, on a free port of this
//! machine, for as long as the command takes. To read it a server may be using it, to change it none.

use std::path::{Path, PathBuf};
use std::time::Duration;

use furrow_coordinator::{Config, Coordinator, Store};
use reqwest::{Method, RequestBuilder, Response, Url};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::net::TcpListener;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::error::CliError;
use crate::http::problem::{MEDIA_TYPE, Problem};
use crate::http::{self, App};

const CONNECT_WITHIN: Duration = Duration::from_secs(5);

/// A little more than the server takes to give up by itself.
const ANSWER_WITHIN: Duration = Duration::from_secs(75);

/// Where the server is.
#[derive(Debug, clap::Args)]
pub(super) struct Server {
    /// The server's address
    #[arg(long, env = "FURROW_URL", value_name = "URL", default_value = "http://127.0.0.1:8080")]
    url: String,
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
    local: Option<Local>,
}

/// A database that this process serves to itself.
struct Local {
    coordinator: Coordinator,
    _stop: DropGuard,
}

impl Client {
    /// # Errors
    /// Bad input: the address is no `http://` address.
    pub(super) fn new(server: &Server) -> Result<Self, CliError> {
        let base = Url::parse(&server.url).map_err(CliError::bad_input(format_args!("--url {}", server.url)))?;
        if base.scheme() != "http" || base.host().is_none() {
            let text = format!("--url {}: expected http://HOST:PORT", server.url);
            return Err(CliError::BadInput(text));
        }
        let http = reqwest::Client::builder().no_proxy().connect_timeout(CONNECT_WITHIN).timeout(ANSWER_WITHIN);
        Ok(Self { http: http.build().map_err(CliError::failed("cannot set up HTTP"))?, base, local: None })
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
        Ok(Self { local, ..Self::new(&Server { url })? })
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
        self.http.request(method, url)
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
        Client::new(&Server { url: url.to_owned() })
    }

    #[test]
    fn an_address_that_is_none_is_bad_input() {
        for bad in ["nonsense", "https://host", "ftp://host", "http://"] {
            assert_eq!(client(bad).err().map(|error| error.exit_code()), Some(2), "{bad}");
        }
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
