//! Lanes of corn, from a sweep to the published tables, and perception judged by labelled scans.

use serde_json::{Value, json};

use crate::bad_input::refused;
use crate::plan::{directory, path, text_file};
use crate::process;
use crate::server::Server;

/// Scans of simulated lanes with their labels.
const SCANS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../worker/navigation/benches/scans/lane.csv");

#[tokio::test]
async fn a_sweep_over_lanes_stands_beside_the_published_tables_and_claims() {
    let directory = directory();
    let server = Server::start(&path(&directory, "served.db"), 2).await;
    let set = json!({"limits.max_time_s": 15});
    let sweep = server.submit(&json!({"plan": "velasquez2022/table-1", "set": set, "seeds": 2})).await;
    server.done(sweep).await;

    let table = server.json("/v1/publications/velasquez2022/table-1").await;
    assert_eq!(table["sweep"], sweep);
    let cells = table["cells"].as_array().unwrap();
    let is_filtered = |cell: &&Value| cell["factors"] == json!({"algorithm": "pl-ekf-lgg", "field": "lane-a"});
    let cell = cells.iter().find(is_filtered).unwrap();
    assert_eq!((&cell["ours"]["n"], &cell["published"]), (&json!(2), &json!(1.0)), "{cell}");
    let claims = server.json("/v1/publications/velasquez2022/claims").await;
    assert!(["\"verdict\"", "ekf-gaps"].iter().all(|part| claims.to_string().contains(part)), "{claims}");

    let job = server.jobs(sweep).await[0]["id"].to_string();
    let drawn = server.text(&format!("/v1/jobs/{job}/trajectory.svg")).await;
    let file = path(&directory, "job.svg");
    let told = process::finished(&["job", &job, "--url", &server.url, "--svg", &file]).await;
    assert_eq!(told.code, Some(0), "{told:?}");
    assert_eq!(std::fs::read_to_string(&file).unwrap().trim_end(), drawn.trim_end());
    assert!(drawn.contains("lane-a"), "{}", &drawn[..200]);
    let poses = server.json(&format!("/v1/jobs/{job}/trajectory")).await;
    assert!(poses.to_string().len() > 1000, "15 s at 20 Hz");
}

#[tokio::test]
async fn perception_is_judged_by_labelled_scans_and_bad_files_are_refused_with_the_line() {
    let judge = async |perception: &str| process::json(&["scans", SCANS, "--perception", perception, "--json"]).await;
    for perception in ["pl", "joint-fit", "particle-filter"] {
        let judged = judge(perception).await;
        assert!(judged["scans"].as_u64().unwrap() > 10, "{judged}");
        assert!(judged["labelled"]["bad_share"].as_f64().unwrap() < 0.5, "{judged}");
        assert_eq!(judge(perception).await, judged);
    }
    let directory = directory();
    let torn = text_file(&directory, "torn.csv", "# two points are not enough\n1;0,0,1,1,2,2;3,4\n");
    refused(&["scans", &torn, "--perception", "pl"], &["torn.csv:2"]).await;
    refused(&["scans", SCANS, "--perception", "sight"], &["sight", "joint-fit"]).await;
    refused(&["scans", "nowhere.csv", "--perception", "pl"], &["nowhere.csv"]).await;
}
