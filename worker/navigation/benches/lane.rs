//! What each part of the lane system costs per scan: `cargo bench -p furrow-navigation --bench lane`.
//!
//! The scans are simulated: twelve places between two rows with leaves, up to 3 m away, repeated until a scan has a
//! return for each of 1081 beams.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use furrow_navigation::control::{LanePd, LanePdParams, Twist};
use furrow_navigation::labelled;
use furrow_navigation::localization::LocalizationSpec;
use furrow_navigation::parameters::Kinds;
use furrow_navigation::perception::{LaneEstimate, LaneFinderSpec, LaneView, Points};
use furrow_navigation::random::Stream;
use serde_json::Map;

const BEAMS: usize = 1081;
const WIDTH_M: f64 = 0.75;
const TWIST: Twist = Twist { linear_m_s: 0.7, angular_rad_s: 0.1 };
const PERIOD_S: f64 = 0.025;

fn full_scans() -> Vec<(Points, LaneEstimate)> {
    let scans = labelled::read(include_str!("scans/lane.csv")).expect("the file holds scans");
    let full = |scan: labelled::LabelledScan| {
        let again = |values: &[f64]| values.iter().copied().cycle().take(BEAMS).collect();
        (Points { x_m: again(&scan.points.x_m), y_m: again(&scan.points.y_m) }, scan.label.expect("all are labelled"))
    };
    scans.into_iter().map(full).collect()
}

fn lane_finders(criterion: &mut Criterion) {
    let scans = full_scans();
    for kind in LaneFinderSpec::kinds() {
        let mut finder = LaneFinderSpec::read_kind(kind, Map::new()).expect("defaults are allowed").build(WIDTH_M);
        let mut random = Stream::new(1, "line-finder");
        let mut turn = scans.iter().cycle();
        criterion.bench_function(kind, |bench| {
            bench.iter(|| {
                let (points, label) = turn.next().expect("a cycle has no end");
                black_box(finder.find(points, *label, 0.025, &mut random))
            });
        });
    }
}

fn lane_estimators(criterion: &mut Criterion) {
    let scans = full_scans();
    for kind in LocalizationSpec::kinds() {
        let spec = LocalizationSpec::read_kind(kind, Map::new()).expect("defaults are allowed");
        let Some(mut estimator) = spec.lane_estimator(WIDTH_M) else { continue };
        let mut random = Stream::new(1, "localization");
        let mut turn = scans.iter().cycle();
        criterion.bench_function(kind, |bench| {
            bench.iter(|| {
                let (points, label) = turn.next().expect("a cycle has no end");
                estimator.predict(TWIST, PERIOD_S);
                estimator.correct(points, LaneView::nothing(*label), &mut random);
                black_box(estimator.estimate())
            });
        });
    }
}

fn lane_control(criterion: &mut Criterion) {
    let mut control = LanePd::new(&LanePdParams::default());
    let places = full_scans();
    let mut turn = places.iter().cycle();
    criterion.bench_function("lane-pd", |bench| {
        bench.iter(|| black_box(control.steer(turn.next().expect("a cycle has no end").1, PERIOD_S)));
    });
}

criterion_group!(benches, lane_finders, lane_estimators, lane_control);
criterion_main!(benches);
