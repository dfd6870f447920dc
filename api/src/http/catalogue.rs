//! `/v1/fields`, `/v1/algorithms`: what a scenario can be made of, with every parameter.

use axum::Json;
use furrow_navigation::parameters::{Choice, Parameter};
use furrow_sim::scenario::catalogue;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::App;
use super::extract::Params;
use super::problem::Problem;

/// Choices, in the order of the loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Choices {
    /// What there is to choose from.
    pub items: Vec<PartChoice>,
}

/// One thing that a part of a scenario can be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PartChoice {
    /// The part: `field`, `robot`, `sensors`, `perception`, `localization`, `control`, `mission`, `observer` or `limits`.
    pub part: String,
    /// The word in the part's `kind`.
    pub kind: String,
    /// What it is.
    pub about: String,
    /// Its parameters. A custom field has none in this form: its schema describes it.
    pub parameters: Vec<ParameterInfo>,
    /// JSON Schema (draft 2020-12) of the part as an object; `unit` says the unit of a number.
    #[schema(value_type = Object)]
    pub schema: Value,
}

/// A parameter of a part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct ParameterInfo {
    /// Its dotted path in a scenario, as `set` takes it.
    pub path: String,
    /// What it means.
    pub about: String,
    /// Where its default comes from: a publication, the program behind its tables, or ours.
    pub source: String,
    /// Its unit; `1` for a pure number, empty for words and truth values.
    pub unit: String,
    /// What it is unless set: a number, a word, a truth value or an object.
    pub default: Value,
    /// Smallest and largest allowed number.
    pub range: Option<[f64; 2]>,
    /// The allowed words, if it is a word.
    pub words: Vec<String>,
}

impl PartChoice {
    fn of(part: &str, choice: &Choice) -> Self {
        let info = |parameter: &Parameter| ParameterInfo {
            path: format!("{part}.{}", parameter.name),
            about: parameter.about().to_owned(),
            source: parameter.source().to_owned(),
            unit: parameter.unit.to_owned(),
            default: choice.default_of(parameter.name).cloned().unwrap_or_default(),
            range: parameter.range,
            words: parameter.words.iter().map(|word| (*word).to_owned()).collect(),
        };
        Self {
            part: part.to_owned(),
            kind: choice.kind.to_owned(),
            about: choice.about.to_owned(),
            parameters: choice.parameters.iter().map(info).collect(),
            schema: choice.schema.clone(),
        }
    }
}

/// All choices of the parts that `wanted` names.
pub fn choices(wanted: impl Fn(&str) -> bool) -> Choices {
    let parts = catalogue().into_iter().filter(|(part, _)| wanted(part));
    let items = parts.flat_map(|(part, choices)| choices.into_iter().map(move |choice| PartChoice::of(part, &choice)));
    Choices { items: items.collect() }
}

pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(list_fields)).routes(routes!(list_algorithms))
}

/// What a field can be, with every parameter.
#[utoipa::path(get, path = "/v1/fields", tag = "catalogue",
    responses((status = 200, body = Choices), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_fields(params: Params) -> Result<Json<Choices>, Problem> {
    params.finish()?;
    Ok(Json(choices(|part| part == "field")))
}

/// What robot, sensors, perception, localization, control, mission, observer and limits can be, with every parameter.
#[utoipa::path(get, path = "/v1/algorithms", tag = "catalogue",
    responses((status = 200, body = Choices), (status = "default", body = Problem, content_type = "application/problem+json")))]
async fn list_algorithms(params: Params) -> Result<Json<Choices>, Problem> {
    params.finish()?;
    Ok(Json(choices(|part| part != "field")))
}
