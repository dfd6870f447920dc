//! Rays among plants.

use super::*;
use furrow_navigation::random::Stream;
use proptest::prelude::*;

const FAR: [f64; 2] = [0.0, 100.0];

fn crown(x_m: f64, y_m: f64, radius_m: f64, per_m: f64) -> Shape {
    let crown = Crown { z_m: 1.0, radius_m, half_height_m: radius_m, per_m };
    Shape { x_m, y_m, row: Some(0), poles: [None, None], crown }
}

fn stem(x_m: f64, y_m: f64, radius_m: f64, top_z_m: f64) -> Shape {
    let poles = [Some(Pole { x_m, y_m, radius_m, top_z_m }), None];
    Shape { poles, ..crown(x_m, y_m, 0.001, 0.0) }
}

fn ray(origin: [f64; 3], towards: [f64; 3]) -> Ray {
    let delta = [0, 1, 2].map(|axis| towards[axis] - origin[axis]);
    let length = f64::sqrt(delta.iter().map(|d| d * d).sum());
    Ray { origin, direction: delta.map(|d| d / length) }
}

fn cast(shapes: &[Shape], ray: &Ray) -> f64 {
    let canopy = Canopy::new(shapes, [0.0; 2], 1);
    let mut tried = Tried::default();
    tried.begin(&canopy);
    canopy.cast(ray, FAR, &mut tried)
}

/// Every ray against every plant.
fn brute_force(shapes: &[Shape], ray: &Ray) -> f64 {
    let canopy = Canopy::new(shapes, [0.0; 2], 1);
    canopy.bodies.iter().map(|body| body.meet(ray, FAR, &canopy.leaves)).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_stem_is_met_at_its_face_and_missed_above_it() {
    let stems = [stem(3.0, 0.0, 0.02, 1.0), stem(5.0, 0.0, 0.02, 2.0)];
    let level = ray([0.0, 0.0, 0.5], [1.0, 0.0, 0.5]);
    assert!((cast(&stems, &level) - 2.98).abs() < 1e-12);
    let above = ray([0.0, 0.0, 1.5], [1.0, 0.0, 1.5]);
    assert!((cast(&stems, &above) - 4.98).abs() < 1e-12);
    assert!(cast(&stems, &ray([0.0, 0.1, 0.5], [1.0, 0.1, 0.5])).is_infinite());
}

#[test]
fn a_crown_lets_through_as_beer_and_lambert_say() {
    let mut random = Stream::new(1, "rays");
    for per_m in [3.0, 8.0] {
        // Rays anywhere through a sphere of 0.6 m: by the length of their chord, the share that gets through, and
        // the mean depth of the others.
        let (n, bins) = (60_000, 6);
        let (mut all, mut through, mut expected) = (vec![0.0; bins], vec![0.0; bins], vec![0.0; bins]);
        let (mut depth, mut expected_depth) = (0.0, 0.0);
        let crowns: Vec<_> = (0..20).map(|i| crown(0.31 + 3.0 * f64::from(i), 0.17, 0.6, per_m)).collect();
        let canopy = Canopy::new(&crowns, [0.0; 2], 1);
        let mut tried = Tried::default();
        tried.begin(&canopy);
        for i in 0..n {
            let body = &canopy.bodies[i % 20];
            let mut point = || {
                let direction = [random.normal(), random.normal(), random.normal()];
                let per = 0.6 / f64::sqrt(direction.iter().map(|d| d * d).sum());
                [body.x_m + per * direction[0], body.y_m + per * direction[1], 1.0 + per * direction[2]]
            };
            let (from, to) = (point(), point());
            let ray = ray(from, to);
            let chord = f64::sqrt((0..3).map(|k| (to[k] - from[k]) * (to[k] - from[k])).sum());
            let met = body.meet(&ray, FAR, &canopy.leaves);
            let bin = (chord / 1.2 * bins as f64).min(bins as f64 - 1.0) as usize;
            all[bin] += 1.0;
            expected[bin] += libm::exp(-per_m * chord);
            if met.is_infinite() {
                through[bin] += 1.0;
            } else {
                assert!(met <= chord + 1e-9);
                depth += met;
            }
            // Mean of k t exp(-k t) over the chord.
            expected_depth += (1.0 - (1.0 + per_m * chord) * libm::exp(-per_m * chord)) / per_m;
        }
        for bin in 0..bins {
            let gap = (through[bin] - expected[bin]) / all[bin];
            assert!(gap.abs() < 0.02, "{per_m}, {bin}: {through:?} {expected:?} of {all:?}");
        }
        assert!((depth / expected_depth - 1.0).abs() < 0.02, "{depth} {expected_depth}");
    }
}

#[test]
fn leaves_stand_still() {
    let canopy = Canopy::new(&[crown(0.0, 0.0, 0.4, 8.0)], [0.0; 2], 1);
    let mut tried = Tried::default();
    let mut random = Stream::new(1, "rays");
    let mut voxels = std::collections::BTreeSet::new();
    let mut hits = 0;
    tried.begin(&canopy);
    for _ in 0..20_000 {
        let (y, z) = (random.between(-0.4, 0.4), random.between(0.6, 1.4));
        let ray = ray([-3.0, random.between(-1.0, 1.0), 1.0], [0.0, y, z]);
        let t = canopy.cast(&ray, FAR, &mut tried);
        if t.is_finite() {
            hits += 1;
            let at = [0, 1, 2].map(|k| libm::floor((ray.origin[k] + t * ray.direction[k]) / 0.05) as i64);
            voxels.insert(at);
        }
    }
    // The sphere holds 2145 voxels, of which a third (1 - exp(-8 x 0.05)) stop a ray along an edge.
    assert!(hits > 15_000 && voxels.len() < 1_300, "{hits} returns from {} voxels", voxels.len());
}

#[test]
fn without_plants_a_ray_meets_nothing() {
    assert!(cast(&[], &ray([0.0, 0.0, 0.5], [1.0, 0.0, 0.5])).is_infinite());
}

#[test]
fn a_ray_that_begins_in_a_crown_meets_its_leaves() {
    let met = cast(&[crown(0.0, 0.0, 0.5, 12.0)], &ray([0.1, 0.0, 1.0], [1.0, 0.2, 1.0]));
    assert!((0.0..0.5).contains(&met), "{met}");
}

proptest! {
    #[test]
    fn the_grid_gives_the_bits_that_brute_force_gives(
        plants in proptest::collection::vec(
            (-6.0..6.0_f64, -6.0..6.0_f64, 0.02..0.8_f64, 1.0..20.0_f64, prop::bool::ANY), 0..40),
        rays in proptest::collection::vec(
            ((-8.0..8.0_f64, -8.0..8.0_f64, 0.0..3.0_f64), (-6.0..6.0_f64, -6.0..6.0_f64, 0.0..2.0_f64)), 1..40),
    ) {
        let shape = |(x, y, radius, per_m, is_stem): &(f64, f64, f64, f64, bool)| {
            if *is_stem { stem(*x, *y, 0.05 * radius, 2.0 * radius) } else { crown(*x, *y, *radius, *per_m) }
        };
        let shapes: Vec<_> = plants.iter().map(shape).collect();
        for ((x0, y0, z0), (x1, y1, z1)) in rays {
            let slanted = ray([x0, y0, z0], [x1, y1, z1]);
            prop_assert_eq!(cast(&shapes, &slanted), brute_force(&shapes, &slanted));
            let along_x = Ray { origin: [x0, y0, z0], direction: [1.0, 0.0, 0.0] };
            prop_assert_eq!(cast(&shapes, &along_x), brute_force(&shapes, &along_x));
        }
    }
}
