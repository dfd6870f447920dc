//! A running `furrow serve`, seen through its HTTP interface, and workers beside it.

use std::collections::BTreeMap;
use std::time::Duration;

use reqwest::{Client, ClientBuilder, Method, Response, StatusCode};
use serde_json::Value;
use tokio::io::{AsyncBufReadExt, BufReader, Lines};
use tokio::process::ChildStdout;
use tokio::time::{interval, timeout};

use crate::process::Running;

/// A process that is not ready after this long will never be.
const READY_WITHIN: Duration = Duration::from_secs(20);
/// A sweep of these tests is done after this long, on a busy machine, too.
const DONE_WITHIN: Duration = Duration::from_secs(120);
/// Pause between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(25);

/// A coordinator process. It is killed when dropped.
pub(crate) struct Server {
    pub(crate) process: Running,
    /// Where users connect, such as `http://127.0.0.1:8080`.
    pub(crate) url: String,
    /// Where workers connect, such as `tcp/127.0.0.1:7447`.
    pub(crate) endpoint: String,
    /// Where workers keep their finished runs: beside the database.
    pub(crate) spool: String,
    /// What it printed until it was ready.
    pub(crate) said: Vec<String>,
    client: Client,
    _stdout: Lines<BufReader<ChildStdout>>,
}

/// What a run is, for a comparison between sweeps: its labels and its seed.
pub(crate) type Row = (String, u64);

impl Server {
    /// Serves the database `db` with so many threads of its own.
    pub(crate) async fn start(db: &str, threads: u32) -> Self {
        Self::start_at(db, threads, "tcp/127.0.0.1:0").await
    }

    /// The same, where workers know it.
    pub(crate) async fn start_at(db: &str, threads: u32, endpoint: &str) -> Self {
        // Every run counts in these tests: none is done twice to verify it.
        Self::launch(db, threads, endpoint, "0").await
    }

    /// Serves `db` to other processes, and has this share of the results computed again.
    pub(crate) async fn verifying(db: &str, share: &str) -> Self {
        Self::launch(db, 0, "tcp/127.0.0.1:0", share).await
    }

    async fn launch(db: &str, threads: u32, endpoint: &str, verify: &str) -> Self {
        Self::start_with(db, &["--zenoh", endpoint, "--threads", &threads.to_string(), "--verify", verify], &[]).await
    }

    /// Serves the database `db` with these arguments and this environment.
    pub(crate) async fn start_with(db: &str, more: &[&str], environment: &[(&str, &str)]) -> Self {
        let mut args = vec!["serve", "--db", db, "--http", "127.0.0.1:0"];
        args.extend(more);
        let mut process = Running::start_in(&args, environment);
        let mut stdout = BufReader::new(process.child.stdout.take().expect("it is piped")).lines();
        let ready = timeout(READY_WITHIN, announced(&mut stdout)).await.expect("furrow serve is not ready");
        let (url, endpoint, said) = ready;
        let spool = format!("{db}.spool");
        Self { process, url, endpoint, spool, said, client: client(|builder| builder), _stdout: stdout }
    }

    /// Starts a worker process with one thread.
    pub(crate) fn worker(&self) -> Running {
        Running::start(&["work", "--connect", &self.endpoint, "--threads", "1", "--spool", &self.spool])
    }

    /// What `path` answers, good or bad.
    pub(crate) async fn get(&self, path: &str) -> Response {
        self.client.get(format!("{}{path}", self.url)).send().await.expect("the server answers")
    }

    /// What posting `body` to `path` answers, good or bad.
    pub(crate) async fn post(&self, path: &str, content_type: &str, body: impl Into<String>) -> Response {
        let request = self.client.post(format!("{}{path}", self.url)).header("content-type", content_type);
        request.body(body.into()).send().await.expect("the server answers")
    }

    /// The JSON of a good answer to `method` on `path`, with a JSON body if one is given.
    pub(crate) async fn change(&self, method: Method, path: &str, body: Option<&Value>) -> Value {
        let request = self.client.request(method, format!("{}{path}", self.url));
        let request = if let Some(body) = body { request.json(body) } else { request };
        let response = request.send().await.expect("the server answers");
        let (status, text) = (response.status(), response.text().await.unwrap());
        assert_eq!(status, StatusCode::OK, "{path}: {text}");
        serde_json::from_str(&text).unwrap()
    }

