//! The same bits from any number of lanes.

use proptest::prelude::*;
use pulp::{Arch, Scalar, Scalar128b, Scalar256b, Scalar512b, WithSimd};

use super::bands::{BandSums, Distances, Moments};
use super::from_whole;
use super::nearest::NearestLines;
use super::pairs::{SumApart, Weights};
use super::same::{CountParallel, FitTriples, GROUP, SameLines};

/// Runs a loop one by one, by two, four and eight double-precision numbers, and as this machine does.
macro_rules! in_any_lanes {
    ($run:expr) => {{
        let run = $run;
        let alone = run(Lanes::One);
        for lanes in [Lanes::Two, Lanes::Four, Lanes::Eight, Lanes::Native] {
            prop_assert_eq!(&alone, &run(lanes));
        }
        alone
    }};
}

#[derive(Clone, Copy)]
enum Lanes {
    One,
    Two,
    Four,
    Eight,
    Native,
}

impl Lanes {
    fn run<T: WithSimd>(self, work: T) -> T::Output {
        match self {
            Self::One => work.with_simd(Scalar),
            Self::Two => work.with_simd(Scalar128b),
            Self::Four => work.with_simd(Scalar256b),
            Self::Eight => work.with_simd(Scalar512b),
            Self::Native => Arch::new().dispatch(work),
        }
    }
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

fn bits32(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

fn points() -> impl Strategy<Value = Vec<(f64, f64)>> {
    proptest::collection::vec((-4.0..4.0_f64, -4.0..4.0_f64), 0..45)
}

fn single(numbers: &[f64]) -> Vec<f32> {
    numbers.iter().map(|number| *number as f32).collect()
}

proptest! {
    #[test]
    fn sums_over_bands(points in points(), slope in -1.0..1.0_f64, intercept in -1.0..1.0_f64, reach in 0.1..3.0_f64) {
        let (x_m, y_m): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
        let sums = || BandSums { band: [slope, intercept, reach], x_m: &x_m, y_m: &y_m };
        in_any_lanes!(|lanes: Lanes| bits(&lanes.run(Moments(sums()))));
        in_any_lanes!(|lanes: Lanes| bits(&lanes.run(Distances(sums(), 0.1, -0.2))));
    }

    #[test]
    fn nearest_lines_weights_and_sums(points in points(), lines in points()) {
        let (x_m, y_m): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
        let (x_m, y_m) = (single(&x_m), single(&y_m));
        let n = x_m.len();
        let lines: Vec<[f32; 4]> =
            (0..).zip(&lines).map(|(i, (a, b))| [*a as f32, 1.0, *b as f32, from_whole(i)]).collect();
        let owners = in_any_lanes!(|lanes: Lanes| {
            let (mut nearest_m, mut numbers) = (vec![0.3; n], vec![from_whole(super::LARGEST); n]);
            let (nearest, which) = (&mut nearest_m, &mut numbers);
            lanes.run(NearestLines { lines: &lines, x_m: &x_m, y_m: &y_m, nearest_m: nearest, numbers: which });
            (bits32(&nearest_m), numbers.into_iter().map(super::to_whole).collect::<Vec<u32>>())
        });
        let mut weights = Vec::new();
        for i in 0..n {
            let row = in_any_lanes!(|lanes: Lanes| {
                let mut weights = vec![0.0; i];
                let others = [&x_m[..i], &y_m[..i]];
                lanes.run(Weights { x_m: x_m[i], y_m: y_m[i], others, weights: &mut weights });
                bits32(&weights)
            });
            weights.extend(row.into_iter().map(|bits| super::to_whole(f32::from_bits(bits))));
        }
        in_any_lanes!(|lanes: Lanes| lanes.run(SumApart { weights: &weights, owners: &owners.1 }));
    }

    #[test]
    fn fits_and_same_lines(corners in proptest::collection::vec((points_of_three(), points_of_three()), 0..45)) {
        let n = corners.len();
        let corner = |i: usize| -> (Vec<f64>, Vec<f64>) { corners.iter().map(|(x, y)| (x[i], y[i])).unzip() };
        let [first, second, third] = [corner(0), corner(1), corner(2)];
        let room = n.next_multiple_of(GROUP);
        let places: Vec<f32> = (0..room).map(|i| i as f32).collect();
        in_any_lanes!(|lanes: Lanes| {
            let (mut slopes, mut intercepts_m) = (vec![0.0; n], vec![0.0; n]);
            let mut compared = [(); 4].map(|()| vec![0.0; room]);
            let mut new = vec![0.0; room];
            lanes.run(FitTriples {
                x_m: [&first.0, &second.0, &third.0],
                y_m: [&first.1, &second.1, &third.1],
                slopes: &mut slopes,
                intercepts_m: &mut intercepts_m,
                compared: compared.each_mut().map(|all| &mut all[..n]),
                new: &mut new[..n],
            });
            let tolerances: Vec<f64> = slopes.iter().map(|slope| 0.1 + 0.1 * slope.abs()).collect();
            let mut counts = vec![1.0; n];
            lanes.run(CountParallel { slopes: &slopes, tolerances: &tolerances, counts: &mut counts });
            let lines = compared.each_ref().map(Vec::as_slice);
            lanes.run(SameLines { lines, places: &places, n, before: &[[0.1, 0.5]], new: &mut new });
            (bits(&slopes), bits(&intercepts_m), bits(&counts), bits32(&new[..n]))
        });
    }
}

fn points_of_three() -> impl Strategy<Value = [f64; 3]> {
    [-4.0..4.0_f64, -4.0..4.0_f64, -4.0..4.0_f64]
}
