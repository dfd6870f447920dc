//! Digests of a few short runs, checked in: the same bits in every profile and on every machine.
//!
//! A change that is meant to change results writes them anew: `UPDATE_GOLDEN=1 cargo test -p furrow-sim golden`.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};

use crate::scenario::tests::{base, lane, nursery};
use crate::{Scenario, Seed, simulate};

const FILE: &str = "golden/digests.json";

/// Name, perception, mission, crop, selection: short runs that together pass through every part.
fn runs() -> BTreeMap<String, Scenario> {
    let mut runs = BTreeMap::new();
    for crop in 1..=4 {
        for (name, perception, mission) in [
            ("pearl", json!({"kind": "pearl"}), "row-by-row"),
            ("ruby", json!({"kind": "ruby"}), "row-by-row"),
            ("rg", json!({"kind": "rg"}), "row-by-row"),
            ("rgop", json!({"kind": "rgop"}), "row-by-row"),
            ("rgoppn", json!({"kind": "rgoppn"}), "row-by-row"),
            ("rgoppni", json!({"kind": "rgoppni"}), "row-by-row"),
            ("rgoppni-as-printed", json!({"kind": "rgoppni", "selection": "as-printed"}), "row-by-row"),
            ("ruby-as-printed", json!({"kind": "ruby", "selection": "as-printed"}), "row-by-row"),
            ("rgop-as-printed", json!({"kind": "rgop", "selection": "as-printed", "passes_per_scan": 2}), "row-by-row"),
            ("oracle", json!({"kind": "oracle"}), "row-by-row"),
            ("heading-hold", json!({"kind": "none"}), "heading-hold"),
        ] {
            let mut scenario = base();
            scenario["field"] = json!({"kind": "guyonneau2022", "crop": crop, "seed": "job"});
            scenario["perception"] = perception;
            scenario["mission"] = json!({"kind": mission});
            scenario["limits"]["max_time_s"] = json!(if name == "oracle" { 170.0 } else { 12.0 });
            runs.insert(format!("{name}-crop-{crop}"), Scenario::from_value(scenario).unwrap());
        }
    }
    runs.extend(lane_runs());
    runs.extend(nursery_runs());
    runs
}

/// Short runs in nurseries and in the test garden.
fn nursery_runs() -> BTreeMap<String, Scenario> {
    let (pid, io) = ("pid", "io-linearization");
    let mut runs = BTreeMap::new();
    for (perception, localization, control, number) in [
        ("pcl-lines", "none", pid, 5),
        ("parallel-lines-ransac", "none", pid, 60),
        ("centroid-lines", "none", pid, 20),
        ("map-lines", "none", pid, 7),
        ("map-lines", "pose-graph", io, 85),
        ("oracle", "oracle", io, 99),
    ] {
        let mut scenario = nursery();
        scenario["field"]["nursery"] = json!(number);
        for (part, kind) in [("perception", perception), ("localization", localization), ("control", control)] {
            scenario[part] = json!({"kind": kind});
        }
        scenario["limits"]["max_time_s"] = json!(20.0);
        runs.insert(
            format!("{perception}-{localization}-nursery-{number:03}"),
            Scenario::from_value(scenario).unwrap(),
        );
    }
    runs
}

/// Short runs along lanes.
fn lane_runs() -> BTreeMap<String, Scenario> {
    let (filter, view) = (json!({"kind": "ekf"}), json!({"kind": "view"}));
    let lgg = json!({"kind": "lane-pd"});
    let offset = json!({"kind": "lane-pd", "guide": "offset", "kp": 0.35, "kd": 0.75});
    let (pl, oracle) = (json!({"kind": "pl"}), json!({"kind": "oracle"}));
    let mut runs = BTreeMap::new();
    for (name, field, rate_hz, parts) in [
        ("pl-ekf-lgg", "lane-b", 40, [&pl, &filter, &lgg]),
        ("pl-ekf-lgg-at-5-hz", "lane-e", 5, [&pl, &filter, &lgg]),
        ("pl-ekf-gains", "lane-g", 40, [&pl, &filter, &offset]),
        ("pl-lgg", "lane-c", 40, [&pl, &view, &lgg]),
        ("pl-lgg", "es-1", 40, [&pl, &view, &lgg]),
        ("oracle-lgg", "production", 10, [&oracle, &view, &lgg]),
    ] {
        let mut scenario = lane();
        scenario["field"] = json!({"kind": "velasquez2022", "lane": field, "seed": "job"});
        scenario["sensors"]["rate_hz"] = json!(rate_hz);
        for (part, value) in ["perception", "localization", "control"].into_iter().zip(parts) {
            scenario[part] = value.clone();
        }
        scenario["limits"]["max_time_s"] = json!(30.0);
        runs.insert(format!("{name}-{field}"), Scenario::from_value(scenario).unwrap());
    }
    runs
}

fn digests() -> BTreeMap<String, String> {
    let hex = |digest: [u8; 32]| blake3::Hash::from(digest).to_hex().to_string();
    runs().into_iter().map(|(name, scenario)| (name, hex(simulate(&scenario, Seed(7), &mut ()).digest))).collect()
}

#[test]
fn short_runs_give_the_golden_digests() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(FILE);
    let digests = digests();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        std::fs::write(&path, serde_json::to_string_pretty(&digests).unwrap() + "\n").unwrap();
    }
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    assert_eq!(serde_json::to_value(&digests).unwrap(), golden, "results have changed; see the head of this file");
}
