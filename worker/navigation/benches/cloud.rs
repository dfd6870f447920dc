//! What each building block of clouds costs per scan: `cargo bench -p furrow-navigation --bench cloud`.
//!
//! The scans are made here: 65 x 40 rays of 60 x 50 degrees, 0.55 m above rough ground and 5 degrees down, between rows of
//! porous plants.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use furrow_navigation::Pose;
use furrow_navigation::perception::cloud::{CloudMount, Clusters, FrontEnd, FrontEndParams, LocalMap, Point3};
use furrow_navigation::perception::rows::RowDetectorSpec;
use furrow_navigation::perception::rows::map_lines::MapLinesParams;
use furrow_navigation::random::Stream;

const HEIGHT_M: f64 = 0.55;
const PITCH_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
const NEAREST_M: f64 = 0.3;
const FARTHEST_M: f64 = 15.0;
/// At 0.8 m/s and 10 Hz.
const STEP_M: f64 = 0.08;
const VOXEL_M: f64 = 0.03;
const WINDOW_M: f64 = 6.0;
const TOLERANCE_M: f64 = 0.06;

/// A field of two lanes on both sides of the robot's.
struct Field {
    plants: Vec<Plant>,
    /// Leaves met per metre of a ray.
    density_per_m: f64,
}

struct Plant {
    centre: [f64; 3],
    radii: [f64; 3],
}

impl Field {
    fn new(spacing_m: f64, radius_m: f64, half_height_m: f64, density_per_m: f64) -> Self {
        let mut random = Stream::new(1, "field");
        let mut plants = Vec::new();
        for y in [-1.95, -0.65, 0.65, 1.95] {
            for i in -10..(40.0 / spacing_m) as i32 {
                let grown = 1.0 + 0.2 * random.normal();
                let x = spacing_m * f64::from(i) + 0.04 * random.normal();
                let half_height_m = half_height_m * grown;
                plants.push(Plant {
                    centre: [x, y + 0.04 * random.normal(), half_height_m],
                    radii: [radius_m * grown, radius_m * grown, half_height_m],
                });
            }
        }
        Self { plants, density_per_m }
    }

    /// What the LiDAR at `x_m` sees, in its own frame. Leaves stand still: each place in a plant has its own chance.
    fn scan(&self, x_m: f64, random: &mut Stream) -> Vec<Point3> {
        let directions = (0..40).flat_map(|row| (0..65).map(move |column| (row, column)));
        let in_reach = |plant: &&Plant| (x_m - 1.0..x_m + FARTHEST_M).contains(&plant.centre[0]);
        let plants: Vec<_> = self.plants.iter().filter(in_reach).collect();
        let mut points = Vec::new();
        for (row, column) in directions {
            let elevation = (-25.0 + 50.0 * f64::from(row) / 39.0).to_radians();
            let azimuth = (-30.0 + 60.0 * f64::from(column) / 64.0).to_radians();
            let (sin_el, cos_el) = libm::sincos(elevation);
            let (sin_az, cos_az) = libm::sincos(azimuth);
            let ray = [cos_el * cos_az, cos_el * sin_az, sin_el];
            let range_m = self.range_m(&plants, [x_m, 0.0, HEIGHT_M], levelled(ray), random);
            let range_m = range_m + 0.01 * libm::exp(range_m / 10.0) * random.normal();
            if (NEAREST_M..FARTHEST_M).contains(&range_m) {
                let [x, y, z] = ray.map(|c| range_m * c);
                points.push(Point3 { x, y, z });
            }
        }
        points
    }

    fn range_m(&self, plants: &[&Plant], from: [f64; 3], ray: [f64; 3], random: &mut Stream) -> f64 {
        let ground_m = if ray[2] < 0.0 { (HEIGHT_M + 0.02 * random.normal()) / -ray[2] } else { f64::INFINITY };
        let leaves = plants.iter().filter_map(|plant| self.first_leaf_m(plant, from, ray));
        leaves.fold(ground_m, f64::min)
    }

    fn first_leaf_m(&self, plant: &Plant, from: [f64; 3], ray: [f64; 3]) -> Option<f64> {
        const STEP_M: f64 = 0.04;
        let scaled = |v: [f64; 3]| [0, 1, 2].map(|i| v[i] / plant.radii[i]);
        let to = scaled([0, 1, 2].map(|i| from[i] - plant.centre[i]));
        let along = scaled(ray);
        let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let (a, b, c) = (dot(along, along), dot(to, along), dot(to, to) - 1.0);
        let root = (b * b - a * c).sqrt();
        let (enter, leave) = (((-b - root) / a).max(0.0), (-b + root) / a);
        let steps = ((leave - enter) / STEP_M).ceil();
        (0..steps as u32).map(|step| enter + STEP_M * f64::from(step)).find(|range_m| {
            let place = [0, 1, 2].map(|i| ((from[i] + range_m * ray[i]) / STEP_M).floor() as i64 as u64);
            let mixed =
                place.iter().fold(7, |hash: u64, c| (hash ^ c).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29));
            (mixed >> 11) as f64 / (1_u64 << 53) as f64 > libm::exp(-self.density_per_m * STEP_M)
        })
    }
}

