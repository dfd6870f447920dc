//! A plan's factors as lists of labelled changes, and the choice among them.

use std::collections::{BTreeMap, HashSet};

use furrow_sim::plan::{Factor, Level, RangeLevel};
use serde_json::{Value, json};

use super::Request;
use super::error::PlanError;
use super::label::{is_factor_name, is_label, kebab};
use super::path::is_path;

/// A factor holds at most this many levels.
const MAX_LEVELS: u64 = 100_000;

/// JSON of a plan is nested at most this deep.
const MAX_DEPTH: usize = 64;

/// What one level does to a scenario.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Change {
    /// A merge patch, before defaults are filled in.
    Merge(Value),
    /// A path set to a value, before defaults are filled in.
    Put(String, Value),
    /// A path set to a value in the resolved scenario.
    Set(String, Value),
}

/// One level: a label, and a scenario per change.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Choice {
    pub(super) label: String,
    pub(super) changes: Vec<Change>,
}

/// One factor.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dimension {
    pub(super) name: String,
    pub(super) choices: Vec<Choice>,
}

/// Refuses factors whose names, labels, ranges or patches no sweep may have.
pub(super) fn check_factors(factors: &[Factor]) -> Result<(), PlanError> {
    let mut names = HashSet::new();
    for (i, factor) in factors.iter().enumerate() {
        let at = format!("factors[{i}]");
        check_name(&format!("{at}.name"), &factor.name, !names.insert(factor.name.as_str()))?;
        let choices = choices(&at, &factor.levels)?;
        check_choices(&at, &choices)?;
    }
    Ok(())
}

fn check_name(at: &str, name: &str, taken: bool) -> Result<(), PlanError> {
    if !is_factor_name(name) {
        return Err(PlanError::malformed(at, format!("`{name}` must be snake_case, such as `lidar_hz`")));
    }
    if taken {
        return Err(PlanError::malformed(at, format!("there is a factor `{name}` already")));
    }
    Ok(())
}

fn check_choices(at: &str, choices: &[Choice]) -> Result<(), PlanError> {
    if choices.is_empty() {
        return Err(PlanError::malformed(format!("{at}.levels"), "must hold at least one level"));
    }
    let mut labels = HashSet::new();
    for Choice { label, .. } in choices {
        if !is_label(label) {
            return Err(PlanError::malformed(at, format!("label `{label}` must be kebab-case, such as `crop-2`")));
        }
        if !labels.insert(label) {
            return Err(PlanError::malformed(at, format!("label `{label}` is there twice")));
        }
    }
    Ok(())
}

/// The levels with ranges written out.
fn choices(at: &str, levels: &[Level]) -> Result<Vec<Choice>, PlanError> {
    let mut choices = Vec::new();
    for (i, level) in levels.iter().enumerate() {
        let at = format!("{at}.levels[{i}]");
        match level {
            Level::Patch(level) => choices.push(patches(&at, &level.label, std::slice::from_ref(&level.patch))?),
            Level::Pool(level) => choices.push(patches(&at, &level.label, &level.pool)?),
            Level::Range(level) => choices.extend(range(&at, level)?),
        }
        if choices.len() as u64 > MAX_LEVELS {
            let what = format!("{at}: more than {MAX_LEVELS} levels");
            return Err(PlanError::TooLarge { what, limit: MAX_LEVELS });
        }
    }
    Ok(choices)
}

fn patches(at: &str, label: &str, patches: &[Value]) -> Result<Choice, PlanError> {
    if patches.is_empty() {
        return Err(PlanError::malformed(format!("{at}.pool"), "must hold at least one patch"));
    }
    if let Some(bad) = patches.iter().find(|patch| !patch.is_object() || too_deep(patch, MAX_DEPTH)) {
        let shown: String = bad.to_string().chars().take(60).collect();
        let reason = format!("patch `{shown}` must be an object, nested at most {MAX_DEPTH} deep");
        return Err(PlanError::malformed(at, reason));
    }
    Ok(Choice { label: label.to_owned(), changes: patches.iter().cloned().map(Change::Merge).collect() })
}

fn too_deep(value: &Value, left: usize) -> bool {
    match (value, left) {
        (Value::Array(_) | Value::Object(_), 0) => true,
        (Value::Array(items), _) => items.iter().any(|item| too_deep(item, left - 1)),
        (Value::Object(object), _) => object.values().any(|item| too_deep(item, left - 1)),
        _ => false,
    }
}

fn range(at: &str, level: &RangeLevel) -> Result<impl Iterator<Item = Choice>, PlanError> {
    let [first, last] = level.range;
    if first > last || last - first >= MAX_LEVELS {
        let reason = format!("must be [first, last] with first <= last and at most {MAX_LEVELS} integers");
        return Err(PlanError::malformed(format!("{at}.range"), reason));
    }
    if !is_path(&level.path) {
        return Err(PlanError::malformed(format!("{at}.path"), "must be a dotted path, such as `field.index`"));
    }
    let (before, rest) = level.label.split_once('#').ok_or_else(|| {
        PlanError::malformed(format!("{at}.label"), "must hold `#` where the integer goes, such as `nursery-###`")
    })?;
    let after = rest.trim_start_matches('#').to_owned();
    let (width, before, path) = (1 + rest.len() - after.len(), before.to_owned(), level.path.clone());
    Ok((first..=last).map(move |index| Choice {
        label: format!("{before}{index:0width$}{after}"),
        changes: vec![Change::Put(path.clone(), Value::from(index))],
    }))
}

