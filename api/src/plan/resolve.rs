//! One scenario: the base, the levels' changes, the defaults, then the paths that were set.

use std::collections::BTreeMap;

use furrow_sim::{Scenario, ScenarioError};
use serde_json::Value;

use super::factor::Change;
use super::merge::merge;
use super::path::{find, put};

/// One scenario, resolved.
pub(super) struct Resolved {
    /// Its canonical JSON.
    pub(super) text: String,
    /// Paths that it does not have.
    pub(super) missed: Vec<String>,
}

/// Applies `changes` to `base` in order, fills in the defaults, and sets the paths of `set` and of the changes
/// that are settings, whichever the scenario has.
///
/// # Errors
/// Names the key that the scenario does not know or that is out of range.
pub(super) fn resolve(
    base: &Value,
    changes: &[&Change],
    set: &BTreeMap<String, Value>,
) -> Result<Resolved, ScenarioError> {
    resolve_with(base, changes, set, |raw| Ok(Scenario::from_value(raw)?.canonical_json()))
}

/// [`resolve`] with `complete` as what checks a scenario and fills in its defaults.
fn resolve_with(
    base: &Value,
    changes: &[&Change],
    set: &BTreeMap<String, Value>,
    complete: impl Fn(Value) -> Result<String, ScenarioError>,
) -> Result<Resolved, ScenarioError> {
    let mut raw = base.clone();
    let mut pending: BTreeMap<&str, &Value> = set.iter().map(|(path, value)| (path.as_str(), value)).collect();
    for change in changes {
        match change {
            Change::Merge(patch) => merge(&mut raw, patch),
            Change::Put(path, value) => put_or_refuse(&mut raw, path, value)?,
            Change::Set(path, value) => drop(pending.insert(path, value)),
        }
    }
    let text = apply(complete(raw)?, &mut pending, complete)?;
    Ok(Resolved { text, missed: pending.keys().map(|path| (*path).to_owned()).collect() })
}

fn put_or_refuse(raw: &mut Value, path: &str, value: &Value) -> Result<(), ScenarioError> {
    if put(raw, path, value.clone()) {
        return Ok(());
    }
    Err(ScenarioError { path: path.to_owned(), reason: "leads beyond the end of an array".to_owned() })
}

/// Sets what can be set and resolves again, until nothing more can be: setting a whole part may bring the paths
/// that others wait for. What is left in `pending` the scenario does not have.
fn apply(
    mut text: String,
    pending: &mut BTreeMap<&str, &Value>,
    complete: impl Fn(Value) -> Result<String, ScenarioError>,
) -> Result<String, ScenarioError> {
    while !pending.is_empty() {
        let mut scenario = document(&text)?;
        let before = pending.len();
        // In order of the paths, so that a whole part is set before what lies inside it.
        pending.retain(|path, value| match find(&mut scenario, path) {
            Some(place) => {
                *place = (*value).clone();
                false
            }
            None => true,
        });
        if pending.len() == before {
            break;
        }
        text = complete(scenario)?;
    }
    Ok(text)
}

/// A canonical scenario as a JSON document.
pub(super) fn document(text: &str) -> Result<Value, ScenarioError> {
    serde_json::from_str(text)
        .map_err(|error| ScenarioError { path: "scenario".to_owned(), reason: format!("is not JSON: {error}") })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// Fills in `iterations` of an `rgop`, and refuses more than 100 of them.
    fn complete(mut raw: Value) -> Result<String, ScenarioError> {
        if raw["perception"]["kind"] == "rgop" {
            let iterations = raw["perception"].get("iterations").and_then(Value::as_u64).unwrap_or(10);
            if iterations > 100 {
                return Err(ScenarioError { path: "perception.iterations".into(), reason: "at most 100".into() });
            }
            raw["perception"]["iterations"] = json!(iterations);
        }
        Ok(raw.to_string())
    }

    fn resolved(changes: &[Change], set: &[(&str, Value)]) -> Result<(Value, Vec<String>), ScenarioError> {
        let base = json!({"perception": {"kind": "oracle"}, "field": {"kind": "nursery"}});
        let set = set.iter().map(|(path, value)| ((*path).to_owned(), value.clone())).collect();
        let resolved = resolve_with(&base, &changes.iter().collect::<Vec<_>>(), &set, complete)?;
        Ok((document(&resolved.text)?, resolved.missed))
    }

    #[test]
    fn a_path_may_name_a_default_that_no_level_wrote() {
        let level = Change::Merge(json!({"perception": {"kind": "rgop"}}));
        let (scenario, missed) = resolved(&[level], &[("perception.iterations", json!(20))]).unwrap();
        assert_eq!(scenario["perception"], json!({"kind": "rgop", "iterations": 20}));
        assert!(missed.is_empty());
    }

    #[test]
    fn a_path_that_the_scenario_does_not_have_is_missed_and_changes_nothing() {
        let (scenario, missed) = resolved(&[], &[("perception.iterations", json!(20))]).unwrap();
        assert_eq!(scenario["perception"], json!({"kind": "oracle"}));
        assert_eq!(missed, ["perception.iterations"]);
    }

    #[test]
    fn a_whole_part_may_be_set_together_with_what_it_brings() {
        let set = [("perception", json!({"kind": "rgop"})), ("perception.iterations", json!(5))];
        let (scenario, missed) = resolved(&[], &set).unwrap();
        assert_eq!(scenario["perception"], json!({"kind": "rgop", "iterations": 5}));
        assert!(missed.is_empty());
    }

    #[test]
    fn what_was_set_is_checked_like_what_was_written() {
        let level = Change::Merge(json!({"perception": {"kind": "rgop"}}));
        let error = resolved(&[level], &[("perception.iterations", json!(101))]).unwrap_err();
        assert_eq!(error.path, "perception.iterations");
    }

    #[test]
    fn changes_apply_in_the_order_of_the_factors() {
        let changes = [
            Change::Merge(json!({"field": {"kind": "crop", "seed": 1}})),
            Change::Put("field.seed".into(), json!(2)),
            Change::Set("field.kind".into(), json!("other")),
        ];
        let (scenario, _) = resolved(&changes, &[]).unwrap();
        assert_eq!(scenario["field"], json!({"kind": "other", "seed": 2}));
    }
}
