//! What every line finder must do, in one call.

use serde_json::json;

use super::{Beams, Line, LineFinderSpec, Scan};
use crate::parameters::{Kinds, Parameter};
use crate::random::Stream;
use proptest::prelude::*;

/// Panics with the first rule that a finder breaks.
pub(super) fn check(spec: &LineFinderSpec) {
    check_but_for_success(spec);
    two_rows_are_found(spec);
}

/// Likewise, for parameters with which a finder is known to miss rows.
pub(super) fn check_but_for_success(spec: &LineFinderSpec) {
    an_empty_scan_gives_no_lines(spec);
    the_same_seed_gives_the_same_lines(spec);
    a_mirrored_scan_gives_mirrored_lines_in_distribution(spec);
    any_scan_gives_finite_lines(spec);
    a_warm_finder_allocates_nothing(spec);
}

/// Panics if the largest and smallest parameters break a finder of this kind.
pub(super) fn check_extremes(kind: &str) {
    let table = LineFinderSpec::table(kind).expect("a finder's kind");
    for end in [0, 1] {
        let keys = ["lines", "keep", "tiny", "attach_distance_m", "bad_distance_m", "fuse_distance_m"];
        let ranges = table.iter().filter(|parameter| keys.contains(&parameter.name));
        let value = |parameter: &Parameter| {
            let value = parameter.range.expect("these have a range")[end];
            if parameter.unit == "1" { json!(value as u64) } else { json!(value) }
        };
        let mut parameters: serde_json::Map<_, _> =
            ranges.map(|parameter| (parameter.name.to_owned(), value(parameter))).collect();
        for selection in ["as-run", "as-printed"] {
            parameters.insert("selection".to_owned(), json!(selection));
            let spec = LineFinderSpec::read_kind(kind, parameters.clone()).expect("the ends of a range are allowed");
            for n in [2, 360, 2000] {
                find(&spec, &[vec![1.0; n], (0..n).map(|i| 1.0 + 3.0 * i as f64 / n as f64).collect()], 1);
            }
        }
    }
}

fn find(spec: &LineFinderSpec, scans: &[Vec<f64>], seed: u64) -> Vec<Line> {
    let beams = beams(scans[0].len());
    let mut finder = spec.build();
    let mut random = Stream::new(seed, "line-finder");
    let mut lines = Vec::new();
    for ranges_m in scans {
        lines = finder.find(&Scan { beams: &beams, ranges_m }, &mut random).lines.to_vec();
    }
    lines
}

fn beams(n: usize) -> Beams {
    Beams::new(n, std::f64::consts::PI)
}

/// A scan between two rows of stems at y = `left` and y = -`right`, every 0.3 m, noise of 0.01 m.
fn two_rows(left: f64, right: f64, seed: u64) -> Vec<f64> {
    let beams = beams(360);
    let mut noise = Stream::new(seed, "noise");
    let mut ranges = vec![f64::INFINITY; 360];
    for row in [left, -right] {
        for i in 0..12 {
            let (x, y): (f64, f64) = (0.1 + 0.3 * f64::from(i), row);
            let range = libm::hypot(x, y);
            let beam = (libm::atan2(y, x) - beams.angle_min_rad) / beams.angle_increment_rad;
            ranges[(beam.round() as usize).min(359)] = range + 0.01 * noise.normal();
        }
    }
    ranges
}

fn an_empty_scan_gives_no_lines(spec: &LineFinderSpec) {
    assert_eq!(find(spec, &[vec![f64::INFINITY; 360]], 1), []);
}

fn the_same_seed_gives_the_same_lines(spec: &LineFinderSpec) {
    let scans = [two_rows(0.5, 0.5, 1), two_rows(0.5, 0.5, 2)];
    assert_eq!(find(spec, &scans, 7), find(spec, &scans, 7));
}

fn two_rows_are_found(spec: &LineFinderSpec) {
    let scans: Vec<_> = (0..5).map(|i| two_rows(0.6, 0.4, i)).collect();
    let close =
        |intercept: f64| move |line: &Line| line.slope.abs() < 0.1 && (line.intercept_m - intercept).abs() < 0.06;
    let found = (0..20).filter(|seed| {
        let lines = find(spec, &scans, *seed);
        lines.iter().any(close(0.6)) && lines.iter().any(close(-0.4))
    });
    assert!(found.count() >= 18);
}

fn a_mirrored_scan_gives_mirrored_lines_in_distribution(spec: &LineFinderSpec) {
    let mean = |mirrored: bool| {
        let mut sum = (0.0, 0.0, 0.0);
        for seed in 0..200 {
            let mut ranges = two_rows(0.7, 0.4, seed);
            if mirrored {
                ranges.reverse();
            }
            for line in find(spec, &[ranges], seed) {
                sum = (sum.0 + line.slope, sum.1 + line.intercept_m, sum.2 + 1.0);
            }
        }
        (sum.0 / sum.2, sum.1 / sum.2)
    };
    let (plain, mirrored) = (mean(false), mean(true));
    assert!((plain.0 + mirrored.0).abs() < 0.05 && (plain.1 + mirrored.1).abs() < 0.05, "{plain:?} {mirrored:?}");
}

/// After as many scans of a kind as its vectors take to grow, of which a later one may be the largest yet.
fn a_warm_finder_allocates_nothing(spec: &LineFinderSpec) {
    let beams = beams(360);
    let mut finder = spec.build();
    let mut random = Stream::new(1, "line-finder");
    let scans: Vec<_> = (0..50).map(|seed| two_rows(0.6, 0.4, seed)).collect();
    let mut find_all = || {
        for ranges_m in &scans {
            finder.find(&Scan { beams: &beams, ranges_m }, &mut random);
        }
    };
    (0..20).for_each(|_| find_all());
    let counted = allocation_counter::measure(find_all);
    assert_eq!(counted.count_total, 0, "{spec:?}: {counted:?}");
    assert!(allocation_counter::measure(|| drop(scans.clone())).count_total > 50, "what is allocated is counted");
}

fn any_scan_gives_finite_lines(spec: &LineFinderSpec) {
    let range = prop_oneof![
        Just(f64::INFINITY),
        Just(f64::NAN),
        Just(0.0),
        Just(-1.0),
        Just(0.3),
        0.1..4.0_f64,
        Just(1e-300),
        Just(1e6),
        Just(1e200),
        Just(f64::MAX)
    ];
    let scans = proptest::collection::vec(proptest::collection::vec(range, 60), 1..4);
    proptest!(ProptestConfig::with_cases(100), |(scans in scans, seed in any::<u64>())| {
        for line in find(spec, &scans, seed) {
            prop_assert!(line.slope.is_finite() && line.intercept_m.is_finite());
        }
    });
    for scan in degenerate_scans() {
        for line in find(spec, &[scan.clone(), scan], 1) {
            assert!(line.slope.is_finite() && line.intercept_m.is_finite());
        }
    }
}

/// All returns on one vertical line, on one that runs straight ahead, on one across, and all in one place.
fn degenerate_scans() -> [Vec<f64>; 4] {
    let beams = beams(60);
    let wall = |across: &[f64], distance: f64| -> Vec<f64> {
        across.iter().map(|part| if *part > 0.05 { distance / part } else { f64::INFINITY }).collect()
    };
    let diagonal: Vec<f64> = beams.cos.iter().zip(&beams.sin).map(|(cos, sin)| 0.7 * cos + 0.7 * sin).collect();
    [wall(&beams.cos, 1.0), wall(&beams.sin, 0.5), wall(&diagonal, 0.4), vec![1e-9; 60]]
}