/// The dimensions of a request: the plan's factors, with the user's field in place of the plan's fields, the
/// varied paths after them, and of all these the levels that `only` names.
pub(super) fn dimensions(factors: &[Factor], request: &Request) -> Result<Vec<Dimension>, PlanError> {
    let mut dimensions = Vec::new();
    for (i, factor) in factors.iter().enumerate() {
        let choices = choices(&format!("factors[{i}]"), &factor.levels)?;
        dimensions.push(Dimension { name: factor.name.clone(), choices });
    }
    if let Some(field) = &request.field {
        let changes = vec![Change::Merge(json!({"field": field.scenario_part()}))];
        let own = Dimension { name: "field".to_owned(), choices: vec![Choice { label: field.label.clone(), changes }] };
        match dimensions.iter_mut().find(|dimension| dimension.name == "field") {
            Some(dimension) => *dimension = own,
            None => dimensions.push(own),
        }
    }
    for (path, values) in &request.vary {
        let varied = varied(path, values)?;
        let taken = dimensions.iter().any(|dimension| dimension.name == varied.name);
        check_name(&format!("vary.{path}"), &varied.name, taken)?;
        dimensions.push(varied);
    }
    select(&mut dimensions, &request.only)?;
    Ok(dimensions)
}

fn varied(path: &str, values: &[Value]) -> Result<Dimension, PlanError> {
    let at = format!("vary.{path}");
    if !is_path(path) {
        return Err(PlanError::malformed(at, "must be a dotted path, such as `perception.iterations`"));
    }
    let choice = |value: &Value| {
        let label = value_label(value).ok_or_else(|| {
            PlanError::malformed(&at, format!("`{value}` gives no label: take numbers, words or objects with a `kind`"))
        })?;
        Ok(Choice { label, changes: vec![Change::Set(path.to_owned(), value.clone())] })
    };
    let choices = values.iter().map(choice).collect::<Result<Vec<_>, PlanError>>()?;
    let distinct: HashSet<&String> = choices.iter().map(|choice| &choice.label).collect();
    if choices.is_empty() || distinct.len() < choices.len() {
        return Err(PlanError::malformed(at, "must hold at least one value, and none twice"));
    }
    Ok(Dimension { name: varied_name(path), choices })
}

/// The path's last word; an index goes with the word before it.
fn varied_name(path: &str) -> String {
    let words: Vec<&str> = path.split('.').collect();
    let is_index = |word: &&str| word.bytes().all(|byte| byte.is_ascii_digit());
    let start = words.iter().rposition(|word| !is_index(word)).unwrap_or(0);
    words[start..].join("_")
}

/// A value as a label: numbers as they are written, words in kebab-case, objects by their `kind`.
fn value_label(value: &Value) -> Option<String> {
    match value {
        Value::Number(number) => Some(number.to_string()),
        Value::String(text) => kebab_or_decimal(text),
        Value::Object(object) => object.get("kind").and_then(Value::as_str).and_then(kebab),
        other => kebab(&other.to_string()),
    }
}

fn kebab_or_decimal(text: &str) -> Option<String> {
    if is_label(text) { Some(text.to_owned()) } else { kebab(text) }
}

