//! Streams of events on a real coordinator.

use axum::body::{Body, BodyDataStream};
use axum::http::Request;
use futures::StreamExt;
use serde_json::{Value, json};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::super::events::Stopping;
use super::{Service, plan};

/// The events of a stream, read one by one.
struct Listener {
    stream: BodyDataStream,
    text: String,
}

impl Listener {
    async fn at(service: &Service, path: &str) -> Self {
        Self::until(service, path, CancellationToken::new()).await
    }

    async fn until(service: &Service, path: &str, stop: CancellationToken) -> Self {
        let request = Request::get(path).extension(Stopping(stop)).body(Body::empty()).unwrap();
        let response = service.router.clone().oneshot(request).await.unwrap();
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        Self { stream: response.into_body().into_data_stream(), text: String::new() }
    }

    /// The next event and its data; none at the end.
    async fn next(&mut self) -> Option<(String, Value)> {
        loop {
            if let Some((event, rest)) = self.text.split_once("\n\n") {
                let field = |name: &str| event.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
                let told = field("event:").zip(field("data:"));
                let told = told.map(|(kind, data)| (kind.to_owned(), serde_json::from_str(data).unwrap()));
                self.text = rest.to_owned();
                if told.is_some() {
                    return told;
                }
                continue;
            }
            let piece = self.stream.next().await?.unwrap();
            self.text.push_str(std::str::from_utf8(&piece).unwrap());
        }
    }

    /// The data of the next event of that kind.
    async fn hear(&mut self, wanted: &str) -> Value {
        loop {
            let (kind, data) = self.next().await.unwrap_or_else(|| panic!("no `{wanted}` came"));
            if kind == wanted {
                return data;
            }
        }
    }
}

#[tokio::test]
async fn a_sweep_tells_its_progress_its_cells_and_its_end_and_then_the_stream_ends() {
    let service = Service::start().await;
    service.post(&json!({"plan": plan(), "seeds": 2}), &[]).await;
    let mut listener = Listener::at(&service, "/v1/sweeps/1/events").await;
    assert_eq!(listener.hear("workers").await["live"], 0);
    assert_eq!(listener.hear("incidents").await["verified"]["open"], 0);
    let begun = listener.hear("progress").await;
    assert_eq!((&begun["state"], &begun["done"], &begun["total"]), (&json!("active"), &json!(0), &json!(8)));
    assert_eq!(begun["eta_ci95_s"], Value::Null);

    service.work().await;
    assert_eq!(listener.hear("workers").await["live"], 1);
    let cells = listener.hear("cells").await;
    let items = cells["items"].as_array().unwrap();
    assert_eq!((items.len(), &cells["more"]), (4, &json!(false)));
    assert!(items.iter().all(|cell| cell["done"] == 2 && cell["total"] == 2), "{cells}");
    let done = listener.hear("progress").await;
    assert_eq!((&done["state"], &done["done"], &done["eta_ci95_s"]), (&json!("done"), &json!(8), &Value::Null));
    assert_eq!(listener.hear("end").await["state"], "done");
    assert_eq!(listener.next().await, None);
}

#[tokio::test]
async fn sweeps_that_come_and_go_are_told_of() {
    let service = Service::start().await;
    let mut listener = Listener::at(&service, "/v1/events").await;
    listener.hear("incidents").await;
    service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await;
    assert_eq!(listener.hear("sweeps").await["items"][0]["id"], 1);
    let removal = Request::delete("/v1/sweeps/1?purge=true").body(Body::empty()).unwrap();
    assert_eq!(service.send(removal).await.status, 204);
    while listener.hear("sweeps").await["gone"] != json!([1]) {}
}

#[tokio::test]
async fn who_comes_when_all_streams_are_taken_is_refused_until_one_is_free() {
    let service = Service::start().await;
    let mut listeners = Vec::new();
    for _ in 0..64 {
        listeners.push(Listener::at(&service, "/v1/events").await);
    }
    let refused = service.get("/v1/events").await;
    assert_eq!((refused.status, refused.header("retry-after")), (503, "1"));
    listeners.pop();
    Listener::at(&service, "/v1/events").await.hear("workers").await;
}

#[tokio::test]
async fn a_reader_that_was_slow_hears_the_newest_state_only() {
    let service = Service::start().await;
    service.post(&json!({"plan": plan(), "seeds": 1}), &[]).await;
    let mut listener = Listener::at(&service, "/v1/sweeps/1/events").await;
    listener.hear("progress").await;
    for priority in 1..=20 {
        let body = Body::from(json!({"priority": priority}).to_string());
        let patch = Request::patch("/v1/sweeps/1").header("content-type", "application/json").body(body).unwrap();
        assert_eq!(service.send(patch).await.status, 200);
    }
    assert_eq!(listener.hear("progress").await["priority"], 20);
}

#[tokio::test]
async fn streams_end_with_the_service() {
    let (service, stop) = (Service::start().await, CancellationToken::new());
    let mut listener = Listener::until(&service, "/v1/events", stop.clone()).await;
    listener.hear("incidents").await;
    stop.cancel();
    while listener.next().await.is_some() {}
}

#[tokio::test]
async fn there_are_no_events_of_a_sweep_that_is_not_there() {
    let service = Service::start().await;
    assert_eq!(service.get("/v1/sweeps/7/events").await.status, 404);
    assert_eq!(service.get("/v1/events?colour=red").await.status, 400);
}
