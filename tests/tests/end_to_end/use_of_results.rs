//! What can be read of a finished sweep, and that the command line says the same as HTTP.

use serde_json::json;

use crate::bad_input::refused;
use crate::plan::{directory, path, plan};
use crate::process;
use crate::server::Server;

#[tokio::test]
async fn a_finished_sweep_is_a_table_a_list_of_jobs_and_a_picture() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 2).await;
    let sweep = server.submit(&json!({"plan": plan(5.0, 2), "record": true})).await;
    server.done(sweep).await;

    let table = server.json(&format!("/v1/sweeps/{sweep}/table?group_by=algorithm&metric=simulated_s")).await;
    let cells = table["cells"].as_array().unwrap();
    assert_eq!(cells.len(), 2);
    assert!(cells.iter().all(|cell| cell["n"] == 4 && cell["metrics"]["simulated_s"]["max"] == 5.0), "{table}");
    let csv = server.text(&format!("/v1/sweeps/{sweep}/table?group_by=algorithm&metric=simulated_s&format=csv")).await;
    assert!(csv.lines().count() == 3 && csv.contains("rgop"), "{csv}");

    let jobs = server.jobs(sweep).await;
    assert_eq!(jobs.len(), 8);
    let job = server.json(&format!("/v1/jobs/{}", jobs[0]["id"])).await;
    assert_eq!((&job["digest"], &job["recorded"]), (&jobs[0]["digest"], &json!(true)));
    assert_eq!(job["scenario"]["limits"]["max_time_s"], 5.0);
    assert!(job["timings"]["wall_ms"].as_f64().unwrap() > 0.0);
    let picture = server.text(&format!("/v1/jobs/{}/trajectory.svg", jobs[0]["id"])).await;
    assert!(picture.starts_with("<svg") || picture.starts_with("<?xml"), "{}", &picture[..80]);
}

#[tokio::test]
async fn the_command_line_sees_what_the_server_has() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 2).await;
    let plan = crate::plan::file(&directory, "plan.json", &plan(2.0, 1));
    let submitted = process::json(&["submit", &plan, "--url", &server.url, "--json"]).await;
    let sweep = submitted["id"].as_i64().unwrap();
    server.done(sweep).await;
    let number = sweep.to_string();
    let status = process::json(&["status", &number, "--url", &server.url, "--json"]).await;
    assert_eq!((&status["state"], &status["done"]), (&json!("done"), &json!(4)));
    let table = process::finished(&["table", &number, "--url", &server.url, "--format", "csv"]).await;
    assert!(table.code == Some(0) && table.stdout.contains("oracle"), "{table:?}");
    let job = server.jobs(sweep).await[0]["id"].to_string();
    let job = process::json(&["job", &job, "--url", &server.url, "--json"]).await;
    assert_eq!(job["state"], "done");
}

#[tokio::test]
async fn levels_are_compared_and_runs_exported_by_command_as_over_http() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 2).await;
    let sweep = server.submit(&json!({"plan": plan(2.0, 3)})).await;
    server.done(sweep).await;
    let number = sweep.to_string();

    let question = ["--factor", "algorithm", "--a", "oracle", "--b", "rgop", "--metric", "mean_squared_error_mm2"];
    let args = [&["compare", number.as_str(), "--url", &server.url, "--json"][..], &question].concat();
    let compared = process::json(&args).await;
    assert_eq!((&compared["groups"][0]["pairs"], &compared["groups"][0]["incomplete"]), (&json!(6), &json!(0)));
    let asked = format!("/v1/sweeps/{sweep}/compare?factor=algorithm&a=oracle&b=rgop&metric=mean_squared_error_mm2");
    assert_eq!(server.json(&asked).await["groups"], compared["groups"]);
    let wrong = ["compare", &number, "--url", &server.url, "--factor", "algorithm", "--a", "oracle", "--b", "ruby"];
    refused(&wrong, &["ruby", "rgop"]).await;

    for (format, begins) in [("csv", &b"job,"[..]), ("json", b"{"), ("parquet", b"PAR1")] {
        let file = path(&directory, &format!("runs.{format}"));
        let args = ["export", &number, "--url", &server.url, "--format", format, "--output", &file];
        let exported = process::finished(&args).await;
        assert_eq!(exported.code, Some(0), "{exported:?}");
        let bytes = std::fs::read(&file).unwrap();
        assert!(bytes.starts_with(begins), "{format}: {:?}", String::from_utf8_lossy(&bytes[..20]));
        if format != "parquet" {
            let lines = bytes.iter().filter(|byte| **byte == b'\n').count();
            assert_eq!(lines, 12 + usize::from(format == "csv"), "a line a run");
        }
    }
}

