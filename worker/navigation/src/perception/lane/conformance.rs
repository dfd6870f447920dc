//! What every lane finder must do, in one call.

use proptest::prelude::*;

use super::simulated::Scene;
use super::{LaneEstimate, LaneFinderSpec, LaneView, Points};
use crate::random::Stream;

const WIDTH_M: f64 = 0.75;
const MIDDLE: LaneEstimate = LaneEstimate::middle(WIDTH_M);

/// Panics with the first rule that a finder breaks; its prior's heading is off by `prior_error_rad` at most, or zero
/// if it needs none.
pub(super) fn check(spec: &LaneFinderSpec, prior_error_rad: Option<f64>) {
    an_empty_scan_shows_nothing_and_hands_the_start_on(spec);
    the_same_seed_gives_the_same_view(spec);
    a_mirrored_scan_gives_a_mirrored_view(spec);
    the_place_in_a_lane_is_found(spec, prior_error_rad);
    a_side_without_a_row_is_invalid(spec);
    any_points_give_finite_views(spec);
    a_warm_finder_allocates_nothing(spec);
}

fn find(spec: &LaneFinderSpec, points: &Points, prior: LaneEstimate) -> LaneView {
    spec.build(WIDTH_M).find(points, prior, 0.025, &mut Stream::new(1, "line-finder"))
}

pub(super) fn place(offset_m: f64, heading_rad: f64) -> LaneEstimate {
    LaneEstimate { left_m: 0.5 * WIDTH_M - offset_m, right_m: 0.5 * WIDTH_M + offset_m, heading_rad }
}

fn an_empty_scan_shows_nothing_and_hands_the_start_on(spec: &LaneFinderSpec) {
    let prior = LaneEstimate { heading_rad: 0.1, ..MIDDLE };
    assert_eq!(find(spec, &Points::default(), prior), LaneView::nothing(prior));
}

fn the_same_seed_gives_the_same_view(spec: &LaneFinderSpec) {
    let points = Scene::new(place(0.1, 0.05), 3.0).scan(&mut Stream::new(1, "scan"));
    assert_eq!(find(spec, &points, MIDDLE), find(spec, &points, MIDDLE));
}

fn a_mirrored_scan_gives_a_mirrored_view(spec: &LaneFinderSpec) {
    for seed in 0..50 {
        let points = Scene::new(place(0.08, -0.06), 3.0).scan(&mut Stream::new(seed, "scan"));
        let mirrored = Points { x_m: points.x_m.clone(), y_m: points.y_m.iter().map(|y| -y).collect() };
        let prior = LaneEstimate { heading_rad: -0.03, ..MIDDLE };
        let (view, other) = (find(spec, &points, prior), find(spec, &mirrored, place(0.0, 0.03)));
        assert!((view.heading_rad + other.heading_rad).abs() < 1e-9, "{view:?} {other:?}");
        assert!((view.left.distance_m - other.right.distance_m).abs() < 1e-9, "{view:?} {other:?}");
        assert!((view.right.distance_m - other.left.distance_m).abs() < 1e-9, "{view:?} {other:?}");
        assert_eq!((view.left.valid, view.right.valid), (other.right.valid, other.left.valid));
    }
}

/// Stems alone to a few centimetres and two degrees; among leaves nineteen of twenty to 0.1 m and five degrees.
fn the_place_in_a_lane_is_found(spec: &LaneFinderSpec, prior_error_rad: Option<f64>) {
    let mut poor = 0;
    for seed in 0..200 {
        let mut random = Stream::new(seed, "place");
        let truth = place(random.between(-0.15, 0.15), random.between(-0.25, 0.25));
        let prior_rad = prior_error_rad.map_or(0.0, |error| truth.heading_rad + random.between(-error, error));
        let prior = LaneEstimate { heading_rad: prior_rad, ..MIDDLE };
        for leaves_per_m in [0.0, 2.0] {
            let view = find(spec, &Scene::new(truth, leaves_per_m).scan(&mut random), prior);
            let off_m = 0.5 * (view.right.distance_m - view.left.distance_m) - truth.cross_track_m();
            let off_deg = (view.heading_rad - truth.heading_rad).to_degrees();
            if leaves_per_m > 0.0 {
                poor += u32::from(off_m.abs() > 0.1 || off_deg.abs() > 5.0);
            } else {
                assert!(off_m.abs() < 0.04 && off_deg.abs() < 2.0 && view.heading_valid, "{truth:?} {view:?}");
                // With the heading as good as that, both rows show.
                let prior = LaneEstimate { heading_rad: view.heading_rad, ..MIDDLE };
                let view = find(spec, &Scene::new(truth, 0.0).scan(&mut random), prior);
                assert!(view.left.valid && view.right.valid && view.heading_valid, "{truth:?} {view:?}");
            }
        }
    }
    assert!(poor <= 10, "{poor} of 200 among leaves");
}

fn a_side_without_a_row_is_invalid(spec: &LaneFinderSpec) {
    for rows in [[true, false], [false, true]] {
        let scene = Scene { rows, ..Scene::new(place(0.05, 0.04), 0.0) };
        let view = find(spec, &scene.scan(&mut Stream::new(1, "scan")), MIDDLE);
        assert_eq!([view.left.valid, view.right.valid], rows, "{view:?}");
        let (seen, distance_m) = if rows[0] { (view.left, 0.325) } else { (view.right, 0.425) };
        assert!((seen.distance_m - distance_m).abs() < 0.03 && (view.heading_rad - 0.04).abs() < 0.03, "{view:?}");
    }
}

fn a_warm_finder_allocates_nothing(spec: &LaneFinderSpec) {
    let mut finder = spec.build(WIDTH_M);
    let mut random = Stream::new(1, "line-finder");
    let scans: Vec<_> = (0..50).map(|_| Scene::new(place(0.1, 0.05), 2.0).scan(&mut random)).collect();
    let mut find_all = || {
        for points in &scans {
            finder.find(points, MIDDLE, 0.025, &mut random);
        }
    };
    (0..3).for_each(|_| find_all());
    let counted = allocation_counter::measure(find_all);
    assert_eq!(counted.count_total, 0, "{spec:?}: {counted:?}");
}

fn any_points_give_finite_views(spec: &LaneFinderSpec) {
    let coordinate = || {
        prop_oneof![
            4 => -2.0..2.0_f64,
            1 => prop_oneof![Just(0.0), Just(0.4), Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e-300)],
        ]
    };
    let scans = proptest::collection::vec(proptest::collection::vec((coordinate(), coordinate()), 0..60), 1..4);
    proptest!(ProptestConfig::with_cases(200), |(scans in scans, heading_rad in -4.0..4.0_f64)| {
        let mut finder = spec.build(WIDTH_M);
        let mut random = Stream::new(1, "line-finder");
        for scan in scans {
            let (x_m, y_m) = scan.into_iter().unzip();
            let view = finder.find(&Points { x_m, y_m }, LaneEstimate { heading_rad, ..MIDDLE }, 0.025, &mut random);
            prop_assert!(view.heading_rad.is_finite());
            for side in [view.left, view.right] {
                prop_assert!(side.distance_m.is_finite() && side.distance_m >= 0.0);
            }
        }
    });
}
