//! `/` and `/docs`: pages for people, files of this program. They ask the routes under `/v1` for all they show.

use axum::Router;
use axum::extract::Path;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::App;
use super::problem::Problem;

/// Nothing comes from elsewhere, and nothing is run or styled from within the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const JS: &str = "text/javascript; charset=utf-8";
const SVG: &str = "image/svg+xml";

macro_rules! files {
    ($($name:literal $media_type:ident),* $(,)?) => {
        [$(($name, $media_type, include_str!(concat!("../../page/", $name)))),*]
    };
}

static FILES: &[(&str, &str, &str)] = &files![
    "index.html" HTML,
    "docs.html" HTML,
    "app.css" CSS,
    "icon.svg" SVG,
    "api.js" JS,
    "cell.js" JS,
    "charts.js" JS,
    "compare.js" JS,
    "docs.js" JS,
    "dom.js" JS,
    "events.js" JS,
    "format.js" JS,
    "frame.js" JS,
    "main.js" JS,
    "parameters.js" JS,
    "plots.js" JS,
    "publication.js" JS,
    "replay.js" JS,
    "run.js" JS,
    "scale.js" JS,
    "scene.js" JS,
    "submit.js" JS,
    "sweep.js" JS,
    "sweeps.js" JS,
    "table.js" JS,
    "theme.js" JS,
    "workers.js" JS,
];

pub(super) fn routes() -> Router<App> {
    Router::new()
        .route("/", get(async || file("index.html")))
        .route("/docs", get(async || file("docs.html")))
        .route("/page/{name}", get(async |Path(name): Path<String>| file(&name)))
}

fn file(name: &str) -> Response {
    let Some((_, media_type, text)) = FILES.iter().find(|(known, ..)| *known == name) else {
        return Problem::not_found("page", name.chars().take(80).collect::<String>()).into_response();
    };
    let headers = [(CONTENT_TYPE, *media_type), (CONTENT_SECURITY_POLICY, POLICY), (CACHE_CONTROL, "no-cache")];
    (headers, *text).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_that_a_page_names_is_there_and_none_is_of_another_server() {
        for (file, _, text) in FILES {
            assert!(!text.contains("https://") && !text.contains("<script>"), "{file}");
            let named = text.split(['"', '\'', '`']).filter_map(|word| {
                word.strip_prefix("./").or(word.strip_prefix("/page/")).filter(|name| name.contains('.'))
            });
            for name in named {
                assert!(FILES.iter().any(|(known, ..)| *known == name), "{file} names {name}");
            }
        }
    }
}
