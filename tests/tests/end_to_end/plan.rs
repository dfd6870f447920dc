//! Small plans in temporary files.

use std::path::PathBuf;

use serde_json::{Value, json};
use tempfile::TempDir;

/// A directory that goes when the test ends.
pub(crate) fn directory() -> TempDir {
    tempfile::tempdir().expect("a temporary directory can be made")
}

/// Two algorithms on two drawn fields, each run cut off after `max_time_s` of simulated time.
pub(crate) fn plan(max_time_s: f64, seeds: u64) -> Value {
    let level = |label: &str, patch: Value| json!({"label": label, "patch": patch});
    json!({
        "name": "tests/short", "title": "Short runs", "source": "Furrow's end-to-end tests", "seeds": seeds,
        "base": {
            "field": {"kind": "guyonneau2022", "crop": 1, "seed": "job"}, "robot": {"kind": "two-wheeled"},
            "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
            "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
            "mission": {"kind": "row-by-row"}, "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time", "max_time_s": max_time_s}
        },
        "factors": [
            {"name": "algorithm", "levels": [
                level("oracle", json!({"perception": {"kind": "oracle"}})),
                level("rgop", json!({"perception": {"kind": "rgop"}})),
            ]},
            {"name": "field", "levels": [
                level("crop-1", json!({"field": {"crop": 1}})),
                level("crop-2", json!({"field": {"crop": 2}})),
            ]},
        ],
    })
}

/// A JSON file in `directory`; its path as text, for a command line.
pub(crate) fn file(directory: &TempDir, name: &str, content: &Value) -> String {
    text_file(directory, name, &content.to_string())
}

/// A file in `directory`; its path as text.
pub(crate) fn text_file(directory: &TempDir, name: &str, content: &str) -> String {
    let path = directory.path().join(name);
    std::fs::write(&path, content).unwrap();
    text(path)
}

/// A path in `directory` as text; nothing is there yet.
pub(crate) fn path(directory: &TempDir, name: &str) -> String {
    text(directory.path().join(name))
}

fn text(path: PathBuf) -> String {
    path.into_os_string().into_string().expect("a temporary path is UTF-8")
}
