//! Answers that are made of a sweep's results, remembered until something changes.
//!
//! Many readers of one table cost one computation: while it goes on, the others wait for it, and who comes after it gets the
//! same bytes as long as nothing was committed since. Nobody gets an answer that is older than the question.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::{Bytes, to_bytes};
use axum::extract::{Request, State};
use axum::http::header::{ACCEPT, CONTENT_LENGTH, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::etag::{Tag, is_known};
use super::problem::Problem;

/// Answers that are kept.
const KEPT: usize = 64;

/// A longer answer is made anew each time.
const LONGEST: usize = 1 << 20;

/// The answers that were given last, by question.
#[derive(Debug, Clone, Default)]
pub(super) struct Answers(Arc<Mutex<VecDeque<(Question, Slot)>>>);

/// An answer, or the place of one that is being made.
type Slot = Arc<tokio::sync::Mutex<Option<Answer>>>;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Question {
    path: String,
    accept: Option<HeaderValue>,
}

#[derive(Debug, Clone)]
struct Answer {
    /// The coordinator's number of changes before it was made.
    changes: u64,
    headers: HeaderMap,
    body: Bytes,
}

impl Question {
    /// The question, if its answer is worth remembering.
    fn of(request: &Request) -> Option<Self> {
        let path = request.uri().path();
        let wanted = path.ends_with("/table") || path.ends_with("/compare") || path.starts_with("/v1/publications/");
        let path =
            request.uri().path_and_query().map(|path| path.as_str().to_owned()).filter(|path| path.len() < 2_000);
        let accept = request.headers().get(ACCEPT).cloned();
        (wanted && *request.method() == Method::GET).then_some(Self { path: path?, accept })
    }
}

impl Answers {
    /// The place of the answer; that of the question that was asked first makes room for a new one.
    fn slot(&self, question: Question) -> Slot {
        let mut slots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = slots.iter().position(|(other, _)| *other == question) {
            let found = slots.remove(at).expect("it was found just above");
            let slot = Arc::clone(&found.1);
            slots.push_back(found);
            return slot;
        }
        if slots.len() == KEPT {
            slots.pop_front();
        }
        let slot = Slot::default();
        slots.push_back((question, Arc::clone(&slot)));
        slot
    }
}

impl Answer {
    fn to(&self, asked: &HeaderMap) -> Response {
        let tag = self.headers.get(ETAG).and_then(|tag| tag.to_str().ok());
        let known = tag.is_some_and(|tag| is_known(tag, asked));
        let mut response =
            if known { StatusCode::NOT_MODIFIED.into_response() } else { self.body.clone().into_response() };
        for (name, value) in self.headers.iter().filter(|(name, _)| **name != CONTENT_LENGTH) {
            response.headers_mut().insert(name, value.clone());
        }
        response
    }
}

/// Answers from memory where that is as good as asking `next`.
pub(super) async fn remembered(
    State((app, answers)): State<(App, Answers)>,
    mut request: Request,
    next: Next,
) -> Response {
    let Some(question) = Question::of(&request) else { return next.run(request).await };
    let on_arrival = *app.coordinator().changed().borrow();
    let slot = answers.slot(question);
    let mut slot = slot.lock().await;
    let asked = request.headers().clone();
    if let Some(answer) = slot.as_ref().filter(|answer| answer.changes >= on_arrival) {
        return answer.to(&asked);
    }
    let changes = *app.coordinator().changed().borrow();
    request.headers_mut().remove(IF_NONE_MATCH);
    let response = next.run(request).await;
    if response.status() != StatusCode::OK {
        return response;
    }
    let (parts, body) = response.into_parts();
    let body = match to_bytes(body, usize::MAX).await {
        Ok(body) => body,
        Err(error) => return Problem::internal(&error).into_response(),
    };
    let mut headers = parts.headers;
    if !headers.contains_key(ETAG) {
        headers.extend(Tag::of_body(&body).headers());
    }
    let answer = Answer { changes, headers, body };
    let response = answer.to(&asked);
    *slot = (answer.body.len() <= LONGEST).then_some(answer);
    response
}