#[tokio::test]
async fn a_run_is_replayed_into_a_file_that_is_whole_or_not_there() {
    let directory = directory();
    let database = path(&directory, "served.db");
    let server = Server::start(&database, 2).await;
    let sweep = server.submit(&json!({"plan": plan(2.0, 1)})).await;
    server.done(sweep).await;
    let job = server.jobs(sweep).await[0]["id"].to_string();
    let (asked, read) = (path(&directory, "asked.mcap"), path(&directory, "read.mcap"));
    for source in [["--url", &server.url, "--mcap", &asked], ["--db", &database, "--mcap", &read]] {
        let replayed = process::finished(&[&["replay", job.as_str()][..], &source].concat()).await;
        assert_eq!((replayed.code, replayed.stdout.as_str()), (Some(0), ""), "{replayed:?}");
    }
    let bytes = std::fs::read(&asked).unwrap();
    const MAGIC: &[u8] = b"\x89MCAP0\r\n";
    assert!(bytes.len() > 10_000 && bytes.starts_with(MAGIC) && bytes.ends_with(MAGIC), "{} bytes", bytes.len());
    assert!(bytes == std::fs::read(&read).unwrap(), "the same run gives the same bytes");

    let replay = |job: &str, file: &str| ["replay", job, "--url", &server.url, "--mcap", file].map(str::to_owned);
    let nowhere = replay("999", &path(&directory, "nowhere.mcap"));
    refused(&nowhere.each_ref().map(String::as_str), &["999"]).await;
    let lost = replay(&job, &path(&directory, "no/such/folder.mcap"));
    let lost = process::finished(&lost.each_ref().map(String::as_str)).await;
    assert!(lost.code == Some(1) && lost.stderr.contains("folder.mcap"), "{lost:?}");
    let left = std::fs::read_dir(directory.path()).unwrap().map(|entry| entry.unwrap().file_name());
    let mut left: Vec<_> =
        left.filter_map(|name| name.into_string().ok()).filter(|name| !name.contains(".db")).collect();
    left.sort();
    assert_eq!(left, ["asked.mcap", "read.mcap"]);
    refused(&["replay", &job, "--url", &server.url], &["--mcap"]).await;
}

#[tokio::test]
async fn plans_are_listed_and_the_interface_describes_itself() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 0).await;
    assert!(server.text("/v1/plans").await.contains("guyonneau2022/algorithm-5"));
    let document = server.json("/openapi.json").await;
    assert!(document["openapi"].as_str().unwrap().starts_with("3.1"));
    assert!(document["paths"]["/v1/sweeps"]["post"].is_object());
    let listed = process::finished(&["plans"]).await;
    assert!(listed.code == Some(0) && listed.stdout.contains("guyonneau2022/bounds"), "{listed:?}");
}

#[tokio::test]
async fn a_report_is_a_file_that_stands_alone() {
    let directory = directory();
    let db = path(&directory, "results.db");
    let plan = crate::plan::file(&directory, "plan.json", &plan(2.0, 1));
    process::json(&["run", &plan, "--db", &db, "--json"]).await;
    for (name, begins) in [("report.html", "<!doctype html>"), ("report.md", "# ")] {
        let file = path(&directory, name);
        let written = process::finished(&["report", "1", "--db", &db, "--output", &file]).await;
        assert_eq!(written.code, Some(0), "{written:?}");
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(text.starts_with(begins) && text.contains("Single runs"), "{name}");
    }
    refused(&["report", "1", "--db", &db, "--format", "pdf"], &["html", "md"]).await;
}

#[tokio::test]
async fn seeds_are_added_until_the_interval_is_narrow_or_there_are_enough() {
    let directory = directory();
    let db = path(&directory, "results.db");
    let plan = crate::plan::file(&directory, "plan.json", &plan(2.0, 1));
    let narrow = process::json(&["run", &plan, "--until", "simulated_s<=0.1", "--json"]).await;
    let until = &narrow["until"];
    assert_eq!((&until["reached"], &until["looks"], &until["seeds"]), (&json!(true), &json!(1), &json!(5)), "{until}");

    let args = ["run", &plan, "--until", "success<=0.5", "--max-seeds", "7", "--db", &db, "--json"];
    let wide = process::finished(&args).await;
    assert!(wide.code == Some(1) && wide.stderr.contains("not reached with 7 seeds"), "{wide:?}");
    let said: serde_json::Value = serde_json::from_str(&wide.stdout).unwrap();
    assert_eq!((&said["until"]["looks"], &said["runs"], &said["cached"]), (&json!(2), &json!(28), &json!(0)));
    let sweeps = process::json(&["status", "--db", &db, "--json"]).await;
    assert_eq!(sweeps["items"].as_array().unwrap().len(), 1, "the look before leaves no sweep behind");
    let number = sweeps["items"][0]["id"].to_string();
    let report = process::finished(&["report", &number, "--db", &db]).await;
    assert!(report.stdout.contains("&quot;seeds&quot;: 7"), "{report:?}");
    refused(&["run", &plan, "--until", "robot:success"], &["robot", "algorithm"]).await;
    refused(&["run", &plan, "--until", "luck<=1"], &["luck", "success"]).await;
}

#[tokio::test]
async fn parameters_are_listed_with_their_ranges() {
    let listed = process::finished(&["parameters", "perception.rgop"]).await;
    assert!(listed.code == Some(0) && listed.stdout.contains("perception.iterations"), "{listed:?}");
    let control = process::json(&["parameters", "control", "--json"]).await;
    assert_eq!(control["items"][0]["schema"]["properties"]["kind"], json!({"const": "fuzzy"}));
    refused(&["parameters", "weather"], &["field", "perception"]).await;
    let script = process::finished(&["completions", "bash"]).await;
    assert!(script.code == Some(0) && script.stdout.contains("_furrow"), "{script:?}");
}