    /// A good answer's text.
    pub(crate) async fn text(&self, path: &str) -> String {
        let response = self.get(path).await;
        let (status, text) = (response.status(), response.text().await.unwrap());
        assert_eq!(status, StatusCode::OK, "{path}: {text}");
        text
    }

    /// A good answer's JSON.
    pub(crate) async fn json(&self, path: &str) -> Value {
        serde_json::from_str(&self.text(path).await).unwrap()
    }

    /// Submits a sweep; its number.
    pub(crate) async fn submit(&self, request: &Value) -> i64 {
        let response = self.post("/v1/sweeps", "application/json", request.to_string()).await;
        assert_eq!(response.status(), StatusCode::CREATED, "{}", response.text().await.unwrap());
        response.json::<Value>().await.unwrap()["id"].as_i64().unwrap()
    }

    /// Waits until `path` answers what `look` looks for.
    pub(crate) async fn until<T>(&self, path: &str, look: impl Fn(&Value) -> Option<T>) -> T {
        let mut looks = interval(LOOK_EVERY);
        let search = async {
            loop {
                looks.tick().await;
                if let Some(seen) = look(&self.json(path).await) {
                    return seen;
                }
            }
        };
        match timeout(DONE_WITHIN, search).await {
            Ok(seen) => seen,
            Err(_) => panic!("{path} never became as expected: {}", self.text(path).await),
        }
    }

    /// Waits until every job of the sweep has ended; the sweep.
    pub(crate) async fn done(&self, sweep: i64) -> Value {
        let ended = |sweep: &Value| (sweep["state"] == "done").then(|| sweep.clone());
        self.until(&format!("/v1/sweeps/{sweep}"), ended).await
    }

    /// All jobs of a sweep.
    pub(crate) async fn jobs(&self, sweep: i64) -> Vec<Value> {
        let mut jobs = Vec::new();
        let mut after = String::new();
        loop {
            let page = self.json(&format!("/v1/jobs?sweep={sweep}&limit=1000{after}")).await;
            jobs.extend_from_slice(page["items"].as_array().unwrap());
            let Some(next) = page["next"].as_str() else { return jobs };
            after = format!("&after={next}");
        }
    }

    /// How often each job of a sweep was handed out, by its number.
    pub(crate) async fn attempts(&self, sweep: i64) -> BTreeMap<i64, u64> {
        let attempts = |job: &Value| (job["id"].as_i64().unwrap(), job["attempts"].as_u64().unwrap());
        self.jobs(sweep).await.iter().map(attempts).collect()
    }

    /// The digest of every run of a sweep.
    pub(crate) async fn digests(&self, sweep: i64) -> BTreeMap<Row, String> {
        let row = |job: &Value| (job["factors"].to_string(), job["seed"].as_u64().unwrap());
        let digest = |job: &Value| job["digest"].as_str().unwrap_or_else(|| panic!("no digest: {job}")).to_owned();
        self.jobs(sweep).await.iter().map(|job| (row(job), digest(job))).collect()
    }
}

/// A client for HTTP, set up by `set`. Its encryption has to be chosen in every process that makes one.
pub(crate) fn client(set: impl FnOnce(ClientBuilder) -> ClientBuilder) -> Client {
    furrow_api::http::tls::provide();
    // A server that stood still closes connections that were idle; no request is to meet that.
    set(Client::builder().no_proxy().tls_certs_only([]).pool_max_idle_per_host(0)).build().unwrap()
}

/// Reads the lines in which a server says where it listens; these, and all lines up to them.
async fn announced(stdout: &mut Lines<BufReader<ChildStdout>>) -> (String, String, Vec<String>) {
    let (mut url, mut endpoint, mut said) = (None, None, Vec::new());
    while let Some(line) = stdout.next_line().await.unwrap() {
        for word in line.split_whitespace() {
            if word.starts_with("http://") {
                url = Some(word.to_owned());
            } else if word.starts_with("tcp/") || word.starts_with("quic/") {
                endpoint = Some(word.to_owned());
            }
        }
        said.push(line);
        if let (Some(url), Some(endpoint)) = (&url, &endpoint) {
            return (url.clone(), endpoint.clone(), said);
        }
    }
    panic!("furrow serve ended before it said where it listens");
}
