//! A server beyond its own machine: encrypted, for those with a token; and the commands that make tokens.

use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use reqwest::{Certificate, Client, StatusCode};
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::plan::{directory, path, plan};
use crate::process::{Running, finished, finished_with, json as output};
use crate::server::{Server, client};

const READY_WITHIN: Duration = Duration::from_secs(20);
const LEAVES_WITHIN: Duration = Duration::from_secs(10);

/// A server that listens on all addresses. It is reached over the loopback interface, which makes no difference to it.
struct Exposed {
    process: Running,
    port: u16,
    /// What it said when it began.
    said: Vec<String>,
}

impl Exposed {
    async fn start(db: &str, options: &[&str]) -> Self {
        let args = ["serve", "--db", db, "--http", "0.0.0.0:0", "--zenoh", "tcp/127.0.0.1:0"];
        let mut process = Running::start(&[&args, options].concat());
        let mut lines = BufReader::new(process.child.stdout.take().unwrap()).lines();
        let mut said = Vec::new();
        let ready = async {
            while !said.last().is_some_and(|line: &String| line.starts_with("workers connect")) {
                said.push(lines.next_line().await.unwrap().expect("furrow serve ended"));
            }
        };
        timeout(READY_WITHIN, ready).await.expect("furrow serve is not ready");
        let port = said[0].rsplit(':').next().unwrap().parse().unwrap();
        Self { process, port, said }
    }

    fn url(&self, scheme: &str) -> String {
        format!("{scheme}://127.0.0.1:{}", self.port)
    }
}

/// Makes a token; its text, and a file with it.
async fn token(folder: &Path, db: &str, name: &str, scopes: &str) -> (String, PathBuf) {
    let made = finished(&["token", "create", "--name", name, "--scope", scopes, "--expires", "90d", "--db", db]).await;
    assert_eq!(made.code, Some(0), "{made:?}");
    let text = made.stdout.trim().to_owned();
    assert_eq!(made.stdout, format!("{text}\n"), "nothing else is printed");
    assert!(text.starts_with("furrow_") && text.len() == 50, "{text}");
    let file = folder.join(format!("{name}.token"));
    std::fs::write(&file, &made.stdout).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    (text, file)
}

fn trusting(certificate: &Path) -> Client {
    client(|builder| builder.tls_certs_only([Certificate::from_pem(&std::fs::read(certificate).unwrap()).unwrap()]))
}

#[tokio::test]
async fn beyond_this_machine_a_server_is_encrypted_and_needs_a_token() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let server = Exposed::start(&db, &[]).await;
    let certificate = PathBuf::from(format!("{db}.http-cert.pem"));
    assert!(server.said[0].starts_with("listening on https://0.0.0.0:"), "{:?}", server.said);
    assert!(server.said[1].contains("SHA-256 ") && server.said[1].contains("http-cert.pem"), "{:?}", server.said);
    let key = std::fs::metadata(format!("{db}.http-key.pem")).unwrap();
    assert_eq!(key.permissions().mode() & 0o777, 0o600);

    let (http, url) = (trusting(&certificate), server.url("https"));
    let (text, _) = token(directory.path(), &db, "reader", "read").await;
    let ask = async |path: &str, token: Option<&str>| {
        let request = http.get(format!("{url}{path}"));
        let request = if let Some(token) = token { request.bearer_auth(token) } else { request };
        request.send().await.unwrap()
    };
    assert_eq!(ask("/v1/sweeps", None).await.status(), StatusCode::UNAUTHORIZED);
    assert_eq!(ask("/v1/sweeps", Some("furrow_wrong")).await.status(), StatusCode::UNAUTHORIZED);
    let answer = ask("/v1/sweeps", Some(&text)).await;
    assert_eq!(answer.status(), StatusCode::OK, "a token works at once");
    assert_eq!(answer.headers()["strict-transport-security"], "max-age=31536000");
    assert!(ask("/metrics", Some(&text)).await.text().await.unwrap().contains("furrow_workers_live 0"));
    assert_eq!(ask("/healthz", None).await.json::<Value>().await.unwrap(), json!({"status": "ok"}));
    assert_eq!(ask("/readyz", None).await.status(), StatusCode::OK);

    let submit = http.post(format!("{url}/v1/sweeps")).bearer_auth(&text).json(&json!({"plan": plan(1.0, 1)}));
    let refused = submit.send().await.unwrap();
    assert_eq!(refused.status(), StatusCode::FORBIDDEN);
    assert!(refused.json::<Value>().await.unwrap()["detail"].as_str().unwrap().contains("`submit`"));

    let revoked = finished(&["token", "revoke", "reader", "--db", &db]).await;
    assert_eq!(revoked.code, Some(0), "{revoked:?}");
    assert_eq!(ask("/v1/sweeps", Some(&text)).await.status(), StatusCode::UNAUTHORIZED, "a revoked one at once");
}

