//! What a person sees of each kind of lane in the LiDAR's scans, against table 5 of Velasquez et al. (2022): one test of
//! rows, stems, leaves, weeds and tilted rays together. The robot is carried along the middle; no algorithm takes part.

use furrow_navigation::random::Stream;

use crate::field::velasquez2022::{LaneName, Velasquez2022Params};
use crate::field::{FieldSeed, FieldSpec};
use crate::lidar::{OnePlanarLidarParams, TiltedLidar};
use crate::observer::operator::label::label;

/// Drawn lanes per lane of a kind.
const LANES: u64 = 4;
/// From one labelled scan to the next: every tenth at 0.7 m/s \[m\].
const EVERY_M: f64 = 0.175;
const LIDAR_X_M: f64 = 0.24;

/// Share of scans in which the left and the right row show [%], mean and standard deviation of the lane's width \[m\].
fn view(lanes: &[LaneName]) -> [f64; 4] {
    let (mut scans, mut valid, mut widths) = (0.0, [0.0; 2], Vec::new());
    for (lane, seed) in lanes.iter().flat_map(|lane| (1..=LANES).map(move |seed| (*lane, seed))) {
        let params = Velasquez2022Params { lane, seed: FieldSeed::Fixed(seed), ..Default::default() };
        let field = FieldSpec::Velasquez2022(params).build(1);
        let lane = field.lane.as_ref().unwrap();
        let mut lidar = TiltedLidar::new(&OnePlanarLidarParams::default());
        let mut noise = Stream::new(seed, "lidar-front");
        for i in 0..(lane.length_m / EVERY_M) as u32 - 10 {
            let along_m = 0.5 + EVERY_M * f64::from(i);
            let pose = lane.pose(&field, along_m);
            let heading_rad = lane.place(&field, (pose, LIDAR_X_M), along_m).heading_rad;
            let (scan, from_stem) = lidar.scan((&field, lane), pose, along_m, lane.ground(along_m), &mut noise);
            let sides = label(&scan, from_stem, heading_rad, 5);
            scans += 1.0;
            valid.iter_mut().zip(sides).for_each(|(valid, side)| *valid += f64::from(u8::from(side.is_some())));
            if let [Some(left_m), Some(right_m)] = sides {
                widths.push(left_m + right_m);
            }
        }
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
