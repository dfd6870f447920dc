use nalgebra::SymmetricEigen;
use proptest::prelude::*;

use super::*;
use crate::random::Stream;

const NOISE: MeasurementNoise = MeasurementNoise { line_m: 0.1, plant_m: 0.1, huber: 1.0 };
const START: Pose = Pose { x_m: 0.3, y_m: 0.02, heading_rad: 0.1 };
const STEP: Pose = Pose { x_m: 0.25, y_m: 0.01, heading_rad: -0.03 };

fn start(sd: f64) -> LinearPrior {
    LinearPrior::new(START, Matrix3::from_diagonal_element(1.0 / (sd * sd)))
}

fn nothing_known() -> LinearPrior {
    LinearPrior::new(START, Matrix3::zeros())
}

fn odometry() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(1.6e4, 9e4, 9e4))
}

fn chain(window: usize, prior: LinearPrior) -> Chain {
    Chain::new(window, 8, NOISE, prior)
}

fn plant(seen: [f64; 2], planted: [f64; 2]) -> Measurement {
    Measurement::Plant { seen, planted }
}

fn row_point(seen: [f64; 2], row_y_m: f64) -> Measurement {
    Measurement::RowPoint { seen, row_y_m, share: 1.0 }
}

/// A chain of `n` more poses; each sees one point of either row and every third one a plant, all a little off.
fn drive(chain: &mut Chain, n: usize, plants: bool) {
    let mut random = Stream::new(1, "test");
    for i in 0..n {
        chain.push(STEP, odometry()).unwrap();
        for side in [-1.0, 1.0] {
            let along = random.between(0.5, 4.0);
            chain.measure(row_point([along, side * 0.65 + 0.05 * random.normal()], side * 0.65));
        }
        if plants && i % 3 == 0 {
            let (x, y) = chain.newest().local(2.0, 0.65);
            chain.measure(plant([x + 0.02 * random.normal(), y + 0.02 * random.normal()], [2.0, 0.65]));
        }
    }
}

fn poses(chain: &Chain) -> Vec<Pose> {
    chain.nodes().map(|(pose, _)| pose).collect()
}

/// The newest pose's information, all others eliminated: singular where the graph does not fix it.
fn information(chain: &mut Chain) -> Matrix3<f64> {
    chain.linearise();
    chain.eliminate_older().unwrap();
    chain.blocks.last().unwrap().own.information
}

/// Its rank: what of the newest pose the graph fixes.
fn rank(mut chain: Chain) -> usize {
    let eigenvalues = SymmetricEigen::new(information(&mut chain)).eigenvalues;
    eigenvalues.iter().filter(|value| **value > 1e-3).count()
}

#[test]
fn without_measurements_the_chain_is_the_odometry() {
    let mut chain = chain(10, start(0.05));
    let mut expected = START;
    for _ in 0..25 {
        chain.push(STEP, odometry()).unwrap();
        chain.optimise(5).unwrap();
        expected = expected.compose(STEP);
    }
    let off = expected.relative(chain.newest());
    assert!(off.x_m.abs() + off.y_m.abs() + off.heading_rad.abs() < 1e-9, "{off:?}");
    assert_eq!(chain.nodes().len(), 10);
}

#[test]
fn the_newest_covariance_is_that_of_the_whole_system_inverted() {
    let mut chain = chain(4, start(0.05));
    drive(&mut chain, 3, true);
    let covariance = chain.optimise(0).unwrap();
    chain.linearise();
    let mut whole = nalgebra::SMatrix::<f64, 12, 12>::zeros();
    for (i, block) in chain.blocks.iter().enumerate() {
        whole.fixed_view_mut::<3, 3>(3 * i, 3 * i).copy_from(&block.own.information);
        if i < 3 {
            whole.fixed_view_mut::<3, 3>(3 * i, 3 * i + 3).copy_from(&block.with_next);
            whole.fixed_view_mut::<3, 3>(3 * i + 3, 3 * i).copy_from(&block.with_next.transpose());
        }
    }
    let inverse = whole.try_inverse().unwrap();
    let newest = inverse.fixed_view::<3, 3>(9, 9);
    assert!((newest - covariance).amax() < 1e-9 * covariance.amax(), "{newest} {covariance}");

    let gradient = nalgebra::SVector::<f64, 12>::from_fn(|i, _| chain.blocks[i / 3].own.gradient[i % 3]);
    let expected = -(inverse * gradient);
    let before = poses(&chain);
    chain.eliminate().unwrap();
    chain.step();
    for (i, (before, after)) in before.iter().zip(poses(&chain)).enumerate() {
        let step = Vector3::new(after.x_m - before.x_m, after.y_m - before.y_m, after.heading_rad - before.heading_rad);
        assert!((step - expected.fixed_rows::<3>(3 * i)).amax() < 1e-10, "{i}");
    }
}

