//! What the LiDAR sees of nurseries.

use super::*;
use crate::field::FieldSpec;
use crate::field::vintu2018::Vintu2018Params;

fn nursery(params: Vintu2018Params) -> Nursery {
    FieldSpec::Vintu2018(params).build(1).nursery.unwrap()
}

/// Level ground without anything on it.
fn bare() -> Nursery {
    nursery(Vintu2018Params { missing_share: 1.0, weed_factor: 0.0, roughness_factor: 0.0, ..Default::default() })
}

fn exact() -> Fx10Params {
    Fx10Params { range_noise_m: 0.0, ..Default::default() }
}

/// The points of a scan by a robot that stands still, in the robot's frame, and their cells.
fn scan(params: &Fx10Params, nursery: &Nursery, at: Pose) -> (Vec<Point3>, Vec<u32>) {
    let mut lidar = Fx10::new(params);
    let scan = lidar.scan(nursery, at, at, &mut Stream::new(1, "lidar"));
    (scan.points.iter().map(|p| params.mount().robot_from_lidar()(*p)).collect(), scan.cells.to_vec())
}

/// Far from the holes of missing plants.
const ASIDE: Pose = Pose { x_m: -30.0, y_m: 0.0, heading_rad: 2.0 };

#[test]
fn level_ground_is_seen_as_a_plane_below_the_horizon() {
    let (points, cells) = scan(&exact(), &bare(), ASIDE);
    assert!(points.iter().all(|p| p.z.abs() < 2e-6));
    // From 30 degrees down to where the ground is 15 m away: 21 of 40 rows, 50 degrees / 39 apart, and parts of others.
    assert!((0.5..0.62).contains(&(points.len() as f64 / 2600.0)), "{}", points.len());
    let nearest = points.iter().map(|p| p.x).fold(f64::INFINITY, f64::min);
    assert!((nearest - 0.575 - 0.55 / libm::tan(30.0_f64.to_radians()) * 0.87).abs() < 0.03, "{nearest}");
    assert!(cells.windows(2).all(|pair| pair[0] < pair[1]) && cells[cells.len() - 1] == 2599);
    let (first, last) = (points[points.len() - 65], points[points.len() - 1]);
    assert!(first.y > 0.3 && (first.y + last.y).abs() < 1e-9, "a row runs from left to right");
}

#[test]
fn a_ray_that_meets_nothing_gives_no_return() {
    let up = Fx10Params { pitch_down_rad: -0.5, ..exact() };
    assert!(scan(&up, &bare(), ASIDE).0.is_empty());
}

#[test]
fn a_repeated_scan_without_noise_hits_the_same_points() {
    let nursery = nursery(Vintu2018Params { nursery: 30, ..Default::default() });
    let at = Pose { x_m: 3.0, y_m: 0.1, heading_rad: 0.05 };
    let mut lidar = Fx10::new(&exact());
    let mut random = Stream::new(1, "lidar");
    let first = lidar.scan(&nursery, at, at, &mut random).points.to_vec();
    lidar.scan(&nursery, Pose { x_m: 9.0, ..at }, at, &mut random);
    assert_eq!(lidar.scan(&nursery, at, at, &mut random).points, first);
    assert!(first.len() > 1_500);
}

#[test]
fn noise_grows_e_fold_over_ten_metres() {
    let bare = bare();
    let range = |p: &Point3| f64::sqrt(p.x * p.x + p.y * p.y + p.z * p.z);
    let clean: Vec<_> = {
        let mut lidar = Fx10::new(&exact());
        lidar.scan(&bare, ASIDE, ASIDE, &mut Stream::new(1, "lidar")).points.iter().map(range).collect()
    };
    let mut lidar = Fx10::new(&Fx10Params::default());
    let mut random = Stream::new(2, "lidar");
    let (mut squares, mut n) = ([0.0; 12], [0.0; 12]);
    for _ in 0..300 {
        let scan = lidar.scan(&bare, ASIDE, ASIDE, &mut random);
        for (noisy, clean) in scan.points.iter().map(range).zip(&clean) {
            if *clean < 12.0 {
                squares[*clean as usize] += (noisy - clean) * (noisy - clean) / libm::exp(clean / 5.0);
                n[*clean as usize] += 1.0;
            }
        }
    }
    for metre in [1, 2, 3, 6] {
        let sd_m = f64::sqrt(squares[metre] / n[metre]);
        assert!(n[metre] > 5_000.0 && (sd_m - 0.01).abs() < 0.0003, "{metre}: {sd_m}");
    }
}

