//! Which form an answer takes: the parameter `format`, else the header Accept, else JSON.

use axum::http::header::ACCEPT;
use axum::http::{HeaderMap, HeaderValue};

use super::problem::Problem;

/// One form that a route can answer in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Form<T> {
    /// Its word for `format`.
    pub(super) word: &'static str,
    /// Its media type, without parameters.
    pub(super) media_type: &'static str,
    /// What the route knows it by.
    pub(super) form: T,
}

/// The media type of Apache Parquet.
pub(super) const PARQUET: &str = "application/vnd.apache.parquet";

impl<T> Form<T> {
    /// The header for an answer in this form.
    pub(super) fn content_type(&self) -> HeaderValue {
        let text = match self.media_type {
            text if text.starts_with("text/") => format!("{text}; charset=utf-8"),
            other => other.to_owned(),
        };
        HeaderValue::from_str(&text).expect("media types are plain ASCII")
    }
}

/// The form to answer in; the first of `offered` where neither parameter nor header chooses one.
///
/// A header that none of them satisfies is ignored: a table in another form is better than none.
///
/// # Errors
/// `format` names none of them.
pub(super) fn choose<T: Copy>(
    offered: &[Form<T>],
    format: Option<&str>,
    headers: &HeaderMap,
) -> Result<Form<T>, Problem> {
    let Some(word) = format else { return Ok(accepted(offered, headers).unwrap_or(offered[0])) };
    offered.iter().find(|form| form.word == word).copied().ok_or_else(|| {
        let words = offered.iter().map(|form| form.word);
        let list: Vec<_> = words.clone().collect();
        Problem::bad_request(format!("`format={word}` is none of {}", list.join(", "))).at("format").allowing(words)
    })
}

fn accepted<T: Copy>(offered: &[Form<T>], headers: &HeaderMap) -> Option<Form<T>> {
    let values = headers.get_all(ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let mut ranges: Vec<(f64, &str)> = values.flat_map(|value| value.split(',')).map(range).collect();
    ranges.retain(|(quality, _)| *quality > 0.0);
    ranges.sort_by(|a, b| b.0.total_cmp(&a.0));
    ranges.iter().find_map(|(_, wanted)| offered.iter().find(|form| satisfies(form.media_type, wanted)).copied())
}

/// A media range and how much it is liked.
fn range(text: &str) -> (f64, &str) {
    let mut parts = text.split(';').map(str::trim);
    let media_range = parts.next().unwrap_or_default();
    let quality = parts.find_map(|part| part.strip_prefix("q=")).map_or(1.0, |q| q.parse().unwrap_or(0.0));
    (quality, media_range)
}

fn satisfies(media_type: &str, wanted: &str) -> bool {
    let family = wanted.strip_suffix('*').unwrap_or("-");
    wanted == "*/*"
        || media_type.eq_ignore_ascii_case(wanted)
        || (family.ends_with('/') && media_type.starts_with(family))
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFERED: [Form<u8>; 3] = [
        Form { word: "json", media_type: "application/json", form: 0 },
        Form { word: "csv", media_type: "text/csv", form: 1 },
        Form { word: "md", media_type: "text/markdown", form: 2 },
    ];

    fn chosen(format: Option<&str>, accept: &'static str) -> &'static str {
        let headers = HeaderMap::from_iter([(ACCEPT, HeaderValue::from_static(accept))]);
        choose(&OFFERED, format, &headers).unwrap().word
    }

    #[test]
    fn the_parameter_wins_over_the_header() {
        assert_eq!(chosen(Some("md"), "text/csv"), "md");
        assert_eq!(chosen(None, "text/csv"), "csv");
    }

    #[test]
    fn the_header_is_read_by_quality_and_ignored_where_it_asks_for_something_else() {
        assert_eq!(chosen(None, "text/csv;q=0.5, text/markdown"), "md");
        assert_eq!(chosen(None, "image/png, text/*;q=0.1"), "csv");
        assert_eq!(chosen(None, "text/html,*/*;q=0.8"), "json");
        assert_eq!(chosen(None, "image/png"), "json");
        assert_eq!(chosen(None, "text/csv;q=0, application/xml"), "json");
        assert_eq!(chosen(None, "text/csv;q=NaN,;;,=*/"), "json");
    }

    #[test]
    fn an_unknown_format_is_refused_with_those_there_are() {
        let problem = choose(&OFFERED, Some("pdf"), &HeaderMap::new()).unwrap_err();
        assert_eq!((problem.key.as_deref(), problem.allowed.len()), (Some("format"), 3));
    }
}