/// From the LiDAR's frame to one that is level.
fn levelled([x, y, z]: [f64; 3]) -> [f64; 3] {
    let (sin, cos) = libm::sincos(PITCH_RAD);
    [cos * x + sin * z, y, cos * z - sin * x]
}

/// Young plants close together, trees, and a hedge.
fn fields() -> [(&'static str, Field); 3] {
    [
        ("young", Field::new(0.4, 0.18, 0.4, 6.0)),
        ("trees", Field::new(1.4, 0.5, 1.2, 3.0)),
        ("hedge", Field::new(0.4, 0.35, 0.8, 8.0)),
    ]
}

fn scans(field: &Field, n: usize) -> Vec<Vec<Point3>> {
    let mut random = Stream::new(1, "scan");
    (0..n).map(|i| field.scan(STEP_M * i as f64, &mut random)).collect()
}

fn params() -> FrontEndParams {
    RowDetectorSpec::MapLines(MapLinesParams::default()).front_end()
}

/// As it sits on the robot.
fn front_end() -> FrontEnd {
    FrontEnd::new(&params(), CloudMount { x_m: 0.0, height_m: HEIGHT_M, pitch_down_rad: PITCH_RAD })
}

fn plants(scans: &[Vec<Point3>]) -> Vec<Vec<Point3>> {
    let (mut front_end, mut random) = (front_end(), Stream::new(1, "ground"));
    let above = |scan: &Vec<Point3>| {
        front_end.filter(scan);
        front_end.find_ground(&mut random);
        front_end.plants().to_vec()
    };
    scans.iter().map(above).collect()
}

fn filters(criterion: &mut Criterion) {
    for (name, field) in fields() {
        let scans = scans(&field, 40);
        let n: usize = scans.iter().map(Vec::len).sum();
        let mut group = criterion.benchmark_group(format!("{name}, {} points", n / scans.len()));
        let mut turn = scans.iter().cycle();
        let (mut front_end, mut random) = (front_end(), Stream::new(1, "plane"));
        group.bench_function("outliers", |bench| {
            let next = || turn.next().expect("a cycle has no end");
            bench.iter_batched(next, |scan| front_end.filter(scan), BatchSize::SmallInput);
        });
        group.bench_function("ground", |bench| bench.iter(|| front_end.find_ground(&mut random)));
    }
}

fn rows(criterion: &mut Criterion) {
    for (name, field) in fields() {
        let plants = plants(&scans(&field, 40));
        let n: usize = plants.iter().map(Vec::len).sum();
        let mut group = criterion.benchmark_group(format!("{name}, {} plant points", n / plants.len()));
        let mut turn = plants.iter().cycle();
        let mut next = || turn.next().expect("a cycle has no end");
        let mut clusters = Clusters::default();
        for tolerance_m in [0.1, 0.6] {
            group.bench_function(format!("clusters {tolerance_m} m"), |bench| {
                let find = |scan: &Vec<Point3>| clusters.find(scan, tolerance_m, 10).count();
                bench.iter_batched(&mut next, find, BatchSize::SmallInput);
            });
        }
    }
}

fn local_map(criterion: &mut Criterion) {
    for (name, field) in fields() {
        let plants = plants(&scans(&field, 300));
        let drive = |map: &mut LocalMap, i: usize| {
            map.insert(&plants[i], Pose { x_m: STEP_M * i as f64, ..Pose::default() });
            map.clusters(15).len()
        };
        let empty = || LocalMap::new(VOXEL_M, (WINDOW_M, 150), TOLERANCE_M);
        let mut map = empty();
        (0..200).for_each(|i| {
            black_box(drive(&mut map, i));
        });
        let mut group = criterion.benchmark_group(format!("{name}, map of {}", map.points().len()));
        group.sample_size(20);
        // A hundred scans on from there.
        group.bench_function("100 scans", |bench| {
            let mut fresh = || {
                let mut map = empty();
                (0..200).for_each(|i| map.insert(&plants[i], Pose { x_m: STEP_M * i as f64, ..Pose::default() }));
                map
            };
            let on = |map: &mut LocalMap| (200..300).map(|i| drive(map, i)).sum::<usize>();
            bench.iter_batched_ref(&mut fresh, on, BatchSize::PerIteration);
        });
        let mut clusters = Clusters::default();
        group.bench_function("clusters from nothing", |bench| {
            bench.iter(|| clusters.find(black_box(map.points()), TOLERANCE_M, 15).count());
        });
    }
}

criterion_group!(benches, filters, rows, local_map);
criterion_main!(benches);
