//! What a nursery costs to build and a scan of the FX10 in it: `cargo bench -p furrow-sim --bench fx10`.
//!
//! Scans are taken every metre along the first lane, from before the first plants to behind the last.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use furrow_navigation::random::Stream;
use furrow_sim::Pose;
use furrow_sim::field::{FieldSpec, vintu2018::Vintu2018Params};
use furrow_sim::lidar::{Fx10, Fx10Params};

/// Small, middle and large plants of each species.
const NURSERIES: [(&str, u32); 6] = [
    ("beech, small", 2),
    ("beech, middle", 24),
    ("beech, large", 47),
    ("laurel, small", 52),
    ("laurel, middle", 68),
    ("laurel, large", 97),
];

fn spec(nursery: u32) -> FieldSpec {
    FieldSpec::Vintu2018(Vintu2018Params { nursery, ..Default::default() })
}

fn scans(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("fx10 scan");
    for (name, number) in NURSERIES {
        let nursery = spec(number).build(1).nursery.expect("it is one");
        let way = 2.0 + nursery.map.row_length_m();
        let mut lidar = Fx10::new(&Fx10Params::default());
        let mut noise = Stream::new(1, "lidar");
        let mut x_m = -1.0;
        group.bench_function(BenchmarkId::from_parameter(name), |bench| {
            bench.iter(|| {
                x_m = if x_m + 1.0 > way { -1.0 } else { x_m + 1.0 };
                let at = Pose { x_m, y_m: 0.0, heading_rad: 0.0 };
                black_box(lidar.scan(&nursery, at, at, &mut noise).points.len())
            });
        });
    }
}

fn builds(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("nursery");
    for (name, number) in NURSERIES {
        let spec = spec(number);
        group.bench_function(BenchmarkId::from_parameter(name), |bench| {
            bench.iter(|| black_box(spec.build(1).plants.len()));
        });
    }
}

criterion_group!(benches, scans, builds);
criterion_main!(benches);