#[test]
fn ground_and_plants_lie_where_they_are_whatever_the_tilt() {
    let nursery = nursery(Vintu2018Params { nursery: 20, roughness_factor: 3.0, ..Default::default() });
    let mut lidar = Fx10::new(&exact());
    let (mut on_ground, mut at_plants) = (0, 0);
    for i in 0..20 {
        let at = Pose { x_m: 0.3 * f64::from(i), y_m: 0.0, heading_rad: 0.02 * f64::from(i) };
        let world_from_lidar = Frame::of_lidar(exact().mount(), at, nursery.terrain.ground(at));
        for p in lidar.scan(&nursery, at, at, &mut Stream::new(1, "lidar")).points {
            let turned = world_from_lidar.turn([p.x, p.y, p.z]);
            let [x, y, z] = [0, 1, 2].map(|k| world_from_lidar.origin[k] + turned[k]);
            let above = z - nursery.terrain.height_m(x, y);
            let at_plant = nursery.shapes.iter().any(|shape| {
                let (dx, dy) = (x - shape.x_m, y - shape.y_m);
                dx * dx + dy * dy <= shape.crown.radius_m * shape.crown.radius_m + 0.01 && z <= shape.top_z_m() + 1e-9
            });
            assert!(above > -0.08 && (above < 0.05 || at_plant), "{x} {y} {z}: {above}");
            on_ground += i32::from(above < 0.05);
            at_plants += i32::from(above >= 0.05);
        }
    }
    assert!(on_ground > 3_000 && at_plants > 10_000, "{on_ground} {at_plants}");
}

#[test]
fn a_lidar_in_a_crown_sees_the_leaves_around_it() {
    let nursery = nursery(Vintu2018Params { nursery: 99, missing_share: 0.0, leaf_factor: 5.0, ..Default::default() });
    let shape = nursery.shapes[40];
    let at = Pose { x_m: shape.x_m - 0.575, y_m: shape.y_m, heading_rad: 0.0 };
    let (points, _) = scan(&exact(), &nursery, at);
    let near = points.iter().filter(|p| p.x < 0.575 + 0.76).count();
    assert!(near > 1_500 && points.iter().all(|p| p.is_finite()), "{near} of {}", points.len());
}

#[test]
fn a_lissajous_scan_fills_the_field_of_view_and_moves_with_the_robot() {
    let params = Fx10Params { pattern: Pattern::Lissajous, ..exact() };
    let cells: std::collections::BTreeSet<_> = Fx10::new(&params).rays.cells.into_iter().collect();
    assert!(cells.len() > 900 && cells.iter().all(|cell| *cell < 2600), "{}", cells.len());
    let nursery = nursery(Vintu2018Params { nursery: 30, ..Default::default() });
    let (from, to) = (Pose::default(), Pose { x_m: 0.02, y_m: 0.0, heading_rad: 0.02 });
    let mut lidar = Fx10::new(&params);
    let mut random = Stream::new(1, "lidar");
    let mut still = |at| lidar.scan(&nursery, at, at, &mut random).points.to_vec();
    let (before, after) = (still(from), still(to));
    let moving = lidar.scan(&nursery, to, from, &mut random).points.to_vec();
    // Twenty rays at either end take a 130th of the way: 0.2 mm and 0.2 mrad, a millimetre at 5 m. A ray that returns from one of the
    // poses alone, past the edge of a leaf or a clod by a hair, shifts those after it.
    let alike = |some: &mut dyn Iterator<Item = &Point3>, others: &mut dyn Iterator<Item = &Point3>| {
        let others: Vec<_> = others.take(30).collect();
        let near = |a: &Point3, b: &Point3| [a.x - b.x, a.y - b.y, a.z - b.z].iter().all(|gap| gap.abs() < 0.001);
        some.take(20).filter(|point| others.iter().any(|other| near(point, other))).count()
    };
    let begins = alike(&mut moving.iter(), &mut before.iter());
    let ends = alike(&mut moving.iter().rev(), &mut after.iter().rev());
    let stays = alike(&mut before.iter().rev(), &mut after.iter().rev());
    assert!(begins > 12 && ends > 12 && stays < 5, "{begins} {ends} {stays}");
}

#[test]
fn nothing_is_allocated_once_warm() {
    let nursery = nursery(Vintu2018Params { nursery: 70, ..Default::default() });
    let mut lidar = Fx10::new(&Fx10Params::default());
    let mut random = Stream::new(1, "lidar");
    let mut scans = || {
        for i in 0..20 {
            let at = Pose { x_m: 0.3 * f64::from(i), y_m: 0.0, heading_rad: 0.1 * f64::from(i) };
            lidar.scan(&nursery, at, at, &mut random);
        }
    };
    scans();
    assert_eq!(allocation_counter::measure(scans).count_total, 0);
}
