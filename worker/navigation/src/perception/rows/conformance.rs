//! What every row detector must do.

use proptest::prelude::*;

use super::{DetectedRows, PlantPoints, RowDetector, RowDetectorSpec};
use crate::Pose;
use crate::localization::PlantingMap;
use crate::parameters::Kinds;
use crate::perception::cloud::Point3;
use crate::random::Stream;

const MAP: PlantingMap =
    PlantingMap { row_distance_m: 1.3, planting_distance_m: 0.4, rows: 5, plants_per_row: 21, lanes_to_the_left: true };

fn all() -> Vec<(&'static str, Box<dyn RowDetector>)> {
    let build = |kind| RowDetectorSpec::read_kind(kind, Default::default()).unwrap().build(&MAP);
    RowDetectorSpec::kinds().into_iter().map(|kind| (kind, build(kind))).collect()
}

/// Two rows of small bushes, seen `offset_m` left of the middle and turned by `heading_rad`; `side` -1 mirrors all.
fn scan(offset_m: f64, heading_rad: f64, side: f64, seed: u64) -> Vec<Point3> {
    let mut random = Stream::new(seed, "scan");
    let (sin, cos) = libm::sincos(heading_rad);
    let rows = [0.65, -0.65].map(|y| y - offset_m);
    let bushes = (0..12).flat_map(|i| rows.map(|y| [1.7 + 0.4 * f64::from(i), y]));
    let leaves = bushes.flat_map(|bush| (0..60).map(move |_| bush));
    leaves
        .map(|[x, y]| {
            let [x, y] = [x + 0.05 * random.normal(), y + 0.05 * random.normal()];
            Point3 { x: cos * x + sin * y, y: side * (cos * y - sin * x), z: random.between(0.05, 0.5) }
        })
        .collect()
}

fn detect<'a>(detector: &'a mut dyn RowDetector, points: &[Point3], random: &mut Stream) -> DetectedRows<'a> {
    detector.detect(PlantPoints { points, odometry_from_robot: Pose::default() }, random)
}

#[test]
fn no_points_are_no_rows() {
    for (kind, mut detector) in all() {
        let rows = detect(detector.as_mut(), &[], &mut Stream::new(1, "rows"));
        assert_eq!(rows, DetectedRows::default(), "{kind}");
    }
}

#[test]
fn the_rows_beside_the_robot_are_found_on_their_sides() {
    for (kind, mut detector) in all() {
        let mut found = 0;
        for seed in 0..100 {
            let (offset_m, heading_rad) = (0.1, 0.08);
            let points = scan(offset_m, heading_rad, 1.0, seed);
            let mut random = Stream::new(seed, "rows");
            let mut offsets: Vec<_> = detect(detector.as_mut(), &points, &mut random)
                .lines
                .iter()
                .flatten()
                .filter(|line| (libm::atan2(line.direction[1], line.direction[0]) + heading_rad).abs() < 0.07)
                .map(|line| line.left_of([0.0, 0.0]))
                .collect();
            offsets.sort_by(f64::total_cmp);
            let expected = [-0.65 + offset_m, 0.65 + offset_m];
            let near = offsets.iter().zip(expected).filter(|(is, should)| (*is - should).abs() < 0.15).count();
            found += usize::from(near == 2);
        }
        assert!(found >= 80, "{kind}: {found} of 100");
    }
}

#[test]
fn the_same_seed_gives_the_same_rows() {
    let points = scan(0.0, 0.1, 1.0, 3);
    for ((kind, mut one), (_, mut other)) in all().into_iter().zip(all()) {
        let rows = detect(one.as_mut(), &points, &mut Stream::new(7, "rows"));
        assert_eq!(rows, detect(other.as_mut(), &points, &mut Stream::new(7, "rows")), "{kind}");
    }
}

#[test]
fn a_warm_detector_allocates_nothing() {
    for (kind, mut detector) in all() {
        let points = scan(0.0, 0.05, 1.0, 5);
        let mut random = Stream::new(1, "rows");
        let mut detect_often = |times: u32| {
            (0..times).filter(|_| detect(detector.as_mut(), &points, &mut random).lines[0].is_some()).count()
        };
        detect_often(30);
        let allocated = allocation_counter::measure(|| assert_eq!(detect_often(5), 5));
        assert_eq!(allocated.count_total, 0, "{kind}");
    }
}

proptest! {
    #[test]
    fn any_points_give_finite_rows(
        points in prop::collection::vec((-9.0..9.0_f64, -4.0..4.0_f64, 0.0..2.0_f64), 0..80),
        same in 0..20_usize,
        x_m in prop_oneof![Just(0.0), -1e9..1e9_f64, Just(f64::NAN)],
    ) {
        let mut points: Vec<_> = points.into_iter().map(|(x, y, z)| Point3 { x, y, z }).collect();
        if let Some(first) = points.first().copied() {
            points.extend(std::iter::repeat_n(first, same));
        }
        for (kind, mut detector) in all() {
            for seed in 0..3 {
                let odometry_from_robot = Pose { x_m, ..Pose::default() };
                let view = PlantPoints { points: &points, odometry_from_robot };
                let rows = detector.detect(view, &mut Stream::new(seed, "rows"));
                let finite = |line: &super::RowLine| line.point.iter().chain(&line.direction).all(|part| part.is_finite());
                prop_assert!(rows.lines.iter().flatten().all(finite), "{}", kind);
            }
        }
    }
}
