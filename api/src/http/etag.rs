//! Entity tags: whether a client has the answer already.
//!
//! A table is a function of the results on record. A result never changes, and a cell's results only grow in number, so the
//! counts of all cells say which table it is. A client that sends the tag back in `If-None-Match` gets 304 and no body.

use axum::http::header::{CACHE_CONTROL, ETAG, IF_NONE_MATCH, VARY};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use furrow_coordinator::view::CellSummary;
use furrow_schema::sweep::{Sweep, SweepState};

/// The tag of one form of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tag(String);

impl Tag {
    /// Of what is made from the results of a sweep with these cells, which are to be read before the results are.
    pub(super) fn of_results(sweep: &Sweep, cells: &[CellSummary], form: &str) -> Self {
        let mut text = format!("{} {} {} {form}", env!("CARGO_PKG_VERSION"), crate::engine(), sweep.id);
        for cell in cells {
            text += &format!(" {}:{}/{}+{}", cell.id, cell.done, cell.total, cell.failed);
        }
        Self(format!("\"{}\"", hash_of(text.as_bytes())))
    }

    /// Of all runs of a sweep, with states and attempts: only one that is done stands still. It ends anew, and so at
    /// another time, after jobs of it were tried again.
    pub(super) fn of_runs(sweep: &Sweep, cells: &[CellSummary], form: &str) -> Option<Self> {
        let ended = (sweep.state == SweepState::Done).then_some(sweep.finished_ms?)?;
        Some(Self::of_results(sweep, cells, &format!("{form} {ended}")))
    }

    /// Of an answer that is one only by what it says.
    pub(super) fn of_body(body: &[u8]) -> Self {
        Self(format!("\"{}\"", hash_of(body)))
    }

    /// Whether a client has this form already.
    pub(super) fn is_known(&self, headers: &HeaderMap) -> bool {
        is_known(&self.0, headers)
    }

    /// The answer to who has it.
    pub(super) fn not_modified(&self) -> Response {
        (StatusCode::NOT_MODIFIED, self.headers()).into_response()
    }

    /// Who has this answer may keep it for itself, and ask whether it still holds.
    pub(super) fn headers(&self) -> [(HeaderName, HeaderValue); 3] {
        let tag = HeaderValue::from_str(&self.0).expect("digits are plain ASCII");
        let own = HeaderValue::from_static("private, no-cache");
        [(ETAG, tag), (CACHE_CONTROL, own), (VARY, HeaderValue::from_static("accept"))]
    }
}

/// Whether `own` is among the tags that a client sent along.
pub(super) fn is_known(own: &str, headers: &HeaderMap) -> bool {
    let values = headers.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    let mut tags = values.flat_map(|value| value.split(',')).map(str::trim);
    tags.any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == own)
}

/// The first digits of a hash: enough, since nobody gains by two answers with one tag.
fn hash_of(bytes: &[u8]) -> String {
    let digest = ring::digest::digest(&ring::digest::SHA256, bytes);
    digest.as_ref()[..16].iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known(header: &'static str) -> bool {
        let headers = HeaderMap::from_iter([(IF_NONE_MATCH, HeaderValue::from_static(header))]);
        Tag("\"ab\"".to_owned()).is_known(&headers)
    }

    #[test]
    fn a_tag_is_found_in_a_list_weak_or_not() {
        assert!(known("\"ab\"") && known("\"x\", W/\"ab\"") && known("*"));
        assert!(!known("\"abc\"") && !known("ab") && !known(""));
        assert!(!Tag("\"ab\"".to_owned()).is_known(&HeaderMap::new()));
    }
}
