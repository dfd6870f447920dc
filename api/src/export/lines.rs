//! Rows as JSON, an object a line; what a run does not have is null.

use std::collections::BTreeMap;

use furrow_coordinator::view::RunRow;
use furrow_schema::id::JobId;
use serde::Serialize;

use super::{Columns, ExportError};

#[derive(Serialize)]
struct Line<'a> {
    job: JobId,
    key: String,
    factors: BTreeMap<&'a str, &'a str>,
    seed: u64,
    state: &'static str,
    attempts: u32,
    outcome: Option<&'a str>,
    digest: Option<String>,
    metrics: BTreeMap<&'a str, Option<f64>>,
}

pub(super) fn rows(columns: &Columns, runs: &[RunRow]) -> Result<Vec<u8>, ExportError> {
    let mut bytes = Vec::new();
    for run in runs {
        serde_json::to_writer(&mut bytes, &line(columns, run)).map_err(ExportError::of)?;
        bytes.push(b'\n');
    }
    Ok(bytes)
}

fn line<'a>(columns: &'a Columns, run: &'a RunRow) -> Line<'a> {
    Line {
        job: run.job,
        key: run.key.to_string(),
        factors: columns.factors.iter().map(|factor| (factor.as_str(), columns.label(run, factor))).collect(),
        seed: run.seed,
        state: run.state.as_str(),
        attempts: run.attempts,
        outcome: run.outcome.as_deref(),
        digest: run.digest.map(|digest| digest.to_string()),
        metrics: columns.metrics.iter().map(|name| (name.as_str(), run.metrics.get(name).copied())).collect(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::super::Form;
    use super::super::tests::{export, runs};

    #[test]
    fn a_run_is_an_object_and_what_it_lacks_is_null() {
        let bytes = export(Form::Lines, &[&runs()]);
        let lines: Vec<Value> =
            String::from_utf8(bytes).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!((lines.len(), &lines[0]["job"]), (2, &json!(7)));
        assert_eq!(lines[0]["metrics"], json!({"success": 1.0, "distance_m": 0.1 + 0.2}));
        assert_eq!(lines[1]["metrics"], json!({"success": null, "distance_m": null}));
        assert_eq!([&lines[1]["state"], &lines[1]["outcome"]], [&json!("failed"), &json!(null)]);
    }
}
