//! What each line finder costs per scan: `cargo bench -p furrow-navigation`.
//!
//! The scans in the folder `scans` were made by the simulator in the middle of the first inter-row of each crop of
//! Guyonneau et al. (2022): a scan a line, a range a beam \[m\] from right to left, empty where there is no return.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use furrow_navigation::parameters::Kinds;
use furrow_navigation::perception::{Beams, LineFinderSpec, Scan};
use furrow_navigation::random::Stream;
use serde_json::Map;

const SCANS: [&str; 4] = [
    include_str!("scans/crop-1.csv"),
    include_str!("scans/crop-2.csv"),
    include_str!("scans/crop-3.csv"),
    include_str!("scans/crop-4.csv"),
];

fn read(text: &str) -> Vec<Vec<f64>> {
    let range = |field: &str| if field.is_empty() { Ok(f64::INFINITY) } else { field.parse() };
    let scan = |line: &str| line.split(',').map(range).collect::<Result<_, _>>().expect("the files hold numbers");
    text.lines().map(scan).collect()
}

fn line_finders(criterion: &mut Criterion) {
    for kind in LineFinderSpec::kinds() {
        let mut group = criterion.benchmark_group(kind);
        for (crop, text) in (1..).zip(SCANS) {
            let scans = read(text);
            let beams = Beams::new(scans[0].len(), std::f64::consts::PI);
            let mut finder = LineFinderSpec::read_kind(kind, Map::new()).expect("defaults are allowed").build();
            let mut random = Stream::new(1, "line-finder-front");
            let mut turn = scans.iter().cycle();
            group.bench_function(BenchmarkId::from_parameter(format!("crop-{crop}")), |bench| {
                bench.iter(|| {
                    let ranges_m = turn.next().expect("a cycle has no end");
                    black_box(finder.find(&Scan { beams: &beams, ranges_m }, &mut random).lines.len())
                });
            });
        }
    }
}

criterion_group!(benches, line_finders);
criterion_main!(benches);
