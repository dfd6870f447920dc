//! `/metrics`: what happens here, in the text format of Prometheus.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::header::CONTENT_TYPE;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use furrow_coordinator::Census;
use furrow_coordinator::figures::{Histogram, Snapshot};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::problem::Problem;

/// Upper ends of the steps in which the time of a request is counted \[s\].
const REQUEST_STEPS_S: &[f64] = &[0.001, 0.005, 0.01, 0.05, 0.1, 0.5, 1.0, 5.0, 10.0, 60.0];

const MEDIA_TYPE: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The requests that were answered.
#[derive(Debug)]
pub(super) struct Requests {
    /// By method, route and status: as many as there are routes, not as clients think of.
    answered: Mutex<BTreeMap<(&'static str, String, u16), u64>>,
    took: Histogram,
}

impl Default for Requests {
    fn default() -> Self {
        Self { answered: Mutex::default(), took: Histogram::new(REQUEST_STEPS_S) }
    }
}

/// Counts a request when it is answered.
pub(super) async fn count(State(app): State<App>, request: Request, next: Next) -> Response {
    let begun = Instant::now();
    let method = method(&request);
    let route = request.extensions().get::<MatchedPath>().map_or("none", MatchedPath::as_str).to_owned();
    let response = next.run(request).await;
    let requests = app.requests();
    requests.took.observe(begun.elapsed());
    let mut answered = requests.answered.lock().unwrap_or_else(PoisonError::into_inner);
    *answered.entry((method, route, response.status().as_u16())).or_default() += 1;
    response
}

fn method(request: &Request) -> &'static str {
    let known = ["GET", "HEAD", "POST", "PATCH", "PUT", "DELETE", "OPTIONS"];
    known.into_iter().find(|method| *method == request.method().as_str()).unwrap_or("other")
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(metrics))
}

/// Counters and gauges for Prometheus.
#[utoipa::path(get, path = "/metrics", tag = "health",
    responses(
        (status = 200, body = String, content_type = "text/plain"),
        (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn metrics(State(app): State<App>) -> Result<Response, Problem> {
    let census = app.coordinator().census().await?;
    let mut page = Page::default();
    queue(&mut page, &census);
    writer(&mut page, &app);
    requests(&mut page, app.requests());
    process(&mut page);
    Ok(([(CONTENT_TYPE, MEDIA_TYPE)], page.0).into_response())
}

fn queue(page: &mut Page, census: &Census) {
    let sweeps = ["active", "paused", "done", "cancelled"].map(|state| (state, census.sweeps.get(state).copied()));
    page.family("furrow_sweeps", "gauge", "Sweeps by state.");
    sweeps.iter().for_each(|(state, n)| page.sample("furrow_sweeps", &[("state", state)], n.unwrap_or(0) as f64));
    page.family("furrow_jobs", "gauge", "Jobs by state, as sweeps list them: one of two sweeps counts twice.");
    for (state, n) in &census.jobs {
        page.sample("furrow_jobs", &[("state", state)], *n as f64);
    }
    page.one("furrow_workers_live", "gauge", "Workers that were heard of within a lease.", census.workers_live as f64);
    page.one("furrow_incidents", "gauge", "Results that differ from the one on record.", census.incidents as f64);
    page.one("furrow_database_bytes", "gauge", "Length of the database's file.", census.database_bytes as f64);
    page.one("furrow_wal_bytes", "gauge", "Length of the write-ahead log.", census.wal_bytes as f64);
}

fn writer(page: &mut Page, app: &App) {
    let figures = app.coordinator().figures();
    let results = figures.recorded() as f64;
    page.one("furrow_results_recorded_total", "counter", "Results acknowledged since the start.", results);
    let help = "Time of a transaction from begin to commit.";
    page.histogram("furrow_commit_seconds", help, &figures.commits.snapshot());
}

fn requests(page: &mut Page, requests: &Requests) {
    page.family("furrow_http_requests_total", "counter", "Requests answered, by method, route and status.");
    let answered = requests.answered.lock().unwrap_or_else(PoisonError::into_inner);
    for ((method, route, status), n) in &*answered {
        let labels = [("method", *method), ("route", route), ("status", &status.to_string())];
        page.sample("furrow_http_requests_total", &labels, *n as f64);
    }
    drop(answered);
    let help = "Time from a request's head to the head of its answer.";
    page.histogram("furrow_http_request_seconds", help, &requests.took.snapshot());
}

/// Memory and processor time of this process, where the system tells them as files.
fn process(page: &mut Page) {
    if let Some(bytes) = resident_bytes() {
        page.one("process_resident_memory_bytes", "gauge", "Memory in use.", bytes);
    }
    if let Some(seconds) = cpu_seconds() {
        page.one("process_cpu_seconds_total", "counter", "Processor time used.", seconds);
    }
    if let Ok(files) = std::fs::read_dir("/proc/self/fd") {
        page.one("process_open_fds", "gauge", "Open files and connections.", files.count() as f64);
    }
}

fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024.0)
}

/// From the 14th and 15th field, in hundredths of a second; the second one is a name that may hold anything.
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// The text as it grows.
#[derive(Debug, Default)]
struct Page(String);

impl Page {
    fn family(&mut self, name: &str, kind: &str, help: &str) {
        self.line(format_args!("# HELP {name} {help}\n# TYPE {name} {kind}"));
    }

    fn one(&mut self, name: &str, kind: &str, help: &str, value: f64) {
        self.family(name, kind, help);
        self.sample(name, &[], value);
    }

    fn sample(&mut self, name: &str, labels: &[(&str, &str)], value: f64) {
        let labels: Vec<_> = labels.iter().map(|(label, value)| format!("{label}=\"{}\"", escaped(value))).collect();
        match labels.is_empty() {
            true => self.line(format_args!("{name} {value}")),
            false => self.line(format_args!("{name}{{{}}} {value}", labels.join(","))),
        }
    }

    fn histogram(&mut self, name: &str, help: &str, snapshot: &Snapshot) {
        self.family(name, "histogram", help);
        let bucket = format!("{name}_bucket");
        for (end, n) in &snapshot.up_to_s {
            self.sample(&bucket, &[("le", &end.to_string())], *n as f64);
        }
        self.sample(&bucket, &[("le", "+Inf")], snapshot.count as f64);
        self.sample(&format!("{name}_sum"), &[], snapshot.sum_s);
        self.sample(&format!("{name}_count"), &[], snapshot.count as f64);
    }

    fn line(&mut self, text: std::fmt::Arguments<'_>) {
        writeln!(self.0, "{text}").expect("a text takes whatever is written to it");
    }
}

fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}
