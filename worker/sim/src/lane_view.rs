//! What a person sees of each kind of lane in the LiDAR's scans, against table 5 of Velasquez et al. (2022), and how leaves fill a
//! lane, against real scans: tests of rows, stems, leaves, weeds and tilted rays together. The robot is carried along the
//! middle; no algorithm takes part.

use furrow_navigation::perception::{Points, Scan};
use furrow_navigation::random::Stream;

use crate::field::lane::Place;
use crate::field::velasquez2022::{LaneName, Velasquez2022Params};
use crate::field::{FieldSeed, FieldSpec};
use crate::lidar::{OnePlanarLidarParams, TiltedLidar};
use crate::observer::operator::label::label;

/// Drawn lanes per lane of a kind.
const LANES: u64 = 4;
/// From one labelled scan to the next: every tenth at 0.7 m/s \[m\].
const EVERY_M: f64 = 0.175;
const LIDAR_X_M: f64 = 0.24;

/// Shows what the LiDAR sees, carried along the middle of a drawn lane: each scan, which of its returns are stems, and its place.
fn carry(lane: LaneName, seed: u64, mut see: impl FnMut(&Scan<'_>, &[bool], Place)) {
    let params = Velasquez2022Params { lane, seed: FieldSeed::Fixed(seed), ..Default::default() };
    let field = FieldSpec::Velasquez2022(params).build(1);
    let lane = field.lane.as_ref().unwrap();
    let mut lidar = TiltedLidar::new(&OnePlanarLidarParams::default());
    let mut noise = Stream::new(seed, "lidar-front");
    for i in 0..(lane.length_m / EVERY_M) as u32 - 10 {
        let along_m = 0.5 + EVERY_M * f64::from(i);
        let pose = lane.pose(&field, along_m);
        let (scan, from_stem) = lidar.scan((&field, lane), pose, along_m, lane.ground(along_m), &mut noise);
        see(&scan, from_stem, lane.place(&field, (pose, LIDAR_X_M), along_m));
    }
}

/// Share of scans in which the left and the right row show [%], mean and standard deviation of the lane's width \[m\].
fn view(lanes: &[LaneName]) -> [f64; 4] {
    let (mut scans, mut valid, mut widths) = (0.0, [0.0; 2], Vec::new());
    for (lane, seed) in lanes.iter().flat_map(|lane| (1..=LANES).map(move |seed| (*lane, seed))) {
        carry(lane, seed, |scan, from_stem, place| {
            let sides = label(scan, from_stem, place.heading_rad, 5);
            scans += 1.0;
            valid.iter_mut().zip(sides).for_each(|(valid, side)| *valid += f64::from(u8::from(side.is_some())));
            if let [Some(left_m), Some(right_m)] = sides {
                widths.push(left_m + right_m);
            }
        });
    }
    let n = widths.len() as f64;
    let mean = widths.iter().sum::<f64>() / n;
    let variance = widths.iter().map(|width| (width - mean) * (width - mean)).sum::<f64>() / (n - 1.0);
    [100.0 * valid[0] / scans, 100.0 * valid[1] / scans, mean, variance.sqrt()]
}

#[test]
fn lanes_look_to_the_lidar_as_the_paper_says() {
    use LaneName::{A, B, C, D, E, F, Production};
    // Table 5; standard deviations follow from its shares within 0.05 and 0.1 m.
    let published: [(&str, &[LaneName], [f64; 4]); 5] = [
        ("straight", &[A], [96.0, 99.5, 0.762, 0.034]),
        ("gap", &[B], [96.011, 93.162, 0.708, 0.050]),
        ("internal border", &[C, D], [78.2, 91.6, 0.754, 0.042]),
        ("external border", &[E, F], [84.053, 97.01, 0.771, 0.048]),
        ("production", &[Production], [94.34, 81.761, 0.766, 0.064]),
    ];
    let mut ours = Vec::new();
    for (kind, lanes, paper) in published {
        let here = view(lanes);
        let close = (0..4).all(|i| (here[i] - paper[i]).abs() <= [8.0, 8.0, 0.02, 0.012][i]);
        ours.push((close, format!("{kind}: {here:.3?}, published {paper:?}")));
    }
    assert!(ours.iter().all(|(close, _)| *close), "{ours:#?}");
}

/// Cells of 20 x 30 mm with returns in them, per scan and at these distances inwards of the nearer row \[m\], 0.1 to 1.9 m ahead.
fn cells(lane: LaneName, inwards_m: [[f64; 2]; 5]) -> [f64; 5] {
    let (mut points, mut scans, mut counts) = (Points::default(), 0.0, [0.0; 5]);
    carry(lane, 1, |scan, _, place| {
        scans += 1.0;
        points.read_scan(scan);
        let cell = |size_m: f64, at_m: f64| (at_m / size_m).floor();
        let mut seen: Vec<_> = points.iter().map(|(x, y)| [cell(0.03, x), cell(0.02, y)]).collect();
        seen.sort_by(|a, b| a.partial_cmp(b).unwrap());
        seen.dedup();
        let (sin, cos) = libm::sincos(place.heading_rad);
        for [x, y] in seen.into_iter().map(|[x, y]| [0.03 * (x + 0.5), 0.02 * (y + 0.5)]) {
            let (x, y) = (cos * x - sin * y, sin * x + cos * y);
            let inwards = if y > 0.0 { place.left_m - y } else { place.right_m + y };
            if x > 0.1 && x < 1.9 {
                let is_in = |[from, to]: &[f64; 2]| inwards >= *from && inwards < *to;
                counts.iter_mut().zip(&inwards_m).for_each(|(n, band)| *n += f64::from(u8::from(is_in(band))));
            }
        }
    });
    counts.map(|n| n / scans)
}

#[test]
fn leaves_fill_the_lane_as_those_of_real_maize_do() {
    let bands = [[0.05, 0.1], [0.1, 0.15], [0.15, 0.2], [0.2, 0.25], [0.25, 0.3]];
    // The mean of 1,630 scans of a TerraSentia under maize (github.com/Felipe-Tommaselli/nn_lidar_perception).
    let real = [25.1, 14.0, 8.3, 5.3, 3.4];
    let ours = cells(LaneName::A, bands);
    let share = |cells: &[f64; 5], band: usize| cells[band] / cells.iter().sum::<f64>();
    for band in 0..5 {
        let gap = share(&ours, band) - share(&real, band);
        assert!(gap.abs() < 0.05 && (ours[band] / real[band] - 1.0).abs() < 0.3, "{ours:.1?}, real {real:?}");
    }
}
