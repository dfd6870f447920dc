//! Clouds for tests.

use proptest::prelude::*;

use super::Point3;

fn point(coordinate: impl Strategy<Value = f64> + Clone) -> impl Strategy<Value = Point3> {
    (coordinate.clone(), coordinate.clone(), coordinate).prop_map(|(x, y, z)| Point3 { x, y, z })
}

/// Points anywhere, on a lattice (many of them equal, many distances too), in clumps or on a line.
pub(super) fn clouds() -> impl Strategy<Value = Vec<Point3>> {
    let lattice = (-6..7).prop_map(|c| 0.25 * f64::from(c));
    let clump = (point(-2.0..2.0_f64), proptest::collection::vec(point(-0.1..0.1_f64), 1..40));
    let clumps = proptest::collection::vec(clump, 0..6).prop_map(|clumps| {
        let add = |(a, some): (Point3, Vec<Point3>)| {
            some.into_iter().map(move |b| Point3 { x: a.x + b.x, y: a.y + b.y, z: a.z + b.z })
        };
        clumps.into_iter().flat_map(add).collect()
    });
    let line = proptest::collection::vec(-2.0..2.0_f64, 0..100)
        .prop_map(|along| along.into_iter().map(|t| Point3 { x: t, y: 2.0 * t, z: -t }).collect());
    prop_oneof![
        proptest::collection::vec(point(-2.0..2.0_f64), 0..200),
        proptest::collection::vec(point(lattice), 0..200),
        clumps,
        line,
    ]
}

/// Points some of which are no measurements.
pub(super) fn cloud_with_bad_points() -> impl Strategy<Value = Vec<Point3>> {
    let bad = prop_oneof![
        Just(0.0),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::NEG_INFINITY),
        Just(1e300),
        Just(-1e300),
        Just(1e10),
        Just(1e-300),
    ];
    proptest::collection::vec(point(prop_oneof![3 => -1.0..1.0_f64, 1 => bad]), 0..60)
}
