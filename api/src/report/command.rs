//! How to run a sweep again.

use std::fmt::Write;

use serde_json::Value;

/// The command line, or, where a plan or a field of the user's own is needed, what to submit.
pub(super) fn again(request: &Value) -> String {
    match request["plan"].as_str() {
        Some(plan) if request.get("field").is_none() => line(plan, request),
        _ => submission(request),
    }
}

fn line(plan: &str, request: &Value) -> String {
    let mut line = format!("furrow run {}", quoted(plan));
    for (factor, labels) in entries(request, "only") {
        let labels: Vec<&str> = labels.as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        let _ = write!(line, " --only {}", quoted(&format!("{factor}={}", labels.join("|"))));
    }
    for (path, value) in entries(request, "set") {
        let _ = write!(line, " --set {}", quoted(&format!("{path}={value}")));
    }
    for (path, values) in entries(request, "vary") {
        let values: Vec<String> = values.as_array().into_iter().flatten().map(Value::to_string).collect();
        let _ = write!(line, " --vary {}", quoted(&format!("{path}={}", values.join(","))));
    }
    if let Some(seeds) = request["seeds"].as_u64() {
        let _ = write!(line, " --seeds {seeds}");
    }
    line
}

fn entries<'a>(request: &'a Value, key: &str) -> impl Iterator<Item = (&'a String, &'a Value)> {
    request[key].as_object().into_iter().flatten()
}

fn submission(request: &Value) -> String {
    let body = serde_json::to_string_pretty(request).unwrap_or_default();
    format!(
        "furrow serve --db results.db --threads 4 &\n\
         curl -X POST http://127.0.0.1:8080/v1/sweeps -H 'content-type: application/json' -d @- <<'EOF'\n{body}\nEOF"
    )
}

/// A word as a shell takes it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_plan_by_name_is_run_by_one_line() {
        let request = json!({"plan": "guyonneau2022/bounds", "only": {"algorithm": ["rgop", "oracle"]},
            "set": {"field.seed": {"fixed": 2}}, "vary": {"perception.iterations": [5, 10]}, "seeds": 3});
        let line = "furrow run guyonneau2022/bounds --only 'algorithm=rgop|oracle' --set 'field.seed={\"fixed\":2}' \
            --vary perception.iterations=5,10 --seeds 3";
        assert_eq!(again(&request), line);
        assert_eq!(quoted("it's"), "'it'\\''s'");
    }

    #[test]
    fn a_plan_or_field_of_ones_own_is_submitted_whole() {
        for request in [json!({"plan": {"name": "mine"}, "seeds": 1}), json!({"plan": "a/b", "field": {}, "seeds": 1})]
        {
            assert!(again(&request).contains("curl -X POST"), "{request}");
        }
    }
}
