//! What a request says, read strictly: every refusal is a problem that names the key.

use std::fmt::Display;
use std::str::FromStr;

use axum::body::Bytes;
use axum::extract::rejection::BytesRejection;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::header::CONTENT_TYPE;
use axum::http::request::Parts;
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use serde::de::DeserializeOwned;

use super::problem::Problem;

/// A request's JSON body.
///
/// The media type must be JSON: a page from elsewhere cannot make a browser send that without asking first.
pub(super) struct JsonBody<T>(pub(super) T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for JsonBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        if !is_json(request.headers()) {
            let detail = "the body must be JSON, and say so: `Content-Type: application/json`";
            return Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, detail));
        }
        let bytes = Bytes::from_request(request, state).await.map_err(unread)?;
        parse(&bytes).map(Self)
    }
}

fn is_json(headers: &HeaderMap) -> bool {
    let Some(value) = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()) else { return false };
    let media_type = value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase();
    media_type == "application/json" || (media_type.starts_with("application/") && media_type.ends_with("+json"))
}

fn unread(rejection: BytesRejection) -> Problem {
    let detail = rejection.body_text();
    match rejection.into_response().status() {
        StatusCode::PAYLOAD_TOO_LARGE => {
            let limit = super::BODY_LIMIT >> 20;
            Problem::new(StatusCode::PAYLOAD_TOO_LARGE, format!("the body is larger than {limit} MiB"))
        }
        status => Problem::new(status, detail),
    }
}

/// Reads an object. A list would do for serde too, and nobody means that.
fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    if bytes.trim_ascii_start().first().is_some_and(|byte| *byte != b'{') {
        return Err(Problem::bad_request("the body must be a JSON object"));
    }
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(unreadable)?;
    reader.end().map_err(|error| Problem::bad_request(format!("the body goes on after its JSON: {error}")))?;
    Ok(value)
}

/// Names the key where a value is wrong; where it is no JSON at all, line and column say enough.
fn unreadable(error: serde_path_to_error::Error<serde_json::Error>) -> Problem {
    let path = error.path().to_string();
    let problem = Problem::bad_request(format!("the body cannot be read: {}", error.inner()));
    if error.inner().is_data() && path != "." { problem.at(path) } else { problem }
}

/// A request's query, taken apart parameter by parameter; one that nobody took is an error.
pub(super) struct Params {
    given: Vec<(String, String)>,
    known: Vec<&'static str>,
}

impl<S: Send + Sync> FromRequestParts<S> for Params {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let Query(given) = Query::<Vec<(String, String)>>::from_request_parts(parts, state)
            .await
            .map_err(|rejection| Problem::bad_request(rejection.body_text()))?;
        Ok(Self { given, known: Vec::new() })
    }
}

impl Params {
    /// The value of `name`, if given; given twice is an error.
    pub(super) fn text(&mut self, name: &'static str) -> Result<Option<String>, Problem> {
        self.known.push(name);
        let mut values = self.given.extract_if(.., |(key, _)| key == name).map(|(_, value)| value);
        let first = values.next();
        if values.next().is_some() {
            return Err(Problem::bad_request(format!("`{name}` is given more than once")).at(name));
        }
        Ok(first)
    }

    /// The value of `name` as a `T`, if given.
    pub(super) fn parsed<T: FromStr<Err: Display>>(&mut self, name: &'static str) -> Result<Option<T>, Problem> {
        let parse = |text: String| {
            let wrong = |error| Problem::bad_request(format!("`{name}={text}`: {error}")).at(name);
            text.parse().map_err(wrong)
        };
        self.text(name)?.map(parse).transpose()
    }

    /// All parameters that begin with `prefix`, by the rest of their names; `shown` names them in an error.
    pub(super) fn prefixed(&mut self, prefix: &str, shown: &'static str) -> Vec<(String, String)> {
        self.known.push(shown);
        let cut = |(key, value): (String, String)| (key[prefix.len()..].to_owned(), value);
        self.given.extract_if(.., |(key, _)| key.starts_with(prefix)).map(cut).collect()
    }

    /// A page's length: 1 to `most`.
    pub(super) fn limit(&mut self, default: u32, most: u32) -> Result<u32, Problem> {
        let limit = self.parsed("limit")?.unwrap_or(default);
        if (1..=most).contains(&limit) {
            return Ok(limit);
        }
        Err(Problem::bad_request(format!("`limit={limit}` is not 1 to {most}")).at("limit"))
    }

    /// Nothing else may be given.
    pub(super) fn finish(self) -> Result<(), Problem> {
        let Some((key, _)) = self.given.into_iter().next() else { return Ok(()) };
        Err(Problem::bad_request(format!("there is no parameter `{key}` here")).at(key).allowing(self.known))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn params(given: &[(&str, &str)]) -> Params {
        let given = given.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        Params { given, known: Vec::new() }
    }

    #[test]
    fn an_unknown_parameter_is_named_beside_those_allowed() {
        let mut query = params(&[("limit", "3"), ("colour", "red")]);
        assert_eq!(query.limit(10, 100), Ok(3));
        let problem = query.finish().unwrap_err();
        assert_eq!((problem.key.as_deref(), &*problem.allowed), (Some("colour"), &["limit".to_owned()][..]));
    }

    #[test]
    fn a_value_that_cannot_be_read_names_its_parameter() {
        for bad in ["-1", "0", "101", "ten", ""] {
            let problem = params(&[("limit", bad)]).limit(10, 100).unwrap_err();
            assert_eq!((problem.status, problem.key.as_deref()), (400, Some("limit")), "{bad}");
        }
        let twice = params(&[("a", "1"), ("a", "2")]).text("a").unwrap_err();
        assert_eq!(twice.key.as_deref(), Some("a"));
    }

    #[test]
    fn only_json_is_read_as_json() {
        for (value, good) in [
            ("application/json", true),
            ("application/json; charset=utf-8", true),
            ("application/merge-patch+json", true),
            ("text/plain", false),
            ("application/x-www-form-urlencoded", false),
        ] {
            let headers = HeaderMap::from_iter([(CONTENT_TYPE, value.parse().unwrap())]);
            assert_eq!(is_json(&headers), good, "{value}");
        }
        assert!(!is_json(&HeaderMap::new()));
    }
}
