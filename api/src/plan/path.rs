//! Dotted paths into a JSON document: `perception.iterations`, `mission.turns.0.angle_rad`.

use serde_json::{Map, Value};

/// Paths have at most this many words.
const MAX_WORDS: usize = 32;

/// Whether `path` is one to [`MAX_WORDS`] words, none of them empty, joined by dots.
pub(super) fn is_path(path: &str) -> bool {
    let words = path.split('.');
    words.clone().count() <= MAX_WORDS && words.clone().all(|word| !word.is_empty())
}

/// The value at `path`, if the document has that path. A number indexes an array.
pub(super) fn find<'a>(document: &'a mut Value, path: &str) -> Option<&'a mut Value> {
    path.split('.').try_fold(document, |at, word| match at {
        Value::Object(object) => object.get_mut(word),
        Value::Array(items) => items.get_mut(word.parse::<usize>().ok()?),
        _ => None,
    })
}

/// Sets `path` to `value`, with new objects where the path does not exist yet. False where an array is shorter
/// than the path says.
pub(super) fn put(document: &mut Value, path: &str, value: Value) -> bool {
    let mut at = document;
    for word in path.split('.') {
        at = match at {
            Value::Array(items) => match word.parse::<usize>().ok().and_then(|index| items.get_mut(index)) {
                Some(item) => item,
                None => return false,
            },
            Value::Object(object) => object.entry(word).or_insert(Value::Null),
            other => {
                *other = Value::Object(Map::new());
                other.as_object_mut().expect("made an object just above").entry(word).or_insert(Value::Null)
            }
        };
    }
    *at = value;
    true
}

/// The paths of `document` most similar to `path`, the best first, at most three. Arrays count as one value.
pub(super) fn nearest<'a>(documents: impl Iterator<Item = &'a Value>, path: &str) -> Vec<String> {
    let mut known = Vec::new();
    documents.for_each(|document| collect(document, String::new(), &mut known));
    known.sort();
    known.dedup();
    let mut scored: Vec<(f64, String)> = known.into_iter().map(|other| (similarity(path, &other), other)).collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    scored.into_iter().filter(|(score, _)| *score > 0.4).take(3).map(|(_, other)| other).collect()
}

/// 0 to 2: how alike the paths are, plus how alike their last words are.
fn similarity(a: &str, b: &str) -> f64 {
    let last = |path: &str| path.rsplit('.').next().unwrap_or_default().to_owned();
    strsim::normalized_levenshtein(a, b) + strsim::normalized_levenshtein(&last(a), &last(b)).powi(2)
}

fn collect(document: &Value, prefix: String, into: &mut Vec<String>) {
    let Value::Object(object) = document else { return };
    for (key, value) in object {
        let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        collect(value, path.clone(), into);
        into.push(path);
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_path_leads_through_objects_and_arrays() {
        let mut document = json!({"a": {"b": [1, {"c": 2}]}});
        assert_eq!(find(&mut document, "a.b.1.c"), Some(&mut json!(2)));
        for absent in ["a.x", "a.b.2", "a.b.-1", "a.b.c", "a.b.0.c", "b"] {
            assert_eq!(find(&mut document, absent), None, "{absent}");
        }
    }

    #[test]
    fn putting_makes_the_objects_on_the_way() {
        let mut document = json!({"field": {"kind": "nursery"}, "a": [1]});
        assert!(put(&mut document, "field.index", json!(7)));
        assert!(put(&mut document, "limits.time_s", json!(9)));
        assert!(put(&mut document, "a.0", json!(2)));
        assert!(!put(&mut document, "a.1", json!(2)));
        assert_eq!(document, json!({"field": {"kind": "nursery", "index": 7}, "limits": {"time_s": 9}, "a": [2]}));
    }

    #[test]
    fn empty_words_and_bottomless_paths_are_no_paths() {
        assert!(is_path("a.b.0"));
        assert!(!["", "a..b", ".a", "a."].iter().any(|path| is_path(path)));
        assert!(!is_path(&vec!["a"; 33].join(".")));
    }

    #[test]
    fn a_misspelt_path_finds_its_neighbours() {
        let document = json!({"perception": {"kind": "rgop", "iterations": 10}, "limits": {"time_s": 1500}});
        assert_eq!(nearest([&document].into_iter(), "perception.iteration")[0], "perception.iterations");
        assert_eq!(nearest([&document].into_iter(), "iterations")[0], "perception.iterations");
        assert!(nearest([&document].into_iter(), "zzzzzzzz").is_empty());
    }
}