#[test]
fn what_leaves_the_window_is_remembered_exactly() {
    let [mut short, mut long] = [3, 100].map(|window| chain(window, start(0.05)));
    for chain in [&mut short, &mut long] {
        drive(chain, 12, true);
    }
    // Linearised at the same poses, both give the same information and the same step.
    let (covariance, expected) = (short.optimise(0).unwrap(), long.optimise(0).unwrap());
    assert!((covariance - expected).amax() < 1e-9 * expected.amax(), "{covariance} {expected}");
    for chain in [&mut short, &mut long] {
        chain.step();
    }
    let off = short.newest().relative(long.newest());
    assert!(off.x_m.abs() + off.y_m.abs() + off.heading_rad.abs() < 1e-10, "{off:?}");
}

#[test]
fn optimised_poses_are_where_the_gradient_vanishes() {
    let mut chain = chain(20, start(0.05));
    drive(&mut chain, 15, true);
    let before = chain.linearise();
    chain.optimise(30).unwrap();
    let after = chain.linearise();
    assert!(after < before);
    let steepest = chain.blocks.iter().map(|block| block.own.gradient.amax()).fold(0.0, f64::max);
    // In units of the steepest information, a thousandth of a millimetre.
    assert!(steepest < 1e-6 * 1e5, "{steepest}");
}

#[test]
fn lines_leave_the_place_along_the_row_open_and_plants_fix_it() {
    let mut lines = chain(20, nothing_known());
    drive(&mut lines, 10, false);
    assert_eq!(rank(lines.clone()), 2);
    let information = information(&mut lines);
    assert!(information.column(0).amax() < 1e-3, "{information}");
    assert_eq!(lines.optimise(3), Err(Unsolvable));

    let mut plants = chain(20, nothing_known());
    drive(&mut plants, 10, true);
    assert_eq!(rank(plants.clone()), 3);
    assert!(plants.optimise(3).is_ok());

    let mut as_angles = chain(20, nothing_known());
    as_angles.push(STEP, odometry()).unwrap();
    let seen = [std::f64::consts::FRAC_PI_2 - 0.07, 0.6];
    as_angles.measure(Measurement::RowLine { seen, row_y_m: 0.65, sds: [0.05, 0.1] });
    assert_eq!(rank(as_angles), 2);
    let mut bare = chain(20, nothing_known());
    bare.push(STEP, odometry()).unwrap();
    assert_eq!(rank(bare), 0);
}

#[test]
fn an_unsolvable_chain_keeps_its_poses() {
    let mut chain = chain(20, nothing_known());
    drive(&mut chain, 5, false);
    let before = poses(&chain);
    assert_eq!(chain.optimise(3), Err(Unsolvable));
    assert_eq!(poses(&chain), before);
}

#[test]
fn one_wrong_plant_moves_the_chain_by_no_more_than_the_kernel_allows() {
    let newest = |wrong_m: f64| {
        let mut chain = chain(20, start(0.05));
        drive(&mut chain, 10, true);
        let (x, y) = chain.newest().local(2.0, 0.65);
        chain.measure(plant([x + wrong_m, y], [2.0, 0.65]));
        chain.optimise(20).unwrap();
        chain.newest().x_m
    };
    let [right, far, further] = [0.0, 0.5, 1.0].map(newest);
    // Beyond the kernel's threshold the pull is constant: twice as wrong moves it no further.
    assert!((right - far).abs() < 0.05 && (far - further).abs() < 0.01, "{right} {far} {further}");
}

fn odd() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -3.0..3.0_f64,
        1 => prop_oneof![Just(0.0), Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e-300), Just(9e5)],
    ]
}

proptest! {
    #[test]
    fn odd_inputs_are_an_error_or_leave_finite_poses(
        steps in proptest::collection::vec(([odd(), odd(), odd()], odd(), [odd(), odd(), odd(), odd()], 0..3), 1..12),
        known in any::<bool>(),
    ) {
        let mut chain = chain(4, if known { start(0.05) } else { nothing_known() });
        for ([x_m, y_m, heading_rad], weight, [a, b, c, d], kind) in steps {
            let _ = chain.push(Pose { x_m, y_m, heading_rad }, Matrix3::from_diagonal_element(weight));
            chain.measure(match kind {
                0 => row_point([a, b], c),
                1 => Measurement::RowLine { seen: [a, b], row_y_m: c, sds: [d, 0.1] },
                _ => plant([a, b], [c, d]),
            });
            let before = poses(&chain);
            let solved = chain.optimise(3);
            prop_assert!(poses(&chain).iter().all(|pose| is_finite(*pose)));
            match solved {
                Ok(covariance) => prop_assert!(covariance.iter().all(|entry| entry.is_finite())),
                Err(Unsolvable) => prop_assert_eq!(poses(&chain), before),
            }
        }
    }
}
