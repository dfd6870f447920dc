//! JSON merge patch (RFC 7396), save that an object that names a `kind` replaces what was there.
//!
//! Another variant has other parameters: merging them into the old one's would leave keys behind that it does
//! not know.

use serde_json::{Map, Value};

/// Changes `target` as `patch` says: objects merge key by key, null removes a key, all else replaces, and so
/// does an object that holds `kind`, as it stands.
pub(super) fn merge(target: &mut Value, patch: &Value) {
    match patch {
        Value::Object(changes) if !changes.contains_key("kind") => merge_keys(target, changes),
        _ => *target = patch.clone(),
    }
}

fn merge_keys(target: &mut Value, changes: &Map<String, Value>) {
    if !target.is_object() {
        *target = Value::Object(Map::new());
    }
    let Value::Object(object) = target else { return };
    for (key, change) in changes {
        if change.is_null() {
            object.remove(key);
        } else {
            merge(object.entry(key.clone()).or_insert(Value::Null), change);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::json;

    use super::*;

    fn merged(mut target: Value, patch: &Value) -> Value {
        merge(&mut target, patch);
        target
    }

    #[test]
    fn the_examples_of_the_rfc_hold() {
        let examples = [
            (json!({"a": "b"}), json!({"a": "c"}), json!({"a": "c"})),
            (json!({"a": "b"}), json!({"b": "c"}), json!({"a": "b", "b": "c"})),
            (json!({"a": "b", "b": "c"}), json!({"a": null}), json!({"b": "c"})),
            (json!({"a": ["b"]}), json!({"a": "c"}), json!({"a": "c"})),
            (json!({"a": {"b": "c"}}), json!({"a": {"b": "d", "c": null}}), json!({"a": {"b": "d"}})),
            (json!({"a": [{"b": "c"}]}), json!({"a": [1]}), json!({"a": [1]})),
            (json!(["a", "b"]), json!(["c", "d"]), json!(["c", "d"])),
            (json!({"a": "foo"}), json!("bar"), json!("bar")),
            (json!({"e": null}), json!({"a": 1}), json!({"e": null, "a": 1})),
            (json!([1, 2]), json!({"a": "b", "c": null}), json!({"a": "b"})),
            (json!({}), json!({"a": {"bb": {"ccc": null}}}), json!({"a": {"bb": {}}})),
        ];
        for (target, patch, expected) in examples {
            assert_eq!(merged(target, &patch), expected, "{patch}");
        }
    }

    #[test]
    fn an_object_with_a_kind_replaces_the_whole_object() {
        let base = json!({"perception": {"kind": "rgop", "iterations": 10}, "limits": {"time_s": 1500}});
        let patch = json!({"perception": {"kind": "oracle"}, "limits": {"stuck_s": 30}});
        let expected = json!({"perception": {"kind": "oracle"}, "limits": {"time_s": 1500, "stuck_s": 30}});
        assert_eq!(merged(base, &patch), expected);
    }

    #[test]
    fn parameters_merge_into_the_same_kind_when_the_patch_names_none() {
        let base = json!({"perception": {"kind": "rgop", "iterations": 10}});
        let expected = json!({"perception": {"kind": "rgop", "iterations": 20}});
        assert_eq!(merged(base, &json!({"perception": {"iterations": 20}})), expected);
    }

    fn any_json() -> impl Strategy<Value = Value> {
        let leaf =
            prop_oneof![Just(Value::Null), any::<bool>().prop_map(Value::from), any::<i32>().prop_map(Value::from)];
        leaf.prop_recursive(4, 32, 4, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                proptest::collection::btree_map("[a-c]|kind", inner, 0..4)
                    .prop_map(|map| Value::Object(map.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn merging_twice_is_merging_once(target in any_json(), patch in any_json()) {
            let once = merged(target, &patch);
            prop_assert_eq!(merged(once.clone(), &patch), once);
        }

        #[test]
        fn an_empty_patch_leaves_an_object_as_it_is(target in any_json()) {
            prop_assume!(target.is_object());
            prop_assert_eq!(merged(target.clone(), &json!({})), target);
        }

        #[test]
        fn keys_that_the_patch_does_not_name_stay(target in any_json(), patch in any_json()) {
            let (Value::Object(before), Value::Object(changes)) = (&target, &patch) else { return Ok(()) };
            prop_assume!(!changes.contains_key("kind"));
            let after = merged(target.clone(), &patch);
            for (key, value) in before.iter().filter(|(key, _)| !changes.contains_key(*key)) {
                prop_assert_eq!(&after[key], value);
            }
        }
    }
}
