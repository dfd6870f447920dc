//! Rays among plants.

use super::leaves::VOXEL_M;
use super::*;
use crate::Pose;
use crate::field::vintu2018::{Crown, Pole, Standing};
use crate::lidar::frame::Frame;
use furrow_navigation::perception::cloud::CloudMount;
use furrow_navigation::random::Stream;
use proptest::prelude::*;

const FAR: [f64; 2] = [0.0, 100.0];

struct Ray {
    origin: [f64; 3],
    direction: [f64; 3],
}

fn crown(x_m: f64, y_m: f64, radius_m: f64, per_m: f64) -> Shape {
    let crown = Crown { z_m: 1.0, radius_m, half_height_m: radius_m, per_m };
    Shape { x_m, y_m, row: Some(0), poles: [None, None], crown }
}

fn stem(x_m: f64, y_m: f64, radius_m: f64, top_z_m: f64) -> Shape {
    let poles = [Some(Pole { x_m, y_m, radius_m, foot_z_m: -0.05, top_z_m }), None];
    Shape { poles, ..crown(x_m, y_m, 0.001, 0.0) }
}

fn ray(origin: [f64; 3], towards: [f64; 3]) -> Ray {
    let delta = [0, 1, 2].map(|axis| towards[axis] - origin[axis]);
    let length = f64::sqrt(delta.iter().map(|d| d * d).sum());
    Ray { origin, direction: delta.map(|d| d / length) }
}

/// One ray against every plant.
fn cast(shapes: &[Shape], ray: &Ray) -> f64 {
    first(&Canopy::new(shapes, 1), ray, FAR)
}

