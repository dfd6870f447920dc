//! What graph localization costs per scan: `cargo bench -p furrow-navigation --bench graph`.
//!
//! A robot drives to and fro in a lane of 100 m at 0.8 m/s and scans ten times a second, so that about every third
//! scan adds a node and optimises the window. Each scan shows two lines of 200 points and twelve plants, all noisy.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use furrow_navigation::Pose;
use furrow_navigation::localization::{GraphLocalization, GraphParams, PlantingMap};
use furrow_navigation::perception::rows::{DetectedRows, RowLine};
use furrow_navigation::random::Stream;

const STEP_M: f64 = 0.08;
const SCANS: u32 = 1000;
const MAP: PlantingMap =
    PlantingMap { row_distance_m: 1.5, planting_distance_m: 1.2, rows: 2, plants_per_row: 84, lanes_to_the_left: true };

/// A scan's rows, as the robot at x = `x_m` in the middle of the lane sees them.
struct Seen {
    supports: [Vec<[f64; 2]>; 2],
    plants: Vec<[f64; 2]>,
}

impl Seen {
    fn new(x_m: f64, random: &mut Stream) -> Self {
        let mut near = |ahead: f64, left: f64| [ahead + 0.05 * random.normal(), left + 0.05 * random.normal()];
        let supports = [-0.75, 0.75].map(|left| (0..200).map(|i| near(0.5 + 0.02 * f64::from(i), left)).collect());
        let first = (x_m / MAP.planting_distance_m).floor() * MAP.planting_distance_m - x_m;
        let plants = (1..7).flat_map(|i| [-0.75, 0.75].map(|left| (first + 1.2 * f64::from(i), left)));
        Self { supports, plants: plants.map(|(ahead, left)| near(ahead, left)).collect() }
    }

    fn rows(&self) -> DetectedRows<'_> {
        let lines = [-0.75, 0.75].map(|left| Some(RowLine { point: [0.0, left], direction: [1.0, 0.0] }));
        DetectedRows { lines, supports: [&self.supports[0], &self.supports[1]], plants: &self.plants }
    }
}

fn graph(criterion: &mut Criterion) {
    let mut random = Stream::new(1, "scan");
    let there = (0..SCANS).map(|i| STEP_M * f64::from(i));
    let seen: Vec<(f64, Seen)> = there.map(|x_m| (x_m, Seen::new(x_m, &mut random))).collect();
    let mut graph = GraphLocalization::new(&GraphParams::default(), MAP, Pose::default());
    let mut turn = seen.iter().chain(seen.iter().rev()).cycle();
    criterion.bench_function("graph", |bench| {
        bench.iter(|| {
            let (x_m, seen) = turn.next().expect("a cycle has no end");
            graph.correct(Pose { x_m: *x_m, ..Pose::default() }, &seen.rows());
            black_box(graph.estimate())
        });
    });
    let (pose, matches) = graph.newest();
    assert!(graph.nodes().len() == 40 && pose.y_m.abs() < 0.1 && matches.len() > 40, "{pose:?} {}", matches.len());
}

criterion_group!(benches, graph);
criterion_main!(benches);