#[tokio::test]
async fn commands_send_the_token_from_a_file_or_the_environment() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let mut server = Exposed::start(&db, &["--threads", "1"]).await;
    let url = server.url("https");
    let ca = format!("{db}.http-cert.pem");
    let (text, file) = token(directory.path(), &db, "laptop", "read,submit").await;
    let file = file.to_str().unwrap();
    let plan_file = path(&directory, "plan.json");
    std::fs::write(&plan_file, plan(1.0, 1).to_string()).unwrap();

    let submit = ["submit", &plan_file, "--url", &url, "--ca", &ca, "--token-file", file, "--json"];
    assert_eq!(output(&submit).await["total"], 4);
    let watch = ["watch", "1", "--url", &url, "--ca", &ca, "--json"];
    let watched = finished_with(&watch, &[("FURROW_TOKEN", &text)]).await;
    assert_eq!(watched.code, Some(0), "{watched:?}");

    let refused = async |args: &[&str], env: &[(&str, &str)], word: &str| {
        let ended = finished_with(args, env).await;
        assert!(ended.code != Some(0) && ended.stderr.contains(word), "{args:?}: {ended:?}");
        assert!(!ended.stderr.contains(&text), "{ended:?}");
    };
    refused(&["status", "--url", &url, "--ca", &ca], &[], "needs a token").await;
    refused(&["status", "--url", &url, "--token-file", file], &[], "certificate").await;
    let purge = ["cancel", "1", "--purge", "--url", &url, "--ca", &ca, "--token-file", file];
    refused(&purge, &[], "`admin`").await;
    refused(&["status", "--url", "http://192.0.2.1:1", "--token-file", file], &[], "in the clear").await;
    std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o644)).unwrap();
    refused(&["status", "--url", &url, "--ca", &ca, "--token-file", file], &[], "everybody").await;

    let listed = output(&["token", "list", "--db", &db, "--json"]).await;
    assert_eq!(listed["items"][0]["name"], "laptop");
    assert!(listed["items"][0]["used_ms"].is_i64(), "{listed}");
    assert!(!listed.to_string().contains(&text));
    assert_eq!(server.process.terminate(LEAVES_WITHIN).await.code(), Some(0));
    let log = server.process.log();
    assert!(!log.contains(&text) && !log.contains(text.trim_start_matches("furrow_")), "{log}");
}

#[tokio::test]
async fn behind_a_proxy_a_server_speaks_in_the_clear_and_needs_a_token_all_the_same() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let server = Exposed::start(&db, &["--http-plain"]).await;
    let (text, _) = token(directory.path(), &db, "reader", "read").await;
    let (http, url) = (client(|builder| builder), server.url("http"));
    assert_eq!(http.get(format!("{url}/v1/sweeps")).send().await.unwrap().status(), StatusCode::UNAUTHORIZED);
    let asked = http.get(format!("{url}/v1/sweeps")).bearer_auth(&text).header("host", "furrow.example");
    assert_eq!(asked.send().await.unwrap().status(), StatusCode::OK);
}

#[tokio::test]
async fn a_client_that_dawdles_or_says_too_much_is_given_up() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    let address = server.url.strip_prefix("http://").unwrap();
    let mut slow = TcpStream::connect(address).await.unwrap();
    slow.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: ").await.unwrap();
    let ended = timeout(Duration::from_secs(30), slow.read_to_end(&mut Vec::new())).await;
    assert!(ended.is_ok(), "half a head holds a connection for ever");

    let answer = async |request: &str| {
        let mut stream = TcpStream::connect(address).await.unwrap();
        // It may be closed before all of it is sent.
        let _ = stream.write_all(request.as_bytes()).await;
        let mut answer = Vec::new();
        let _ = timeout(Duration::from_secs(30), stream.read_to_end(&mut answer)).await.expect("it is answered");
        String::from_utf8_lossy(&answer).into_owned()
    };
    let many = "X-Many: 1\r\n".repeat(200);
    let head = answer(&format!("GET /healthz HTTP/1.1\r\nHost: localhost\r\n{many}\r\n")).await;
    assert!(head.starts_with("HTTP/1.1 431"), "{head}");
    let long = "x".repeat(100_000);
    let head = answer(&format!("GET /healthz?{long} HTTP/1.1\r\nHost: localhost\r\n\r\n")).await;
    assert!(head.is_empty() || head.starts_with("HTTP/1.1 4"), "{head}");
    let rebound = answer("GET /v1/sweeps HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n").await;
    assert!(rebound.starts_with("HTTP/1.1 421"), "{rebound}");
    assert_eq!(server.get("/healthz").await.status(), 200, "it still serves");
}

#[tokio::test]
async fn a_bad_token_command_is_refused_and_makes_nothing() {
    let directory = directory();
    let db = path(&directory, "none.db");
    for (args, word) in [
        (vec!["token", "create", "--name", "x", "--db", &db], "no such file"),
        (vec!["token", "list", "--db", &db], "no such file"),
        (vec!["token", "create", "--name", "x", "--scope", "all", "--db", &db], "read, submit or admin"),
        (vec!["token", "create", "--name", "x", "--expires", "soon", "--db", &db], "90d"),
        (vec!["serve", "--db", &db, "--http-cert", &db], "--http-key"),
    ] {
        let ended = finished(&args).await;
        assert_eq!(ended.code, Some(2), "{args:?}: {ended:?}");
        assert!(ended.stderr.contains(word), "{args:?}: {ended:?}");
    }
    assert!(!Path::new(&db).exists());
}