fn first(canopy: &Canopy, ray: &Ray, within: [f64; 2]) -> f64 {
    let (origin, direction) = (ray.origin, ray.direction);
    let stems = canopy.stems.iter().map(|stem| stem.meet(origin, direction, within));
    let leaves = canopy.foliage.iter().map(|foliage| foliage.meet(origin, direction, within, &canopy.leaves));
    stems.chain(leaves).fold(f64::INFINITY, f64::min)
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
        let canopy = Canopy::new(&crowns, 1);
        for i in 0..n {
            let foliage = &canopy.foliage[i % 20];
            let [x, y, z] = [0.31 + 3.0 * (i % 20) as f64, 0.17, 1.0];
            let mut point = || {
                let direction = [random.normal(), random.normal(), random.normal()];
                let per = 0.6 / f64::sqrt(direction.iter().map(|d| d * d).sum());
                [x + per * direction[0], y + per * direction[1], z + per * direction[2]]
            };
            let (from, to) = (point(), point());
            let ray = ray(from, to);
            let chord = f64::sqrt((0..3).map(|k| (to[k] - from[k]) * (to[k] - from[k])).sum());
            let met = foliage.meet(ray.origin, ray.direction, FAR, &canopy.leaves);
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
    let canopy = Canopy::new(&[crown(0.0, 0.0, 0.4, 2.0)], 1);
    let mut random = Stream::new(1, "rays");
    let mut voxels = std::collections::BTreeSet::new();
    let mut hits = 0;
    for _ in 0..20_000 {
        let (y, z) = (random.between(-0.4, 0.4), random.between(0.6, 1.4));
        let ray = ray([-3.0, random.between(-1.0, 1.0), 1.0], [0.0, y, z]);
        let t = first(&canopy, &ray, FAR);
        if t.is_finite() {
            hits += 1;
            let at = [0, 1, 2].map(|k| libm::floor((ray.origin[k] + t * ray.direction[k]) / VOXEL_M) as i64);
            voxels.insert(at);
        }
    }
    // The sphere reaches into some 150 voxels, of which a quarter (1 - exp(-2 x 0.15)) stop a ray along an edge.
    assert!(hits > 5_000 && voxels.len() < 75, "{hits} returns from {} voxels", voxels.len());
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

/// x, y, radius, half height \[m\] and density of leaves \[1/m\].
type Plant = (f64, f64, f64, f64, f64);

/// Whether a scan from a tilted LiDAR at the origin gives the bits that each ray against each plant gives.
fn scan_is_exact(
    plants: &[Plant],
    (heading_rad, roll_rad, pitch_rad, pitch_down_rad): (f64, f64, f64, f64),
    spread: f64,
    (moved_m, turned_rad): (f64, f64),
    scatter_seed: u64,
) -> Result<(), TestCaseError> {
    let shape = |(x, y, radius, half_height, per_m): &Plant| {
        let mut shape = crown(*x, *y, *radius, *per_m);
        shape.crown.half_height_m = *half_height;
        shape.poles =
            [stem(*x, *y, 0.05 * radius, 1.0 + half_height).poles[0], stem(x + 0.05, *y, 0.006, 1.5).poles[0]];
        shape
    };
    let shapes: Vec<_> = plants.iter().map(shape).collect();
    let canopy = Canopy::new(&shapes, 1);
    let pose = Pose { x_m: 0.0, y_m: 0.0, heading_rad };
    let mount = CloudMount { x_m: 0.0, height_m: 0.55, pitch_down_rad };
    let frame = Frame::of_lidar(mount, pose, Standing { z_m: 0.0, roll_rad, pitch_rad });
    let mut random = Stream::new(scatter_seed, "rays");
    let (mut origins, mut directions) = (Vec::new(), [Vec::new(), Vec::new(), Vec::new()]);
    for cell in 0..65 * 40 {
        let mut angle = |i: u32, n: u32, view: f64| {
            let beside = f64::from(i) + spread * random.between(-1.0, 1.0);
            view * (0.5 - beside / f64::from(n - 1))
        };
        let (azimuth, elevation) = (angle(cell % 65, 65, 1.05), angle(cell / 65, 40, 0.87));
        let ((sa, ca), (se, ce)) = (libm::sincos(azimuth), libm::sincos(elevation));
        // Turned on about the vertical, and moved on.
        let share = random.between(-1.0, 1.0);
        let on = Pose { heading_rad: heading_rad + share * turned_rad, x_m: share * moved_m, ..pose };
        let on = Frame::of_lidar(mount, on, Standing { z_m: 0.0, roll_rad, pitch_rad });
        origins.push(on.origin);
        let direction = on.turn([ce * ca, ce * sa, se]);
        (0..3).for_each(|k| directions[k].push(direction[k]));
    }
    let grid = Grid::new([65, 40], [1.05, 0.87], spread as f32, 0..65 * 40);
    let [x, y, z] = &directions;
    let rays = Rays { grid: &grid, directions: [x, y, z], from_m: 0.3 };
    let view = View::new(frame, [moved_m, turned_rad], 15.0);
    let mut found = vec![15.0; 65 * 40];
    canopy.shorten(&view, rays, |ray| origins[ray], &mut found, &mut Room::default());
    for (ray, found) in found.iter().enumerate() {
        let one = Ray { origin: origins[ray], direction: rays.direction(ray) };
        prop_assert_eq!(*found, first(&canopy, &one, [0.3, 15.0]).min(15.0));
    }
    Ok(())
}

#[test]
fn a_pole_right_beside_a_tilted_lidar_is_met() {
    let plants = [(0.084, -0.054, 0.02, 0.05, 1.0), (0.0, 0.0, 0.02, 0.05, 1.0)];
    scan_is_exact(&plants, (-0.61, -0.128, -0.194, -0.332), 0.0, (0.0, 0.0), 0).unwrap();
}

proptest! {
    #[test]
    fn windows_give_the_bits_that_brute_force_gives(
        plants in proptest::collection::vec(
            (-6.0..6.0_f64, -6.0..6.0_f64, 0.02..0.8_f64, 0.05..2.0_f64, 1.0..20.0_f64), 0..40),
        angles in (-4.0..4.0_f64, -0.2..0.2_f64, -0.2..0.2_f64, -0.4..0.4_f64),
        spread in prop_oneof![Just(0.0), 0.0..0.5_f64],
        motion in prop_oneof![Just((0.0, 0.0)), (0.0..0.1_f64, 0.0..0.1_f64)],
        scatter_seed in 0..u64::MAX,
    ) {
        scan_is_exact(&plants, angles, spread, motion, scatter_seed)?;
    }
}
