//! Answers that are made of a sweep's results, remembered until something changes.
//!
//! Many readers of one table cost one computation: while it goes on, the others wait for it, and who comes after it gets the
//! same bytes as long as nothing was committed since. Nobody gets an answer that is older than the question, but for the
//! table of a sweep that goes on: each of its commits would make the table anew, which may take longer than the time to
//! the next one. Such a table is given for some times as long as it took to make, and made anew beside that.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use axum::body::{Bytes, to_bytes};
use axum::extract::{Request, State};
use axum::http::header::{ACCEPT, CONTENT_LENGTH, ETAG, IF_NONE_MATCH};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use furrow_schema::sweep::SweepState;

use super::App;
use super::etag::{Tag, is_known};
use super::problem::Problem;

/// Answers that are kept.
const KEPT: usize = 64;

/// A longer answer is made anew each time.
const LONGEST: usize = 1 << 20;

/// The table of a sweep that goes on is made anew so many times as long after it was made as that took,
const MADE_ANEW: u32 = 3;
/// within this at most,
const MADE_ANEW_WITHIN: Duration = Duration::from_secs(1);
/// and given so many times as long after that.
const GIVEN: u32 = 2;

/// The answers that were given last, by question.
#[derive(Debug, Clone, Default)]
pub(super) struct Answers(Arc<Mutex<VecDeque<Remembered>>>);

type Remembered = (Question, Arc<Slot>);

/// An answer, and who makes the next one.
#[derive(Debug, Default)]
struct Slot {
    answer: Mutex<Option<Answer>>,
    making: Arc<tokio::sync::Mutex<()>>,
    /// Whether the sweep went on at which of the coordinator's changes.
    going_on: tokio::sync::Mutex<(u64, bool)>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Question {
    path: String,
    accept: Option<HeaderValue>,
}

#[derive(Debug, Clone)]
struct Answer {
    /// The coordinator's number of changes before it was made.
    changes: u64,
    made_at: Instant,
    /// How long it took to make.
    cost: Duration,
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
    fn slot(&self, question: Question) -> Arc<Slot> {
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
        let slot = Arc::<Slot>::default();
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

impl Slot {
    fn answer(&self) -> Option<Answer> {
        self.answer.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Asks `next`, and remembers what it answers if that is worth it.
    async fn make(&self, app: &App, mut request: Request, next: Next) -> Response {
        let asked = request.headers().clone();
        request.headers_mut().remove(IF_NONE_MATCH);
        let (changes, asked_at) = (*app.coordinator().changed().borrow(), Instant::now());
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
        let answer = Answer { changes, made_at: Instant::now(), cost: asked_at.elapsed(), headers, body };
        let response = answer.to(&asked);
        let kept = (answer.body.len() <= LONGEST).then_some(answer);
        *self.answer.lock().unwrap_or_else(PoisonError::into_inner) = kept;
        response
    }

    /// Whether the question is after the table of a sweep that has not ended by that change: asked of the store once for each
    /// change, not for each reader.
    async fn goes_on(&self, app: &App, path: &str, change: u64) -> bool {
        let name = path.strip_prefix("/v1/sweeps/").and_then(|rest| rest.strip_suffix("/table"));
        let Some(name) = name else { return false };
        let mut known = self.going_on.lock().await;
        if known.0 < change {
            let now = *app.coordinator().changed().borrow();
            let goes_on = app.sweep_named(name).await.is_ok_and(|sweep| sweep.state == SweepState::Active);
            *known = (now, goes_on);
        }
        known.1
    }
}

/// What the table of a sweep that goes on is good for when something was committed since.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Use {
    Given,
    /// And made anew meanwhile.
    GivenOnceMore,
    None,
}

impl Use {
    /// By the time since it was made, and how long that took.
    fn of(age: Duration, cost: Duration) -> Self {
        let made_anew = MADE_ANEW_WITHIN.min(MADE_ANEW * cost);
        if age < made_anew {
            Self::Given
        } else if age < made_anew + GIVEN * cost {
            Self::GivenOnceMore
        } else {
            Self::None
        }
    }
}

/// Answers from memory where that is as good as asking `next`.
pub(super) async fn remembered(State((app, answers)): State<(App, Answers)>, request: Request, next: Next) -> Response {
    let Some(question) = Question::of(&request) else { return next.run(request).await };
    let on_arrival = *app.coordinator().changed().borrow();
    let slot = answers.slot(question);
    let is_fresh = |answer: &Answer| answer.changes >= on_arrival;
    let held = slot.answer();
    if let Some(answer) = held.as_ref().filter(|answer| is_fresh(answer)) {
        return answer.to(request.headers());
    }
    if let Some(answer) = held {
        let use_of_it = Use::of(answer.made_at.elapsed(), answer.cost);
        if use_of_it != Use::None && slot.goes_on(&app, request.uri().path(), on_arrival).await {
            let response = answer.to(request.headers());
            if use_of_it == Use::GivenOnceMore
                && let Ok(making) = Arc::clone(&slot.making).try_lock_owned()
            {
                tokio::spawn(async move {
                    slot.make(&app, request, next).await;
                    drop(making);
                });
            }
            return response;
        }
    }
    let _making = slot.making.lock().await;
    if let Some(answer) = slot.answer().filter(is_fresh) {
        return answer.to(request.headers());
    }
    slot.make(&app, request, next).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longer_a_table_took_the_longer_it_is_given() {
        let ms = Duration::from_millis;
        let uses = |cost, ages: [u64; 4]| ages.map(|age| Use::of(ms(age), ms(cost)));
        let all = [Use::Given, Use::GivenOnceMore, Use::GivenOnceMore, Use::None];
        assert_eq!(uses(1, [2, 3, 4, 5]), all);
        assert_eq!(uses(100, [299, 300, 499, 500]), all);
        assert_eq!(uses(2_000, [999, 1_000, 4_999, 5_000]), all);
        assert_eq!(Use::of(ms(0), ms(0)), Use::None);
    }
}