/// Keeps the levels that `only` names, in the plan's order.
fn select(dimensions: &mut [Dimension], only: &BTreeMap<String, Vec<String>>) -> Result<(), PlanError> {
    let names: Vec<String> = dimensions.iter().map(|dimension| dimension.name.clone()).collect();
    for (factor, labels) in only {
        let dimension = dimensions.iter_mut().find(|dimension| dimension.name == *factor);
        let dimension =
            dimension.ok_or_else(|| PlanError::UnknownFactor { factor: factor.clone(), known: names.clone() })?;
        let known: HashSet<&str> = dimension.choices.iter().map(|choice| choice.label.as_str()).collect();
        if let Some(level) = labels.iter().find(|label| !known.contains(label.as_str())) {
            let known = dimension.choices.iter().map(|choice| choice.label.clone()).collect();
            return Err(PlanError::UnknownLevel { factor: factor.clone(), level: level.clone(), known });
        }
        if labels.is_empty() {
            return Err(PlanError::malformed(format!("only.{factor}"), "must name at least one level"));
        }
        let wanted: HashSet<&String> = labels.iter().collect();
        dimension.choices.retain(|choice| wanted.contains(&choice.label));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use serde_json::from_value;

    use super::*;
    use crate::plan::{CustomField, PlanSource};

    fn factors() -> Vec<Factor> {
        from_value(json!([
            {"name": "algorithm", "levels": [{"label": "rgop", "patch": {}}, {"label": "rg", "patch": {}}]},
            {"name": "field", "levels": [{"label": "nursery-###", "range": [8, 11], "path": "field.index"}]}
        ]))
        .unwrap()
    }

    fn request() -> Request {
        Request::all_of(PlanSource::Named("x".into()))
    }

    fn labels(dimension: &Dimension) -> Vec<&str> {
        dimension.choices.iter().map(|choice| choice.label.as_str()).collect()
    }

    #[test]
    fn a_range_is_inclusive_and_fills_with_zeros() {
        let dimensions = dimensions(&factors(), &request()).unwrap();
        assert_eq!(labels(&dimensions[1]), ["nursery-008", "nursery-009", "nursery-010", "nursery-011"]);
        assert_eq!(dimensions[1].choices[3].changes, [Change::Put("field.index".into(), json!(11))]);
    }

    #[test]
    fn only_keeps_the_plans_order_and_refuses_what_it_does_not_know() {
        let mut request = request();
        request.only.insert("algorithm".into(), vec!["rg".into(), "rgop".into(), "rg".into()]);
        assert_eq!(labels(&dimensions(&factors(), &request).unwrap()[0]), ["rgop", "rg"]);

        request.only.insert("algorithm".into(), vec!["rgob".into()]);
        let error = dimensions(&factors(), &request).unwrap_err().to_string();
        assert_eq!(error, "only.algorithm: unknown level `rgob`: allowed are rgop, rg");

        request.only = BTreeMap::from([("algoritm".into(), vec!["rg".into()])]);
        let error = dimensions(&factors(), &request).unwrap_err().to_string();
        assert_eq!(error, "only: unknown factor `algoritm`: allowed are algorithm, field");
    }

    #[test]
    fn a_users_field_takes_the_place_of_the_plans_fields() {
        let mut request = request();
        request.field = Some(CustomField::from_json(json!({"name": "My Field", "rows": []})).unwrap());
        let with_field = dimensions(&factors(), &request).unwrap();
        assert_eq!(labels(&with_field[1]), ["my-field"]);
        assert_eq!(dimensions(&factors()[..1], &request).unwrap()[1].name, "field");
    }

    #[test]
    fn a_varied_path_is_a_factor_named_by_its_last_word() {
        let mut request = request();
        request.vary.insert("perception.iterations".into(), vec![json!(5), json!(0.5), json!("as-run"), json!(-1)]);
        let varied = dimensions(&factors(), &request).unwrap().remove(2);
        assert_eq!(varied.name, "iterations");
        assert_eq!(labels(&varied), ["5", "0.5", "as-run", "-1"]);
        assert_eq!(varied_name("mission.turns.0"), "turns_0");
    }

    #[test]
    fn a_varied_path_may_not_hide_a_factor_or_repeat_a_value() {
        let mut request = request();
        request.vary.insert("perception.algorithm".into(), vec![json!(5)]);
        assert!(dimensions(&factors(), &request).unwrap_err().to_string().contains("`algorithm` already"));
        request.vary = BTreeMap::from([("a.b".into(), vec![json!(5), json!("5")])]);
        assert!(dimensions(&factors(), &request).unwrap_err().to_string().starts_with("vary.a.b: "));
        request.vary = BTreeMap::from([("a.b".into(), vec![])]);
        assert!(dimensions(&factors(), &request).is_err());
    }

    #[test]
    fn malformed_factors_are_refused_by_the_key() {
        let level = json!({"label": "a", "patch": {}});
        for (factors, key) in [
            (json!([{"name": "Algorithm", "levels": [level]}]), "factors[0].name"),
            (json!([{"name": "a", "levels": [level]}, {"name": "a", "levels": [level]}]), "factors[1].name"),
            (json!([{"name": "a", "levels": []}]), "factors[0].levels"),
            (json!([{"name": "a", "levels": [level, level]}]), "label `a` is there twice"),
            (json!([{"name": "a", "levels": [{"label": "A b", "patch": {}}]}]), "label `A b`"),
            (json!([{"name": "a", "levels": [{"label": "a", "patch": 3}]}]), "factors[0].levels[0]"),
            (json!([{"name": "a", "levels": [{"label": "a", "pool": []}]}]), "factors[0].levels[0].pool"),
            (json!([{"name": "a", "levels": [{"label": "a", "range": [0, 3], "path": "b"}]}]), "levels[0].label"),
            (json!([{"name": "a", "levels": [{"label": "a-#", "range": [3, 0], "path": "b"}]}]), "levels[0].range"),
            (json!([{"name": "a", "levels": [{"label": "a-#", "range": [0, u64::MAX], "path": "b"}]}]), "range"),
            (json!([{"name": "a", "levels": [{"label": "a-#", "range": [0, 3], "path": "b."}]}]), "levels[0].path"),
        ] {
            let error = check_factors(&from_value::<Vec<Factor>>(factors).unwrap()).unwrap_err().to_string();
            assert!(error.contains(key), "{error}");
        }
    }
}
