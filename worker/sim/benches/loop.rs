//! What scans and whole runs cost: `cargo bench -p furrow-sim`. Line finders have their own in furrow-navigation.
//!
//! Scans are taken in the middle of the first inter-row of each crop, field seed 1.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use furrow_navigation::random::Stream;
use furrow_sim::field::{Field, FieldSeed, FieldSpec, guyonneau2022::Guyonneau2022Params};
use furrow_sim::lidar::{PlanarLidar, TwoPlanarLidarsParams};
use furrow_sim::{Pose, Scenario, Seed, simulate};
use serde_json::json;

fn field(crop: u32) -> Field {
    FieldSpec::Guyonneau2022(Guyonneau2022Params { crop, seed: FieldSeed::Fixed(1) }).build(1)
}

/// A lane of Velasquez et al. (2022), driven by the whole system.
fn lane(name: &str) -> Scenario {
    Scenario::from_value(json!({
        "field": {"kind": "velasquez2022", "lane": name}, "robot": {"kind": "skid-steer"},
        "sensors": {"kind": "one-planar-lidar"}, "perception": {"kind": "pl"}, "localization": {"kind": "ekf"},
        "control": {"kind": "lane-pd"}, "mission": {"kind": "lane"}, "observer": {"kind": "operator"},
        "limits": {"kind": "simulated-time", "max_time_s": 10.0}
    }))
    .expect("a scenario of known parts")
}

/// The front LiDAR in the middle of the first inter-row.
fn middle(field: &Field) -> Pose {
    let [x_m, y_m] = field.middles[0].at(0.5 * field.middles[0].length_m());
    Pose { x_m, y_m, heading_rad: 0.0 }.sensor(0.5, false)
}

fn scans(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("scan");
    for crop in 1..=4 {
        let field = field(crop);
        let at = middle(&field);
        let mut lidar = PlanarLidar::new(&TwoPlanarLidarsParams::default());
        let mut noise = Stream::new(1, "lidar-front");
        group.bench_function(BenchmarkId::from_parameter(format!("crop-{crop}")), |bench| {
            bench.iter(|| black_box(lidar.scan(&field.plants, black_box(at), &mut noise).ranges_m[0]));
        });
    }
}

fn runs(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("run of 10 simulated seconds");
    group.sample_size(10);
    for crop in 1..=4 {
        let scenario = Scenario::from_value(json!({
            "field": {"kind": "guyonneau2022", "crop": crop}, "robot": {"kind": "two-wheeled"},
            "sensors": {"kind": "two-planar-lidars"}, "perception": {"kind": "rgop"},
            "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
            "mission": {"kind": "row-by-row"}, "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time", "max_time_s": 10.0}
        }))
        .expect("a scenario of known parts");
        group.bench_function(BenchmarkId::from_parameter(format!("rgop, crop-{crop}")), |bench| {
            bench.iter(|| simulate(black_box(&scenario), Seed(1), &mut ()).digest);
        });
    }
    for name in ["lane-a", "lane-e", "production"] {
        let scenario = lane(name);
        group.bench_function(BenchmarkId::from_parameter(format!("pl-ekf-lgg, {name}")), |bench| {
            bench.iter(|| simulate(black_box(&scenario), Seed(1), &mut ()).digest);
        });
    }
}

criterion_group!(benches, scans, runs);
criterion_main!(benches);
