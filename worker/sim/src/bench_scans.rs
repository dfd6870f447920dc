//! The scans on which the line finders are timed are what the simulator makes.
//!
//! After a change to fields or LiDAR: `UPDATE_GOLDEN=1 cargo test -p furrow-sim bench_scans`.

use std::fmt::Write as _;
use std::path::PathBuf;

use furrow_navigation::random::Stream;

use crate::Pose;
use crate::field::{FieldSeed, FieldSpec, guyonneau2022::Guyonneau2022Params};
use crate::lidar::{PlanarLidar, TwoPlanarLidarsParams};
use crate::run::STEP_S;

const SCANS: u32 = 20;
/// Full speed along a row \[m/s\].
const SPEED_M_S: f64 = 0.137;

/// Scans of the front LiDAR while the robot drives on from the middle of the first inter-row, field seed 1.
fn scans(crop: u32) -> String {
    let field = FieldSpec::Guyonneau2022(Guyonneau2022Params { crop, seed: FieldSeed::Fixed(1) }).build(1);
    let [x_m, y_m] = field.middles[0].at(0.5 * field.middles[0].length_m());
    let mut lidar = PlanarLidar::new(&TwoPlanarLidarsParams::default());
    let mut noise = Stream::new(1, "lidar-front");
    let mut text = String::new();
    for i in 0..SCANS {
        let robot = Pose { x_m: x_m + f64::from(i) * SPEED_M_S * STEP_S, y_m, heading_rad: 0.0 };
        let scan = lidar.scan(&field.plants, robot.sensor(0.5, false), &mut noise);
        for (beam, range_m) in scan.ranges_m.iter().enumerate() {
            text.push_str(if beam > 0 { "," } else { "" });
            if range_m.is_finite() {
                write!(text, "{range_m:.4}").unwrap();
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn the_scans_for_timing_are_those_of_the_simulator() {
    for crop in 1..=4 {
        let path = format!("../navigation/benches/scans/crop-{crop}.csv");
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path);
        let scans = scans(crop);
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            std::fs::write(&path, &scans).unwrap();
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), scans, "crop {crop}; see the head of this file");
    }
}
