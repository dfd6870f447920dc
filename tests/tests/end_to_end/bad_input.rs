//! Bad input on the command line: exit code 2, a message that names the key and what is allowed, nothing written.

use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::net::TcpListener;

use crate::plan::{directory, file, path, plan, text_file};
use crate::process;

/// Runs `furrow`, which must refuse and name all `words` on its error output.
pub(crate) async fn refused(args: &[&str], words: &[&str]) {
    let finished = process::finished(args).await;
    assert_eq!(finished.code, Some(2), "furrow {args:?}: {finished:?}");
    assert_eq!(finished.stdout, "", "furrow {args:?}");
    for word in words {
        assert!(finished.stderr.contains(word), "furrow {args:?} does not say `{word}`: {}", finished.stderr);
    }
}

fn short_plan(directory: &TempDir) -> String {
    file(directory, "short.json", &plan(1.0, 1))
}

#[tokio::test]
async fn an_unknown_plan_is_refused_with_the_known_ones() {
    refused(&["run", "guyonneau2022/algorithm-50"], &["guyonneau2022/algorithm-50", "guyonneau2022/algorithm-5"]).await;
    refused(&["run", "nowhere/plan.json"], &["nowhere/plan.json"]).await;
}

#[tokio::test]
async fn what_the_plan_does_not_have_is_refused_with_what_it_has() {
    let directory = directory();
    let plan = short_plan(&directory);
    let run = |flag, value| ["run", plan.as_str(), flag, value].map(str::to_owned);
    for (args, words) in [
        (run("--only", "robot=rgop"), ["robot", "algorithm"]),
        (run("--only", "algorithm=rgop2"), ["rgop2", "oracle"]),
        (run("--only", "algorithm"), ["--only", "algorithm"]),
        (run("--set", "limits.max_tim_s=3"), ["limits.max_tim_s", "max_time_s"]),
        (run("--set", "limits.max_time_s=-1"), ["limits.max_time_s", "100000"]),
        (run("--set", "limits.max_time_s=soon"), ["limits.max_time_s", "soon"]),
        (run("--set", "control.kind=wise"), ["control.kind", "fuzzy"]),
        (run("--vary", "limits.max_time_s=1,-1"), ["limits.max_time_s", "-1"]),
        (run("--seeds", "0"), ["seeds", "0"]),
        (run("--seeds", "many"), ["seeds", "many"]),
        (run("--threads", "0"), ["--threads", "0"]),
    ] {
        refused(&args.each_ref().map(String::as_str), &words).await;
    }
}

#[tokio::test]
async fn a_malformed_plan_is_refused_with_the_place() {
    let directory = directory();
    let torn = text_file(&directory, "torn.json", "{\"name\": \"torn\",\n \"title\": ");
    refused(&["run", &torn], &["torn.json", "line 2"]).await;
    let mut unknown = plan(1.0, 1);
    unknown["sedes"] = json!(3);
    refused(&["run", &file(&directory, "unknown.json", &unknown)], &["sedes"]).await;
    let mut patched = plan(1.0, 1);
    patched["factors"][0]["levels"][0]["patch"] = json!({"perception": {"kind": "rgop", "eyes": 3}});
    refused(&["run", &file(&directory, "patched.json", &patched)], &["perception.eyes"]).await;
}

fn field() -> Value {
    let plants: Vec<Value> = (0..20)
        .flat_map(|i| (0..2).map(move |row| (f64::from(i) * 0.5, row)))
        .map(|(x_m, row)| json!({"x_m": x_m, "y_m": f64::from(row), "radius_m": 0.05, "height_m": 1.0, "kind": "crop", "row": row}))
        .collect();
    json!({
        "name": "mine", "row_spacing_m": 1.0, "plants": plants, "inter_rows": 1,
        "rows": [{"points_m": [[0.0, 0.0], [10.0, 0.0]]}, {"points_m": [[0.0, 1.0], [10.0, 1.0]]}],
        "start": {"x_m": -1.0, "y_m": 0.5, "heading_rad": 0.0}
    })
}

