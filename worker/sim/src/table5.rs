//! The number of LiDAR points at the beginning of a run, against table 5 of Guyonneau et al. (2022): one test of
//! fields, stems, rays and the fusing of points together.

use furrow_navigation::perception::Points;
use furrow_navigation::random::Stream;

use crate::Pose;
use crate::field::{FieldSeed, FieldSpec, guyonneau2022::Guyonneau2022Params};
use crate::lidar::{PlanarLidar, TwoPlanarLidarsParams};

/// Drawn fields per crop.
const FIELDS: u64 = 50;

/// Mean raw and fused points of the front LiDAR over the first 500 scans: 2.5 s standing, then 10 s at 0.137 m/s.
fn mean_points(crop: u32) -> (f64, f64) {
    let (mut raw, mut fused, mut scans) = (0.0, 0.0, 0.0);
    let mut points = Points::default();
    for seed in 1..=FIELDS {
        let field = FieldSpec::Guyonneau2022(Guyonneau2022Params { crop, seed: FieldSeed::Fixed(seed) }).build(1);
        let mut lidar = PlanarLidar::new(&TwoPlanarLidarsParams::default());
        let mut random = Stream::new(seed, "lidar-front");
        for scan in (0..500).step_by(10) {
            let x_m = 0.137 * (0.025 * f64::from(scan) - 2.5).max(0.0);
            let at = Pose { x_m, ..Pose::default() }.sensor(0.5, false);
            let scan = lidar.scan(&field.plants, at, &mut random);
            points.read_scan(&scan);
            raw += points.len() as f64;
            points.read_scan_fused(&scan, 0.05);
            fused += points.len() as f64;
            scans += 1.0;
        }
    }
    (raw / scans, fused / scans)
}

#[test]
fn the_lidar_sees_as_many_points_as_the_paper_says() {
    // Rows ruby and rgop of table 5; 10 % for crops 1 to 3, 15 % for crop 4.
    let published = [(91.0, 40.1, 0.10), (179.3, 73.12, 0.10), (122.54, 54.18, 0.10), (120.36, 47.16, 0.15)];
    for (crop, (raw, fused, share)) in (1..).zip(published) {
        let (mean_raw, mean_fused) = mean_points(crop);
        assert!((mean_raw / raw - 1.0).abs() <= share, "crop {crop}: {mean_raw} raw points, published {raw}");
        assert!((mean_fused / fused - 1.0).abs() <= share, "crop {crop}: {mean_fused} fused points, published {fused}");
    }
}