#[tokio::test]
async fn a_field_of_the_user_s_own_runs_and_a_malformed_one_is_refused_by_its_key() {
    let directory = directory();
    let plan = short_plan(&directory);
    let good = file(&directory, "my-field.json", &field());
    let printed = process::json(&["run", &plan, "--field", &good, "--json"]).await;
    assert_eq!(printed["cells"][0]["factors"]["field"], "my-field");

    for (key, value, word) in [
        ("/row_spacing_m", json!("wide"), "row_spacing_m"),
        ("/rows/1/points_m", json!([[0.0, 1.0]]), "rows[1]"),
        ("/plants/3/row", json!(7), "plants[3]"),
        ("/plants/3/radius_m", json!(-1.0), "plants[3]"),
        ("/inter_rows", json!(2), "inter_rows"),
        ("/start/heading_rad", json!(null), "start"),
    ] {
        let mut bad = field();
        *bad.pointer_mut(key).unwrap() = value;
        refused(&["run", &plan, "--field", &file(&directory, "bad.json", &bad)], &["field=bad", word]).await;
    }
    let mut unknown = field();
    unknown["hedges"] = json!([]);
    refused(&["run", &plan, "--field", &file(&directory, "bad.json", &unknown)], &["hedges"]).await;
    refused(&["run", &plan, "--field", &text_file(&directory, "bad.json", "[1,")], &["bad.json", "line 1"]).await;
    refused(&["run", &plan, "--field", "nowhere/field.json"], &["nowhere/field.json"]).await;
}

#[tokio::test]
async fn a_database_that_cannot_be_used_is_refused_and_left_alone() {
    let directory = directory();
    let plan = short_plan(&directory);
    let nowhere = path(&directory, "no/such/place.db");
    refused(&["run", &plan, "--db", &nowhere], &["place.db"]).await;
    refused(&["serve", "--db", &nowhere, "--http", "127.0.0.1:0"], &["place.db"]).await;
    let folder = path(&directory, "");
    refused(&["run", &plan, "--db", &folder], &[folder.trim_end_matches('/')]).await;
    let letter = text_file(&directory, "letter.db", &"Dear reader. ".repeat(500));
    refused(&["run", &plan, "--db", &letter], &["letter.db"]).await;
    assert!(std::fs::read_to_string(&letter).unwrap().starts_with("Dear reader."));
}

#[tokio::test]
async fn bad_input_writes_nothing() {
    let directory = directory();
    let (plan, db) = (short_plan(&directory), path(&directory, "untouched.db"));
    refused(&["run", &plan, "--db", &db, "--only", "algorithm=none"], &["algorithm"]).await;
    refused(&["run", "no/such-plan", "--db", &db], &["no/such-plan"]).await;
    assert!(!std::path::Path::new(&db).exists());
}

#[tokio::test]
async fn a_busy_port_is_named() {
    let directory = directory();
    let db = path(&directory, "served.db");
    let taken = TcpListener::bind("127.0.0.1:0").await.unwrap().into_std().unwrap();
    let address = taken.local_addr().unwrap().to_string();
    refused(&["serve", "--db", &db, "--http", &address], &["--http", &address]).await;
    let endpoint = format!("tcp/{address}");
    refused(&["serve", "--db", &db, "--http", "127.0.0.1:0", "--zenoh", &endpoint], &["--zenoh", &endpoint]).await;
    refused(&["serve", "--db", &db, "--http", "127.0.0.1:0", "--zenoh", "nonsense"], &["--zenoh", "nonsense"]).await;
    refused(&["serve", "--db", &db, "--http", "nonsense"], &["--http", "nonsense"]).await;
}

#[tokio::test]
async fn without_a_coordinator_a_worker_says_how_to_get_one() {
    let unused = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let endpoint = format!("tcp/{unused}");
    refused(&["work", "--connect", &endpoint], &[&endpoint, "furrow serve", "--connect"]).await;
    refused(&["work", "--connect", "carrier-pigeon/3"], &["--connect", "carrier-pigeon/3", "tcp/HOST:PORT"]).await;
}

#[tokio::test]
async fn without_a_server_a_client_says_where_it_looked() {
    let unused = TcpListener::bind("127.0.0.1:0").await.unwrap().local_addr().unwrap();
    let url = format!("http://{unused}");
    let finished = process::finished(&["status", "--url", &url]).await;
    assert_eq!(finished.code, Some(1), "{finished:?}");
    assert!(finished.stderr.contains(&url), "{finished:?}");
}

#[tokio::test]
async fn a_spool_that_cannot_be_one_is_named() {
    let directory = directory();
    let file = text_file(&directory, "taken", "");
    refused(&["work", "--spool", &file], &["--spool", &file]).await;
}
